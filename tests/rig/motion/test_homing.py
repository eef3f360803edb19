"""Homing, end stops and standby."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import DeviceError
from palpate.base.geometry.plane import distance_range
from palpate.config import ArmFingerConfig, RigFile, SlideFingerConfig, load_rig, shipped_rig
from palpate.drivers.dynamixel.models import SPECIFICATIONS, known_models, model_by_name
from palpate.drivers.dynamixel.servo_state import MAX_TURNS, NO_MARK, mark_item, mark_value, turns_of_mark
from palpate.drivers.emulators.mechanics import FingerTruth, SlideMechanics
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.kinematics import Servos, Turn
from palpate.rig.bench import connect
from palpate.rig.mechanisms import kinematics_of, mechanism_of
from palpate.rig.mechanisms.arm import ArmMechanism, arm_kinematics
from palpate.rig.mechanisms.slide import SlideMechanism
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import HomingPolicy, back_stop_distances_mm
from palpate.rig.reach.standby_ways import Standby
from support.benches.as_bought import anywhere_rig, run_from_anywhere
from support.benches.rigs import small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES
from support.devices.servo_wire import Console

# ----------------------------------------------------------------------------------------------------
# Slides that start anywhere in their travel are homed, and known until they lose their power.

RIG = small_rig(shipped_rig("xm430-bench"))


def anywhere(rig: RigFile = RIG) -> RigFile:
    assert rig.emulation is not None
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"start": "anywhere"})})


def session_of(seed: int) -> EmulatedSession:
    return emulated_session(seed=seed, rig=anywhere(), objects=small_objects())


def off_mm(session: EmulatedSession, hand: Hand) -> float:
    """How far any tip is from where the host believes it to be, along its slide."""
    offs = []
    for finger, real in zip(hand.fingers, session.bench.fingers, strict=True):
        x, y = finger.kinematics.centre_mm(hand.servos_of([finger])[finger])
        offs.append(float(np.hypot(*(real.centre_mm - (x, y)))))
    return max(offs)


@pytest.mark.parametrize("seed", sample(range(3), [0]))
def test_wherever_slides_stand_they_are_homed(seed: int) -> None:
    session = session_of(seed)
    furthest = [finger.centre_mm for finger in session.bench.fingers]
    with connect(session.bench_rig) as hand:
        hand.prepare()
        assert off_mm(session, hand) < 1.5
        for finger, real, start in zip(hand.fingers, session.bench.fingers, furthest, strict=True):
            base = np.array(finger.spec.base_mm)
            assert np.hypot(*(real.centre_mm - base)) < max(np.hypot(*(start - base)), 80.0) + 1.0
    assert not any(session.torque().values())
    assert all(finger.hardest_n < 0.1 for finger in session.bench.fingers)


def test_a_run_from_anywhere_identifies() -> None:
    """`benchmarks/bench_homing.py` has a hundred of them, and runs after a blink of power."""
    outcome = run_from_anywhere(7)
    assert outcome.kind == "right", outcome.text
    assert outcome.torque_on == ()
    assert outcome.homed > 5.0


def test_known_turns_are_kept_until_power_is_lost() -> None:
    session = session_of(1)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        turns = [finger.drive.servos[1].turns for finger in hand.fingers]
    assert any(turns)
    before = session.clock.now()
    with connect(session.bench_rig) as hand:
        hand.prepare()
        assert [finger.drive.servos[1].turns for finger in hand.fingers] == turns
        assert off_mm(session, hand) < 1.5
    assert session.clock.now() - before < 1.0, "nothing was homed again"

    servo = session.servos[12]
    servo.power_off()
    servo.power_on()
    with connect(session.bench_rig) as hand:
        hand.prepare()
        assert hand.fingers[0].drive.servos[1].turns == 0, "it was retracted in its first turn"
        assert [finger.drive.servos[1].turns for finger in hand.fingers[1:]] == turns[1:]
        assert off_mm(session, hand) < 1.5


def test_home_all_homes_what_is_known_too() -> None:
    session = session_of(1)
    for _ in range(2):
        before = session.clock.now()
        with connect(session.bench_rig) as hand:
            hand.prepare(home=HomingPolicy.ALL)
            assert off_mm(session, hand) < 1.5
        assert session.clock.now() - before > 3.0


def test_without_homing_nothing_moves_and_known_turns_hold() -> None:
    session = session_of(1)
    with connect(session.bench_rig) as hand:
        hand.prepare()
    before = [finger.centre_mm for finger in session.bench.fingers]
    with connect(session.bench_rig) as hand:
        hand.prepare(home=HomingPolicy.NONE)
        assert off_mm(session, hand) < 1.5
    for finger, at in zip(session.bench.fingers, before, strict=True):
        assert np.hypot(*(finger.centre_mm - at)) < 0.3


def clamp(servo: EmulatedServo) -> Callable[[float, float], float]:
    at = servo.shaft_rad
    return lambda angle, speed: -50.0 * (angle - at) - 0.5 * speed


def test_a_slide_that_is_held_on_its_way_back_is_no_stop() -> None:
    session = session_of(1)
    session.servos[12].hold(clamp(session.servos[12]))
    with (
        pytest.raises(DeviceError, match=r"finger f1: its slide \(servo 12\) is held"),
        connect(session.bench_rig) as hand,
    ):
        hand.prepare()
    assert not any(session.torque().values())
    session.servos[12].hold(None)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        assert off_mm(session, hand) < 1.5


SKIN_N_PER_MM = 5.0  # the stiffer than the skin of any shipped bench


def test_a_slide_that_meets_something_on_its_way_back_presses_it_softly() -> None:
    """It presses with 3 N, and without a look at currents with 13 N."""
    session = session_of(1)
    servo, finger = session.servos[12], RIG.fingers[0]
    assert isinstance(finger, SlideFingerConfig)
    mm_per_rad = finger.slide.mm_per_turn / math.tau
    at_rad = servo.shaft_rad - 35.0 / mm_per_rad
    pressed_n = [0.0]

    def thing(angle_rad: float, _speed: float) -> float:
        deep_mm = max(0.0, (at_rad - angle_rad) * mm_per_rad)
        pressed_n.append(SKIN_N_PER_MM * deep_mm)
        return pressed_n[-1] * mm_per_rad / 1000

    servo.hold(thing)
    with (
        pytest.raises(DeviceError, match=r"finger f1: its slide \(servo 12\) is held .* N more than before"),
        connect(session.bench_rig) as hand,
    ):
        hand.prepare()
    assert 0.5 < max(pressed_n) < 4.5
    assert not any(session.torque().values())


def test_an_aim_outside_its_range_is_refused_before_torque() -> None:
    session = session_of(1)
    narrow = [
        finger.model_copy(update={"aim": finger.aim.model_copy(update={"range_deg": (-1.0, 1.0)})})
        for finger in RIG.fingers
        if isinstance(finger, SlideFingerConfig)
    ]
    stood = {dxl_id: servo.shaft_rad for dxl_id, servo in session.servos.items()}
    bench = replace(session.bench_rig, rig=session.rig.model_copy(update={"fingers": narrow}))
    with (
        pytest.raises(DeviceError, match=r"its aim \(servo \d1\) stands at .*°, outside its range"),
        connect(bench) as hand,
    ):
        hand.prepare()
    assert {dxl_id: servo.shaft_rad for dxl_id, servo in session.servos.items()} == stood
    assert not any(session.torque().values())


def test_a_blink_of_power_is_named_with_what_homes_it() -> None:
    session = session_of(1)

    def blink() -> None:
        session.servos[22].power_off()
        session.servos[22].power_on()

    session.clock.after(6.0, blink)
    with (
        pytest.raises(DeviceError, match=r"servo 22 .* has restarted.*palpate home, homes it"),
        connect(session.bench_rig) as hand,
    ):
        hand.prepare(home=HomingPolicy.ALL)
    assert not any(session.torque().values())
    with connect(session.bench_rig) as hand:
        hand.prepare()
        assert off_mm(session, hand) < 1.5


@given(
    st.sampled_from([finger for finger in RIG.fingers if isinstance(finger, SlideFingerConfig)]),
    st.floats(0, 1),
    st.integers(-20, 20),
    st.sampled_from([1, -1]),
)
def test_the_stop_is_among_the_places_where_it_may_be(
    finger: SlideFingerConfig, share: float, turns: int, sign: int
) -> None:
    """And no place is nearer than another that comes later."""
    slide = finger.slide.model_copy(update={"mm_per_turn": sign * finger.slide.mm_per_turn})
    stops = SlideMechanism(finger.model_copy(update={"slide": slide})).homing
    assert stops is not None
    back, front = stops.back_mm, stops.front_mm
    reading = back + share * (front - back) + turns * slide.mm_per_turn
    places = back_stop_distances_mm(stops, reading)
    assert turns in [turn for _, turn in places]
    assert all(stop == pytest.approx(back + turn * slide.mm_per_turn) for stop, turn in places)
    assert [stop for stop, _ in places] == sorted((stop for stop, _ in places), reverse=True)


def test_marks_hold_what_they_are_given() -> None:
    for turns in range(-MAX_TURNS, MAX_TURNS + 1):
        assert turns_of_mark(mark_value(turns)) == turns
    assert turns_of_mark(NO_MARK) is None
    with pytest.raises(ValueError, match="either way"):
        mark_value(MAX_TURNS + 1)


@pytest.mark.parametrize("name", sorted(set(SPECIFICATIONS) & set(known_models())))
def test_every_model_takes_a_mark_and_forgets_it_with_its_turns(name: str) -> None:
    servo = EmulatedServo(1, model=name, start_rad=9.0)
    unit = servo._inner
    item = mark_item(model_by_name(name, unit.firmware))
    assert item is not None

    def held() -> int | None:
        return turns_of_mark(int.from_bytes(unit.read(item.address, item.size), "little"))

    assert held() is None, "a servo fresh from power bears none"
    for turns in (-MAX_TURNS, 0, MAX_TURNS):
        unit.write(item.address, item.encode(mark_value(turns)))
        assert held() == turns
    servo.power_off()
    servo.power_on()
    assert held() is None


# ----------------------------------------------------------------------------------------------------
# Hard stops of emulated slides: a servo of little current stalls there, and coming back shows the play.

STOPS = (43.0, 60.0)
PLAY = 0.15
STIFFNESS = 2000.0
CURRENT = 30
# 30 units of 2.69 mA of a motor with 4.1 Nm at 2.3 A (e-Manual), at 100 mm per turn; 0.05 Nm of friction.
FORCE = CURRENT * 2.69e-3 * 4.1 / 2.3 * 2 * math.pi / 0.1
FRICTION = 0.05 * 2 * math.pi / 0.1


class Slide:
    """A slide at aim 0 along x, whose servo is driven in Current-based Position Control Mode."""

    def __init__(self, model: str = "XM430-W350", mm_per_turn: float = 100.0) -> None:
        mm_per_rad = mm_per_turn / (2 * math.pi)
        self.console = Console(model=model, start_rad=(50.0 - 90.0) / mm_per_rad)
        self.truth = FingerTruth(
            base_mm=(0.0, 0.0),
            heading_rad=0.0,
            height_mm=10.0,
            gear_ratio=5.0,
            aim_zero_rad=0.0,
            aim_play_rad=0.0,
            mm_per_rad=mm_per_rad,
            zero_mm=90.0,
            slide_play_mm=PLAY,
            tip_radius_mm=5.0,
            stiffness_n_per_mm=3.0,
            array_heading_rad=0.0,
            stops_mm=STOPS,
        )
        self.mechanics = SlideMechanics(self.truth, EmulatedServo(2), self.console.servo)
        self.console.start(5, current=CURRENT, velocity=50)

    @property
    def carriage(self) -> float:
        return float(self.mechanics.centre_mm[0])

    @property
    def drive(self) -> float:
        """Where the tip would be without play, as an exact encoder would tell."""
        return self.truth.zero_mm + self.truth.mm_per_rad * self.console.servo.shaft_rad

    def go(self, distance: float, seconds: float) -> list[tuple[float, float]]:
        """Drive towards a distance; drive and carriage every millisecond."""
        tick = 2048 + (distance - self.truth.zero_mm) / self.truth.mm_per_rad * 4096 / (2 * math.pi)
        assert self.console.write(116, round(tick), 4) == 0
        seen = []
        for _ in range(round(seconds * 1000)):
            self.mechanics.step(1e-3, None)
            seen.append((self.drive, self.carriage))
        return seen


@pytest.mark.parametrize(("goal", "stop", "outward"), [(30.0, STOPS[0], -1), (75.0, STOPS[1], 1)])
def test_a_servo_of_little_current_stalls_at_the_stop(goal: float, stop: float, outward: int) -> None:
    slide = Slide()
    slide.go(goal, 2.0)
    before = slide.carriage
    slide.go(goal, 0.5)
    assert slide.carriage == pytest.approx(before, abs=1e-6), "it stands"
    deep = outward * (slide.carriage - stop)
    assert (FORCE - FRICTION) / STIFFNESS <= deep <= (FORCE + FRICTION) / STIFFNESS
    # The stop pushes back, so the play is all on one side.
    assert slide.drive - slide.carriage == pytest.approx(outward * PLAY)


def test_coming_back_shows_the_play() -> None:
    slide = Slide()
    slide.go(30.0, 2.0)
    pressed = slide.drive
    way = slide.go(50.0, 2.0)
    still = [drive for drive, carriage in way if carriage <= STOPS[0]]
    # The drive has gone through the play both ways before it takes the carriage along.
    assert max(still) - pressed == pytest.approx(2 * PLAY, abs=0.05)
    assert min(carriage for _, carriage in way) >= STOPS[0] - (FORCE + FRICTION) / STIFFNESS
    drive, carriage = way[-1]
    assert drive == pytest.approx(50.0, abs=0.3)
    assert drive - carriage == pytest.approx(PLAY)


def test_no_push_where_there_is_no_stop() -> None:
    slide = Slide()
    slide.go(45.0, 2.0)
    assert slide.carriage == pytest.approx(45.0 + PLAY, abs=0.3)
    assert slide.carriage - slide.drive == pytest.approx(PLAY)


@pytest.mark.parametrize("model", ["XL330-M288", "XC330-M288", "XM430-W350"])
@pytest.mark.parametrize("mm_per_turn", [-100.0, 40.0, 200.0])
def test_slides_of_every_kind_come_to_rest_at_their_stops(model: str, mm_per_turn: float) -> None:
    slide = Slide(model, mm_per_turn)
    way = slide.go(30.0, 2.0)
    assert min(carriage for _, carriage in way) > STOPS[0] - 0.5
    assert {round(carriage, 4) for _, carriage in way[-500:]} == {round(slide.carriage, 4)}
    assert slide.carriage == pytest.approx(STOPS[0], abs=0.05)


# ----------------------------------------------------------------------------------------------------
# Arms and a stage that start anywhere: fingers come to where they wait, or a line says why not.

ARMS = load_rig(EXAMPLES / "two-link-rig.toml")


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
        item.kinematics.servos_rad(item.home(ARMS.clear_radius_mm), 0.0)
        for item in map(mechanism_of, ARMS.fingers)
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
    standby, rng = Standby.of(ARMS, Turn()), np.random.default_rng(5)
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
    arm = mechanism_of(ARMS.fingers[index])
    assert isinstance(arm, ArmMechanism)
    assert standby.is_there(index, (servos[0], servos[1]))
    away = math.hypot(*arm.kinematics.centre_mm((servos[0], servos[1])))
    assert away == pytest.approx(arm.wait_radius_mm(ARMS.clear_radius_mm), abs=0.1)


def test_an_arm_that_is_hemmed_in_has_no_way() -> None:
    """A wall between the tip and every place where it may wait; there is no way round it."""
    wall = [[-150.0, 60.0], [150.0, 60.0], [150.0, 66.0], [-150.0, 66.0]]
    data = ARMS.model_dump(mode="json", exclude_unset=True)
    rig = RigFile.model_validate(data | {"obstacles": [{"name": "wall", "outline_mm": wall}]})
    drawn = homes()
    drawn[0] = posture(0, (0.0, 0.0))
    standby = Standby.of(rig, Turn())
    assert not standby.is_there(0, drawn[0])
    assert next(standby.ways(0, drawn), None) is None
