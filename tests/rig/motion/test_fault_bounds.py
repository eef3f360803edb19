"""Faults just before a touch: how hard a finger presses then, how far it goes, how it ends.

The fault matrix (`fault_matrix`) has the other instants.

The bounds are those of docs/safety.md, for the shipped rig.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from command import log_events
from emulated_session import EmulatedSession, small_session

from palpate.base.errors import DeviceError, PalpateError, SafetyStop
from palpate.drivers.dynamixel.errors import Restarted
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.emulators.wire_faults import FaultRates, WireRates
from palpate.rig.conversion import line_of
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.reach.approaches import reach_of

FORCE_N = 10.0
"""max_force_n (8 N, by the servos' current limit, whatever the host does) and a quarter.

No fault here leads to more, as docs/safety.md says; what nobody stops may press harder: `test_unstopped`.
"""

NOTICED_MM = 5.0
"""Approach speed by 0.18 s until the host has asked again and waited, and what a slide coasts."""

UNHEARD_MM = 12.0
"""Approach speed by 0.52 s until Bus Watchdog trips, and the servo's braking."""

SLIDES = {12: 0, 22: 1, 32: 2}


class Watch:
    """What fingers do from the fault on, as the bench knows it and the host does not."""

    def __init__(self, session: EmulatedSession) -> None:
        self._session = session
        self._at = [finger.centre_mm for finger in session.bench.fingers]
        self.furthest_mm = self._next_s = 0.0
        for finger in session.bench.fingers:
            finger.hardest_n = 0.0
        session.clock.on_tick = self._look

    def _look(self) -> None:
        if self._session.clock.now() < self._next_s:
            return  # tips move in steps of a millisecond
        self._next_s = self._session.clock.now() + 1e-3
        for finger, at in zip(self._session.bench.fingers, self._at, strict=True):
            self.furthest_mm = max(self.furthest_mm, float(np.hypot(*(finger.centre_mm - at))))

    @property
    def hardest_n(self) -> float:
        return max(finger.hardest_n for finger in self._session.bench.fingers)


def closing_with(
    folder: Path, stage: GripPhase, after_s: float, fault: Callable[[EmulatedSession], object], seed: int
) -> tuple[EmulatedSession, Watch, PalpateError | None]:
    """Carry out a grip with a fault in it; what came of it, None if nobody minded."""
    session = small_session(seed=seed)
    if after_s == JUST_BEFORE_TOUCHING:
        after_s = first_touch_s(seed) - 0.1
    watches: list[Watch] = []

    def strike() -> None:
        watches.append(Watch(session))
        fault(session)

    def on_stage(now: GripPhase) -> None:
        if now is stage and not watches:
            session.clock.after(after_s, strike)

    error: PalpateError | None = None
    try:
        session.run_grip(folder, session.middle(), on_stage)
    except PalpateError as ended:
        error = ended
    (watch,) = watches
    return session, watch, error


def check_end(session: EmulatedSession, folder: Path, error: PalpateError | None) -> None:
    """The log is whole and says how it ended; every servo that can hear has its torque off."""
    events = log_events(folder / "session.jsonl.zst")
    assert events[-1]["event"] == "end"
    assert events[-1]["how"] == ("done" if error is None else type(error).__name__)
    assert not any(session.torque().values())
    session.rest(1.0)
    assert session.rest(0.5) < 1e-3


JUST_BEFORE_TOUCHING = -1.0
WHEN = [(GripPhase.CLOSING, JUST_BEFORE_TOUCHING)]


@cache
def first_touch_s(seed: int) -> float:
    """When the first finger touches the part, from the beginning of the closing."""
    session = small_session(seed=seed)
    began: list[float] = []
    touched: list[float] = []

    def look() -> None:
        if began and not touched and any(finger.press is not None for finger in session.bench.fingers):
            touched.append(session.clock.now())

    def on_stage(now: GripPhase) -> None:
        if now is GripPhase.CLOSING:
            began.append(session.clock.now())

    session.clock.on_tick = look
    with TemporaryDirectory() as folder:
        session.run_grip(Path(folder), session.middle(), on_stage)
    return touched[0] - began[0]


@pytest.mark.parametrize(("stage", "after_s", "dxl_id"), [*((*when, 12) for when in WHEN)])
def test_a_silent_servo(tmp_path: Path, stage: GripPhase, after_s: float, dxl_id: int) -> None:
    """Its data line breaks: it hears and says nothing, and goes on with what it was told last."""

    def deafen(session: EmulatedSession) -> None:
        session.servos[dxl_id]._unit.deaf_s = 1e9

    session, watch, error = closing_with(tmp_path, stage, after_s, deafen, seed=7)
    assert error is not None
    assert f"servo {dxl_id} " in str(error)
    session.rest(1.0)
    assert watch.hardest_n <= FORCE_N
    assert watch.furthest_mm <= UNHEARD_MM, "the deaf one is stopped by its own watchdog"
    others = {i: on for i, on in session.torque().items() if i != dxl_id}
    assert not any(others.values())


FAILURES: dict[str, Callable[[EmulatedSession], object]] = {
    "overload": lambda s: s.servos[22].report_hardware_error(OVERLOAD_BIT),
    "one servo's plug": lambda s: s.servos[32].power_off(),
    "brown-out of all": lambda s: [servo.set_supply(3.0) for servo in s.servos.values()],
    "voltage too low": lambda s: s.servos[12].set_supply(9.0),
    "too hot": lambda s: s.servos[12].set_temperature(95.0),
}


@pytest.mark.parametrize(
    ("failure", "stage", "after_s"),
    [
        *((failure, GripPhase.CLOSING, JUST_BEFORE_TOUCHING) for failure in FAILURES),
    ],
)
def test_a_servo_that_fails(tmp_path: Path, failure: str, stage: GripPhase, after_s: float) -> None:
    session, watch, error = closing_with(tmp_path, stage, after_s, FAILURES[failure], seed=7)
    assert error is not None
    for servo in session.servos.values():
        servo.set_supply(12.0)  # after the run, power comes back
    session.rest(1.0)
    check_end(session, tmp_path, error)
    assert watch.hardest_n <= FORCE_N
    assert watch.furthest_mm <= NOTICED_MM


@pytest.mark.parametrize(("stage", "after_s", "back_s"), [*((*when, 3.0) for when in WHEN)])
def test_the_adapter_unplugged_and_plugged_in_again(
    tmp_path: Path, stage: GripPhase, after_s: float, back_s: float
) -> None:
    def unplug(session: EmulatedSession) -> None:
        wire = session.cables["mock://bus"].wire
        wire.unplugged = True
        session.clock.after(back_s, lambda: setattr(wire, "unplugged", False))

    session, watch, error = closing_with(tmp_path, stage, after_s, unplug, seed=7)
    assert error is not None
    assert "failed" in str(error)
    check_end(session, tmp_path, error)
    assert not getattr(error, "__notes__", []), "torque is off: nothing to warn of"
    assert watch.hardest_n <= FORCE_N
    assert watch.furthest_mm <= UNHEARD_MM


@pytest.mark.parametrize(("stage", "after_s"), WHEN)
def test_the_host_dies(tmp_path: Path, stage: GripPhase, after_s: float) -> None:
    """Nothing is heard of it any more: every servo stops by itself, with torque on."""

    def die(session: EmulatedSession) -> None:
        for cable in session.cables.values():
            cable.cut = True

    session, watch, error = closing_with(tmp_path, stage, after_s, die, seed=7)
    assert error is not None
    session.rest(0.6)
    assert session.rest(1.0) < 1e-3
    assert watch.hardest_n <= FORCE_N
    assert watch.furthest_mm <= UNHEARD_MM


RATES = {
    "1 % of bytes flipped": FaultRates(flipped=0.01),
    "a third of packets lost": FaultRates(lost=0.33),
}


@pytest.mark.parametrize(
    ("stage", "after_s", "rates"),
    [
        *((*when, "1 % of bytes flipped") for when in WHEN),
        (GripPhase.CLOSING, JUST_BEFORE_TOUCHING, "a third of packets lost"),
    ],
)
def test_a_bad_wire(tmp_path: Path, stage: GripPhase, after_s: float, rates: str) -> None:
    """The grip is carried out all the same, or ends with an error; fingers keep to their limits."""

    def spoil(session: EmulatedSession) -> None:
        session.cables["mock://bus"].wire.rates = WireRates(RATES[rates], RATES[rates])

    session, watch, error = closing_with(tmp_path, stage, after_s, spoil, seed=7)
    check_end(session, tmp_path, error)
    assert watch.hardest_n <= FORCE_N
    for finger, item in zip(session.bench.fingers, session.middle(), strict=True):
        gone = line_of(item).travel_mm(tuple(finger.centre_mm.tolist()))
        assert gone <= item.travel_mm + 1.0


def test_most_grips_survive_a_wire_that_loses_little(tmp_path: Path) -> None:
    survived = 0
    for seed in (2, 5):
        folder = tmp_path / str(seed)
        folder.mkdir()

        def spoil(session: EmulatedSession) -> None:
            rates = FaultRates(flipped=0.0005, lost=0.005)
            session.cables["mock://bus"].wire.rates = WireRates(rates, rates)

        _, _, error = closing_with(folder, GripPhase.CLOSING, 0.1, spoil, seed)
        survived += error is None
    assert survived == 2


def test_a_computer_that_sleeps_while_a_finger_runs_into_the_part(tmp_path: Path) -> None:
    """Then it has pressed too hard: what the contacts say of the part is not worth much any more."""
    session, watch, error = closing_with(
        tmp_path, GripPhase.CLOSING, JUST_BEFORE_TOUCHING, lambda s: s.clock.sleep(0.8), seed=7
    )
    check_end(session, tmp_path, error)
    assert isinstance(error, SafetyStop)
    assert watch.hardest_n <= FORCE_N


def test_a_computer_that_sleeps_begins_the_grip_again(tmp_path: Path) -> None:
    """Bus Watchdog stops every finger; then the grip is carried out from the start."""

    def sleep(session: EmulatedSession) -> None:
        session.clock.sleep(0.8)

    session, watch, error = closing_with(tmp_path, GripPhase.CLOSING, 1.0, sleep, seed=7)
    assert error is None
    check_end(session, tmp_path, error)
    assert watch.hardest_n <= FORCE_N
    assert session.stages.count(GripPhase.CLOSING) == 2


def test_a_servo_that_blinks(tmp_path: Path) -> None:
    """Without power for a moment: it is back before anybody asks, and has forgotten everything."""

    def blink(session: EmulatedSession) -> None:
        session.servos[22].power_off()
        session.servos[22].power_on()

    session, watch, error = closing_with(tmp_path, GripPhase.CLOSING, 1.7, blink, seed=7)
    assert isinstance(error, Restarted)
    assert "servo 22 " in str(error)
    check_end(session, tmp_path, error)
    assert watch.furthest_mm <= NOTICED_MM


def test_a_servo_that_somebody_else_switches_off(tmp_path: Path) -> None:
    session, watch, error = closing_with(
        tmp_path, GripPhase.CLOSING, 1.7, lambda s: s.servos[12].take_block(64, b"\0"), seed=7
    )
    assert isinstance(error, SafetyStop)
    assert "servo 12 " in str(error)
    assert "this run did not switch it off" in str(error)
    check_end(session, tmp_path, error)
    assert watch.furthest_mm <= NOTICED_MM


def test_a_servo_that_is_held_on_its_way(tmp_path: Path) -> None:
    """An aim is clamped while it turns: the run ends after a second, not after twenty."""
    session = small_session()
    session.bench.fingers[0].servos[0].hold(lambda rad, rad_s: -80.0 * rad - 0.5 * rad_s)
    reach = reach_of(session.rig)
    own = reach.of_finger(0)
    with pytest.raises(
        DeviceError, match=r"servo 11 .* \(finger f1, aim\) did not reach .* its Present Position stays at"
    ):
        session.run_grip(tmp_path, [reach.approaches[own[0]].up_to(10.0)])
    assert session.stages == [GripPhase.AIMING]
    assert session.clock.now() < 4.0
    assert not any(session.torque().values())


def test_an_item_that_does_not_stay_written_ends_the_run_before_torque_goes_on(tmp_path: Path) -> None:
    session = small_session()
    table = session.servos[22]._unit.table
    put = table.set
    table.set = lambda name, value: put(name, 7 if name == "Current Limit" else value)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"servo 22 .* keeps Current Limit at 7 instead of"):
        session.run_grip(tmp_path, session.middle())
    assert session.stages == []
    assert not any(session.torque().values())


