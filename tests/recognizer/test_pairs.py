"""The table of pairs of edges against every pair tried one after the other."""

import math
from functools import cache

import numpy as np
import pytest
from shapely_bench import SHIPPED_OBJECTS, flat, grip, outlines, place

from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.model import ObjectModel
from palpate.recognizer.segments import distance_range
from palpate.recognizer.tree import Interpretations, first_level, next_level, second_level

THIN, THICK = Finger(0.0, 10.0), Finger(5.0, 10.0)
FINGERS = [(THIN, THIN), (THICK, THICK), (THIN, THICK), (THICK, THIN)]


def models() -> list[ObjectModel]:
    """Shipped parts, a square (four-fold symmetric) and parallel edges in plenty."""
    comb = [(x, 20 if k % 4 in (1, 2) else 8) for k, x in enumerate(np.repeat(np.arange(-30.0, 31.0, 10), 2))]
    square = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])
    return [*outlines(SHIPPED_OBJECTS)[:4], square, flat("comb", [(-30, -20), (30, -20), *comb[::-1]])]


@cache
def catalogue(flat_edges: int = 600) -> Catalogue:
    return Catalogue(models(), flat_edges=flat_edges)


def exact_ranges(first: EdgeSet, a: np.ndarray, second: EdgeSet, b: np.ndarray) -> tuple:
    shortest, longest = distance_range(first.start[a], first.end[a], second.start[b], second.end[b])
    slack = first.slack_mm[a] + second.slack_mm[b]
    return shortest - slack, longest + slack


def allowed_pairs(
    first: EdgeSet, second: EdgeSet, lo: float, hi: float, distance: float, bound: float
) -> set[tuple[int, int]]:
    """Every pair of one state, its first edge representative, that turn and distance allow."""
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


@pytest.mark.parametrize("flat_edges", [600, 20])
@pytest.mark.parametrize("fingers", FINGERS)
def test_every_allowed_pair_is_found(fingers: tuple[Finger, Finger], flat_edges: int) -> None:
    """Windows of all widths, also across the cut and more than a turn; states in lists and in strips."""
    rng = np.random.default_rng(31)
    first, second = (catalogue(flat_edges).edges(finger) for finger in fingers)
    table = catalogue(flat_edges).pairs(*fingers)
    margin = float(first.span.max() + second.span.max()) + 1e-5
    total = 0
    for width in (0.0, 0.0, 1e-3, 0.3, 0.7, 2.0, math.pi, 6.0, 2 * math.pi, 7.0):
        for _ in range(3):
            # Some windows begin or end at the turn of an actual pair, where rounding matters.
            a, b = rng.integers(0, len(first.state)), rng.integers(0, len(second.state))
            turn = float(second.normal_rad[b] - first.normal_rad[a])
            lo = rng.choice([turn, turn - width, rng.uniform(-7, 7), -width / 2, 2 * math.pi - width / 2])
            distance, bound = rng.choice([0.0, rng.uniform(0, 90)]), rng.choice([0.0, 0.3, 5.0])
            edge_a, edge_b = table.between(lo, lo + width, distance, bound)
            found = list(zip(edge_a.tolist(), edge_b.tolist(), strict=True))
            assert len(set(found)) == len(found)
            note = (lo, width, distance, bound)
            assert allowed_pairs(first, second, lo, lo + width, distance, bound) <= set(found), note
            # What is found beyond that, the widest arc's span allows everywhere.
            wide = allowed_pairs(first, second, lo - margin, lo + width + margin, distance, bound + 1e-3)
            assert set(found) <= wide, note
            total += len(found)
    assert total > 1000


@pytest.mark.parametrize("fingers", FINGERS)
def test_a_pair_at_the_ends_of_its_own_ranges_is_found(fingers: tuple[Finger, Finger]) -> None:
    """Distances and turns exactly at their limits, where single precision could cut them off."""
    rng = np.random.default_rng(32)
    first, second = (catalogue().edges(finger) for finger in fingers)
    table = catalogue().pairs(*fingers)
    for a in rng.choice(np.flatnonzero(first.representative), 60):
        state = first.state[a]
        b = rng.integers(second.first[state], second.first[state + 1])
        shortest, longest = exact_ranges(first, np.array([a]), second, np.array([b]))
        turn = float(second.normal_rad[b] - first.normal_rad[a])
        for distance in (float(shortest[0]), float(longest[0])):
            if distance < 0:
                continue
            for full_turns in (-1, 0, 1):
                at = turn + 2 * math.pi * full_turns
                edge_a, edge_b = table.between(at, at, distance, 0.0)
                assert np.any((edge_a == a) & (edge_b == b)), (a, b, distance)


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
@pytest.mark.parametrize("radii", [(0.0, 0.0), (5.0, 5.0), (0.0, 5.0), (5.0, 0.0)])
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
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-9)
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
