"""The compiled kernel gives what numpy gives."""

import math
from collections import Counter
from dataclasses import replace
from importlib import import_module
from itertools import product

import numpy as np
import pytest
import shapely
from scipy.optimize import linprog
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer import Catalogue, Contact, Finger, numpy_steps, recognise
from palpate.recognizer.approach import Facing, Rays
from palpate.recognizer.budget import Budget, BudgetSpentError
from palpate.recognizer.connected_components import Boxes, component_labels, group_by_links
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.interpretation_tree import contact_in_object
from palpate.recognizer.interpretations import Interpretations, Query
from palpate.recognizer.model_test import all_half_planes
from palpate.recognizer.numpy_witnesses import polish
from palpate.recognizer.pose_region import (
    Cells,
    Regions,
    WitnessedCells,
    corner_mask,
    divide_orientations,
)
from palpate.recognizer.recognition import anchor_of, intervals_of
from palpate.recognizer.steps import Steps
from palpate.recognizer.verification import Nearness, Poses, Verification, may_fit, verify
from support.campaign.objects import objects_of
from support.campaign.sampling import sample
from support.oracles.judge import Case, drawn_case
from support.oracles.kernel import compiled_polish, compiled_verify
from support.oracles.shapely_touches import flat, grip, place, until_touched
from support.oracles.whole_queries import WholeQuery, assert_same_by_numpy

compiled_steps = pytest.importorskip("palpate.recognizer.compiled_steps", exc_type=ImportError)

# ----------------------------------------------------------------------------------------------------
# A whole query has the same hypotheses, witnesses and bounds with and without the compiled kernel.


def drawn_query(source: str, seed: int) -> WholeQuery:
    rng = np.random.default_rng([87, seed, len(source)])
    models = objects_of(source)
    placed = place(models[int(rng.integers(len(models)))], rng)
    how = {
        "bound": float(rng.choice([0.05, 0.3, 1.0])),
        "radius": float(rng.choice([0.0, 5.0])),
        "half_range": math.radians(float(rng.choice([2.0, 15.0]))),
    }
    grips = [until_touched(grip, placed, rng, fingers=3, **how)]
    if rng.random() < 0.5:
        grips.append(grip(placed, rng, fingers=2, **how))
    spurious = int(rng.random() < 0.3 and sum(contact.touched for contact in grips[0]) > 2)
    return WholeQuery(models, grips, spurious, Budget(int(rng.choice([1_000_000, 100_000, 10_000]))))


@pytest.mark.parametrize("source", sample(["memo", "own", "loose"], ["memo", "own"]))
@pytest.mark.parametrize("first", sample(range(0, 60, 6), [0]))
def test_answers_are_the_same(source: str, first: int) -> None:
    assert_same_by_numpy([drawn_query(source, seed) for seed in range(first, first + 6)])


# ----------------------------------------------------------------------------------------------------
# The compiled kernel sifts cells, finds regions and cuts cells finer as numpy does, round by round.

REGIONS_IN_A_BLOCK = 10
REGION_BLOCKS = sample(
    range(0, 20 * REGIONS_IN_A_BLOCK, REGIONS_IN_A_BLOCK),
    [0],
)
SOURCES = ("memo", "own", "loose")
ROUNDS = 5


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
            numpy_steps.position_boxes(found, nothing, anchor),
            numpy_steps.position_boxes(expected, nothing, anchor),
            strict=True,
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


def cut_finer(steps: Steps, constraints: Constraints, cells: Cells, *, at_first: bool) -> WitnessedCells:
    if not at_first:
        return steps.sift_parts(constraints, cells)
    parts = np.full(len(cells), 4)
    finer, _ = steps.refine_intervals(constraints.paired, constraints.nodes, cells, parts)
    return steps.sift_intervals(constraints, finer, corners=True)


