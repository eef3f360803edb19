"""What is not measured yet widens the bounds of what is felt: enough for the truth, and hardly more."""

import math

import numpy as np
import pytest
from emulated_session import emulated_session
from firm_rig import firm_rig
from repository import EXAMPLES
from touched import run_checked

from palpate.config import (
    ObjectsFile,
    RigFile,
    SlideFingerConfig,
    load_objects,
    load_rig,
    shipped_objects,
)
from palpate.drivers.emulators.mechanics import FingerTruth, SlideMechanics
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.kinematics import TICK_RAD
from palpate.rig.conversion import (
    array_bound_rad,
    kinematics_of,
    resolution_of,
    slide_kinematics,
    tip_bound_mm,
)
from palpate.rig.reach.approaches import reach_of

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


@pytest.mark.parametrize("number", [3])
def test_touches_of_tips_that_are_not_as_drawn_are_within_their_bounds(number: int) -> None:
    objects = ObjectsFile((load_objects(shipped_objects()).objects[number],))
    touches = run_checked(emulated_session(seed=number, rig=newer_errors(), objects=objects), 1, number)
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
