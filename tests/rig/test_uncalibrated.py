"""An uncalibrated rig, and its arrays."""

import math
import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.calibration.idle_statistics import IdleFit, analyse_idle
from palpate.calibration.measurements import IdleMeasurement
from palpate.calibration.tactile_step import IDLE_S
from palpate.config import (
    ObjectsFile,
    RigFile,
    SlideFingerConfig,
    load_objects,
    load_rig,
    shipped_objects,
    shipped_rig,
)
from palpate.drivers.emulators.mechanics import FingerTruth, SlideMechanics
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.kinematics import TICK_RAD
from palpate.drivers.tactile.columns import column_windows
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.rig.arrays import calibration_of, doubt_warning, extractor_of, threshold_problem
from palpate.rig.conversion import array_bound_rad, tip_bound_mm
from palpate.rig.emulated.devices import description_of
from palpate.rig.fingers import resolution_of
from palpate.rig.mechanisms import kinematics_of
from palpate.rig.mechanisms.slide import slide_kinematics
from palpate.rig.reach.approaches import reach_of
from support.benches.rigs import firm_rig
from support.benches.session import emulated_session, run_checked
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# What is not measured yet widens the bounds of what is felt: enough for the truth, and hardly more.

FRESH = load_rig(EXAMPLES / "fresh-rig.toml")
BENCH = load_rig(firm_rig())


def with_all(rig: RigFile, part: str, **changes: float) -> RigFile:
    """The rig with the same keys of a table of every finger changed."""
    fingers = [
        finger.model_copy(update={part: getattr(finger, part).model_copy(update=changes)})
        for finger in rig.fingers
    ]
    return rig.model_copy(update={"fingers": fingers})


def newer_errors() -> RigFile:
    """The measured bench, but with tips, arrays and slides as they were built, and bounds that say so."""
    assert BENCH.emulation is not None
    drawn = {
        "tip_radius_error_mm": 0.3,
        "array_heading_error_deg": 3.0,
        "zero_error_mm": 0.5,
        "mm_per_turn_error": 0.003,
    }
    rig = BENCH.model_copy(update={"emulation": BENCH.emulation.model_copy(update=drawn)})
    rig = with_all(rig, "tip", radius_bound_mm=0.3)
    rig = with_all(rig, "array", heading_bound_deg=3.0)
    return with_all(rig, "slide", zero_bound_mm=0.5, mm_per_turn_spread=0.003)


@pytest.mark.parametrize("number", [0, 1])
def test_the_true_tip_is_within_the_bound(number: int) -> None:
    """Truth at the ends of the bounds, angles read as the encoder steps; slides of both directions."""
    spec = FRESH.fingers[number]
    assert isinstance(spec, SlideFingerConfig)
    if number == 1:
        # Growing angles pull back; Goal Position 0 is in the middle of the range.
        slide = spec.slide.model_copy(update={"mm_per_turn": -100.0, "zero_mm": 142.0})
        spec = spec.model_copy(update={"slide": slide})
    k = slide_kinematics(spec)
    rng = np.random.default_rng(5)
    closest = 0.0
    for _ in range(200):
        ends = rng.choice([-1.0, 1.0], 7)
        bearing = rng.uniform(0, 2 * math.pi)
        per_turn = spec.slide.mm_per_turn * (1 + 0.003 * ends[0])
        truth = FingerTruth(
            base_mm=(
                spec.base_mm[0] + 3.0 * math.cos(bearing),
                spec.base_mm[1] + 3.0 * math.sin(bearing),
            ),
            heading_rad=math.radians(spec.heading_deg + 3.0 * ends[1]),
            height_mm=10.0,
            gear_ratio=5.0,
            aim_zero_rad=k.aim_zero_rad + 5.0 * ends[2] * math.radians(0.02),
            aim_play_rad=0.0,
            mm_per_rad=per_turn / (2 * math.pi),
            # The file's zero is that of Goal Position 0, half a turn before 2048.
            zero_mm=spec.slide.zero_mm + 0.5 * ends[3] + per_turn / 2 + 0.2 * ends[4],
            slide_play_mm=0.0,
            tip_radius_mm=5.0,
            stiffness_n_per_mm=3.0,
            array_heading_rad=0.0,
        )
        turns = (rng.uniform(45.0, 250.0) - spec.slide.zero_mm) / spec.slide.mm_per_turn
        ticks = (round(rng.uniform(-1900, 1900)), round(4096 * (turns - 0.5)))
        shafts = [(tick + 0.499 * end) * TICK_RAD for tick, end in zip(ticks, ends[5:], strict=True)]
        servos = (ticks[0] * TICK_RAD, ticks[1] * TICK_RAD)
        mechanics = SlideMechanics(
            truth,
            EmulatedServo(1, start_rad=float(shafts[0])),
            EmulatedServo(2, start_rad=float(shafts[1])),
        )
        off = math.dist(mechanics.centre_mm, k.centre_mm(servos))
        assert off <= k.position_bound_mm(servos)
        assert (
            abs(math.remainder(mechanics.facing_rad - k.facing_rad(servos), math.tau))
            <= k.direction_bound_rad
        )
        closest = max(closest, off / k.position_bound_mm(servos))
    assert closest > 0.9, "the bound is not far too wide either"