def same_rounds(constraints: Constraints, counts: Counter[str]) -> None:
    """Every step of the search by kernel and by numpy, each from what the kernel had before."""
    intervals = intervals_of(constraints.nodes, constraints.budget)
    found, expected = (
        steps.sift_intervals(constraints, intervals, corners=False) for steps in (compiled_steps, numpy_steps)
    )
    assert_same_candidates(found, expected)
    for nth in range(ROUNDS):
        (regions, again), (others, also) = (
            steps.search_round(constraints, found, refinable=nth < ROUNDS - 1)
            for steps in (compiled_steps, numpy_steps)
        )
        assert_same_cells(again, also)
        assert_same_regions(constraints, regions, others)
        counts["cells"] += len(found.cells)
        counts["held"] += int(found.holds.sum())
        counts["verified"] += int(regions.verified.sum())
        counts["unverified"] += int((~regions.verified).sum())
        if not len(again):
            break
        counts["rounds"] += 1
        found, parts = (
            cut_finer(steps, constraints, again, at_first=nth == 0) for steps in (compiled_steps, numpy_steps)
        )
        assert_same_candidates(found, parts)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("first", REGION_BLOCKS)
def test_every_round_is_the_same(source: str, first: int) -> None:
    catalogue, counts = Catalogue(objects_of(source)), Counter[str]()
    for seed in range(first, first + REGIONS_IN_A_BLOCK):
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
    found = compiled_steps.sift_intervals(constraints, intervals_of(constraints.nodes), corners=False)
    wrong: Bools = np.zeros(len(found), dtype=bool)
    far = np.full(len(found), 10**6)
    cells = Cells(far, found.cells.state, found.cells.lo, found.cells.hi, found.cells.polygon)
    with pytest.raises(IndexError):
        compiled_steps.search_round(constraints, WitnessedCells(cells, found.spot, wrong), refinable=True)


# ----------------------------------------------------------------------------------------------------
# The compiled kernel measures, clips and groups cells as numpy does, and as shapely and scipy do.


def drawn_cells(rng: np.random.Generator, count: int) -> Cells:
    """Convex polygons of 1 to 9 vertices, of sizes from 1 nm to 100 mm, padded to one more than the most."""
    rows: list[Floats] = []
    for _ in range(count):
        points = rng.normal(0, 10 ** rng.uniform(-6, 2), (int(rng.integers(1, 12)), 2)) + rng.normal(0, 50, 2)
        hull = shapely.MultiPoint(points).convex_hull
        ring = (
            points[:1]
            if hull.geom_type != "Polygon"
            else np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]
        )
        rows.append(ring[:9])
    most = max(map(len, rows)) + 1
    polygon = np.array(
        [np.concatenate([ring, np.repeat(ring[:1], most - len(ring), axis=0)]) for ring in rows]
    )
    lo = rng.uniform(-10, 10, count)
    nothing = np.zeros(count, np.int64)
    return Cells(nothing, nothing, lo, lo + 10 ** rng.uniform(-9, 0.9, count), polygon)


