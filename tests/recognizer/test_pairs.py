"""Tests of pairs and triples of contacts."""

import itertools
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from palpate.base.geometry import Floats, Ints, ObjectModel
from palpate.base.geometry.plane import distance_range
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.interpretation_tree import (
    filter_by_distance,
    first_level,
    narrow_by,
    pair_by_angle,
    second_level,
)
from palpate.recognizer.interpretations import Interpretations, Query
from palpate.recognizer.model_test import half_planes, sinusoid_maximum
from palpate.recognizer.steps import Steps
from support.campaign.sampling import sample
from support.oracles.kernel import both_sides
from support.oracles.outlines import PAIR_TRIPLES, TRIPLE_TRIPLES, arc_hull, triple_arcs
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, grip, outlines, place

# ----------------------------------------------------------------------------------------------------
# Pairs of edges for two contacts at once, against every pair tried one after the other.

THIN, THICK = Finger(0.0, 10.0), Finger(5.0, 10.0)
_ROUNDING_RAD = 1e-9
FINGERS = [(THIN, THIN), (THICK, THICK), (THIN, THICK), (THICK, THIN)]


def models() -> list[ObjectModel]:
    """Shipped parts, a square (four-fold symmetric) and parallel edges in plenty."""
    comb = [(x, 20 if k % 4 in (1, 2) else 8) for k, x in enumerate(np.repeat(np.arange(-30.0, 31.0, 10), 2))]
    square = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])
    return [*outlines(SHIPPED_OBJECTS)[:4], square, flat("comb", [(-30, -20), (30, -20), *comb[-2::-1]])]


@cache
def catalogue(flat_edges: int = 600) -> Catalogue:
    return Catalogue(models(), flat_edges=flat_edges)


def exact_ranges(first: EdgeSet, a: np.ndarray, second: EdgeSet, b: np.ndarray) -> tuple:
    shortest, longest = distance_range(first.start[a], first.end[a], second.start[b], second.end[b])
    slack = first.slack_mm[a] + second.slack_mm[b]
    return shortest - slack, longest + slack


def allowed_pairs(
    first: EdgeSet, second: EdgeSet, one: NormalRange, two: NormalRange, distance: float, bound: float
) -> set[tuple[int, int]]:
    """Every pair of one state, its first edge representative, that turn and distance allow."""
    lo, hi = two.lo_rad - one.hi_rad, two.hi_rad - one.lo_rad
    found = set()
    for a in np.flatnonzero(first.representative):
        state = first.state[a]
        b = np.arange(second.first[state], second.first[state + 1])
        shortest, longest = exact_ranges(first, np.full(len(b), a), second, b)
        span = first.span[a] + second.span[b]
        turn = second.normal_rad[b] - first.normal_rad[a]
        # Some copy of the turn, a whole number of turns away, lies in the window.
        below = np.ceil((lo - span - turn) / (2 * np.pi)) * 2 * np.pi + turn
        fits = (below <= hi + span) & (shortest <= distance + bound) & (longest >= distance - bound)
        found |= {(int(a), int(k)) for k in b[fits]}
    return found


@pytest.mark.parametrize("steps", both_sides())
@pytest.mark.parametrize("trials", sample([40, 150], [40]))
@pytest.mark.parametrize(
    ("fingers", "flat_edges"), [(pair, (600, 20)[k % 2]) for k, pair in enumerate(FINGERS)]
)
def test_every_pair_that_two_points_lie_on_is_found(
    steps: Steps, fingers: tuple[Finger, Finger], flat_edges: int, trials: int
) -> None:
    """Points of two edges, mismeasured, with normal ranges of all widths that just hold the true normals."""
    rng = np.random.default_rng(31)
    first, second = (catalogue(flat_edges).edges(finger) for finger in fingers)
    total = 0
    for trial in range(trials):
        a = int(rng.choice(np.flatnonzero(first.representative)))
        state = first.state[a]
        b = int(rng.integers(second.first[state], second.first[state + 1]))
        theta, bound = rng.uniform(-7, 7), rng.choice([0.0, 0.3, 5.0])
        ends = rng.choice([0.0, 1.0, rng.uniform()], 2)
        gap = second.start[b] + ends[1] * (second.end[b] - second.start[b])
        gap = gap - first.start[a] - ends[0] * (first.end[a] - first.start[a])
        cos, sin = math.cos(theta), math.sin(theta)
        angle = rng.uniform(0, 2 * math.pi)
        chord = np.array([cos * gap[0] - sin * gap[1], sin * gap[0] + cos * gap[1]])
        chord = chord + bound * np.array([math.cos(angle), math.sin(angle)])
        ranges = []
        for normal, span in ((first.normal_rad[a], first.span[a]), (second.normal_rad[b], second.span[b])):
            width = rng.choice([0.0, 1e-3, 0.5, 2.0, 6.2, 2 * math.pi])
            true = normal + theta + rng.choice([-1.0, 0.0, 1.0]) * span
            lo = true - rng.choice([0.0, 1.0, rng.uniform()]) * width
            width = min(width + 2 * _ROUNDING_RAD, 2 * math.pi)
            ranges.append(NormalRange(float(lo - _ROUNDING_RAD), float(lo - _ROUNDING_RAD + width)))
        one, two = ranges
        contacts = [
            Contact("f", finger, True, (x - 100, y), (x, y), float(bound) / 2)
            for finger, (x, y) in zip(fingers, ((0.0, 0.0), chord.tolist()), strict=True)
        ]
        query = Query(catalogue(flat_edges), contacts, np.zeros(2))
        children = steps.second_level(query, ranges, None, modelled=False).children
        found = list(zip(children.parent.tolist(), children.edge.tolist(), strict=True))
        assert len(set(found)) == len(found)
        assert (a, b) in found, trial
        wide = NormalRange(two.lo_rad - 1e-6, min(two.hi_rad + 1e-6, two.lo_rad - 1e-6 + 2 * math.pi))
        distance = float(np.hypot(*chord))
        assert set(found) <= allowed_pairs(first, second, one, wide, distance, bound + 1e-3), trial
        total += len(found)
    assert total > 7 * trials


