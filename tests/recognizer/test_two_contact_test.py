"""The two-contact test as an octagon against the half-planes that it stands for, and against plain search."""

import math

import numpy as np
import pytest
from shapely_bench import SHIPPED_OBJECTS, outlines
from triples import PAIR_TRIPLES, arc_hull, triple_arcs

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.model_test import half_planes, two_contact_hull

WIDTHS = (0.0, 1e-6, 0.01, 0.3, 1.5, math.pi, 5.0, 2 * math.pi)
SETTINGS = [(bound, radius) for bound in (0.0, 0.3, 2.0) for radius in (0.0, 5.0)]


def contact_at(point: Floats, bound: float, radius: float = 5.0) -> Contact:
    x, y = (float(value) for value in point)
    return Contact("f", Finger(radius, 10.0), True, (x - 100.0, y), (x, y), bound)


def pairs_that_may_fit(
    edges: EdgeSet, rng: np.random.Generator, count: int
) -> tuple[Ints, Ints, Floats, Floats]:
    """Pairs of edges of one state, and a chord in W that θ, returned last, lays on them or nearly."""
    edge_a = rng.integers(0, len(edges.state), count)
    state = edges.state[edge_a]
    edge_b = edges.first[state] + rng.integers(0, edges.count[state])
    along = rng.uniform(-0.2, 1.2, (2, count, 1))
    q_a, q_b = (
        edges.start[edge] + part * (edges.end[edge] - edges.start[edge])
        for edge, part in zip((edge_a, edge_b), along, strict=True)
    )
    theta = rng.uniform(-math.pi, math.pi, count)
    x, y = (q_b - q_a + rng.normal(0, rng.choice([0.0, 0.5, 5.0], (count, 1)), (count, 2))).T
    cos, sin = np.cos(theta), np.sin(theta)
    return edge_a, edge_b, np.column_stack([cos * x - sin * y, sin * x + cos * y]), theta


def intervals(rng: np.random.Generator, theta: Floats) -> tuple[Floats, Floats]:
    """Orientation intervals of all widths, about half of them round θ, some by a turn or two off."""
    width = rng.choice(WIDTHS, len(theta))
    lo = np.where(
        rng.uniform(size=len(theta)) < 0.5,
        theta - rng.uniform(size=len(theta)) * width,
        rng.uniform(-4, 4, len(theta)),
    )
    lo = lo + 2 * np.pi * rng.integers(-2, 3, len(theta))
    return lo, lo + width


def by_triples(
    edges: EdgeSet, a: int, one: Contact, b: int, two: Contact, lo: float, hi: float
) -> tuple[float, float]:
    """The same hull from the half-planes of both contacts; anchored at the first contact's end."""
    anchor = np.array(one.end_mm)
    planes = [half_planes(edges, np.array([k]), c, anchor) for k, c in ((a, one), (b, two))]
    g, coefficients = (np.concatenate([plane[part] for plane in planes], axis=1) for part in (0, 1))
    conditions = triple_arcs(g, coefficients, PAIR_TRIPLES)
    begin, end = arc_hull(np.array([lo]), np.array([hi]), conditions)
    return float(begin[0]), float(end[0])


def by_chord(
    catalogue: Catalogue, a: int, one: Contact, b: int, two: Contact, lo: float, hi: float
) -> tuple[float, float]:
    begin, end = two_contact_hull(catalogue, np.array([[a, b]]), [one, two], np.array([lo]), np.array([hi]))
    return float(begin[0]), float(end[0])


@pytest.mark.parametrize(("bound", "radius"), SETTINGS)
def test_same_hull_as_the_triples(bound: float, radius: float) -> None:
    rng = np.random.default_rng(int(10 * bound + radius))
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    edges = catalogue.edges(Finger(radius, 10.0))
    edge_a, edge_b, chord, theta = pairs_that_may_fit(edges, rng, 1500)
    lo, hi = intervals(rng, theta)
    left = 0
    for k in range(len(edge_a)):
        at = rng.uniform(-50, 50, 2)
        one, two = (contact_at(point, bound, radius) for point in (at, at + chord[k]))
        pair = (int(edge_a[k]), one, int(edge_b[k]), two)
        interval = float(lo[k]), float(hi[k])
        mine, other = by_chord(catalogue, *pair, *interval), by_triples(edges, *pair, *interval)
        left += mine[0] <= mine[1]
        both_empty = mine[0] > mine[1] and other[0] > other[1]
        assert both_empty or np.allclose(mine, other, rtol=0, atol=1e-9), (k, pair, interval, mine, other)
    assert left > 200


