"""Contacts from frames: bounds, outlines, sweeps."""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.resources import files
from itertools import chain

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.ops import nearest_points

from palpate.base.errors import InputError
from palpate.drivers.emulators.tip import PartSection, tip_load
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag, TipCalibration
from palpate.drivers.tactile.templates import template_set
from support.campaign.sampling import sample
from support.devices.array_tips import COLS, DESCRIPTION, PITCH, RADIUS, ROWS, TactileTip
from support.oracles.array_contacts import (
    CELL_STEPS,
    HalfPlane,
    Outcome,
    Session,
    contact,
    cylinder_session,
    draw,
    entry,
    extracted,
    pad_session,
    processed,
)

# ----------------------------------------------------------------------------------------------------
# The contact extractor against emulated contacts whose truth it does not see.

MIX = {"flat": 0.45, "end": 0.15, "vertex": 0.15, "notch": 0.1, "dell": 0.15}


def miss_rad(patch: ContactPatch, normals: tuple[float, ...]) -> float:
    """How far outside the range the nearest true direction is; negative inside."""
    return min(abs(patch.angle_rad - n) for n in normals) - patch.angle_half_range_rad


@pytest.mark.parametrize("count", sample([200, 1000], [200]))
def test_drawn_contacts_stay_inside_their_bounds(count: int) -> None:
    rng = np.random.default_rng(1983)
    halves: dict[str, list[float]] = {kind: [] for kind in MIX}
    outside = []
    tip = TactileTip(0)
    for i in range(count):
        if i % 100 == 0:
            tip = TactileTip(i, crosstalk=rng.uniform(0.05, 0.10))
        kind = str(rng.choice(list(MIX), p=list(MIX.values())))
        truth = draw(rng, kind)
        patch = tip.touch(truth.taxels_n)
        assert patch is not None
        halves[kind].append(math.degrees(patch.angle_half_range_rad))
        wrong = miss_rad(patch, truth.normals) > 0
        wrong |= abs(patch.height_mm - truth.top_mm / 2) > patch.height_bound_mm
        if PatchFlag.SEVERAL_PATCHES not in patch.flags:
            wrong |= abs(patch.force_n - truth.force_n) > patch.force_bound_n
        if wrong:
            outside.append((i, truth.kind, truth.normals, patch))
    assert outside == []
    # How narrow ranges are today; allowing for shallow notches cost flat edges 0.6°.
    assert np.median(halves["flat"]) < 9.0
    assert np.median(list(chain.from_iterable(halves.values()))) < 10.0


@pytest.mark.parametrize("spoiled", ["dead", "hot"])
def test_dead_and_hot_taxels_widen_and_are_named(spoiled: str) -> None:
    rng = np.random.default_rng(7)
    flagged = 0
    for seed in range(8):
        # Low rows carry load; a few of them are spoiled over the whole width.
        places = [(int(rng.integers(0, 4)), int(c)) for c in rng.choice(COLS, 6, replace=False)]
        tip = TactileTip(seed, **{spoiled: places})
        for _ in range(25):
            truth = draw(rng, str(rng.choice(list(MIX))))
            patch = tip.touch(truth.taxels_n)
            assert patch is not None
            assert miss_rad(patch, truth.normals) <= 0, (truth.kind, truth.normals, patch)
            flagged += PatchFlag.DEAD_NEIGHBOUR in patch.flags
    assert flagged > 100


def test_a_dead_column_is_bridged() -> None:
    rng = np.random.default_rng(8)
    tip = TactileTip(3, dead=[(row, 10) for row in range(ROWS)])
    for _ in range(60):
        truth = contact(rng, "flat", rng.uniform(-0.3, 0.5), 0.5, 1.5)
        patch = tip.touch(truth.taxels_n)
        assert patch is not None
        assert miss_rad(patch, truth.normals) <= 0, (truth.normals, patch)