def as_rows(nodes: Interpretations) -> np.ndarray:
    """Interpretations as rows (n, 4) of edges, lo and hi, in the order of their edges."""
    rows = np.column_stack([nodes.edges, nodes.lo, nodes.hi])
    return rows[np.lexsort(rows.T[::-1])]


@pytest.mark.parametrize("flat_edges", [600, 20])
@pytest.mark.parametrize("half_range", [None, math.radians(1), math.radians(15), math.radians(100)])
@pytest.mark.parametrize("radii", [(0.0, 0.0), (5.0, 0.0)])
def test_both_ways_to_the_second_level(
    radii: tuple[float, float], half_range: float | None, flat_edges: int
) -> None:
    """Looking both contacts up at once leaves what one level after the other does."""
    rng = np.random.default_rng(34)
    left = 0
    for trial in range(6):
        placed = place(models()[trial], rng)
        contacts: list[Contact] = []
        for radius in radii:
            some = grip(placed, rng, fingers=2, radius=radius, bound=0.3 * (trial % 3), half_range=half_range)
            contacts += [c for c in some if c.touched][:1]
        if len(contacts) < 2:
            continue
        query = Query(catalogue(flat_edges), contacts, np.zeros(2))
        nodes, _ = first_level(catalogue(flat_edges), contacts[0])
        at_once, count = second_level(query, nodes)
        in_turn = narrow_by(query, filter_by_distance(query, pair_by_angle(query, nodes), 0), 0)
        one, two = as_rows(at_once), as_rows(in_turn)
        assert one.shape == two.shape
        np.testing.assert_array_equal(one[:, :2], two[:, :2])
        # Of wide ranges that meet in two pieces the hull is kept: narrowed in another order, another hull.
        if half_range is None or half_range < 1.0:
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)
        assert count.after_model == len(one)
        assert np.all(catalogue(flat_edges).edges(contacts[0].finger).representative[at_once.edges[:, 0]])
        left += len(one)
    assert left > 20


def test_normals_that_allow_nothing_leave_no_pair() -> None:
    against = Contact("a", THICK, True, (-100.0, 0.0), (-25.0, 0.0), 0.3, NormalRange(-0.1, 0.1))
    other = Contact("b", THICK, True, (100.0, 0.0), (25.0, 0.0), 0.3)
    for contacts in ([against, other], [other, against]):
        query = Query(catalogue(), contacts, np.zeros(2))
        nodes, count = second_level(query, first_level(catalogue(), contacts[0])[0])
        assert len(nodes) == count.after_model == 0


# ----------------------------------------------------------------------------------------------------
# The two-contact test as an octagon against the half-planes that it stands for, and against plain search.

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
    steps: Steps, catalogue: Catalogue, a: int, one: Contact, b: int, two: Contact, lo: float, hi: float
) -> tuple[float, float]:
    query = Query(catalogue, [one, two], np.zeros(2))
    begin, end = steps.narrow(query, np.array([[a, b]]), np.array([lo]), np.array([hi]))
    return float(begin[0]), float(end[0])


@pytest.mark.parametrize("steps", both_sides())
@pytest.mark.parametrize(("bound", "radius"), sample(SETTINGS, SETTINGS[1::3]))
def test_same_hull_as_the_triples(steps: Steps, bound: float, radius: float) -> None:
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
        mine, other = by_chord(steps, catalogue, *pair, *interval), by_triples(edges, *pair, *interval)
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