def test_touches_of_tips_that_are_not_as_drawn_are_within_their_bounds() -> None:
    objects = ObjectsFile((load_objects(shipped_objects()).objects[3],))
    touches = run_checked(emulated_session(seed=3, rig=newer_errors(), objects=objects), 1, 3)
    assert sum(touch.contact.touched for touch in touches) >= 2


def test_what_tip_and_array_may_be_off_widens_contacts_and_plans() -> None:
    wide, plain = with_all(BENCH, "tip", radius_bound_mm=0.3), BENCH
    for one, other in zip(reach_of(wide).approaches[::20], reach_of(plain).approaches[::20], strict=True):
        widened = one.position_bound_mm - other.position_bound_mm
        assert widened == pytest.approx(0.3)
    assert resolution_of(wide).distance_mm == pytest.approx(resolution_of(plain).distance_mm + 0.6)
    turned = with_all(BENCH, "array", heading_bound_deg=3.0)
    widened = resolution_of(turned).normal_half_rad - resolution_of(plain).normal_half_rad
    assert widened == pytest.approx(math.radians(3.0))


@pytest.mark.parametrize("rig", [FRESH, load_rig(EXAMPLES / "two-link-rig.toml")], ids=["slides", "arms"])
def test_bounds_that_were_found_take_the_place_of_the_others(rig: RigFile) -> None:
    rig = with_all(with_all(rig, "tip", radius_bound_mm=0.3), "array", heading_bound_deg=3.0)
    rig = with_all(rig, "bounds", encoder_deg=0.0)
    found = with_all(rig, "bounds", position_mm=0.7, direction_deg=0.9)
    for before, finger in zip(rig.fingers, found.fingers, strict=True):
        assert (tip_bound_mm(before), array_bound_rad(before)) == (0.3, math.radians(3.0))
        assert (tip_bound_mm(finger), array_bound_rad(finger)) == (0.0, 0.0)
        kinematics = kinematics_of(finger)
        for servos in ((0.0, 0.0), (0.4, -0.3)):
            assert kinematics.position_bound_mm(servos) == 0.7
            assert kinematics.centre_mm(servos) == kinematics_of(before).centre_mm(servos)
        assert kinematics.direction_bound_rad == math.radians(0.9)
    # A direction alone leaves the places as they were: they do not count the array's.
    alone = with_all(rig, "bounds", direction_deg=0.9)
    before, turned = (kinematics_of(item.fingers[0]) for item in (rig, alone))
    assert turned.position_bound_mm((0.0, 0.0)) == before.position_bound_mm((0.0, 0.0))


# ----------------------------------------------------------------------------------------------------
# What the rig file says of an array's taxels is what its extractor is told.

ROWS, COLS = 2, 3
SMALL = Description(
    unique_id=b"array of a rig.",
    firmware="test",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=ROWS,
    cols=COLS,
    bit_depth=12,
    max_rate_hz=100.0,
    full_scale_n=4.0,
    counts_per_n=1000.0,
    tip_radius_mm=6.0,
    columns=(-0.3, 0.0, 0.3),
    row_heights_mm=(1.0, 3.0),
)
TAXELS = {
    "gain": [[1.0, 2.0, 1.0], [0.5, 1.0, 1.0]],
    "gain_bound": [[0.02, 0.03, 0.04], [0.02, 0.3, 0.3]],
    "unusable": [[1, 2]],
    "noise_counts": 1.5,
    "crosstalk": 0.06,
    "crosstalk_bound": 0.01,
}


def rig(taxels: dict[str, Any] | None) -> RigFile:
    data = tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    if taxels is not None:
        data["fingers"][0]["array"]["taxels"] = taxels
    return RigFile.model_validate(data)


def test_calibrated_taxels_are_used_one_by_one() -> None:
    file = rig(TAXELS)
    told = calibration_of(file, file.fingers[0], SMALL)
    assert told.gain.tolist() == TAXELS["gain"]
    assert told.spreads.tolist() == TAXELS["gain_bound"]
    assert (told.noise_counts, told.crosstalk, told.crosstalk_bound) == (1.5, 0.06, 0.01)
    assert told.usable is not None
    assert np.argwhere(~told.usable).tolist() == [[1, 2]]
    assert told.stiffness_n_per_mm == file.fingers[0].tip.stiffness_n_per_mm
    # And so a taxel of twice the gain shows the same force with twice the counts.
    counts = np.array([[0, 1000, 0], [0, 500, 0]], np.uint16)
    assert ContactExtractor(SMALL, told).force_n(TactileFrame(0, 0.0, 0.0, counts)) == pytest.approx(1.0)


def test_an_array_that_was_not_calibrated_has_one_bound_for_all() -> None:
    file = rig(None)
    told = calibration_of(file, file.fingers[0], SMALL)
    assert (told.gain == 1).all()
    assert (told.spreads == file.fingers[0].array.gain_spread).all()
    assert told.spreads.shape == (ROWS, COLS)
    assert told.usable is None


