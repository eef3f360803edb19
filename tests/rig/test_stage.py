"""A turning stage under the fingers: reach at several angles, turns among obstacles, runs to a verdict."""

import math
import tomllib
from typing import Any

import numpy as np
import pytest
import shapely
from emulated_session import EmulatedSession, emulated_session, identify_checked, shape_of
from firm_rig import firm_rig
from quick_rig import STAGE, small, small_objects
from shapely import affinity
from touch_check import check_touch

from palpate.base.errors import DeviceError
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.bench import connect
from palpate.rig.conversion import line_of
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.reach.approaches import Reach, reach_of


def staged(text: str | None = None, **changes: Any) -> RigFile:
    data = tomllib.loads(text or firm_rig().read_text(encoding="utf-8"))
    data["emulation"] |= {"stage_backlash_deg": 0.02, "stage_error_deg": 0.02}
    return RigFile.model_validate(data | {"stage": STAGE} | changes)


RIG = staged()
REACH = reach_of(RIG, aims=21)
SMALL = staged(small(firm_rig()))


def grip_at(reach: Reach, angle: float, rng: np.random.Generator) -> list[FingerApproach]:
    grip = []
    for finger in range(3):
        own = reach.of_finger(finger, angle)
        index = own[int(rng.integers(len(own) // 4, 3 * len(own) // 4))]
        grip.append(reach.approaches[index])
    return grip


def test_ways_are_offered_at_several_angles_within_the_number() -> None:
    angles = np.unique(REACH.stage_rad)
    assert len(angles) >= 5
    assert 0.0 in angles
    assert angles[0] == pytest.approx(-math.pi / 6)
    assert angles[-1] == pytest.approx(math.pi / 6)
    assert 500 < len(REACH.approaches) <= 1500
    assert REACH.middle_rad == 0.0
    still = reach_of(staged(stage=None), aims=21)
    middle, plain = REACH.of_finger(0, 0.0)[10], still.of_finger(0)[10]
    with_stage, without = REACH.approaches[middle], still.approaches[plain]
    assert with_stage.position_bound_mm > without.position_bound_mm
    for index in REACH.of_finger(0):
        assert math.hypot(*REACH.approaches[index].start_mm) >= 130.0
    seconds = REACH.seconds(np.full(len(REACH.approaches), 50.0))
    assert seconds[REACH.of_finger(0, angles[0])[10]] > seconds[middle] + 0.9


def test_approaches_at_different_angles_never_go_together() -> None:
    one = REACH.of_finger(0, 0.0)[10]
    others = np.array(REACH.of_finger(1))
    good = REACH.together(one, 20.0, others, np.full(len(others), 20.0))
    assert good[REACH.stage_rad[others] == 0.0].any()
    assert not good[REACH.stage_rad[others] != 0.0].any()


def test_the_stage_turns_no_finger_into_a_post() -> None:
    """A post beside a finger's home: no angle beyond it, whatever the finger does there."""
    post = [[55.0, 145.0], [65.0, 145.0], [65.0, 155.0], [55.0, 155.0]]
    reach = reach_of(staged(obstacles=[{"name": "post", "outline_mm": post}]), aims=9)
    shape = shapely.Polygon(post)
    base = shapely.LineString([RIG.fingers[0].base_mm, (0.0, 136.0)])
    lowest = float(reach.stage_rad.min())
    assert -math.pi / 6 + 0.05 < lowest < -0.1
    for angle in np.linspace(lowest, float(reach.stage_rad.max()), 200):
        turned = affinity.rotate(base, angle, origin=tuple(STAGE["centre_mm"]), use_radians=True)
        assert turned.buffer(5.0).distance(shape) >= RIG.closing.clearance_mm
    for approach in reach.approaches:
        bases = affinity.rotate(
            shapely.Point(RIG.fingers[approach.finger_index].base_mm),
            approach.stage_rad,
            origin=tuple(STAGE["centre_mm"]),
            use_radians=True,
        )
        body = shapely.LineString(
            [(bases.x, bases.y), line_of(approach).point_mm(approach.travel_mm)]
        ).buffer(5.0)
        assert body.distance(shape) >= RIG.closing.clearance_mm - 0.02


def run_at(session: EmulatedSession, reach: Reach, angles: list[float]) -> None:
    """Grips at some angles, every touch compared with the truth; tips wait outside while the stage turns."""
    assert session.placement is not None
    assert session.bench.stage is not None
    shape = shape_of(session.placement)
    stage = session.bench.stage
    rng = np.random.default_rng(8)
    before = [stage.angle_rad]
    moved = []
    centres: list[np.ndarray] = []

    def look() -> None:
        if abs(stage.angle_rad - before[0]) > 1e-4:
            moved.append(min(float(np.hypot(*finger.centre_mm)) for finger in session.bench.fingers))
        before[0] = stage.angle_rad

    def remember(now: GripPhase) -> None:
        if now is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    session.clock.on_tick = look
    touched = 0
    with connect(session.bench_rig) as hand:
        hand.prepare()
        for angle in angles:
            touches = carry_out_grip(hand, grip_at(reach, angle, rng), remember)
            assert stage.angle_rad == pytest.approx(angle, abs=math.radians(0.15))
            for touch in touches:
                check_touch(shape, touch, centres[touch.finger_index], 5.0)
                touched += touch.contact.touched
    assert touched >= len(angles)
    assert len(moved) > 20
    assert min(moved) >= session.rig.workspace.radius_mm + 5.0
    assert set(session.torque()) >= {1, 11, 12}
    assert not any(session.torque().values())


@pytest.mark.campaign
def test_touches_at_any_stage_angle_are_within_their_bounds() -> None:
    reach = reach_of(SMALL, aims=21)
    angles = np.unique(reach.stage_rad)
    session = emulated_session(seed=5, rig=SMALL, objects=small_objects())
    run_at(session, reach, [float(angles[0]), 0.0, float(angles[-2])])


def test_a_dead_stage_ends_the_run_with_torque_off() -> None:
    session = emulated_session(rig=RIG)
    assert session.bench.stage is not None
    session.clock.after(1.5, session.bench.stage.servo.power_off)
    grip = grip_at(REACH, float(REACH.stage_rad.max()), np.random.default_rng(1))
    with pytest.raises(DeviceError, match="servo 1 "), connect(session.bench_rig) as hand:
        session.grip(hand, grip)
    assert not any(on for dxl_id, on in session.torque().items() if dxl_id != 1)


@pytest.mark.slow
def test_a_rig_with_a_stage_identifies() -> None:
    objects = small_objects()
    session = emulated_session(seed=4, rig=SMALL, objects=objects)
    result = identify_checked(session, Catalogue(objects.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
