"""Kinematics of two-link arms and of a stage."""

import math
import tomllib
from itertools import product
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely import affinity

from palpate.base.errors import DeviceError, InputError
from palpate.base.geometry.plane import distance_range
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import ArmFingerConfig, ObjectsFile, RigFile, load_objects, load_rig, shipped_objects
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.emulators.mechanics import ArmMechanics, ArmTruth, JointTruth
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.kinematics import TICK_RAD, FingerBody, Line
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.bench import choose_placements, connect
from palpate.rig.conversion import line_of
from palpate.rig.mechanisms.arm import arm_kinematics
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, reach_of
from support.benches.rigs import STAGE, firm_rig, quicken, small, small_objects
from support.benches.session import EmulatedSession, check_touch, emulated_session, identify_checked, shape_of
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Two-link arms on the emulated bench: touches, ways, reach, runs to a verdict, and every way out.

EXAMPLE = EXAMPLES / "two-link-rig.toml"
ARMS = load_rig(EXAMPLE)
REACH = reach_of(ARMS)
SMALL = ARMS.model_copy(update={"workspace": ARMS.workspace.model_copy(update={"radius_mm": 70.0})})
"""The same arms round a smaller table, for runs: their ways are shorter."""


def arm() -> tuple[ArmFingerConfig, ArmKinematics]:
    spec = ARMS.fingers[0]
    assert isinstance(spec, ArmFingerConfig)
    return spec, arm_kinematics(spec)


def middle_grip(rng: np.random.Generator, reach: Reach = REACH) -> list[FingerApproach]:
    """One way of each arm that passes not too far from the middle."""
    grip = []
    for finger in range(3):
        near = []
        for index in reach.of_finger(finger):
            line = line_of(reach.approaches[index])
            if math.hypot(*line.point_mm(line.travel_mm((0.0, 0.0)))) < 30.0:
                near.append(index)
        grip.append(reach.approaches[int(rng.choice(near))])
    return grip


def run_checked(session: EmulatedSession, grips: int, seed: int) -> list[Touch]:
    """Some grips; every touch, every way and every force compared with the bench's truth."""
    assert session.placement is not None
    shape = shape_of(session.placement)
    rng, reach = np.random.default_rng(seed), reach_of(session.rig)
    tracks: list[list[np.ndarray]] = [[] for _ in session.bench.fingers]
    centres: list[np.ndarray] = []

    def look() -> None:
        for track, finger in zip(tracks, session.bench.fingers, strict=True):
            track.append(finger.centre_mm)

    def remember(stage: GripPhase) -> None:
        if stage is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    session.clock.on_tick = look
    every: list[Touch] = []
    with connect(session.bench_rig) as hand:
        hand.prepare()
        for _ in range(grips):
            for track in tracks:
                track.clear()
            touches = carry_out_grip(hand, middle_grip(rng, reach), remember)
            for touch in touches:
                check_touch(shape, touch, centres[touch.finger_index], 5.0)
                check_way(touch, np.array(tracks[touch.finger_index]))
            every += touches
    assert all(finger.hardest_n <= session.rig.closing.max_force_n for finger in session.bench.fingers)
    assert not any(session.torque().values())
    return every


def check_way(touch: Touch, track: np.ndarray) -> None:
    """The whole way that is claimed to be free, the true tip went, to within the bound of the path."""
    contact = touch.contact
    shares = np.linspace(0.0, 1.0, 200)[:, None]
    claimed = (1 - shares) * np.array(contact.start_mm) + shares * np.array(contact.end_mm)
    away = np.hypot(*np.moveaxis(claimed[:, None] - track, 2, 0)).min(axis=1)
    assert contact.path_bound_mm is not None
    assert away.max() <= contact.path_bound_mm
    assert contact.path_bound_mm <= 1.6, "still of use"


@pytest.mark.parametrize(("number", "grips"), sample([(0, 1), (0, 2)], [(0, 1)]))
def test_every_touch_of_an_arm_is_within_its_bounds(number: int, grips: int) -> None:
    objects = load_objects(shipped_objects())
    one = ObjectsFile((objects.objects[number],))
    touches = run_checked(emulated_session(seed=50 + number, rig=SMALL, objects=one), grips, number)
    assert sum(touch.contact.touched for touch in touches) >= 2


