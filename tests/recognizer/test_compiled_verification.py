"""The compiled kernel verifies, rules out and polishes as numpy does; and shapely agrees with both."""

import math
from collections import Counter

import numpy as np
import pytest
import shapely
from campaign_objects import objects_of
from kernel_switch import needs_kernel, without_kernel
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, flat, grip, outlines, place, until_touched
from verification_cases import Case, drawn_case

from palpate.recognizer import Catalogue, Contact, Finger, recognise
from palpate.recognizer.budget import Budget
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.interpretation_tree import Interpretations
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.verification import Poses, Verification, may_fit, verify
from palpate.recognizer.witness_candidates import can_be_verified, polish

pytestmark = needs_kernel

PARTS = ("verification", "witness_candidates")
FEW = 40
CASES = sample(range(0, 30 * FEW, FEW), range(0, 2 * FEW, FEW))
SQUARE = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])


def judged(catalogue: Catalogue, case: Case) -> Verification:
    return verify(catalogue, case.poses, case.contacts, case.anchor_mm, case.skipped)


def same_as_numpy(case: Case) -> Verification:
    """What the kernel says, after it was compared with what numpy says."""
    catalogue = case.catalogue()
    found = judged(catalogue, case)
    with without_kernel(*PARTS):
        expected = judged(catalogue, case)
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


@pytest.mark.parametrize("first", CASES)
def test_verification_is_the_same(first: int) -> None:
    seen: Counter[str] = Counter()
    for seed in range(first, first + FEW):
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
    return Constraints(case.catalogue(), nodes, touched, list(case.contacts), case.anchor_mm)


@pytest.mark.parametrize("first", CASES)
def test_polishing_is_the_same(first: int) -> None:
    kept, moved = 0, 0
    for seed in range(first, first + FEW):
        case, rng = drawn_case(seed), np.random.default_rng([25, seed])
        cells = cells_about(case, rng)
        count = len(cells)
        cuts = np.sort(rng.integers(0, count, 8))
        begins = np.concatenate([[0], cuts, [count]])
        region = np.searchsorted(begins, np.arange(count), side="right") - 1
        cell = np.arange(count)
        constraints = constraints_of(case, rng)
        found, holds = polish(constraints, cells, begins, region, cell, case.poses)
        with without_kernel(*PARTS):
            expected, also = polish(constraints, cells, begins, region, cell, case.poses)
        assert np.array_equal(holds, also), seed
        np.testing.assert_allclose(found.theta, expected.theta, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.position, expected.position, rtol=0, atol=1e-7)
        kept += int(holds.sum())
        moved += int((holds & np.any(found.position != case.poses.position, axis=1)).sum())
    assert kept > moved > 5


@pytest.mark.parametrize("first", CASES)
def test_what_may_fit_is_the_same(first: int) -> None:
    """With budgets that leave some undecided, too: these are the same."""
    outcomes: Counter[bool] = Counter()
    for seed in range(first, first + FEW):
        case, rng = drawn_case(seed), np.random.default_rng([26, seed])
        times = 40 if seed % 20 == 0 else 1
        rows = np.tile(np.arange(len(case.poses)), times)
        turn = rng.choice([0.0, 1e-3, 0.1, 4.0], len(rows))
        shift = rng.choice([0.0, 0.01, 0.5, 5.0], len(rows))
        skipped = None if case.skipped is None else case.skipped[rows]
        catalogue = case.catalogue()
        for most in (None, 0, 300, 3000):
            asked = (
                catalogue, case.poses.select(rows), case.contacts, case.anchor_mm, turn, shift, skipped, most,
            )  # fmt: skip
            found = may_fit(*asked)
            with without_kernel(*PARTS):
                assert np.array_equal(found, may_fit(*asked)), (seed, most)
            outcomes.update(found.tolist())
    assert min(outcomes[True], outcomes[False]) > 500


