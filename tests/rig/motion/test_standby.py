"""Arms and a stage that start anywhere: fingers come to where they wait, or a line says why not."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from emulated_session import EmulatedSession, emulated_session
from homing_runs import anywhere_rig
from quick_rig import small_objects
from repository import EXAMPLES
from sampling import sample

from palpate.base.errors import DeviceError
from palpate.base.geometry.plane import distance_range
from palpate.config import ArmFingerConfig, RigFile, load_rig
from palpate.drivers.kinematics import Servos, Turn
from palpate.rig.bench import connect
from palpate.rig.conversion import arm_kinematics, kinematics_of
from palpate.rig.drives import wait_radius_mm
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import HomingPolicy
from palpate.rig.reach.standby_poses import home_line
from palpate.rig.reach.standby_ways import Standby, standby_of

ARMS = load_rig(EXAMPLES / "two-link-rig.toml")


def anywhere(rig: RigFile) -> RigFile:
    assert rig.emulation is not None
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"start": "anywhere"})})


def put(session: EmulatedSession, index: int, servos: Servos) -> None:
    """Let a finger stand elsewhere before anything has moved."""
    for servo, angle in zip(session.bench.fingers[index].servos, servos, strict=True):
        servo._unit.motion.shaft_rad = angle


def posture(index: int, place: tuple[float, float]) -> Servos:
    spec = ARMS.fingers[index]
    assert isinstance(spec, ArmFingerConfig)
    return arm_kinematics(spec).servos_at(place)


def homes() -> list[Servos]:
    return [
        kinematics_of(spec).servos_rad(home_line(spec, ARMS.clear_radius_mm), 0.0) for spec in ARMS.fingers
    ]


def prepared(session: EmulatedSession) -> None:
    with connect(session.bench_rig) as hand:
        hand.prepare()
        check_waiting(hand, session)
    assert not any(session.torque().values())


def check_waiting(hand: Hand, session: EmulatedSession) -> None:
    """Every true tip is outside of the workspace, where it waits."""
    for finger, real in zip(hand.fingers, session.bench.fingers, strict=True):
        assert np.hypot(*real.centre_mm) > hand.rig.workspace.radius_mm + finger.spec.tip.radius_mm - 1.0


@pytest.mark.parametrize("seed", sample([1, 2], [1]))
def test_arms_come_to_standby_from_anywhere(seed: int) -> None:
    """`benchmarks/bench_homing.py` has many of them, with whole runs."""
    session = emulated_session(seed=seed, rig=anywhere_rig("arms"), objects=small_objects())
    prepared(session)
    assert all(finger.hardest_n < 0.1 for finger in session.bench.fingers)


@pytest.mark.campaign
def test_an_arm_that_meets_the_part_backs_off_and_goes_another_way() -> None:
    """The second arm's tip stands beyond the part: the best way leads through that."""
    session = emulated_session(seed=0, rig=anywhere(ARMS))
    prepared(session)
    assert 0.1 < session.bench.fingers[1].hardest_n < 2.5


def test_a_joint_outside_its_range_is_refused() -> None:
    session = emulated_session(seed=4, rig=ARMS)
    shoulder, elbow = posture(0, (0.0, 117.0))
    put(session, 0, (shoulder, elbow + math.radians(3.0 * 75.0)))
    wanted = r"finger a1: its elbow \(servo 12\) stands at \S+°, outside its range 24 … 142°; with torque off"
    with pytest.raises(DeviceError, match=wanted), connect(session.bench_rig) as hand:
        hand.prepare()
    assert not any(session.torque().values())


def test_without_homing_an_arm_must_stand_where_it_waits() -> None:
    session = emulated_session(seed=4, rig=ARMS)
    put(session, 0, posture(0, (0.0, 60.0)))
    with pytest.raises(DeviceError, match="a1: its tip"), connect(session.bench_rig) as hand:
        hand.prepare(home=HomingPolicy.NONE)


def test_a_stage_starts_anywhere() -> None:
    session = emulated_session(seed=3, rig=anywhere_rig("stage"), objects=small_objects())
    assert session.bench.stage is not None
    assert abs(session.bench.stage.angle_rad) > 0.1
    prepared(session)
    assert all(finger.hardest_n < 0.1 for finger in session.bench.fingers)