@pytest.mark.parametrize("seed", range(20))
def test_boxes_are_the_same_and_volumes_those_of_shapely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = drawn_cells(rng, int(rng.integers(1, 200)))
    origin, anchor = rng.normal(0, 30, (len(cells), 2)), rng.normal(0, 30, 2)
    for one, two in zip(
        compiled_steps.position_boxes(cells, origin, anchor),
        numpy_steps.position_boxes(cells, origin, anchor),
        strict=True,
    ):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-9)
    area = [shapely.convex_hull(shapely.MultiPoint(polygon)).area for polygon in cells.polygon]
    np.testing.assert_allclose(cells.volume, np.array(area) * (cells.hi - cells.lo), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_boxes_contain_every_position(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = drawn_cells(rng, 50)
    lo, hi = compiled_steps.position_boxes(cells, np.zeros((50, 2)), np.zeros(2))
    for theta in np.linspace(cells.lo, cells.hi, 40):
        c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
        x, y = cells.polygon[..., 0], cells.polygon[..., 1]
        for axis, value in enumerate((c * x - s * y, s * x + c * y)):
            assert np.all((value >= lo[:, axis, None]) & (value <= hi[:, axis, None]))


@pytest.mark.parametrize("seed", range(20))
def test_parts_are_the_same_and_cover_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = drawn_cells(rng, int(rng.integers(1, 60)))
    lever, parts = 10 ** rng.uniform(-1, 3), int(rng.integers(2, 6))
    found, owner = compiled_steps.divide_cells(cells, lever, parts)
    expected, other = numpy_steps.divide_cells(cells, lever, parts)
    assert np.array_equal(owner, other)
    np.testing.assert_allclose(found.lo, expected.lo)
    np.testing.assert_allclose(found.centre, expected.centre, rtol=0, atol=1e-9)
    covered = np.bincount(owner, found.volume, minlength=len(cells))
    np.testing.assert_allclose(covered, cells.volume, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2, 30, 160, 161, 400, 3000])
@pytest.mark.parametrize("seed", range(4))
def test_groups_are_the_same(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = np.sort(rng.integers(0, 4, count))
    turn = 2 * np.pi / np.array([1, 2, 3, 6])[state]
    size = 10 ** rng.uniform(-2, 0)
    half = rng.uniform(0, 0.3 * size, count)
    lo = rng.uniform(-5, 5, (count, 2))
    boxes = Boxes(state, rng.uniform(-9, 9, count), half, turn, lo, lo + rng.uniform(0, size * 3, (count, 2)))
    found = component_labels(boxes, compiled_steps.group_boxes)
    assert np.array_equal(found, component_labels(boxes, group_by_links))
    if 0 < count <= 400:
        one, two = np.nonzero(
            (state[:, None] == state) & boxes.meet(np.arange(count)[:, None], np.arange(count)[None])
        )
        links = coo_array((np.ones(len(one)), (one, two)), shape=(count, count))
        assert np.array_equal(found, connected_components(links, directed=False)[1])


# ----------------------------------------------------------------------------------------------------
# The compiled kernel grows the tree, cuts cells and sweeps paths as numpy does.

TREES_IN_A_BLOCK = 20
TREE_BLOCKS = sample(range(0, 30 * TREES_IN_A_BLOCK, TREES_IN_A_BLOCK), [0])


def by_pairing(nodes: Interpretations) -> dict[tuple[int, ...], tuple[float, float]]:
    """Hull of the orientations of each pairing: of several cells of one interpretation each has its own."""
    found: dict[tuple[int, ...], tuple[float, float]] = {}
    for edges, lo, hi in zip(
        map(tuple, nodes.edges.tolist()), nodes.lo.tolist(), nodes.hi.tolist(), strict=True
    ):
        least, most = found.get(edges, (lo, hi))
        found[edges] = min(lo, least), max(hi, most)
    return found


def is_possible(query: Query, edges: tuple[int, ...], kept: tuple[float, float]) -> bool:
    """Whether positions are in the rectangles of all contacts at one of many orientations kept, by scipy.

    Only there: what their normals exclude, both sides have left out.
    """
    g, coefficients = all_half_planes(query, np.array([edges]))
    for theta in np.linspace(*kept, 91):
        limit = coefficients[0] @ [1.0, np.cos(theta), np.sin(theta)]
        if linprog([0.0, 0.0], g[0], limit, bounds=(None, None)).status == 0:
            return True
    return False


def assert_same(query: Query, found: Interpretations, expected: Interpretations) -> int:
    """Equal, but for pairings that are not possible: how many of them one side alone rules out."""
    one, two = by_pairing(found), by_pairing(expected)
    alone = {edges: (one | two)[edges] for edges in one.keys() ^ two.keys()}
    assert not any(is_possible(query, edges, kept) for edges, kept in alone.items())
    for edges in one.keys() & two.keys():
        np.testing.assert_allclose(one[edges], two[edges], rtol=0, atol=1e-8)
    return len(alone)


def grown(steps: Steps, query: Query, before: Interpretations | None, *, modelled: bool) -> Interpretations:
    """Level of the last contact, under that of the contacts before it; the model test with it or after it."""
    assert query.normals is not None
    last = len(query.contacts) - 1
    if last == 3:
        assert before is not None
        cells = cells_of(steps, query.select(range(last)), before)
        place = contact_in_object(cells, query.contacts[-1], query.anchor_mm)
        children = steps.extend(query, query.normals[-1], cells, *place).children
        return before.extend(replace(children, parent=cells.node[children.parent]))
    if before is None:
        first = query.edges[0]
        nothing = np.zeros(len(first.state))
        roots = Interpretations(first.state, np.arange(len(nothing))[:, None], nothing, nothing)
        nodes = roots.extend(steps.second_level(query, query.normals, None, modelled=modelled).children)
    else:
        nodes = before.extend(steps.third_level(query, query.normals, before, modelled=modelled).children)
    for group in () if modelled else ([0, 1],) if last == 1 else ([0, 2], [1, 2], [0, 1, 2]):
        nodes = nodes.narrow(*steps.narrow(query.select(group), nodes.edges[:, group], nodes.lo, nodes.hi))
    return nodes


def cells_of(steps: Steps, query: Query, nodes: Interpretations) -> Cells:
    return steps.cut_cells(query, nodes, divide_orientations(nodes, step_rad=0.05, least=2))[0]


@pytest.mark.parametrize("first", TREE_BLOCKS)
def test_levels_cells_and_paths_are_the_same(first: int) -> None:
    seen: Counter[str] = Counter()
    for seed in range(first, first + TREES_IN_A_BLOCK):
        case = drawn_case(seed)
        touched = [contact for contact in case.contacts if contact.touched][:4]
        whole = Query(case.catalogue(), touched, anchor_of(touched or case.contacts), Budget(10**8))
        if len(touched) < 2 or whole.normals is None:
            continue
        nodes = None
        for size in range(2, len(touched) + 1):
            query = whole.select(range(size))
            found, expected = (
                grown(steps, query, nodes, modelled=seed % 4 > 0) for steps in (compiled_steps, numpy_steps)
            )
            seen["alone"] += assert_same(query, found, expected)
            seen["interpretations"] += len(found)
            if size < 4:
                nodes, used = found, query
        assert nodes is not None
        cells = cells_of(compiled_steps, used, nodes)
        assert_equal_cells(cells, cells_of(numpy_steps, used, nodes))
        seen["cells"] += len(cells)
        evidence = replace(whole, contacts=case.contacts)
        free = compiled_steps.free_cells(evidence, cells, None)
        assert np.array_equal(free, numpy_steps.free_cells(evidence, cells, None))
        seen["blocked"] += int((~free).sum())
    assert seen["interpretations"] > TREES_IN_A_BLOCK
    assert seen["cells"] > TREES_IN_A_BLOCK


def assert_equal_cells(found: Cells, expected: Cells) -> None:
    assert np.array_equal(found.node, expected.node)
    for one, two in ((found.lo, expected.lo), (found.hi, expected.hi), (found.volume, expected.volume)):
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.centre, expected.centre, rtol=0, atol=1e-8)
    assert np.all(corner_mask(found.polygon).sum(axis=1) >= 1)


def test_a_spent_budget_is_the_same() -> None:
    """So small that drawn cases, which numpy has to get through as well, come to its end."""
    seen: Counter[str] = Counter()
    for seed, most in product(range(12), (1_250, 12_500, 125_000)):
        case = drawn_case(seed)
        touched = [replace(contact, normal=None) for contact in case.contacts if contact.touched][:2]
        if len(touched) < 2:
            continue
        query = Query(case.catalogue(), touched, np.zeros(2))
        found = outcome(compiled_steps, query, most)
        assert outcome(numpy_steps, query, most) == found
        seen[found] += 1
    assert min(seen["spent"], seen["done"]) > 3


def outcome(steps: Steps, query: Query, most: int) -> str:
    assert query.normals is not None
    try:
        steps.second_level(query, query.normals, most, modelled=True)
    except BudgetSpentError:
        return "spent"
    return "done"


def test_arrays_that_do_not_fit_are_refused() -> None:
    kernel = import_module("palpate.recognizer._kernel")
    edges = drawn_case(0).catalogue().edges(drawn_case(0).contacts[0].finger)
    arrays = list(compiled_steps.edge_arrays(edges))
    for number in range(len(arrays)):
        short = [*arrays[:number], np.ascontiguousarray(arrays[number][:-1]), *arrays[number + 1 :]]
        with pytest.raises(ValueError, match="do not fit together"):
            kernel.prepared_edges(tuple(short))
    with pytest.raises(ValueError, match="invalid PyCapsule"):
        kernel.narrow((object(), object()), ((0.0, 0.0, 0.0),) * 2, b"", b"", b"", 1)


# ----------------------------------------------------------------------------------------------------
# The compiled kernel verifies, rules out and polishes as numpy does; and shapely agrees with both.

VERIFICATIONS_IN_A_BLOCK = 40
VERIFICATION_BLOCKS = sample(
    range(0, 30 * VERIFICATIONS_IN_A_BLOCK, VERIFICATIONS_IN_A_BLOCK),
    [0],
)
SQUARE = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])