def test_saturated_taxels_widen_and_are_named() -> None:
    rng = np.random.default_rng(9)
    tip = TactileTip(4)
    seen = 0
    for _ in range(120):
        truth = draw(rng, str(rng.choice(["flat", "end"])))
        patch = tip.touch(truth.taxels_n * 12.0)
        assert patch is not None
        if PatchFlag.SATURATED in patch.flags:
            seen += 1
            assert patch.force_bound_n == math.inf
            assert miss_rad(patch, truth.normals) <= 0, (truth.kind, truth.normals, patch)
    assert seen > 20


def test_patches_cut_by_the_edge_are_named_and_still_bounded() -> None:
    rng = np.random.default_rng(10)
    tip = TactileTip(5)
    edge = 10 * PITCH
    for _ in range(80):
        side = 1 if rng.random() < 0.5 else -1
        truth = contact(
            rng, str(rng.choice(["flat", "vertex", "end"])), side * (edge - rng.uniform(0, 0.3)), 0.5, 1.5
        )
        patch = tip.touch(truth.taxels_n)
        assert patch is not None
        assert PatchFlag.TRUNCATED in patch.flags or abs(truth.normals[0]) < edge - 0.1
        assert miss_rad(patch, truth.normals) <= 0, (truth.kind, truth.normals, patch)


def test_a_blunt_notch_is_called_wide() -> None:
    rng = np.random.default_rng(11)
    tip = TactileTip(6)
    wide = 0
    for _ in range(100):
        middle = rng.uniform(-1.0, 0.5)
        cells = np.zeros(COLS * CELL_STEPS)
        for normal in (middle, middle + math.radians(50)):
            rho = entry([HalfPlane(normal, RADIUS - 0.5)])
            cells = np.maximum(cells, np.maximum(0.0, RADIUS - rho)[: cells.size])
        columns = cells.reshape(COLS, CELL_STEPS).sum(axis=1)
        patch = tip.touch(2.0 * np.outer([0.2] * 5 + [0.0] * 3, columns / columns.sum()))
        assert patch is not None
        assert miss_rad(patch, (middle, middle + math.radians(50))) <= 0
        wide += PatchFlag.WIDE in patch.flags
    assert wide > 90


def test_two_touches_take_the_stronger_and_say_so() -> None:
    rng = np.random.default_rng(12)
    tip = TactileTip(7)
    strong, weak = contact(rng, "flat", -1.2, 0.5, 1.5), contact(rng, "flat", 1.2, 0.2, 0.6)
    patch = tip.touch(strong.taxels_n + weak.taxels_n)
    assert patch is not None
    assert PatchFlag.SEVERAL_PATCHES in patch.flags
    assert abs(patch.angle_rad + 1.2) <= patch.angle_half_range_rad


def test_known_gains_narrow_the_range() -> None:
    rng = np.random.default_rng(13)
    tip = TactileTip(8)
    known = ContactExtractor(DESCRIPTION, TipCalibration(gain=tip.array.taxels.gain, gain_spread=0.02))
    known.tare(tip.frames(np.zeros((ROWS, COLS)), 16))
    before, after = [], []
    for _ in range(60):
        truth = draw(rng, "flat")
        frames = tip.frames(truth.taxels_n, 4)
        for extractor, out in ((tip.extractor, before), (known, after)):
            patch = extractor.extract(frames)
            assert patch is not None
            assert miss_rad(patch, truth.normals) <= 0
            out.append(patch.angle_half_range_rad)
    assert np.median(after) < 0.8 * np.median(before)


def test_nothing_touched_gives_nothing_and_the_guard_follows_the_force() -> None:
    tip = TactileTip(9)
    quiet = tip.frames(np.zeros((ROWS, COLS)), 20)
    assert all(tip.extractor.extract(frame) is None for frame in quiet)
    assert max(tip.extractor.force_n(frame) for frame in quiet) < 0.02
    for force in (0.1, 0.5, 2.0):
        truth = contact(np.random.default_rng(1), "flat", 0.1, force / 3, force)
        (frame,) = tip.frames(truth.taxels_n, 1)
        assert 0.75 * force < tip.extractor.force_n(frame) < 1.25 * force