@pytest.mark.parametrize("steps", both_sides())
@pytest.mark.parametrize(("bound", "radius"), sample(SETTINGS, SETTINGS[2::2]))
def test_nothing_that_fits_is_outside_of_the_hull(steps: Steps, bound: float, radius: float) -> None:
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
        begin, end = by_chord(steps, catalogue, *pair, float(lo[k]), float(hi[k]))
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


@pytest.mark.parametrize("steps", both_sides())
def test_edges_of_two_fingers(steps: Steps) -> None:
    """The first contact's edge is taken from the first set, the second's from the second."""
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS)[:1])
    thin, thick = (catalogue.edges(Finger(radius, 10.0)) for radius in (0.0, 5.0))
    q_a = thin.start[2] + 0.4 * (thin.end[2] - thin.start[2])
    q_b = thick.start[7] + 0.6 * (thick.end[7] - thick.start[7])
    one, two = contact_at(q_a, 0.01, 0.0), contact_at(q_b, 0.01)
    lo, hi = by_chord(steps, catalogue, 2, one, 7, two, -0.5, 0.5)
    assert lo <= 0.0 <= hi
    assert hi - lo < 1.0


@pytest.mark.parametrize("steps", both_sides())
def test_points_that_coincide_leave_every_orientation_or_none(steps: Steps) -> None:
    """A chord without length: edges that meet at a corner fit at any θ, edges far apart at none."""
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS)[2:3])
    edges = catalogue.edges(Finger(0.0, 10.0))
    follower = int(np.flatnonzero(np.all(edges.start == edges.end[0], axis=1))[0])
    far = int(np.argmax(np.hypot(*(edges.middle - edges.middle[0]).T)))
    point = contact_at(np.array([3.0, 4.0]), 0.1, 0.0)
    for other, allowed in ((follower, True), (far, False)):
        begin, end = by_chord(steps, catalogue, 0, point, other, point, -1.0, 4.0)
        assert (begin <= end) == allowed
        assert not allowed or (begin, end) == pytest.approx((-1.0, 4.0))


# ----------------------------------------------------------------------------------------------------
# The closed-form model test against linear programming and against dense sampling.

ANGLE = st.floats(-math.pi, math.pi)
COEFFICIENT = st.floats(-5, 5).map(lambda value: round(value, 3))


def excess(g: np.ndarray, limit: np.ndarray) -> float:
    """By how much (mm) the half-planes g·s ≤ limit must be widened to have a point in common."""
    rows = np.column_stack([g, -np.ones(len(g))])
    solved = linprog([0, 0, 1], A_ub=rows, b_ub=limit, bounds=[(None, None)] * 3, method="highs")
    assert solved.status == 0
    return float(solved.fun)


@pytest.mark.parametrize("steps", both_sides())
@pytest.mark.parametrize("fingers", [2, 3, 4])
def test_triples_agree_with_linear_programming(steps: Steps, fingers: int) -> None:
    rng = np.random.default_rng(20 + fingers)
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    feasible = 0
    for trial in range(60):
        model = outlines(SHIPPED_OBJECTS)[trial % 6]
        placed = place(model, rng)
        contacts = [c for c in grip(placed, rng, fingers=fingers, bound=1.0, half_range=None) if c.touched]
        if len(contacts) < 2:
            continue
        anchor = np.zeros(2)
        edges = catalogue.edges(contacts[0].finger)
        state = next(k for k, s in enumerate(catalogue.states) if s.object_name == model.name)
        pick = rng.integers(edges.first[state], edges.first[state + 1], len(contacts))
        theta = rng.uniform(-math.pi, math.pi)
        if trial % 2:  # the edges nearest to the truth, so that about half of the cases are feasible
            theta = placed.theta + rng.normal(0, 0.02)
            turn = np.array([[math.cos(theta), math.sin(theta)], [-math.sin(theta), math.cos(theta)]])
            origin = catalogue.states[state].origin_mm
            middles = (edges.start + edges.end) / 2
            for k, contact in enumerate(contacts):
                local = turn @ (np.array(contact.end_mm) - (placed.x, placed.y)) - origin
                block = slice(edges.first[state], edges.first[state + 1])
                pick[k] = edges.first[state] + np.argmin(np.linalg.norm(middles[block] - local, axis=1))
        planes = [half_planes(edges, pick[k : k + 1], c, anchor) for k, c in enumerate(contacts)]
        wave = np.array([1.0, math.cos(theta), math.sin(theta)])
        short = excess(
            np.concatenate([plane[0][0] for plane in planes]),
            np.concatenate([plane[1][0] @ wave for plane in planes]),
        )
        allowed = True
        for size, triples in ((2, PAIR_TRIPLES), (3, TRIPLE_TRIPLES)):
            for group in itertools.combinations(range(len(contacts)), size):
                g = np.concatenate([planes[k][0] for k in group], axis=1)
                coefficients = np.concatenate([planes[k][1] for k in group], axis=1)
                arcs = triple_arcs(g, coefficients, triples)[0] @ wave
                allowed &= bool(np.all(arcs >= 0))
                if np.min(np.abs(arcs)) > 1e-6:
                    at = np.array([theta])
                    query = Query(catalogue, [contacts[k] for k in group], anchor)
                    lo, hi = steps.narrow(query, pick[None, group], at, at)
                    assert bool(lo[0] <= hi[0]) == bool(np.all(arcs >= 0))
        if abs(short) > 1e-6:
            assert allowed == (short < 0)
        feasible += short < 0
    assert feasible >= 5