def test_cells_that_can_be_verified_are_the_same() -> None:
    for seed in range(40):
        case, rng = drawn_case(seed), np.random.default_rng([27, seed])
        cells, constraints = cells_about(case, rng), constraints_of(case, rng)
        found = can_be_verified(constraints, cells)
        with without_kernel(*PARTS):
            assert np.array_equal(found, can_be_verified(constraints, cells))


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
        gap = verify(catalogue, ORIGIN, [any_normal(point, radius)], np.zeros(2)).gap[0, 0]
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
        free = bool(verify(catalogue, ORIGIN, [path], np.zeros(2)).holds[0])
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
        free = bool(verify(catalogue, ORIGIN, [path], np.zeros(2)).holds[0])
        assert free != deep, (begin, end)
        outcomes[free] += 1
    assert min(outcomes.values()) > 50


def test_nothing_is_asked() -> None:
    catalogue = Catalogue([SQUARE])
    none = Poses(np.empty(0, np.int64), np.empty(0), np.empty((0, 2)))
    contact = any_normal(np.array([25.0, 0.0]), 5.0)
    found = verify(catalogue, none, [contact], np.zeros(2))
    assert found.fits.shape == (0, 1)
    assert found.offset.shape == (0, 1, 2)
    assert len(may_fit(catalogue, none, [contact], np.zeros(2), np.empty(0), np.empty(0))) == 0


def test_nothing_is_high_enough() -> None:
    """What touches fits nowhere, and every path is free."""
    catalogue = Catalogue([SQUARE, flat("low", [(-9, -9), (9, -9), (0, 9)], 4.0)])
    poses = Poses(np.array([0, 1]), np.zeros(2), np.zeros((2, 2)))
    touching = any_normal(np.array([25.0, 0.0]), 5.0)
    found = verify(catalogue, poses, [touching], np.zeros(2))
    assert found.fits.tolist() == [[True], [False]]
    assert found.gap[1, 0] == math.inf
    through = Contact("f", Finger(5.0, 10.0), False, (-50.0, 0.0), (50.0, 0.0), 0.0)
    assert verify(catalogue, poses, [through], np.zeros(2)).holds.tolist() == [False, True]


def test_no_such_state() -> None:
    contact = any_normal(np.array([25.0, 0.0]), 5.0)
    for state in (-1, 1):
        poses = Poses(np.array([state]), np.zeros(1), np.zeros((1, 2)))
        with pytest.raises(IndexError, match="no such state"):
            verify(Catalogue([SQUARE]), poses, [contact], np.zeros(2))


RADII = (0.0, 1.0, 5.0, 8.0)
BOUNDS = (0.0, 0.01, 0.3, 1.0)
NORMALS = (math.radians(1), math.radians(10), math.radians(45), None)


@pytest.mark.parametrize("part", sample(range(10), range(2)))
def test_hypotheses_are_the_same(part: int) -> None:
    models = outlines(SHIPPED_OBJECTS)
    catalogue, compared = Catalogue(models), 0
    for index in range(8):
        rng = np.random.default_rng([31, part, index])
        placed = place(models[int(rng.integers(len(models)))], rng)
        half, bound = NORMALS[int(rng.integers(4))], BOUNDS[int(rng.integers(4))]
        contacts = until_touched(
            grip,
            placed,
            rng,
            fingers=int(rng.integers(3, 6)),
            radius=RADII[int(rng.integers(4))],
            bound=bound,
            half_range=half,
            at_bound=bool(index % 2),
            aim=0.3,
        )
        spurious = int(rng.integers(2)) if half is not None and bound < 1.0 else 0
        found = recognise(catalogue, contacts, max_spurious=spurious, budget=Budget(100_000))
        with without_kernel(*PARTS):
            expected = recognise(catalogue, contacts, max_spurious=spurious, budget=Budget(100_000))
        assert len(found.hypotheses) == len(expected.hypotheses), index
        for one, two in zip(found.hypotheses, expected.hypotheses, strict=True):
            assert one.state_index == two.state_index
            assert one.verified == two.verified
            assert one.configuration.x_mm == pytest.approx(two.configuration.x_mm, abs=1e-6)
            assert one.configuration.y_mm == pytest.approx(two.configuration.y_mm, abs=1e-6)
            assert one.configuration.theta_rad == pytest.approx(two.configuration.theta_rad, abs=1e-8)
            assert one.weight == pytest.approx(two.weight, rel=1e-5)
        compared += len(found.hypotheses)
    assert compared > 5