def test_tare_measures_offset_and_noise() -> None:
    tip = TactileTip(10, noise=3.0, dead=[(2, 2)], hot=[(4, 4)])
    baseline = tip.extractor.tare(tip.frames(np.zeros((ROWS, COLS)), 200))
    assert abs(float(baseline.mean[baseline.usable].mean()) - 20) < 0.2
    assert 2.8 < baseline.noise_counts < 3.2
    assert {tuple(map(int, p)) for p in np.argwhere(~baseline.usable)} == {(2, 2), (4, 4)}
    with pytest.raises(InputError, match="no frames"):
        tip.extractor.tare([])


def test_zeros_that_may_have_drifted_since_widen_the_force() -> None:
    drift = 0.5
    calibration = TipCalibration(gain=np.ones((ROWS, COLS)), drift_counts_per_s=drift)
    extractor = ContactExtractor(DESCRIPTION, calibration)
    noisy = (200 + np.random.default_rng(15).integers(-3, 4, (20, ROWS, COLS))).astype(np.uint16)
    extractor.tare([TactileFrame(i, 0.01 * i, 0.0, counts) for i, counts in enumerate(noisy)])
    touched = still([0] * 8 + [100, 400, 100] + [0] * 9).counts + np.uint16(200)
    soon, later = (
        extractor.extract([TactileFrame(0, 0.19, 0.0, touched), TactileFrame(1, at_s, 0.0, touched)])
        for at_s in (0.2, 20.2)
    )
    assert soon is not None
    assert later is not None
    taxels = ROWS * round(later.extent_rad / PITCH)
    grown = taxels * 20.0 * drift / DESCRIPTION.counts_per_n
    assert later.force_bound_n - soon.force_bound_n >= 0.99 * grown


def test_a_prepared_extractor_does_not_make_templates_at_the_first_contact() -> None:
    odd = replace(DESCRIPTION, tip_radius_mm=4.987)  # nobody else's
    extractor = ContactExtractor(odd, TipCalibration(gain=np.ones((ROWS, COLS))))
    before = template_set.cache_info()
    extractor.prepare()
    prepared = template_set.cache_info()
    assert prepared.misses == before.misses + 1
    assert extractor.extract(still([0] * 8 + [100, 400, 100] + [0] * 9)) is not None
    extractor.prepare()
    assert template_set.cache_info() == prepared


def test_a_flat_pad_says_that_it_does_not_know_the_normal() -> None:
    columns = tuple(2.0 * j for j in range(COLS))
    pad = replace(DESCRIPTION, shape=Shape.FLAT, tip_radius_mm=0.0, columns=columns)
    extractor = ContactExtractor(pad, TipCalibration(gain=np.ones((ROWS, COLS))))
    counts = np.zeros((ROWS, COLS), np.uint16)
    counts[2:4, 5:8] = 800
    patch = extractor.extract(TactileFrame(0, 0.0, 0.0, counts))
    assert patch is not None
    assert patch.angle_half_range_rad == pytest.approx(math.pi / 2)


def test_calibrations_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="gain of shape"):
        ContactExtractor(DESCRIPTION, TipCalibration(gain=np.ones((2, 2))))
    uneven = replace(DESCRIPTION, columns=(*DESCRIPTION.columns[:-1], 2.5))
    with pytest.raises(InputError, match="not evenly spaced"):
        ContactExtractor(uneven, TipCalibration(gain=np.ones((ROWS, COLS))))
    single = replace(DESCRIPTION, cols=1, columns=(0.0,))
    with pytest.raises(InputError, match="one column"):
        ContactExtractor(single, TipCalibration(gain=np.ones((ROWS, 1))))


CLEAN = ContactExtractor(DESCRIPTION, TipCalibration(gain=np.ones((ROWS, COLS))))


def still(columns: list[int]) -> TactileFrame:
    counts = np.zeros((ROWS, COLS), np.uint16)
    counts[:5] = np.asarray(columns, np.uint16)
    return TactileFrame(0, 0.0, 0.0, counts)


blobs = st.tuples(st.integers(1, 12), st.lists(st.integers(60, 700), min_size=1, max_size=6))


