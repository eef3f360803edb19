"""Contacts on pads and their centroids."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.columns import CellLoads, UnseenLoads, centroids
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag, TipCalibration
from support.oracles.array_contacts import describe

# ----------------------------------------------------------------------------------------------------
# Patches on flat and free arrays: which taxels belong together, and what the bounds allow for.

ROWS, COLS = 6, 8
PITCH, ROW_PITCH = 2.0, 3.0
PER_N = 1000.0
FLAT = describe(Shape.FLAT, ROWS, COLS, PITCH, ROW_PITCH, counts_per_n=PER_N)


def extractor(description: Description = FLAT, **calibration: object) -> ContactExtractor:
    shape = (description.rows, description.cols)
    values: dict[str, object] = {"gain": np.ones(shape), "gain_spread": 0.1, "noise_counts": 2.0}
    return ContactExtractor(description, TipCalibration(**(values | calibration)))


def touch(of: ContactExtractor, force_n: np.ndarray) -> ContactPatch:
    """What it says of forces (rows, cols) N without noise."""
    counts = np.clip(np.rint(force_n * PER_N), 0, 4095).astype(np.uint16)
    patch = of.extract(TactileFrame(0, 0.0, 0.0, counts))
    assert patch is not None
    return patch


def loads(*places: tuple[int, int, float]) -> np.ndarray:
    force = np.zeros((ROWS, COLS))
    for row, col, load in places:
        force[row, col] = load
    return force


def place_mm(row: float, col: float) -> tuple[float, float]:
    return (col - (COLS - 1) / 2) * PITCH, (row + 0.5) * ROW_PITCH


def test_force_position_and_area_of_a_known_load() -> None:
    patch = touch(extractor(), loads((2, 3, 0.5), (2, 4, 0.5), (3, 3, 0.5), (3, 4, 0.5)))
    x, z = place_mm(2.5, 3.5)
    assert patch.force_n == pytest.approx(2.0)
    assert patch.position_mm == pytest.approx((x, 0.0, z))
    assert patch.height_mm == pytest.approx(z)
    assert patch.height_bound_mm == patch.position_bound_mm[2]
    assert patch.position_bound_mm[1] == 0.0
    assert PITCH / 2 < patch.position_bound_mm[0] < PITCH
    assert ROW_PITCH / 2 < patch.position_bound_mm[2] < ROW_PITCH
    assert patch.area_mm2 == pytest.approx(4 * PITCH * ROW_PITCH)
    assert patch.force_bound_n == pytest.approx(0.1 * 2.0 / 0.9, rel=0.5)
    assert (patch.angle_rad, patch.angle_half_range_rad) == pytest.approx((-math.pi / 2, math.pi / 2))
    assert math.isnan(patch.centroid_rad)
    assert patch.flags == frozenset()


@pytest.mark.parametrize("off", [-0.5, 0.5])
def test_gains_that_are_all_off_alike_are_within_the_bound_that_says_so(off: float) -> None:
    pressed = np.zeros((ROWS, COLS))
    pressed[1:5, 2:7] = 0.1
    patch = touch(extractor(gain_spread=0.5, is_common=True), pressed * (1 + off))
    assert abs(patch.force_n - pressed.sum()) <= patch.force_bound_n
    assert touch(extractor(gain_spread=0.5), pressed).force_bound_n < pressed.sum() * 0.5 / 0.5


def upright(rows: int, cols: int) -> Description:
    """A free array round an upright cylinder, columns 20° apart."""
    angle = np.radians(20.0) * (np.arange(cols) - (cols - 1) / 2)
    normal = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    normals = np.broadcast_to(normal, (rows, cols, 3))
    place = 5.0 * normals + np.arange(rows)[:, None, None] * [0.0, 0.0, 2.0]
    geometry = tuple(np.concatenate([place, normals], axis=2).ravel().tolist())
    flat = describe(Shape.FLAT, rows, cols, PITCH, ROW_PITCH, counts_per_n=PER_N)
    return replace(flat, shape=Shape.FREE, columns=(), row_heights_mm=(), geometry=geometry)


@pytest.mark.parametrize(
    ("rows", "col", "half_deg"),
    [(3, 3, 10.0), (3, 0, 50.0), (1, 3, 50.0)],  # cut above and below only, at an end, and by one row
)
def test_an_edge_across_which_normals_do_not_turn_leaves_them_known(
    rows: int, col: int, half_deg: float
) -> None:
    force = np.zeros((rows, 7))
    force[:, col] = 0.5
    patch = touch(extractor(upright(rows, 7)), force)
    assert PatchFlag.TRUNCATED in patch.flags
    assert math.degrees(patch.angle_rad) == pytest.approx(20.0 * (col - 3))
    assert math.degrees(patch.angle_half_range_rad) == pytest.approx(half_deg)


def test_two_touches_are_two_patches_and_the_stronger_counts() -> None:
    both = loads((1, 1, 0.4), (1, 2, 0.4), (4, 5, 0.5), (4, 6, 0.5))
    patch = touch(extractor(), both)
    assert patch.flags == {PatchFlag.SEVERAL_PATCHES}
    assert patch.force_n == pytest.approx(1.0)
    assert patch.position_mm[0] == pytest.approx(place_mm(4, 5.5)[0])
    # Force decides, not size.
    wide = loads(*((1, col, 0.1) for col in range(1, 7)), (4, 4, 0.9))
    assert touch(extractor(), wide).position_mm[2] == pytest.approx(place_mm(4, 0)[1])


def test_diagonal_neighbours_belong_together() -> None:
    patch = touch(extractor(), loads((2, 2, 0.5), (3, 3, 0.5)))
    assert PatchFlag.SEVERAL_PATCHES not in patch.flags
    assert patch.force_n == pytest.approx(1.0)
    assert patch.position_mm[0] == pytest.approx(place_mm(0, 2.5)[0])


def test_a_dead_taxel_joins_what_is_on_both_of_its_sides() -> None:
    usable = np.ones((ROWS, COLS), dtype=bool)
    usable[2, 3] = False
    dead = extractor(usable=usable)
    true = loads((2, 2, 0.5), (2, 3, 0.5), (2, 4, 0.5))
    taxels = Taxels(FLAT, seed=1, noise_counts=0.0, crosstalk=0.075, dead=[(2, 3)])
    patch = touch(dead, taxels.counts(true) / PER_N)
    assert PatchFlag.DEAD_NEIGHBOUR in patch.flags
    assert PatchFlag.SEVERAL_PATCHES not in patch.flags
    # What it bears is in the bounds.
    assert 0.9 < patch.force_n < 1.2
    assert patch.force_n + patch.force_bound_n >= 1.5
    assert abs(patch.position_mm[0] - place_mm(2, 3)[0]) <= patch.position_bound_mm[0]
    one_sided = loads((2, 2, 0.2), (2, 3, 1.0))
    patch = touch(dead, taxels.counts(one_sided) / PER_N)
    assert abs(patch.position_mm[0] - place_mm(2, 2 + 1 / 1.2)[0]) <= patch.position_bound_mm[0]
    assert patch.force_n + patch.force_bound_n >= 1.2
    far = touch(dead, loads((4, 6, 0.5)))
    assert PatchFlag.DEAD_NEIGHBOUR not in far.flags


@pytest.mark.parametrize(
    "places",
    [
        [(2, 0), (3, 0), (2, 1), (3, 1)],
        [(2, COLS - 1), (3, COLS - 1), (2, COLS - 2), (3, COLS - 2)],
        [(0, 3), (0, 4), (1, 3), (1, 4)],
        [(ROWS - 1, 3), (ROWS - 1, 4), (ROWS - 2, 3), (ROWS - 2, 4)],
    ],
    ids=["left", "right", "bottom", "top"],
)
def test_each_side_cuts_patches(places: list[tuple[int, int]]) -> None:
    """Two lines alike: the load may go on beyond as far as it likes, along that axis only."""
    patch = touch(extractor(), loads(*((row, col, 0.5) for row, col in places)))
    assert PatchFlag.TRUNCATED in patch.flags
    sideways = len({col for _, col in places} & {0, COLS - 1}) > 0
    across, along = (0, 2) if sideways else (2, 0)
    assert math.isinf(patch.position_bound_mm[across])
    assert patch.position_bound_mm[along] < 5 * PITCH


def test_a_load_that_falls_off_towards_the_side_is_bounded() -> None:
    falling = loads((2, 0, 0.1), (3, 0, 0.1), (2, 1, 1.0), (3, 1, 1.0), (2, 2, 1.0), (3, 2, 1.0))
    patch = touch(extractor(), falling)
    assert all(map(math.isfinite, patch.position_bound_mm))
    # A tenth of a tenth lies beyond at most, 0.02 N, and ends not far out.
    rest, out = 0.02, place_mm(0, -2)[0]
    centroid = (4.4 * patch.position_mm[0] + rest * out) / (4.4 + rest)
    assert abs(centroid - patch.position_mm[0]) < patch.position_bound_mm[0] < 2 * PITCH


def test_nothing_inside_cuts() -> None:
    assert PatchFlag.TRUNCATED not in touch(extractor(), loads((1, 1, 0.5), (1, 2, 0.5))).flags


def test_saturated_taxels_leave_the_force_open() -> None:
    patch = touch(extractor(), loads((2, 3, 5.0), (2, 4, 0.5), (3, 3, 0.6)))
    assert PatchFlag.SATURATED in patch.flags
    assert math.isinf(patch.force_bound_n)
    assert abs(patch.position_mm[0] - place_mm(2, 3)[0]) <= patch.position_bound_mm[0]
    assert abs(patch.position_mm[2] - place_mm(2, 3)[1]) <= patch.position_bound_mm[2]


def test_a_single_taxel_is_named() -> None:
    patch = touch(extractor(), loads((2, 3, 0.5)))
    assert patch.flags == {PatchFlag.SINGLE_TAXEL}
    assert patch.position_mm[0] == pytest.approx(place_mm(2, 3)[0])
    assert patch.position_bound_mm[0] >= PITCH / 2


def test_less_than_the_contact_force_is_no_contact() -> None:
    counts = np.rint(loads((2, 3, 0.08)) * PER_N).astype(np.uint16)
    assert extractor().extract(TactileFrame(0, 0.0, 0.0, counts)) is None
    assert extractor(contact_force_n=0.05).extract(TactileFrame(0, 0.0, 0.0, counts)) is not None


def per_taxel(description: Description) -> Description:
    """The same array, its places given taxel by taxel."""
    geometry = np.concatenate([description.positions_mm(), description.normals()], axis=2)
    return replace(
        description,
        shape=Shape.FREE,
        tip_radius_mm=0.0,
        columns=(),
        row_heights_mm=(),
        geometry=tuple(geometry.ravel().tolist()),
    )


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_a_flat_pad_given_by_taxels_says_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force = np.zeros((ROWS, COLS))
    row, col = rng.integers(0, ROWS - 1), rng.integers(0, COLS - 1)
    force[row : row + 3, col : col + 3] = rng.uniform(0.1, 1.0, force[row : row + 3, col : col + 3].shape)
    one, two = touch(extractor(), force), touch(extractor(per_taxel(FLAT)), force)
    assert two.position_mm == pytest.approx(one.position_mm)
    assert two.position_bound_mm == pytest.approx(one.position_bound_mm)
    assert (two.force_n, two.force_bound_n) == pytest.approx((one.force_n, one.force_bound_n))
    assert two.flags == one.flags
    assert two.area_mm2 == pytest.approx(one.area_mm2)


def test_a_flat_pad_given_by_taxels_does_not_know_the_normal() -> None:
    patch = touch(extractor(per_taxel(FLAT)), loads((2, 3, 0.5), (2, 4, 0.5)))
    assert patch.angle_half_range_rad >= math.radians(45)


RADIUS, TURN = 8.0, math.radians(15)
ROUND = describe(Shape.CYLINDER, ROWS, 12, TURN, 2.0, counts_per_n=PER_N, radius_mm=RADIUS)


@pytest.mark.parametrize("col", range(2, 9))
def test_a_cylinder_given_by_taxels_says_the_same_of_force_and_place(col: int) -> None:
    force = np.zeros((ROWS, 12))
    force[2:4, col : col + 2] = 0.4
    one, two = touch(extractor(ROUND), force), touch(extractor(per_taxel(ROUND)), force)
    angle = (col + 0.5 - 5.5) * TURN
    assert two.force_n == pytest.approx(one.force_n)
    for patch in (one, two):
        assert abs(patch.angle_rad - angle) <= patch.angle_half_range_rad
        truth = (RADIUS * math.cos(angle), RADIUS * math.sin(angle), 6.0)
        away = np.abs(np.subtract(patch.position_mm, truth))
        assert (away <= np.add(patch.position_bound_mm, 1e-9)).all()
    assert two.angle_rad == pytest.approx(one.angle_rad, abs=0.6 * TURN)


def dome() -> Description:
    """A finger tip: a hemisphere of radius 8 on a stump, its rows parallels, its columns over half a turn."""
    rows, cols, radius = 7, 12, 8.0
    azimuth = np.radians(np.linspace(-90, 90, cols))
    rise = np.radians(np.linspace(0, 66, rows))
    normal = np.stack(
        [
            np.cos(rise)[:, None] * np.cos(azimuth),
            np.cos(rise)[:, None] * np.sin(azimuth),
            np.sin(rise)[:, None] * np.ones(cols),
        ],
        axis=2,
    )
    place = radius * normal + np.array([0.0, 0.0, 10.0])
    return replace(
        describe(Shape.FLAT, rows, cols, 1.0, 1.0, counts_per_n=PER_N),
        shape=Shape.FREE,
        columns=(),
        row_heights_mm=(),
        geometry=tuple(np.concatenate([place, normal], axis=2).ravel().tolist()),
    )


@pytest.mark.parametrize("towards", [(20.0, 0.0), (40.0, -50.0), (35.0, 45.0), (10.0, 30.0)])
def test_on_a_dome_place_and_direction_are_right(towards: tuple[float, float]) -> None:
    """A ball pressed on it from somewhere, its load falling off with the angle from there."""
    description = dome()
    rise, azimuth = map(math.radians, towards)
    toward = np.array(
        [math.cos(rise) * math.cos(azimuth), math.cos(rise) * math.sin(azimuth), math.sin(rise)]
    )
    away = np.arccos(np.clip(description.normals() @ toward, -1, 1))
    # A taxel bears the load of its part of the surface, which is smaller higher up.
    share = np.linalg.norm(description.normals()[..., :2], axis=2)
    force = np.maximum(0.0, 1 - (away / math.radians(35)) ** 2) * share
    force *= 2.0 / force.sum()
    patch = touch(extractor(description), force)
    truth = 8.0 * toward + np.array([0.0, 0.0, 10.0])
    assert patch.force_n == pytest.approx(2.0, rel=0.02)
    assert abs(patch.angle_rad - azimuth) <= patch.angle_half_range_rad < math.radians(90)
    # The middle of a load on a curved surface is below the surface: by 8 % of the radius for this cap.
    assert (np.abs(np.subtract(patch.position_mm, truth)) <= np.add(patch.position_bound_mm, 0.64)).all()
    assert abs(patch.height_mm - truth[2]) <= patch.height_bound_mm + 0.64


# ----------------------------------------------------------------------------------------------------
# The true centroid of a load is within the bound, whatever is unknown of cells, gains and unseen places.

CELLS = 9
PLACE = 2.0 * np.arange(CELLS) - 5.0
seeds = st.integers(0, 2**32 - 1)
NOTHING = UnseenLoads(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))


def load_of(
    force: np.ndarray, *, spread: float = 0.0, drift: float = 0.0, around: np.ndarray | None = None
) -> CellLoads:
    """One frame."""
    every = np.ones((1, CELLS), dtype=bool) if around is None else around[None]
    patch = every & (force[None] > 0)
    zero = np.zeros((1, CELLS))
    return CellLoads(force[None], zero, zero + drift, patch, every, np.zeros(1), zero + spread)


def points(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """Point loads anywhere in a stretch of cells: forces on cells, their places, their centroid."""
    begin, end = np.sort(rng.choice(CELLS + 1, 2, replace=False))
    where = rng.uniform(PLACE[0] + 2 * begin - 1, PLACE[0] + 2 * end - 1, rng.integers(1, 20))
    weight = rng.exponential(size=len(where))
    cell = np.clip(((where - PLACE[0] + 1) // 2).astype(int), 0, CELLS - 1)
    return np.bincount(cell, weight, CELLS), where, float(where @ weight / weight.sum())


def missed(load: CellLoads, truth: float, unseen: UnseenLoads = NOTHING) -> float:
    centre, half = centroids(load, PLACE, 1.0, np.zeros(1), unseen)
    return float(abs(truth - centre[0]) - half[0])


@given(seeds)
def test_load_may_be_anywhere_within_its_cell(seed: int) -> None:
    force, _, truth = points(np.random.default_rng(seed))
    assert missed(load_of(force), truth) <= 1e-9


@given(seeds, st.floats(0.0, 0.4))
def test_gains_may_be_anything_within_their_spread(seed: int, spread: float) -> None:
    """Four standard deviations of independent gains, at most their limit."""
    rng = np.random.default_rng(seed)
    force, _, truth = points(rng)
    gain = 1 + spread * rng.uniform(-1, 1, CELLS)
    # The spread is of what is read: a share of the force said, not of the true one.
    assert missed(load_of(force * gain, spread=spread / (1 - spread)), truth) <= 1e-9


@given(seeds, st.floats(0.0, 0.05))
def test_zeros_may_be_off_by_their_drift(seed: int, drift: float) -> None:
    rng = np.random.default_rng(seed)
    force, _, truth = points(rng)
    force = force / force.sum()
    off = drift * rng.choice((-1, 1), CELLS)
    read = force + off
    if read.sum() < 0.2:
        return
    load = load_of(np.where(force > 0, read, off), drift=drift)
    assert missed(load, truth) <= 1e-9


@given(seeds)
def test_a_cell_that_cannot_be_seen_may_bear_up_to_its_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force, _, truth = points(rng)
    blind = int(rng.integers(0, CELLS))
    seen = np.where(np.arange(CELLS) == blind, 0.0, force)
    if seen.sum() == 0:
        return
    limit = force[blind] * rng.uniform(1.0, 3.0)
    unseen = UnseenLoads(
        np.array([[limit]]), np.array([[PLACE[blind] - 1.0]]), np.array([[PLACE[blind] + 1.0]])
    )
    assert missed(load_of(seen), truth, unseen) <= 1e-9


@given(seeds)
def test_several_unseen_places_add_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force, _, _ = points(rng)
    extra, at = rng.exponential(0.3, 3), rng.uniform(-20, 20, 3)
    truth = float((force @ PLACE + extra @ at) / (force.sum() + extra.sum()))
    unseen = UnseenLoads(extra[None] * 1.01, at[None] - 0.5, at[None] + 0.5)
    assert missed(load_of(force), truth, unseen) <= 1e-9


def test_where_nothing_limits_unseen_load_the_centroid_may_be_there() -> None:
    force = np.zeros(CELLS)
    force[3:5] = 1.0
    unseen = UnseenLoads(np.array([[np.inf]]), np.array([[3.0]]), np.array([[5.0]]))
    centre, half = centroids(load_of(force), PLACE, 1.0, np.zeros(1), unseen)
    assert centre[0] == pytest.approx(2.0)
    assert centre[0] + half[0] == pytest.approx(5.0)
    anywhere = UnseenLoads(np.array([[np.inf]]), np.array([[-np.inf]]), np.array([[0.0]]))
    assert np.isinf(centroids(load_of(force), PLACE, 1.0, np.zeros(1), anywhere)[1][0])


def test_frames_do_not_mind_one_another() -> None:
    rng = np.random.default_rng(3)
    forces = np.stack([points(rng)[0] for _ in range(20)])
    every = np.ones_like(forces, dtype=bool)
    zero = np.zeros_like(forces)
    none = np.zeros((20, 1))
    many = CellLoads(forces, zero + 0.01, zero, forces > 0, every, np.full(20, 0.01), zero + 0.1)
    centre, half = centroids(many, PLACE, 1.0, np.zeros(20), UnseenLoads(none, none, none))
    for i, force in enumerate(forces):
        one = CellLoads(
            force[None],
            zero[:1] + 0.01,
            zero[:1],
            force[None] > 0,
            every[:1],
            np.full(1, 0.01),
            zero[:1] + 0.1,
        )
        single = centroids(one, PLACE, 1.0, np.zeros(1), NOTHING)
        assert (single[0][0], single[1][0]) == pytest.approx((centre[i], half[i]))


def test_noise_and_a_smaller_cell_change_the_bound_as_they_should() -> None:
    force = np.zeros(CELLS)
    force[2:6] = [1.0, 2.0, 2.0, 1.0]
    quiet = load_of(force)
    _, coarse = centroids(quiet, PLACE, 1.0, np.zeros(1), NOTHING)
    _, fine = centroids(quiet, PLACE, 0.25, np.zeros(1), NOTHING)
    assert coarse[0] == pytest.approx(1.0)
    assert fine[0] == pytest.approx(0.25)