def test_a_stage_behind_a_post_is_refused() -> None:
    """Between where it stands and angle 0 a retracted finger would meet the post."""
    rig = anywhere_rig("stage")
    post = [[-35.0, 105.0], [-29.0, 105.0], [-29.0, 111.0], [-35.0, 111.0]]
    data = rig.model_dump(mode="json", exclude_unset=True)
    blocked = RigFile.model_validate(data | {"obstacles": [{"name": "post", "outline_mm": post}]})
    session = emulated_session(seed=3, rig=blocked, objects=small_objects())
    assert session.bench.stage is not None
    put_stage(session, 0.45)
    with (
        pytest.raises(DeviceError, match=r"stage .* a finger would meet an obstacle; with torque off"),
        connect(session.bench_rig) as hand,
    ):
        hand.prepare()
    assert not any(session.torque().values())


def put_stage(session: EmulatedSession, angle_rad: float) -> None:
    stage, spec = session.bench.stage, session.rig.stage
    assert stage is not None
    assert spec is not None
    stage.servo._unit.motion.shaft_rad = math.radians(spec.zero_deg) - math.pi + spec.gear_ratio * angle_rad


def gap_mm(rig: RigFile, servos: Sequence[Servos], index: int) -> float:
    """Free space between a finger and all others, by the drawing."""
    bodies = [
        kinematics_of(spec).body(at, spec.tip.radius_mm) for spec, at in zip(rig.fingers, servos, strict=True)
    ]
    own = bodies[index]
    nearest = math.inf
    for other in bodies[:index] + bodies[index + 1 :]:
        i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
        apart, _ = distance_range(own.start[i], own.end[i], other.start[j], other.end[j])
        nearest = min(nearest, float((apart - own.half_width[i] - other.half_width[j]).min()))
    return nearest


def random_postures(rng: np.random.Generator) -> list[Servos]:
    while True:
        drawn: list[Servos] = []
        for spec in ARMS.fingers:
            assert isinstance(spec, ArmFingerConfig)
            k = arm_kinematics(spec)
            near, far = (
                joint.servo_rad(rng.uniform(joint.lo_rad, joint.hi_rad)) for joint in (k.shoulder, k.elbow)
            )
            drawn.append((near, far))
        if all(gap_mm(ARMS, drawn, k) > 1.0 for k in range(3)):
            return drawn


def test_no_way_to_standby_leads_an_arm_into_another_one() -> None:
    standby, rng = standby_of(ARMS, Turn()), np.random.default_rng(5)
    found = 0
    for _ in range(4):
        drawn = random_postures(rng)
        for index in range(3):
            way = next(standby.ways(index, drawn), None)
            if way is None:
                continue
            found += 1
            begin = gap_mm(ARMS, drawn, index)
            for near, far in way.servos_rad[::3].tolist():
                moved = [*drawn[:index], (near, far), *drawn[index + 1 :]]
                assert gap_mm(ARMS, moved, index) >= min(ARMS.closing.clearance_mm, begin) - 0.6
            check_arrival(standby, index, way.servos_rad[-1].tolist())
    assert found > 6


def check_arrival(standby: Standby, index: int, servos: list[float]) -> None:
    spec = ARMS.fingers[index]
    assert isinstance(spec, ArmFingerConfig)
    assert standby.is_there(index, (servos[0], servos[1]))
    away = math.hypot(*arm_kinematics(spec).centre_mm((servos[0], servos[1])))
    assert away == pytest.approx(wait_radius_mm(spec, ARMS.clear_radius_mm), abs=0.1)


def test_an_arm_that_is_hemmed_in_has_no_way() -> None:
    """A wall between the tip and every place where it may wait; there is no way round it."""
    wall = [[-150.0, 60.0], [150.0, 60.0], [150.0, 66.0], [-150.0, 66.0]]
    data = ARMS.model_dump(mode="json", exclude_unset=True)
    rig = RigFile.model_validate(data | {"obstacles": [{"name": "wall", "outline_mm": wall}]})
    drawn = homes()
    drawn[0] = posture(0, (0.0, 0.0))
    standby = standby_of(rig, Turn())
    assert not standby.is_there(0, drawn[0])
    assert next(standby.ways(0, drawn), None) is None