def same_as_numpy(case: Case) -> Verification:
    """What the kernel says, after it was compared with what numpy says."""
    evidence = case.evidence()
    found = compiled_verify(evidence, case.poses, case.skipped)
    expected = verify(evidence, case.poses, case.skipped)
    assert np.array_equal(found.fits, expected.fits)
    assert np.array_equal(found.holds, expected.holds)
    assert np.array_equal(np.isfinite(found.gap), np.isfinite(expected.gap))
    assert not np.isnan(found.gap).any()
    known = np.isfinite(expected.gap)
    for one, two in ((found.gap[known], expected.gap[known]), (found.offset, expected.offset)):
        np.testing.assert_allclose(one, two, rtol=0, atol=2e-9)
    np.testing.assert_allclose(found.normal, expected.normal, rtol=0, atol=1e-7)
    assert np.array_equal(found.limited, expected.limited)
    return found


@pytest.mark.parametrize("first", VERIFICATION_BLOCKS)
def test_verification_is_the_same(first: int) -> None:
    seen: Counter[str] = Counter()
    for seed in range(first, first + VERIFICATIONS_IN_A_BLOCK):
        case = drawn_case(seed)
        found = same_as_numpy(case)
        known = np.isfinite(found.gap)
        seen["gaps"] += int(known.sum())
        seen["fit"] += int((found.fits & known).sum())
        seen["do not fit"] += int((~found.fits & known).sum())
        seen["limited"] += int(found.limited.sum())
        seen["hold"] += int(found.holds.sum())
        seen["blocked"] += int((found.fits.all(axis=1) & ~found.holds).sum())
    assert min(seen[what] for what in ("gaps", "fit", "do not fit", "limited", "hold", "blocked")) > 20, seen