@given(blobs, st.integers(-4, 4))
@settings(max_examples=60)
def test_turning_the_contact_by_columns_turns_the_range(blob: tuple[int, list[int]], shift: int) -> None:
    at, heights = blob
    if not 1 <= at + shift <= COLS - 1 - len(heights):
        return
    pair = []
    for start in (at, at + shift):
        columns = [0] * COLS
        columns[start : start + len(heights)] = heights
        pair.append(CLEAN.extract(still(columns)))
    one, two = pair
    assert (one is None) == (two is None)
    if one is not None and two is not None:
        assert two.angle_rad - one.angle_rad == pytest.approx(shift * PITCH, abs=0.4 * PITCH)
        assert two.centroid_rad - one.centroid_rad == pytest.approx(shift * PITCH, abs=1e-5)
        assert two.force_n == pytest.approx(one.force_n)


@given(blobs)
@settings(max_examples=60)
def test_mirrored_contacts_give_mirrored_ranges(blob: tuple[int, list[int]]) -> None:
    at, heights = blob
    columns = [0] * COLS
    columns[at : at + len(heights)] = heights
    one, two = CLEAN.extract(still(columns)), CLEAN.extract(still(columns[::-1]))
    assert (one is None) == (two is None)
    if one is not None and two is not None:
        assert two.centroid_rad == pytest.approx(-one.centroid_rad, abs=1e-5)
        assert two.angle_rad == pytest.approx(-one.angle_rad, abs=0.012)
        assert two.angle_half_range_rad == pytest.approx(one.angle_half_range_rad, abs=0.012)
        assert two.height_mm == pytest.approx(one.height_mm)


@given(st.lists(st.integers(0, 4095), min_size=ROWS * COLS, max_size=ROWS * COLS))
@settings(max_examples=20)
def test_any_frame_gives_a_finite_patch_or_nothing(values: list[int]) -> None:
    patch = CLEAN.extract(TactileFrame(0, 0.0, 0.0, np.array(values, np.uint16).reshape(ROWS, COLS)))
    if patch is not None:
        assert math.isfinite(patch.angle_rad)
        assert 0 < patch.angle_half_range_rad < 2 * math.pi
        assert math.isfinite(patch.height_mm)


# ----------------------------------------------------------------------------------------------------
# The contact extractor against real outlines: the emulated skin pressed on the shipped models anywhere.

# Half as sensitive: the forces are small beside the noise, as they are where fingers stop gently.
FAINT = replace(DESCRIPTION, full_scale_n=2.0475, counts_per_n=2000.0)


def outlines() -> list[np.ndarray]:
    text = files("palpate.config").joinpath("objects", "memo.json").read_text()
    return [np.array(item["outline"], dtype=float) for item in json.loads(text)["objects"]]


def pressed(rng: np.random.Generator, shapes: list[np.ndarray]) -> Iterator[tuple[float, np.ndarray, float]]:
    """Direction of travel, force on the taxels, and direction from the tip's axis to the nearest point."""
    while True:
        ring = shapes[rng.integers(len(shapes))]
        part = shapely.Polygon(ring)
        away = rng.uniform(0, 2 * math.pi)
        heading = -np.array([math.cos(away), math.sin(away)])
        begin = np.array(part.centroid.coords[0]) + rng.uniform(-20, 20, 2) - 200 * heading
        force, stiffness = math.exp(rng.uniform(math.log(0.33), math.log(0.8))), 3 * rng.uniform(0.8, 1.2)
        travel = 0.0
        while (
            travel < 300 and (gap := part.distance(shapely.Point(begin + travel * heading)) - RADIUS) > 1e-6
        ):
            travel += gap
        if travel >= 300:
            continue
        low, high = travel, travel + 3.0
        for _ in range(25):
            middle = (low + high) / 2
            dent = RADIUS - part.distance(shapely.Point(begin + middle * heading))
            low, high = (middle, high) if dent < force / stiffness else (low, middle)
        centre = begin + low * heading
        touch = tip_load(PartSection(ring, np.roll(ring, -1, axis=0), 20.0), centre, RADIUS, stiffness)
        if touch is None:
            continue
        direction = away + math.pi
        seen = (touch.angle - direction + math.pi) % (2 * math.pi) - math.pi
        slot = np.floor((seen - FAINT.columns[0]) / PITCH + 0.5).astype(int)
        on = (slot >= 0) & (slot < COLS)
        columns = np.bincount(slot[on], touch.by_ray_n[on], minlength=COLS)
        near = nearest_points(part, shapely.Point(centre))[0]
        true = math.atan2(near.y - centre[1], near.x - centre[0])
        yield direction, np.tile(columns / ROWS, (ROWS, 1)), true


