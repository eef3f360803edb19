"""Slides that start anywhere in their travel are homed, and known until they lose their power."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from emulated_session import EmulatedSession, emulated_session
from homing_runs import run_from_anywhere
from hypothesis import given
from hypothesis import strategies as st
from quick_rig import small_objects, small_rig

from palpate.base.errors import DeviceError
from palpate.config import RigFile, SlideFingerConfig, shipped_rig
from palpate.drivers.dynamixel.models import SPECIFICATIONS, known_models, model_by_name
from palpate.drivers.dynamixel.servo_state import MAX_TURNS, NO_MARK, mark_item, mark_value, turns_of_mark
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.rig.bench import connect
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import HomingPolicy, back_stop_distances_mm

RIG = small_rig(shipped_rig("xm430-bench"))


def anywhere(rig: RigFile = RIG) -> RigFile:
    assert rig.emulation is not None
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"start": "anywhere"})})


def session_of(seed: int, rig: RigFile | None = None) -> EmulatedSession:
    return emulated_session(seed=seed, rig=rig or anywhere(), objects=small_objects())


def off_mm(session: EmulatedSession, hand: Hand) -> float:
    """How far any tip is from where the host believes it to be, along its slide."""
    offs = []
    for finger, real in zip(hand.fingers, session.bench.fingers, strict=True):
        x, y = finger.kinematics.centre_mm(hand.servos_of([finger])[finger])
        offs.append(float(np.hypot(*(real.centre_mm - (x, y)))))
    return max(offs)


@pytest.mark.parametrize("seed", range(3))
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
    assert slide.stops_mm is not None
    back, front = slide.stops_mm
    reading = back + share * (front - back) + turns * slide.mm_per_turn
    places = back_stop_distances_mm(slide, reading)
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