def cells_about(case: Case, rng: np.random.Generator) -> Cells:
    """A hexagon about each pose, and some orientations about it."""
    count = len(case.poses)
    size = rng.choice([0.1, 1.0, 3.0], count)
    angle = 2 * math.pi * np.arange(6) / 6
    rim = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = case.poses.position + rng.normal(0, 0.5, (count, 2)) * size[:, None]
    wide = rng.choice([0.0, 0.02, 0.2], count)
    node = rng.integers(5, size=count)
    lo = case.poses.theta - wide * rng.uniform(0, 2, count)
    return Cells(node, case.poses.state, lo, lo + 2 * wide, middle[:, None] + size[:, None, None] * rim)


def constraints_of(case: Case, rng: np.random.Generator) -> Constraints:
    """Five interpretations; in some cases contacts of them are spurious."""
    touched = [contact for contact in case.contacts if contact.touched]
    share = 0.3 if case.skipped is not None else 0.0
    edges = np.where(rng.random((5, len(touched))) < share, -1, 0)
    nodes = Interpretations(np.zeros(5, np.int64), edges, np.zeros(5), np.zeros(5))
    evidence = case.evidence()
    return Constraints(replace(evidence, contacts=touched), nodes, evidence)


@pytest.mark.parametrize("first", VERIFICATION_BLOCKS)
def test_polishing_is_the_same(first: int) -> None:
    kept, moved = 0, 0
    for seed in range(first, first + VERIFICATIONS_IN_A_BLOCK):
        case, rng = drawn_case(seed), np.random.default_rng([25, seed])
        cells = cells_about(case, rng)
        count = len(cells)
        cuts = np.sort(rng.integers(0, count, 8))
        begins = np.concatenate([[0], cuts, [count]])
        region = np.searchsorted(begins, np.arange(count), side="right") - 1
        cell = np.arange(count)
        constraints = constraints_of(case, rng)
        found, holds = compiled_polish(constraints, cells, begins, region, cell, case.poses)
        expected, also = polish(constraints, cells, begins, region, cell, case.poses)
        assert np.array_equal(holds, also), seed
        np.testing.assert_allclose(found.theta, expected.theta, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.position, expected.position, rtol=0, atol=1e-7)
        kept += int(holds.sum())
        moved += int((holds & np.any(found.position != case.poses.position, axis=1)).sum())
    assert kept > moved > 5


