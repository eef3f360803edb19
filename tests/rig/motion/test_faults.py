"""Whatever fails or interrupts: it is named, all that can still hear is switched off, the log is whole."""

import random
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from command import log_events
from emulated_session import EmulatedSession, small_session
from sampling import sample

from palpate.base.errors import DeviceError, PalpateError, SafetyStop
from palpate.drivers.dynamixel import control_table as ct
from palpate.rig.bench import connect
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch

IDS = (11, 12, 21, 22, 31, 32)


def check_log(folder: Path, how: str) -> None:
    events = log_events(folder / "session.jsonl.zst")
    assert events[0]["event"] == "session"
    assert (events[-1]["event"], events[-1]["how"]) == ("end", how)
    assert all("t_s" in event for event in events)
    times = [event["t_s"] for event in events]
    assert times == sorted(times)


def check_off(session: EmulatedSession, *, but: int | None = None) -> None:
    """Torque is off on every servo that can hear, and nothing moves any more."""
    on = [dxl_id for dxl_id, torque in session.torque().items() if torque and dxl_id != but]
    assert on == []
    assert session.rest(0.5) < 4.0, "a slide coasts a little before friction has stopped it"
    assert session.rest(0.5) < 1e-3


def failing(
    session: EmulatedSession, folder: Path, stage: GripPhase, after_s: float, fault: Callable[[], None]
) -> PalpateError:
    """Carry out a grip in which something happens `after_s` into a stage; returns what came of it."""

    def on_stage(now: GripPhase) -> None:
        if now is stage:
            session.clock.after(after_s, fault)

    with pytest.raises(PalpateError) as caught:
        session.run_grip(folder, session.middle(), on_stage)
    assert session.stages[-1] is stage, "the fault was noticed in the stage it happened in"
    message = str(caught.value)
    assert "\n" not in message
    check_log(folder, type(caught.value).__name__)
    return caught.value


@pytest.mark.parametrize("dead", sample(IDS, [11, 32]))
def test_a_servo_that_does_not_answer_is_named_and_nothing_gets_torque(tmp_path: Path, dead: int) -> None:
    session = small_session()
    session.servos[dead].power_off()
    joint = {11: "f1 aim", 12: "f1 slide", 21: "f2 aim", 22: "f2 slide", 31: "f3 aim", 32: "f3 slide"}[dead]
    with pytest.raises(DeviceError, match=rf"^{joint}: servo {dead} on mock://\S+/bus does not answer"):
        session.run_grip(tmp_path, session.middle())
    assert session.stages == []
    check_off(session)
    check_log(tmp_path, "NotAnswering")


def test_a_servo_left_on_by_someone_is_switched_off_when_another_one_is_missing(tmp_path: Path) -> None:
    session = small_session()
    for dxl_id in IDS:
        session.servos[dxl_id].take_block(64, b"\1")
    session.servos[22].power_off()
    with pytest.raises(DeviceError, match="servo 22 "):
        session.run_grip(tmp_path, session.middle())
    check_off(session, but=22)


@pytest.mark.parametrize("name", ["f1", "f3"])
def test_a_silent_array_is_named_and_nothing_gets_torque(tmp_path: Path, name: str) -> None:
    session = small_session()
    session.cables[f"mock://{name}"].cut = True
    with pytest.raises(DeviceError, match=rf"tactile array {name} on mock://\S+/{name} does not answer"):
        session.run_grip(tmp_path, session.middle())
    check_off(session)
    check_log(tmp_path, "ArraySilent")


@pytest.mark.parametrize("dead", [12, 31])
def test_a_servo_that_dies_in_a_closing(tmp_path: Path, dead: int) -> None:
    session = small_session()
    error = failing(session, tmp_path, GripPhase.CLOSING, 1.0, session.servos[dead].power_off)
    assert isinstance(error, DeviceError)
    # A slide is looked at all the time, an aim servo only with torque off: then it is at least named.
    assert f"servo {dead} " in str(error)
    warning, hint = error.__notes__
    assert "another program" in hint
    assert "one servo did not confirm that torque is off" in warning
    assert f"servo {dead} " in warning
    check_off(session, but=dead)


def test_a_finger_held_by_what_it_does_not_feel(tmp_path: Path) -> None:
    """Something catches the finger behind its tip: the servo pulls, the array feels nothing."""
    session = small_session(empty=True)
    slide = session.servos[12]

    def shut() -> None:
        at = slide.shaft_rad
        slide.hold(lambda rad, rad_s: -50.0 * (rad - at) - 0.3 * rad_s)

    error = failing(session, tmp_path, GripPhase.CLOSING, 1.0, shut)
    assert isinstance(error, SafetyStop)
    assert "finger f1 is held" in str(error)
    slide.hold(None)
    check_off(session)