@given(ANGLE, st.floats(0, 2 * math.pi), st.lists(st.tuples(*[COEFFICIENT] * 3), min_size=1, max_size=4))
def test_hull_holds_every_allowed_orientation(lo: float, width: float, conditions: list) -> None:
    rows = np.array(conditions)
    begin, end = arc_hull(np.array([lo]), np.array([lo + width]), rows[None])
    theta = np.linspace(lo, lo + width, 2001)
    value = rows[:, 0] + rows[:, 1] * np.cos(theta[:, None]) + rows[:, 2] * np.sin(theta[:, None])
    allowed = theta[np.all(value >= 1e-9, axis=1)]
    if len(allowed):
        assert begin[0] <= allowed[0] + 1e-12
        assert end[0] >= allowed[-1] - 1e-12
    if begin[0] <= end[0]:
        assert begin[0] >= lo - 1e-12
        assert end[0] <= lo + width + 1e-12


@given(ANGLE, st.floats(0.01, 2 * math.pi), st.tuples(*[COEFFICIENT] * 3))
def test_hull_of_one_condition_is_tight(lo: float, width: float, condition: tuple) -> None:
    begin, end = arc_hull(np.array([lo]), np.array([lo + width]), np.array([[condition]]))
    if begin[0] <= end[0]:
        for theta in (begin[0], end[0]):
            value = condition[0] + condition[1] * math.cos(theta) + condition[2] * math.sin(theta)
            assert value >= -1e-6


@given(ANGLE, st.floats(0, 2 * math.pi), st.tuples(*[COEFFICIENT] * 2))
def test_largest_is_the_maximum(lo: float, width: float, wave: tuple) -> None:
    a, b = wave
    found = float(sinusoid_maximum(np.array(a), np.array(b), np.array(lo), np.array(lo + width)))
    theta = np.linspace(lo, lo + width, 4001)
    sampled = float(np.max(a * np.cos(theta) + b * np.sin(theta)))
    assert found >= sampled - 1e-9
    if width < math.pi:  # over half a turn and more the amplitude stands for it
        assert found <= sampled + 1e-4


@pytest.mark.parametrize("steps", both_sides())
@pytest.mark.parametrize("seed", range(4))
def test_eight_waves_are_the_triples_of_three_contacts(steps: Steps, seed: int) -> None:
    """Two-sided conditions leave no more than the arcs taken one by one; single θ are compared above."""
    rng = np.random.default_rng(seed)
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    placed = place(outlines(SHIPPED_OBJECTS)[seed], rng)
    contacts = [
        c for c in grip(placed, rng, bound=0.5, half_range=None, radius=5.0 * (seed % 2)) if c.touched
    ]
    assert len(contacts) == 3
    edges, anchor = catalogue.edges(contacts[0].finger), np.zeros(2)
    paired = rng.integers(edges.first[seed], edges.first[seed + 1], (3000, 3))
    lo = rng.uniform(-7, 7, 3000)
    hi = lo + 2 * math.pi * rng.uniform(size=3000) ** 3
    first, last = steps.narrow(Query(catalogue, contacts, anchor), paired, lo, hi)
    planes = [half_planes(edges, paired[:, k], contact, anchor) for k, contact in enumerate(contacts)]
    g = np.concatenate([plane[0] for plane in planes], axis=1)
    coefficients = np.concatenate([plane[1] for plane in planes], axis=1)
    conditions = triple_arcs(g, coefficients, TRIPLE_TRIPLES)
    begin, end = arc_hull(lo, hi, conditions)
    left = np.flatnonzero(first <= last)
    assert len(left) > 10
    assert np.all(first[left] >= begin[left] - 1e-9)
    assert np.all(last[left] <= end[left] + 1e-9)