@pytest.mark.parametrize("rates", [FaultRates(flipped=0.0005), FaultRates(lost=0.2)], ids=["noise", "loss"])
def test_an_arrays_bad_wire(tmp_path: Path, rates: FaultRates) -> None:
    """One frame in six is damaged or lost, and dropped: the next one is there before much has happened."""

    def spoil(session: EmulatedSession) -> None:
        for name in ("f1", "f2", "f3"):
            session.cables[f"mock://{name}"].wire.rates = WireRates(to_host=rates)

    session, watch, error = closing_with(tmp_path, GripPhase.CLOSING, 0.1, spoil, seed=7)
    assert error is None
    check_end(session, tmp_path, error)
    assert watch.hardest_n <= session.rig.closing.max_force_n


def test_an_array_unplugged(tmp_path: Path) -> None:
    def unplug(session: EmulatedSession) -> None:
        session.cables["mock://f2"].wire.unplugged = True

    session, watch, error = closing_with(tmp_path, GripPhase.CLOSING, JUST_BEFORE_TOUCHING, unplug, seed=7)
    assert isinstance(error, DeviceError)
    assert "tactile array f2 on " in str(error)
    assert " is gone" in str(error)
    check_end(session, tmp_path, error)
    assert watch.furthest_mm <= NOTICED_MM