STAGES = [
    (GripPhase.AIMING, 0.02),
    (GripPhase.CLOSING, 0.0),
    (GripPhase.CLOSING, 3.0),
    (GripPhase.TOUCHING, 0.4),
    (GripPhase.RETRACTING, 0.5),
]


@pytest.mark.parametrize(("stage", "base_s"), sample(STAGES, STAGES[1::2]))
def test_interrupted_anywhere_fingers_stop(tmp_path: Path, stage: GripPhase, base_s: float) -> None:
    """The interrupt comes at an instant like any other: inside a transfer, between two, in a wait."""
    session = small_session()
    after_s = base_s + random.Random(f"{stage} {base_s}").uniform(0.0, 0.03)

    def interrupt() -> None:
        raise KeyboardInterrupt("Ctrl-C")

    def on_stage(now: GripPhase) -> None:
        if now is stage:
            session.clock.after(after_s, interrupt)

    with pytest.raises(KeyboardInterrupt):
        session.run_grip(tmp_path, session.middle(), on_stage)
    assert session.stages[-1] is stage
    check_off(session)
    check_log(tmp_path, "KeyboardInterrupt")


@pytest.mark.parametrize("after_s", [0.0, 0.001, 0.004, 0.02])
def test_interrupted_while_connecting(tmp_path: Path, after_s: float) -> None:
    session = small_session()
    for dxl_id in IDS:
        session.servos[dxl_id].take_block(64, b"\1")  # left on by whoever was here before

    def interrupt() -> None:
        raise KeyboardInterrupt("Ctrl-C")

    session.clock.after(after_s, interrupt)
    with pytest.raises(KeyboardInterrupt):
        session.run_grip(tmp_path, session.middle())
    check_log(tmp_path, "KeyboardInterrupt")
    check_off(session)


def test_interrupted_while_switching_off() -> None:
    """The interrupt swallows the very packet that was to switch everything off."""
    session = small_session()

    def interrupt() -> None:
        session.clock.on_tick = lambda: None
        raise KeyboardInterrupt("Ctrl-C")

    def grip_and_leave() -> None:
        with connect(session.bench_rig) as hand:
            hand.prepare()
            assert all(session.torque().values())
            session.clock.on_tick = interrupt

    with pytest.raises(KeyboardInterrupt):
        grip_and_leave()
    check_off(session)


def test_a_late_answer_is_not_believed_to_answer_the_next_question() -> None:
    session = small_session()
    bus = session.cables["mock://bus"]

    def recover() -> None:
        bus.late_s = 0.0

    with connect(session.bench_rig) as hand:
        bus.late_s = 0.04
        session.clock.after(0.002, recover)
        assert hand.bus.read(11, ct.RETURN_DELAY_TIME) == 250
        assert hand.bus.read(11, ct.ITEMS["Operating Mode"]) == 3


@cache
def undisturbed() -> list[Touch]:
    """The same grip with nothing in its way."""
    session = small_session()
    with TemporaryDirectory() as folder:
        return session.run_grip(Path(folder), session.middle())


@pytest.mark.parametrize(
    ("stage", "after_s"),
    sample(
        [(GripPhase.AIMING, 0.01), (GripPhase.CLOSING, 1.0), (GripPhase.TOUCHING, 0.3)],
        [(GripPhase.TOUCHING, 0.3)],
    ),
)
def test_answers_that_come_late_once_change_nothing(tmp_path: Path, stage: GripPhase, after_s: float) -> None:
    """A stall of 40 ms, longer than the SDK waits: asked again, no late answer is taken for another one."""
    session = small_session()
    bus = session.cables["mock://bus"]

    def stall() -> None:
        bus.late_s = 0.04
        session.clock.after(0.002, recover)

    def recover() -> None:
        bus.late_s = 0.0

    def on_stage(now: GripPhase) -> None:
        if now is stage:
            session.clock.after(after_s, stall)

    touches = session.run_grip(tmp_path, session.middle(), on_stage)
    for touch, other in zip(touches, undisturbed(), strict=True):
        assert touch.contact.touched
        assert touch.contact.end_mm == pytest.approx(other.contact.end_mm, abs=0.25)
    check_log(tmp_path, "done")
    check_off(session)