def test_an_approach_is_carried_out_within_its_bound() -> None:
    """Planned for a line and a bound: the true tip stays within it, until something stops it."""
    session = emulated_session(rig=ARMS, empty=True)
    grip = middle_grip(np.random.default_rng(9))[:1]
    track: list[np.ndarray] = []
    session.clock.on_tick = lambda: track.append(session.bench.fingers[0].centre_mm)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        carry_out_grip(hand, grip, lambda stage: track.clear() if stage is GripPhase.CLOSING else None)
    line = line_of(grip[0])
    bound = min(item.position_bound_mm for item in REACH.approaches)
    start, end = np.array([line.start_mm]), np.array([line.point_mm(grip[0].travel_mm)])
    points = np.array(track)
    off, _ = distance_range(points, points, np.repeat(start, len(points), 0), np.repeat(end, len(points), 0))
    assert off.max() <= bound
    assert off.max() > 0.0


@pytest.mark.slow
@pytest.mark.campaign
def test_arms_identify() -> None:
    objects = load_objects(shipped_objects())
    session = emulated_session(rig=SMALL, objects=objects)
    result = identify_checked(session, Catalogue(objects.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED


def test_a_dead_elbow_ends_the_run_with_torque_off() -> None:
    session = emulated_session(rig=ARMS)
    dead = session.bench.fingers[1].servos[1]
    session.clock.after(3.0, dead.power_off)
    grip = middle_grip(np.random.default_rng(1))
    with pytest.raises(DeviceError, match="servo 22"), connect(session.bench_rig) as hand:
        session.grip(hand, grip)
    torque = session.torque()
    assert not any(on for dxl_id, on in torque.items() if dxl_id != 22)
    assert session.rest(1.0) < 0.05


def test_a_catalogue_with_a_part_that_is_too_high_is_refused() -> None:
    data: dict[str, Any] = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for finger in data["fingers"]:
        finger["links"]["links_height_mm"] = 20.0
    rig = RigFile.model_validate(data)
    wanted = 'object "tr-1" is 20 mm high; the links of finger "a1" pass 20 mm above the table'
    with pytest.raises(InputError, match=wanted):
        choose_placements(rig, load_objects(shipped_objects()), None, 1)


def test_no_arm_meets_a_post() -> None:
    """Links and tip, sampled on every way and at every place where the tip may wait."""
    post = np.array([[-72.0, 95.0], [-62.0, 95.0], [-62.0, 105.0], [-72.0, 105.0]])
    data: dict[str, Any] = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    rig = RigFile.model_validate(data | {"obstacles": [{"name": "post", "outline_mm": post.tolist()}]})
    reach = reach_of(rig, aims=21)
    free = reach_of(ARMS, aims=21)
    longest = [sum(full.approaches[k].travel_mm for k in full.of_finger(0)) for full in (reach, free)]
    assert 0.1 * longest[1] < longest[0] < 0.9 * longest[1]
    shape = shapely.Polygon(post)
    spec, k = arm()
    own = [reach.approaches[index] for index in reach.of_finger(0)]
    starts = [math.atan2(item.start_mm[1], item.start_mm[0]) for item in own]
    radius = math.hypot(*own[0].start_mm)
    places = [
        (radius * math.cos(at), radius * math.sin(at)) for at in np.linspace(min(starts), max(starts), 60)
    ]
    places += [line_of(item).point_mm(at) for item in own for at in np.linspace(0.0, item.travel_mm, 15)]
    for place_mm in places:
        servos = k.servos_at(place_mm)
        links = shapely.LineString([spec.base_mm, k.elbow_mm(servos), place_mm]).buffer(8.0)
        gap = min(links.distance(shape), shapely.Point(place_mm).buffer(5.0).distance(shape))
        assert gap >= rig.closing.clearance_mm


def test_arms_that_go_together_stay_apart() -> None:
    """Postures of both, sampled on their ways: links and tips never nearer than the clearance."""
    rng = np.random.default_rng(2)
    kinematics = [arm_kinematics(spec) for spec in ARMS.fingers if isinstance(spec, ArmFingerConfig)]
    count = len(REACH.approaches)
    travels = np.array([item.travel_mm for item in REACH.approaches]) * rng.uniform(0.4, 1, count)
    i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)

    def bodies(number: int) -> list[FingerBody]:
        """Of its arm, at places all along its way."""
        arm, line = kinematics[int(REACH.finger[number])], line_of(REACH.approaches[number])
        at = np.linspace(0.0, travels[number], 12)
        return [arm.body(arm.servos_rad(line, float(travel_mm)), 5.0) for travel_mm in at]

    yes = no = 0
    for one in rng.permutation(count)[:25]:
        good = REACH.together(int(one), float(travels[one]), np.arange(count), travels)
        own = bodies(int(one))
        for other in rng.permutation(count)[:12]:
            a, b = int(REACH.finger[one]), int(REACH.finger[other])
            if a == b:
                assert not good[other]
                continue
            gap = math.inf
            for p, q in product(own, bodies(int(other))):
                apart, _ = distance_range(p.start[i], p.end[i], q.start[j], q.end[j])
                gap = min(gap, float((apart - p.half_width[i] - q.half_width[j]).min()))
            assert not good[other] or gap >= ARMS.closing.clearance_mm
            yes, no = yes + bool(good[other]), no + (not good[other])
    assert yes > 20
    assert no > 20


# ----------------------------------------------------------------------------------------------------
# A turning stage under the fingers: reach at several angles, turns among obstacles, runs to a verdict.


def staged(text: str | None = None, **changes: Any) -> RigFile:
    data = tomllib.loads(text or firm_rig().read_text(encoding="utf-8"))
    data["emulation"] |= {"stage_backlash_deg": 0.02, "stage_error_deg": 0.02}
    return RigFile.model_validate(data | {"stage": STAGE} | changes)


RIG = staged()
STAGE_REACH = reach_of(RIG, aims=21)
SMALL_STAGE = staged(quicken(small(firm_rig())))


def grip_at(reach: Reach, angle: float, rng: np.random.Generator) -> list[FingerApproach]:
    grip = []
    for finger in range(3):
        own = reach.of_finger(finger, angle)
        index = own[int(rng.integers(len(own) // 4, 3 * len(own) // 4))]
        grip.append(reach.approaches[index])
    return grip


def test_ways_are_offered_at_several_angles_within_the_number() -> None:
    angles = np.unique(STAGE_REACH.stage_rad)
    assert len(angles) >= 5
    assert 0.0 in angles
    assert angles[0] == pytest.approx(-math.pi / 6)
    assert angles[-1] == pytest.approx(math.pi / 6)
    assert 500 < len(STAGE_REACH.approaches) <= 1500
    assert STAGE_REACH.middle_rad == 0.0
    still = reach_of(staged(stage=None), aims=21)
    middle, plain = STAGE_REACH.of_finger(0, 0.0)[10], still.of_finger(0)[10]
    with_stage, without = STAGE_REACH.approaches[middle], still.approaches[plain]
    assert with_stage.position_bound_mm > without.position_bound_mm
    for index in STAGE_REACH.of_finger(0):
        assert math.hypot(*STAGE_REACH.approaches[index].start_mm) >= 130.0
    seconds = STAGE_REACH.seconds(np.full(len(STAGE_REACH.approaches), 50.0))
    assert seconds[STAGE_REACH.of_finger(0, angles[0])[10]] > seconds[middle] + 0.9


def test_approaches_at_different_angles_never_go_together() -> None:
    one = STAGE_REACH.of_finger(0, 0.0)[10]
    others = np.array(STAGE_REACH.of_finger(1))
    good = STAGE_REACH.together(one, 20.0, others, np.full(len(others), 20.0))
    assert good[STAGE_REACH.stage_rad[others] == 0.0].any()
    assert not good[STAGE_REACH.stage_rad[others] != 0.0].any()


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
    reach = reach_of(SMALL_STAGE, aims=21)
    angles = np.unique(reach.stage_rad)
    session = emulated_session(seed=5, rig=SMALL_STAGE, objects=small_objects())
    run_at(session, reach, [float(angles[0]), 0.0, float(angles[-2])])


def test_a_dead_stage_ends_the_run_with_torque_off() -> None:
    session = emulated_session(rig=RIG)
    assert session.bench.stage is not None
    session.clock.after(1.5, session.bench.stage.servo.power_off)
    grip = grip_at(STAGE_REACH, float(STAGE_REACH.stage_rad.max()), np.random.default_rng(1))
    with pytest.raises(DeviceError, match="servo 1 "), connect(session.bench_rig) as hand:
        session.grip(hand, grip)
    assert not any(on for dxl_id, on in session.torque().items() if dxl_id != 1)


@pytest.mark.slow
def test_a_rig_with_a_stage_identifies() -> None:
    objects = small_objects()
    session = emulated_session(seed=4, rig=SMALL_STAGE, objects=objects)
    result = identify_checked(session, Catalogue(objects.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED


# ----------------------------------------------------------------------------------------------------
# Two-link arms: what the host computes, against mechanics that are written apart from it.


@given(st.floats(25.0, 141.0), st.floats(-58.0, 58.0))
def test_servo_angles_lead_back_to_the_place(elbow_deg: float, shoulder_deg: float) -> None:
    _, k = arm()
    servos = (k.shoulder.servo_rad(math.radians(shoulder_deg)), k.elbow.servo_rad(math.radians(elbow_deg)))
    assert k.servos_at(k.centre_mm(servos)) == pytest.approx(servos, abs=1e-9)


def test_places_out_of_reach_have_no_posture() -> None:
    _, k = arm()
    for point in ((0.0, 230.0 - 301.0), (0.0, 240.0), (0.0, 400.0), (200.0, 230.0)):
        assert any(math.isnan(angle) for angle in k.servos_at(point))
    assert not any(math.isnan(angle) for angle in k.servos_rad(Line((0.0, 110.0), -math.pi / 2), 100.0))


def test_the_true_tip_is_within_the_bound() -> None:
    """Truth drawn to the ends of the bounds, angles read as the encoders step."""
    spec, k = arm()
    rng = np.random.default_rng(3)
    closest = 0.0
    for _ in range(500):
        ends = rng.choice([-1.0, 1.0], 8)
        angle = rng.uniform(0, 2 * math.pi)
        truth = ArmTruth(
            base_mm=(
                spec.base_mm[0] + spec.bounds.base_mm * math.cos(angle),
                spec.base_mm[1] + spec.bounds.base_mm * math.sin(angle),
            ),
            heading_rad=k.heading_rad + ends[0] * k.heading_bound_rad,
            height_mm=10.0,
            upper_mm=k.upper_mm + ends[1] * k.length_bound_mm,
            fore_mm=k.fore_mm + ends[2] * k.length_bound_mm,
            shoulder=JointTruth(3.0, k.shoulder.zero_rad + ends[3] * 3.0 * k.shoulder.play_rad, 0.0),
            elbow=JointTruth(3.0, k.elbow.zero_rad + ends[4] * 3.0 * k.elbow.play_rad, 0.0),
            tip_radius_mm=5.0,
            stiffness_n_per_mm=3.0,
            array_heading_rad=0.0,
        )
        ticks = (rng.integers(-2000, 2000), rng.integers(-1900, 1900))
        shafts = [(tick + 0.499 * end) * TICK_RAD for tick, end in zip(ticks, ends[5:7], strict=True)]
        servos = (float(ticks[0] * TICK_RAD), float(ticks[1] * TICK_RAD))
        mechanics = ArmMechanics(
            truth,
            EmulatedServo(1, start_rad=float(shafts[0])),
            EmulatedServo(2, start_rad=float(shafts[1])),
        )
        off = math.dist(mechanics.centre_mm, k.centre_mm(servos))
        assert off <= k.position_bound_mm(servos)
        turned = math.remainder(mechanics.facing_rad - k.facing_rad(servos), 2 * math.pi)
        assert abs(turned) <= k.direction_bound_rad
        closest = max(closest, off / k.position_bound_mm(servos))
    assert closest > 0.7, "the bound is not far too wide either"


def test_torques_within_the_limits_never_press_harder() -> None:
    """The tip is held; whatever force balances the torques (Jᵀ F = τ) is no larger than the limit."""
    _, k = arm()
    rng = np.random.default_rng(4)
    hardest = 0.0
    for _ in range(300):
        servos = (
            k.shoulder.servo_rad(math.radians(rng.uniform(-58, 58))),
            k.elbow.servo_rad(math.radians(rng.uniform(25, 141))),
        )
        limits = k.largest_torques_nm(servos, 8.0)
        tip = np.array(k.centre_mm(servos))
        levers = [(tip - np.array(axis)) / 1000 for axis in (k.base_mm, k.elbow_mm(servos))]
        transpose = np.array([[-lever[1], lever[0]] for lever in levers])
        for one in (-1, 1):
            torque = np.array([one * limits[0], limits[1]])
            force = float(np.hypot(*np.linalg.solve(transpose, torque)))
            hardest = max(hardest, force)
            assert force <= 8.0 * (1 + 1e-9)
    assert hardest > 7.9