@pytest.mark.parametrize("first", VERIFICATION_BLOCKS)
def test_what_may_fit_is_the_same(first: int) -> None:
    """With budgets that leave some undecided, too: these are the same."""
    outcomes: Counter[bool] = Counter()
    for seed in range(first, first + VERIFICATIONS_IN_A_BLOCK):
        case, rng = drawn_case(seed), np.random.default_rng([26, seed])
        times = 40 if seed % 20 == 0 else 1
        rows = np.tile(np.arange(len(case.poses)), times)
        turn = rng.choice([0.0, 1e-3, 0.1, 4.0], len(rows))
        shift = rng.choice([0.0, 0.01, 0.5, 5.0], len(rows))
        skipped = None if case.skipped is None else case.skipped[rows]
        evidence, poses, near = case.evidence(), case.poses.select(rows), Nearness(turn, shift)
        for most in (None, 0, 300, 3000):
            found = compiled_steps.may_fit(evidence, poses, near, skipped, most)
            assert np.array_equal(found, may_fit(evidence, poses, near, skipped, most)), (seed, most)
            outcomes.update(found.tolist())
    assert min(outcomes[True], outcomes[False]) > 500


def test_cells_that_can_be_verified_are_the_same() -> None:
    for seed in range(40):
        case, rng = drawn_case(seed), np.random.default_rng([27, seed])
        cells, constraints = cells_about(case, rng), constraints_of(case, rng)
        found = compiled_steps.can_be_verified(constraints, cells)
        assert np.array_equal(found, numpy_steps.can_be_verified(constraints, cells))


def any_normal(end: np.ndarray, radius: float) -> Contact:
    """A tip that is said to touch at a place, come from nowhere: any normal is allowed."""
    at = (float(end[0]), float(end[1]))
    return Contact("f", Finger(radius, 10.0), True, at, at, 0.3)


def shape_of(catalogue: Catalogue) -> shapely.Geometry:
    """The only state's section in its centred frame."""
    (item,) = catalogue.states
    polygons = [polygon for section in item.state.sections_at(10.0) for polygon in section.polygons]
    return shapely.union_all(
        [
            shapely.Polygon(p.outer - item.origin_mm, [hole - item.origin_mm for hole in p.holes])
            for p in polygons
        ]
    )


ORIGIN = Poses(np.zeros(1, np.int64), np.zeros(1), np.zeros((1, 2)))


@pytest.mark.parametrize("number", range(len(objects_of("own"))))
@pytest.mark.parametrize("radius", [0.0, 3.0])
def test_distances_are_those_of_shapely(number: int, radius: float) -> None:
    catalogue = Catalogue([type(m)(m.name, m.states[:1]) for m in objects_of("own")[number : number + 1]])
    shape, rng = shape_of(catalogue), np.random.default_rng([28, number])
    grown = shape.buffer(radius, quad_segs=512)
    compared = 0
    for _ in range(600):
        point = rng.uniform(-60, 60, 2)
        expected = shapely.distance(grown.boundary, shapely.Point(point))
        gap = compiled_verify(Query(catalogue, [any_normal(point, radius)], np.zeros(2)), ORIGIN).gap[0, 0]
        if abs(expected - 1.3) < 1e-4:
            continue
        assert (expected < 1.3) == math.isfinite(gap)
        if math.isfinite(gap):
            compared += 1
            assert abs(gap - expected) < 2e-5  # the chords of shapely's arcs
    assert compared > 5


@pytest.mark.parametrize("number", range(len(objects_of("own"))))
@pytest.mark.parametrize("radius", [0.5, 6.0])
def test_free_lines_are_those_of_shapely(number: int, radius: float) -> None:
    catalogue = Catalogue([type(m)(m.name, m.states[:1]) for m in objects_of("own")[number : number + 1]])
    shape, rng = shape_of(catalogue), np.random.default_rng([29, number])
    outcomes: Counter[bool] = Counter()
    for _ in range(800):
        begin, end = rng.uniform(-70, 70, (2, 2))
        away = shapely.distance(shapely.LineString([begin, end]), shape)
        if abs(away - radius) < 1e-5:
            continue
        path = Contact("f", Finger(radius, 10.0), False, tuple(begin.tolist()), tuple(end.tolist()), 0.0)
        free = bool(compiled_verify(Query(catalogue, [path], np.zeros(2)), ORIGIN).holds[0])
        assert free == (away > radius), (begin, end)
        outcomes[free] += 1
    assert min(outcomes.values()) > 50