def test_taxels_of_another_array_are_refused() -> None:
    file = rig(TAXELS | {"gain": [[1.0, 1.0]], "gain_bound": [[0.1, 0.1]], "unusable": []})
    with pytest.raises(InputError, match=f"finger {file.fingers[0].name}: array.taxels are 1 x 2 .* 2 x 3"):
        extractor_of(file, file.fingers[0], SMALL)


def noisy(noise_counts: float, load_n: float = 0.0, count: int = 4000) -> tuple[ContactExtractor, np.ndarray]:
    """An extractor of the shipped bench's size that was tared, and what it makes of frames under a load."""
    rng = np.random.default_rng(5)
    big = replace(SMALL, rows=8, cols=20, counts_per_n=2000.0, columns=tuple(np.linspace(-1.0, 1.0, 20)))
    big = replace(big, row_heights_mm=tuple(range(8)))
    extractor = ContactExtractor(big, calibration_of(rig(None), rig(None).fingers[0], big))

    def frames(load: float, many: int) -> list[TactileFrame]:
        counts = 100.0 + rng.normal(0.0, noise_counts, (many, 8, 20))
        counts[:, :, 9:12] += load * 2000.0 / 24
        return [TactileFrame(k, k / 250, k / 250, c.round().astype(np.uint16)) for k, c in enumerate(counts)]

    extractor.tare(frames(0.0, 16))
    return extractor, np.array([extractor.force_n(frame) for frame in frames(load_n, count)])


def test_noise_alone_stays_below_the_least_threshold_and_a_light_contact_does_not() -> None:
    extractor, untouched = noisy(2.0)
    assert extractor.least_force_n < 0.05
    assert untouched.max() < extractor.least_force_n
    # Spread over 24 taxels 0.06 N are 5 counts a taxel: within four standard deviations of each.
    assert (noisy(2.0, load_n=0.07)[1] > 0.05).mean() > 0.99


def test_a_threshold_within_the_noise_is_refused() -> None:
    closing = rig(None).closing.model_copy(update={"contact_force_n": 0.05})
    assert threshold_problem(noisy(2.0, count=1)[0], closing) is None
    wrong = threshold_problem(noisy(5.0, count=1)[0], closing)
    assert wrong is not None
    assert "noise" in wrong
    assert "contact_force_n" in wrong


def idle_of_a_quiet_bench() -> IdleFit:
    """What calibration says of an array of the bench with light touches, whose zeros do not drift."""
    bench = load_rig(shipped_rig("xl330-bench"))
    assert bench.emulation is not None
    description = description_of(bench.fingers[0], 0)
    taxels = Taxels(description, seed=5, noise_counts=bench.emulation.noise_counts, offset_counts=20.0)
    rate, idles = bench.closing.sample_rate_hz, []
    for start_s in (300.0, 700.0):
        time_s = start_s + np.arange(round(IDLE_S * rate)) / rate
        none = np.zeros((len(time_s), description.rows, description.cols))
        idles.append(IdleMeasurement("f1", taxels.counts(none, time_s), time_s))
    return analyse_idle(idles, description.max_count)


def doubted(drift_counts_per_s: float, force_drift_n_per_s: float | None) -> tuple[str | None, float]:
    """What is said of an array of that bench with such a calibration, and the doubt after ten seconds (N)."""
    bench = load_rig(shipped_rig("xl330-bench"))
    assert bench.emulation is not None
    spec = bench.fingers[0]
    description, noise = description_of(spec, 0), bench.emulation.noise_counts
    taxels = Taxels(description, seed=6, noise_counts=noise, offset_counts=20.0)
    calibration = replace(
        calibration_of(bench, spec, description),
        noise_counts=noise,
        drift_counts_per_s=drift_counts_per_s,
        force_drift_n_per_s=force_drift_n_per_s,
    )
    extractor = ContactExtractor(description, calibration)
    none, period_s = np.zeros((description.rows, description.cols)), 1 / bench.closing.sample_rate_hz
    tared, on_its_way, over = (round(seconds / period_s) for seconds in (0.5, 3.0, 13.0))
    frames = [TactileFrame(k, k * period_s, 0.0, taxels.counts(none)) for k in range(over)]
    extractor.tare(frames[:tared])
    extractor.follow(frames[tared:on_its_way])  # through free space
    extractor.follow(frames[on_its_way:], may_touch=True)
    return doubt_warning(bench, spec, extractor), extractor.zero_doubt_n[0]


def test_a_calibrated_array_is_believed_with_light_touches() -> None:
    idle = idle_of_a_quiet_bench()
    description = description_of(load_rig(shipped_rig("xl330-bench")).fingers[0], 0)
    gain = np.full((description.rows, description.cols), 1 / description.counts_per_n)
    warning, doubt_n = doubted(idle.drift_counts_per_s, idle.drift_of_sums(column_windows(gain)))
    assert warning is None
    assert doubt_n < 0.006


def test_an_array_is_not_believed_whose_zeros_may_hide_what_moves_the_part() -> None:
    warning, doubt_n = doubted(0.42, None)
    assert doubt_n > 0.05
    assert warning is not None
    assert "part_holds_n = 0.3 N" in warning
