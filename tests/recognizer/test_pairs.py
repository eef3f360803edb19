"""The table of pairs of edges against every pair tried one after the other."""

import math
from functools import cache

import numpy as np
import pytest
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, flat, grip, outlines, place

from palpate.base.geometry import ObjectModel
from palpate.base.geometry.plane import distance_range
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.interpretation_tree import Interpretations, first_level, next_level, second_level

THIN, THICK = Finger(0.0, 10.0), Finger(5.0, 10.0)
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


@pytest.mark.parametrize("trials", sample([40, 150], [40]))
@pytest.mark.parametrize(
    ("fingers", "flat_edges"), [(pair, (600, 20)[k % 2]) for k, pair in enumerate(FINGERS)]
)
def test_every_pair_that_two_points_lie_on_is_found(
    fingers: tuple[Finger, Finger], flat_edges: int, trials: int
) -> None:
    """Points of two edges, mismeasured, with normal ranges of all widths that just hold the true normals."""
    rng = np.random.default_rng(31)
    first, second = (catalogue(flat_edges).edges(finger) for finger in fingers)
    table = catalogue(flat_edges).pairs(*fingers)
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
            ranges.append(NormalRange(float(lo), float(lo + width)))
        one, two = ranges
        edge_a, edge_b = table.between(one, two, (float(chord[0]), float(chord[1])), float(bound))
        found = list(zip(edge_a.tolist(), edge_b.tolist(), strict=True))
        assert len(set(found)) == len(found)
        assert (a, b) in found, trial
        margin = float(first.span.max() + second.span.max()) + 1e-4
        wide = NormalRange(two.lo_rad - margin, min(two.hi_rad + margin, two.lo_rad - margin + 2 * math.pi))
        distance = float(np.hypot(*chord))
        assert set(found) <= allowed_pairs(first, second, one, wide, distance, bound + 1e-3), trial
        total += len(found)
    assert total > 7 * trials


@pytest.mark.parametrize("flat_edges", [600, 20])
@pytest.mark.parametrize("fingers", FINGERS)
def test_ranges_are_rounded_outward(fingers: tuple[Finger, Finger], flat_edges: int) -> None:
    rng = np.random.default_rng(33)
    first, second = (catalogue(flat_edges).edges(finger) for finger in fingers)
    edge_a = rng.integers(0, len(first.state), 4000)
    state = first.state[edge_a]
    edge_b = second.first[state] + rng.integers(0, second.count[state])
    near, far = catalogue(flat_edges).pairs(*fingers).ranges(state, edge_a, edge_b)
    shortest, longest = exact_ranges(first, edge_a, second, edge_b)
    assert np.all(near <= shortest)
    assert np.all(far >= longest)
    np.testing.assert_allclose(near, shortest, atol=1e-4)
    np.testing.assert_allclose(far, longest, atol=1e-4)


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
        anchor = np.mean([c.end_mm for c in contacts], axis=0)
        at_once, count = second_level(catalogue(flat_edges), contacts)
        nodes, _ = first_level(catalogue(flat_edges), contacts[0])
        in_turn, count_in_turn = next_level(catalogue(flat_edges), nodes, contacts, anchor)
        one, two = as_rows(at_once), as_rows(in_turn)
        assert one.shape == two.shape
        np.testing.assert_array_equal(one[:, :2], two[:, :2])
        # Of wide ranges that meet in two pieces the hull is kept: narrowed in another order, another hull.
        if half_range is None or half_range < 1.0:
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)
        # Pockets of several arcs, looked at where no normal is known, make several nodes of one.
        if all(contact.normal is not None for contact in contacts):
            assert count.candidates == count_in_turn.candidates
        assert count.after_model == count_in_turn.after_model == len(one)
        assert np.all(catalogue(flat_edges).edges(contacts[0].finger).representative[at_once.edges[:, 0]])
        left += len(one)
    assert left > 20


def test_normals_that_allow_nothing_leave_no_pair() -> None:
    against = Contact("a", THICK, True, (-100.0, 0.0), (-25.0, 0.0), 0.3, NormalRange(-0.1, 0.1))
    other = Contact("b", THICK, True, (100.0, 0.0), (25.0, 0.0), 0.3)
    for contacts in ([against, other], [other, against]):
        nodes, count = second_level(catalogue(), contacts)
        assert len(nodes) == count.after_model == 0