@pytest.mark.parametrize("number", range(len(objects_of("own"))))
def test_lines_into_loose_objects_are_those_of_shapely(number: int) -> None:
    """The tip may go deeper into the outline than its radius: by 2 mm."""
    (model,) = objects_of("own")[number : number + 1]
    catalogue = Catalogue([type(model)(model.name, model.states[:1], tolerance_mm=2.5)])
    shape, rng = shape_of(catalogue), np.random.default_rng([30, number])
    outcomes: Counter[bool] = Counter()
    # A symmetric object may be given a little more tolerance.
    depth = catalogue.states[0].tolerance_mm - 0.5
    inner, sure = (shape.buffer(-depth + by, quad_segs=512) for by in (-1e-3, 1e-3))
    for _ in range(800):
        begin, end = rng.uniform(-60, 60, (2, 2))
        line = shapely.LineString([begin, end])
        deep = line.intersects(inner)
        if deep != line.intersects(sure):
            continue
        path = Contact("f", Finger(0.5, 10.0), False, tuple(begin.tolist()), tuple(end.tolist()), 0.0)
        free = bool(compiled_verify(Query(catalogue, [path], np.zeros(2)), ORIGIN).holds[0])
        assert free != deep, (begin, end)
        outcomes[free] += 1
    assert min(outcomes.values()) > 50


def test_nothing_is_asked() -> None:
    catalogue = Catalogue([SQUARE])
    none = Poses(np.empty(0, np.int64), np.empty(0), np.empty((0, 2)))
    contact = any_normal(np.array([25.0, 0.0]), 5.0)
    found = compiled_verify(Query(catalogue, [contact], np.zeros(2)), none)
    assert found.fits.shape == (0, 1)
    assert found.offset.shape == (0, 1, 2)
    assert (
        len(
            compiled_steps.may_fit(
                Query(catalogue, [contact], np.zeros(2)), none, Nearness(np.empty(0), np.empty(0))
            )
        )
        == 0
    )


def test_nothing_is_high_enough() -> None:
    """What touches fits nowhere, and every path is free."""
    catalogue = Catalogue([SQUARE, flat("low", [(-9, -9), (9, -9), (0, 9)], 4.0)])
    poses = Poses(np.array([0, 1]), np.zeros(2), np.zeros((2, 2)))
    touching = any_normal(np.array([25.0, 0.0]), 5.0)
    found = compiled_verify(Query(catalogue, [touching], np.zeros(2)), poses)
    assert found.fits.tolist() == [[True], [False]]
    assert found.gap[1, 0] == math.inf
    through = Contact("f", Finger(5.0, 10.0), False, (-50.0, 0.0), (50.0, 0.0), 0.0)
    assert compiled_verify(Query(catalogue, [through], np.zeros(2)), poses).holds.tolist() == [False, True]


def test_no_such_state() -> None:
    contact = any_normal(np.array([25.0, 0.0]), 5.0)
    for state in (-1, 1):
        poses = Poses(np.array([state]), np.zeros(1), np.zeros((1, 2)))
        with pytest.raises(IndexError, match="no such state"):
            compiled_verify(Query(Catalogue([SQUARE]), [contact], np.zeros(2)), poses)


# ----------------------------------------------------------------------------------------------------
# Stops that approaches may come to are enclosed as numpy encloses them, by short outlines and by long ones.


@pytest.mark.parametrize("source", ["memo", "own", "loose"])
@pytest.mark.parametrize("seed", sample(range(12), range(3)))
def test_stops_are_the_same(source: str, seed: int) -> None:
    rng = np.random.default_rng([48, seed])
    catalogue, finger = Catalogue(objects_of(source)), Finger(float(rng.choice([0.0, 5.0])), 10.0)
    edges, strips = catalogue.outlines(finger), catalogue.outline_strips(finger)
    count = 300
    state = rng.integers(len(catalogue.states), size=count)
    heading, away = rng.uniform(-np.pi, np.pi, count), rng.uniform(-60, 60, count)
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    start = -rng.uniform(0, 150, count)[:, None] * ahead + away[:, None] * ahead[:, ::-1] * [-1, 1]
    rays = Rays(state, start, ahead, rng.choice([0.0, 0.3, 5.0, 40.0], count))
    facing = Facing(
        heading + np.pi, rng.uniform(0, 0.5, count), rng.uniform(1.6, 3.2, count), rng.random(count) < 0.2
    )
    found, expected = (
        steps.enclose_stops(edges, strips, rays, facing) for steps in (compiled_steps, numpy_steps)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert np.isfinite(expected[2]).sum() > count / 10
    assert not np.isfinite(expected[2]).all()
