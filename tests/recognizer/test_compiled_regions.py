"""The compiled kernel sifts cells, finds regions and cuts cells finer as numpy does, round by round."""

import math
from collections import Counter

import numpy as np
import pytest
from campaign_objects import objects_of
from kernel_switch import needs_kernel, without_kernel
from sampling import sample
from shapely_bench import grip, place

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer import Catalogue, recognise
from palpate.recognizer.budget import Budget
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.recognition import intervals_of
from palpate.recognizer.witness_candidates import WitnessedCells, cut_finer, find_witnesses
from palpate.recognizer.witness_search import Regions, position_boxes, search_round

pytestmark = needs_kernel

FEW = 10
CASES = sample(range(0, 20 * FEW, FEW), range(0, 2 * FEW, FEW))
SOURCES = ("memo", "own", "loose")
ROUNDS = 5
# All but what prepares arrays for the kernel.
PARTS = (
    "connected_components",
    "constraints",
    "model_test",
    "pose_region",
    "verification",
    "witness_candidates",
    "witness_search",
)


def drawn_constraints(catalogue: Catalogue, source: str, rng: np.random.Generator) -> Constraints:
    """Of a grip on one of the objects: some contacts are misses, or may be spurious."""
    models = objects_of(source)
    half = math.radians(float(rng.choice([5.0, 15.0])))
    while True:
        contacts = grip(
            place(models[int(rng.integers(len(models)))], rng),
            rng,
            fingers=int(rng.integers(3, 5)),
            bound=float(rng.choice([0.05, 0.3, 1.0])),
            radius=float(rng.choice([0.0, 5.0])),
            half_range=half,
        )
        touched = sum(contact.touched for contact in contacts)
        if touched > 1:
            break
    budget = Budget(int(rng.choice([10_000, 30_000, 100_000])))
    return recognise(catalogue, contacts, int(rng.random() < 0.4), budget).constraints


def assert_same_cells(found: Cells, expected: Cells) -> None:
    """Polygons may differ in their padding, and in vertices that coincide but for rounding."""
    assert np.array_equal(found.node, expected.node)
    assert np.array_equal(found.state, expected.state)
    np.testing.assert_allclose(found.lo, expected.lo, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.hi, expected.hi, rtol=0, atol=1e-8)
    if len(found):
        nothing, anchor = np.zeros((len(found), 2)), np.zeros(2)
        for one, two in zip(
            position_boxes(found, nothing, anchor), position_boxes(expected, nothing, anchor), strict=True
        ):
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.volume, expected.volume, rtol=1e-6, atol=1e-6)


def assert_same_candidates(found: WitnessedCells, expected: WitnessedCells) -> None:
    assert_same_cells(found.cells, expected.cells)
    assert np.array_equal(found.holds, expected.holds)
    held = found.holds
    np.testing.assert_allclose(found.spot[held], expected.spot[held], rtol=0, atol=1e-6)


def assert_same_regions(constraints: Constraints, found: Regions, expected: Regions) -> None:
    """Of two interpretations in one place either may be taken, if they have the same null contacts."""
    assert np.array_equal(found.first, expected.first)
    assert np.array_equal(found.verified, expected.verified)
    assert_same_cells(found.cells, expected.cells)
    assert_same_cells(found.unturned, expected.unturned)
    for one, two in zip(located(found), located(expected), strict=True):
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-6)
    null = constraints.nodes.edges < 0
    assert np.array_equal(null[found.node], null[expected.node])


def located(regions: Regions) -> tuple[Floats, Floats]:
    return regions.theta, regions.position


def same_rounds(constraints: Constraints, counts: Counter[str]) -> None:
    """Every step of the search by kernel and by numpy, each from what the kernel had before."""
    intervals = intervals_of(constraints.nodes, constraints.budget)
    found = find_witnesses(constraints, intervals)
    with without_kernel(*PARTS):
        expected = find_witnesses(constraints, intervals)
    assert_same_candidates(found, expected)
    for nth in range(ROUNDS):
        refinable = nth < ROUNDS - 1
        regions, again = search_round(constraints, found, refinable=refinable)
        with without_kernel(*PARTS):
            others, also = search_round(constraints, found, refinable=refinable)
        assert_same_cells(again, also)
        assert_same_regions(constraints, regions, others)
        counts["cells"] += len(found.cells)
        counts["held"] += int(found.holds.sum())
        counts["verified"] += int(regions.verified.sum())
        counts["unverified"] += int((~regions.verified).sum())
        if not len(again):
            break
        counts["rounds"] += 1
        finer = cut_finer(constraints, again, at_first=nth == 0)
        with without_kernel(*PARTS):
            parts = cut_finer(constraints, again, at_first=nth == 0)
        assert_same_candidates(finer, parts)
        found = finer


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("first", CASES)
def test_every_round_is_the_same(source: str, first: int) -> None:
    catalogue, counts = Catalogue(objects_of(source)), Counter[str]()
    for seed in range(first, first + FEW):
        rng = np.random.default_rng([38, seed])
        constraints = drawn_constraints(catalogue, source, rng)
        nulls: Ints = constraints.nulls
        counts["spurious"] += int(nulls.any())
        same_rounds(constraints, counts)
    assert counts["cells"] > counts["held"] > 20 < counts["verified"], counts
    assert counts["rounds"] > 0 < counts["spurious"], counts


def test_cells_that_are_no_cells_are_refused() -> None:
    """What the kernel is given is checked: there is such an interpretation, and such a state."""
    catalogue = Catalogue(objects_of("memo"))
    constraints = drawn_constraints(catalogue, "memo", np.random.default_rng(1))
    found = find_witnesses(constraints, intervals_of(constraints.nodes))
    wrong: Bools = np.zeros(len(found), dtype=bool)
    far = np.full(len(found), 10**6)
    cells = Cells(far, found.cells.state, found.cells.lo, found.cells.hi, found.cells.polygon)
    with pytest.raises(IndexError):
        search_round(constraints, WitnessedCells(cells, found.spot, wrong), refinable=True)
