"""Emulated tips against parts that are pushed about: bent and sheared no further than the rule says.

Contacts on the bench leave slack for other errors; here nothing else is wrong, so that the rule stands alone.
"""

import math

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from quick_rig import small_rig

from palpate.base.geometry import Floats
from palpate.config import RigFile, SlideFingerConfig
from palpate.drivers.emulators.bench import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.drivers.emulators.part import Displacement
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.tip import PartSection
from palpate.rig.conversion import deflection_mm, deflection_rad, shear_rad
from palpate.rig.emulated.devices import emulate

MM_PER_N, FRICTION = 0.5, 1.0
_SETTLED = 60  # ms, several lags of the joint


def extended_finger(friction: float, seed: int) -> tuple[SlideFingerConfig, EmulatedFinger]:
    """A finger whose tip sticks and whose aim yields, as far out as it goes: there its lever is longest."""
    data = small_rig().model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {
        "deflection_mm_per_n": MM_PER_N,
        "aim_backlash_deg": 0.0,
        "part": {"engine": "still", "tip_friction": friction},
    }
    del data["fingers"][1:]
    data["fingers"][0]["tip"]["max_friction"] = FRICTION
    data["fingers"][0]["bounds"] |= {"deflection_mm_per_n": MM_PER_N, "deflection_deg_per_n": 0.15}
    rig = RigFile.model_validate(data)
    spec, emulated = rig.fingers[0], emulate(rig, None, seed).bench.fingers[0]
    truth = emulated.truth
    assert isinstance(spec, SlideFingerConfig)
    assert isinstance(truth, FingerTruth)
    slide = EmulatedServo(2, start_rad=(spec.slide.range_mm[1] - truth.zero_mm) / truth.mm_per_rad)
    aim = EmulatedServo(1, start_rad=truth.aim_zero_rad)
    return spec, EmulatedFinger(truth, (aim, slide), emulated.array, None, tip_friction=friction)


def wall(centre: Floats, towards_rad: float, gap_mm: float) -> PartSection:
    """A square with a face at `gap_mm` from a point, which looks back at it."""
    ahead = np.array([math.cos(towards_rad), math.sin(towards_rad)])
    aside = np.array([-ahead[1], ahead[0]])
    face = centre + gap_mm * ahead
    start = np.array([face - 40 * aside, face + 40 * ahead - 40 * aside, face + 40 * ahead + 40 * aside])
    start = np.vstack([start, face + 40 * aside])
    return PartSection(start, np.roll(start, -1, axis=0), 20.0)


def shares(friction: float, seed: int, way: list[tuple[float, float]]) -> Floats:
    """A part is pushed to places (along its face, towards the tip; mm), and rests at each.

    The tip's largest bend, turn and shear (3,), as shares of what is allowed.
    """
    spec, finger = extended_finger(friction, seed)
    centre, facing = finger.centre_mm, finger.facing_rad
    towards = facing + math.radians(80)
    finger.outline = wall(centre, towards, finger.truth.tip_radius_mm + 0.01)
    turn = np.array([[math.cos(towards), -math.sin(towards)], [math.sin(towards), math.cos(towards)]])
    largest = np.zeros(3)
    at = np.zeros(2)
    for target in way:
        path = np.vstack([np.linspace(at, target, 30), np.tile(target, (_SETTLED, 1))])
        for along, ahead in path:
            finger.touch(Displacement(np.zeros(2), turn @ np.array([-ahead, along]), 0.0))
            finger.step(1e-3)
        at = np.array(target)
        if finger.press is None:
            continue
        pressing = float(finger.press.by_ray_n.sum())
        bent = math.dist(finger.centre_mm, centre) / deflection_mm(spec, pressing)
        turned = abs(finger.facing_rad - facing) / deflection_rad(spec, pressing)
        sheared = abs(float(finger.press.angle[0])) / shear_rad(spec.tip, pressing)
        largest = np.maximum(largest, [bent, turned, sheared])
    return largest


@settings(
    max_examples=8, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
)
@given(
    st.floats(0.0, FRICTION),
    st.integers(0, 10**6),
    st.lists(st.tuples(st.floats(-0.4, 0.4), st.floats(0.0, 0.4)), min_size=2, max_size=4),
)
def test_no_tip_is_bent_or_sheared_further_than_its_rule_says(
    friction: float, seed: int, way: list[tuple[float, float]]
) -> None:
    assert shares(friction, seed, way).max() <= 1.0


def test_the_rule_allows_hardly_more_than_there_is() -> None:
    found = np.max([shares(FRICTION, seed, [(0.0, 0.3), (0.8, 0.3)]) for seed in range(4)], axis=0)
    assert found[0] > 0.5, "bent"
    assert found[1] > 0.3, "turned"
    assert found[2] > 0.8, "sheared"