def corners(edges: EdgeSet, edge: Ints, bound: float) -> Floats:
    """Corners (n, 4, 2) of the rectangles in which the contact's centre may lie, in the object's frame."""
    direction, normal = edges.direction[edge], edges.normal[edge]
    before = edges.start[edge] - direction * (edges.slack_along[edge] + bound)[:, None]
    after = edges.end[edge] + direction * (edges.slack_along[edge] + bound)[:, None]
    outer, inner = (edges.slack_out[edge] + bound)[:, None], (edges.slack_in[edge] + bound)[:, None]
    return np.stack(
        [before + normal * outer, after + normal * outer, after - normal * inner, before - normal * inner],
        axis=1,
    )


def rectangles_meet(one: Floats, two: Floats) -> np.ndarray:
    """Whether rectangles (n, 4, 2) have a point in common, by separating axes along their own sides."""
    meet = np.ones(len(one), dtype=bool)
    for rectangle in (one, two):
        for k in (0, 1):
            axis = rectangle[:, k + 1] - rectangle[:, k]
            axis = axis / np.maximum(np.hypot(*axis.T), 1e-300)[:, None]
            a, b = np.einsum("nvj,nj->nv", one, axis), np.einsum("nvj,nj->nv", two, axis)
            meet &= (a.min(axis=1) <= b.max(axis=1)) & (b.min(axis=1) <= a.max(axis=1))
    return meet


@pytest.mark.parametrize(("bound", "radius"), SETTINGS)
def test_nothing_that_fits_is_outside_of_the_hull(bound: float, radius: float) -> None:
    """On a fine grid of θ, both error rectangles as the object's position sees them, laid over each other."""
    rng = np.random.default_rng(100 + int(10 * bound + radius))
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    edges = catalogue.edges(Finger(radius, 10.0))
    edge_a, edge_b, chord, theta = pairs_that_may_fit(edges, rng, 400)
    lo, hi = intervals(rng, theta)
    fitted = 0
    for k in range(len(edge_a)):
        one, two = (contact_at(point, bound, radius) for point in (np.zeros(2), chord[k]))
        pair = (int(edge_a[k]), one, int(edge_b[k]), two)
        begin, end = by_chord(catalogue, *pair, float(lo[k]), float(hi[k]))
        grid = np.linspace(lo[k], hi[k], 1500)
        inside = (theta[k] - lo[k]) % (2 * np.pi)
        if inside <= hi[k] - lo[k]:
            grid = np.append(grid, lo[k] + inside)
        cos, sin = np.cos(grid), np.sin(grid)
        x, y = chord[k]
        seen = np.column_stack([cos * x + sin * y, cos * y - sin * x])
        one = -corners(edges, edge_a[k : k + 1], bound)
        two = seen[:, None] - corners(edges, edge_b[k : k + 1], bound)
        fits = grid[rectangles_meet(np.broadcast_to(one, two.shape), two)]
        fitted += len(fits) > 0
        if len(fits):
            assert begin <= fits.min(), (k, pair, begin, fits.min())
            assert end >= fits.max(), (k, pair, end, fits.max())
    assert fitted > 20


def test_edges_of_two_fingers() -> None:
    """The first contact's edge is taken from the first set, the second's from the second."""
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS)[:1])
    thin, thick = (catalogue.edges(Finger(radius, 10.0)) for radius in (0.0, 5.0))
    q_a = thin.start[2] + 0.4 * (thin.end[2] - thin.start[2])
    q_b = thick.start[7] + 0.6 * (thick.end[7] - thick.start[7])
    one, two = contact_at(q_a, 0.01, 0.0), contact_at(q_b, 0.01)
    lo, hi = two_contact_hull(catalogue, np.array([[2, 7]]), [one, two], np.array([-0.5]), np.array([0.5]))
    assert lo[0] <= 0.0 <= hi[0]
    assert hi[0] - lo[0] < 1.0


def test_points_that_coincide_leave_every_orientation_or_none() -> None:
    """A chord without length: edges that meet at a corner fit at any θ, edges far apart at none."""
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS)[2:3])
    edges = catalogue.edges(Finger(0.0, 10.0))
    follower = int(np.flatnonzero(np.all(edges.start == edges.end[0], axis=1))[0])
    far = int(np.argmax(np.hypot(*(edges.middle - edges.middle[0]).T)))
    point = contact_at(np.array([3.0, 4.0]), 0.1, 0.0)
    for other, allowed in ((follower, True), (far, False)):
        begin, end = by_chord(catalogue, 0, point, other, point, -1.0, 4.0)
        assert (begin <= end) == allowed
        assert not allowed or (begin, end) == pytest.approx((-1.0, 4.0))