@pytest.mark.slow
@pytest.mark.parametrize("count", sample([200, 750], [200]))
def test_the_true_normal_is_in_the_range_wherever_a_finger_meets_a_part(count: int) -> None:
    """Parts have shallow corners, in and out, that a tip feels as one wide or lopsided patch."""
    rng = np.random.default_rng(705)
    tip = TactileTip(0, description=FAINT, crosstalk=0.06)
    outside, halves = [], []
    for number, (direction, taxels, true) in enumerate(pressed(rng, outlines())):
        if number == count:
            break
        if number % 100 == 0:
            tip = TactileTip(number, description=FAINT, crosstalk=0.06)
        patch = tip.touch(taxels, 8)
        if patch is None:
            continue  # pressed where the array has no taxels
        halves.append(patch.angle_half_range_rad)
        off = abs((true - direction - patch.angle_rad + math.pi) % (2 * math.pi) - math.pi)
        if off > patch.angle_half_range_rad:
            outside.append((number, math.degrees(off), math.degrees(patch.angle_half_range_rad), patch.flags))
    assert outside == []
    assert len(halves) > 0.93 * count
    assert np.median(halves) < math.radians(10.5)


# ----------------------------------------------------------------------------------------------------
# Bounds hold over emulated contacts on tips of every kind; `benchmarks/bench_contacts.py` has many more.

PER_SESSION = 40
SEEDS = range(400, 405)
MAKERS: dict[str, Callable[[int, int], Session]] = {"cylinder": cylinder_session, "pad": pad_session}


@pytest.mark.parametrize("tip", sample(MAKERS, ["pad"]))
def test_truths_are_within_their_bounds(tip: str) -> None:
    """Of 200 contacts one may be outside: bounds on noise are four standard deviations."""
    outcomes: list[Outcome] = []
    false = 0
    for seed in SEEDS:
        found = processed(MAKERS[tip](seed, PER_SESSION), seed)
        outcomes += found.outcomes
        false += found.false
    assert false == 0
    missed = [(o.seed, o.index, o.truth.force_n) for o in outcomes if o.patch is None]
    assert len(missed) <= 4, missed  # soft ones, spread out beneath the noise
    outside = [(o.seed, o.index, o.truth, o.outside) for o in outcomes if o.outside]
    assert len(outside) <= 1, outside
    halves = [o.normal_half if tip == "cylinder" else o.centroid_half for o in outcomes]
    assert np.median(halves) < (2.5 if tip == "cylinder" else 12.0)


@pytest.mark.parametrize("tip", list(MAKERS))
def test_single_frames_are_within_their_bounds(tip: str) -> None:
    outcomes = [
        one
        for seed in SEEDS[:4]
        for one in extracted(MAKERS[tip](seed, PER_SESSION), seed, range(0, PER_SESSION, 2))
    ]
    assert [(o.seed, o.index, o.truth, o.outside) for o in outcomes if o.outside] == []


def test_force_on_a_patchs_thin_ends_is_not_lost() -> None:
    """What crosstalk moves beside a patch is its load, too: in the mean nothing is missing but noise."""
    outcomes = [
        one
        for seed in SEEDS[:3]
        for one in extracted(
            cylinder_session(seed, PER_SESSION, gain_spread=0.01), seed, range(0, PER_SESSION, 2)
        )
    ]
    off = [o.patch.force_n / o.truth.force_n - 1 for o in outcomes if o.patch is not None]
    assert len(off) > 40
    assert abs(float(np.median(off))) < 0.004
