"""Faults in motion: the matrix, bounds, a killed process, a servo that does not stop."""

import json
import random
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from palpate.base.errors import DeviceError, PalpateError, SafetyStop
from palpate.config import RigFile
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.emulators.wire_faults import FaultRates, WireRates
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port
from palpate.rig.bench import connect
from palpate.rig.contact_peak import unstopped_peak_n
from palpate.rig.conversion import line_of
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from palpate.testing import served
from support.benches.fault_matrix import PHASES, Cell, problems, run_cell, table, table_of_page
from support.benches.fault_rows import FAULTS, JUST_BEFORE, LOOKED, Fault
from support.benches.rigs import firm_rig, quick_bench, small, small_objects
from support.benches.session import EmulatedSession, emulated_session, small_session
from support.campaign.sampling import sample
from support.commands.command import log_bytes, log_events
from support.commands.repository import PACKAGE

# ----------------------------------------------------------------------------------------------------
# Whatever fails or interrupts: it is named, all that can still hear is switched off, the log is whole.

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
    assert "palpate doctor" in hint
    assert "one servo did not confirm that torque is off" in warning
    assert f"servo {dead} " in warning
    check_off(session, but=dead)


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


BUS, ARRAYS = ("mock://bus",), ("mock://f1", "mock://f2", "mock://f3")


@pytest.mark.parametrize(
    ("ports", "rates", "ends"),
    [
        (BUS, FaultRates(flipped=0.01), False),
        (BUS, FaultRates(lost=0.33), False),
        (ARRAYS, FaultRates(flipped=0.0005), True),
        (ARRAYS, FaultRates(lost=0.2), True),
    ],
)
def test_on_a_bad_wire_fingers_keep_to_their_limits(
    tmp_path: Path, ports: tuple[str, ...], rates: FaultRates, ends: bool
) -> None:
    """Of an array, the next frame is there before much has happened; the bus's wire may end the grip."""
    session = small_session()
    for port in ports:
        session.cables[port].wire.rates = WireRates(rates if port in BUS else FaultRates(), rates)
    how = "done"
    try:
        session.run_grip(tmp_path, session.middle())
    except PalpateError as error:
        how = type(error).__name__
    check_log(tmp_path, how)
    assert how == "done" or not ends
    check_off(session)
    assert max(finger.hardest_n for finger in session.bench.fingers) <= session.rig.closing.max_force_n
    for finger, item in zip(session.bench.fingers, session.middle(), strict=True):
        assert line_of(item).travel_mm(tuple(finger.centre_mm.tolist())) <= item.travel_mm + 1.0


def test_a_computer_that_sleeps_begins_the_grip_again(tmp_path: Path) -> None:
    """Bus Watchdog stops every finger; then the grip is carried out from the start."""
    session = small_session()

    def on_stage(now: GripPhase) -> None:
        if now is GripPhase.CLOSING and session.stages.count(now) == 1:
            session.clock.after(0.5, lambda: session.clock.sleep(0.8))

    session.run_grip(tmp_path, session.middle(), on_stage)
    check_log(tmp_path, "done")
    check_off(session)
    assert session.stages.count(GripPhase.CLOSING) == 2


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


# ----------------------------------------------------------------------------------------------------
# A sample of the fault matrix: every other row once, in one of the phases in which it must be noticed.
#
# The small bench is enough for that, but where a bound on force or travel is that of the shipped bench's
# size.
# `benchmarks/bench_fault_matrix.py` runs all cells on the whole bench, and with each guard removed.

POWER = tuple(
    Fault(name, strike, "", "", (DeviceError,), "servo|port", LOOKED)
    for name, strike in {
        "brown-out of all": lambda host: [servo.set_supply(3.0) for servo in host.session.servos.values()],
        "voltage too low": lambda host: host.session.servos[12].set_supply(9.0),
        "too hot": lambda host: host.session.servos[12].set_temperature(95.0),
    }.items()
)
"""Like rows of the matrix whose `does` the page has under "hardware error"."""

_WHOLE = ("something hard is pushed against a tip", "the computer stops")
_PHASES = ("approach", "touch", "free travel", "torque off")


def sample_of_cells() -> list[Any]:
    """A cell of every other row, and an array cut off as a creep begins: nobody looked there once.

    The rows between are in the campaign.
    """
    draw = random.Random(5)
    found = []
    for number, fault in enumerate(FAULTS):
        noticed = [phase for phase in _PHASES if phase in fault.noticed]
        phase = draw.choice(noticed or list(_PHASES))
        cell = Cell("identify", phase, number, small=fault.name not in _WHOLE)
        found.append(pytest.param(cell, marks=[pytest.mark.campaign] * (number % 2)))
    cut = next(number for number, fault in enumerate(FAULTS) if fault.name == "an array's cable breaks")
    pushed = pytest.param(Cell("check --hold", "creep", cut, small=True), marks=pytest.mark.campaign)
    touching = [
        pytest.param(
            Cell("identify", JUST_BEFORE, fault, small=fault.name not in _WHOLE),
            marks=[pytest.mark.campaign] * (fault in FAULTS),
        )
        for fault in (*FAULTS, *POWER)
        if JUST_BEFORE in fault.noticed
    ]
    return [*found, *touching, Cell("calibrate", "creep", cut, small=True), pushed]


@pytest.mark.parametrize("cell", sample_of_cells(), ids=str)
def test_a_cell_ends_as_its_row_says(cell: Cell) -> None:
    assert problems(cell, run_cell(cell)) == []


def test_phases_are_functions_of_the_package() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    assert [name for name, _ in PHASES if f"def {name}(" not in text] == []


def test_the_page_has_the_rows_of_the_matrix() -> None:
    assert table_of_page() == table(), "write it anew: python benchmarks/bench_fault_matrix.py --page"


# ----------------------------------------------------------------------------------------------------
# The program ends while fingers close, in ways that no handler of it sees: its dead-man switch remains.
#
# `benchmarks/bench_ways_out.py` tries the others, judged by the vendor's SDK.

FOUR_IDS = (11, 12, 21, 22)

PROGRAM = """
import os, signal, sys, threading, time
import palpate

closing = threading.Event()

def look(event):
    if isinstance(event, palpate.StageEvent) and event.stage.value == "closing":
        closing.set()

def drive():
    with palpate.open_rig("real.toml") as rig:
        rig.identify("{parts}", sessions="palpate-sessions", on_event=look)

threading.Thread(target=drive, daemon=True).start()
assert closing.wait(60)
time.sleep(0.3)
{end}
"""
SIGNAL_IN_A_THREAD = "os.kill(os.getpid(), signal.{})"


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("end", "code"),
    sample(
        [
            ("", 0),
            ("raise KeyboardInterrupt", -signal.SIGINT),
            ("sys.exit(3)", 3),
            ("os._exit(7)", 7),
            (SIGNAL_IN_A_THREAD.format("SIGTERM"), -signal.SIGTERM),
            (SIGNAL_IN_A_THREAD.format("SIGQUIT"), -signal.SIGQUIT),
            (SIGNAL_IN_A_THREAD.format("SIGKILL"), -signal.SIGKILL),
        ],
        [("", 0), (SIGNAL_IN_A_THREAD.format("SIGKILL"), -signal.SIGKILL)],
    ),
)
def test_torque_is_off_after_a_program_whatever_ends_it(tmp_path: Path, end: str, code: int) -> None:
    small, parts = quick_bench(tmp_path, fingers=2)
    words = ("--rig", small, "--objects", parts, "--seed", 7, "--rig-out", "real.toml")
    with served(tmp_path, "--pty", *words) as (_, told):
        (tmp_path / "program.py").write_text(PROGRAM.format(parts=parts, end=end))
        words = [sys.executable, "program.py"]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == code, done.stderr
        assert "torque may" not in done.stderr
        bus = Bus(
            open_port(told["ports"]["mock://bus"], 1_000_000), MonotonicClock(), 1_000_000, latency_s=0.1
        )
        try:
            torque = {dxl_id: bus.read(dxl_id, ct.TORQUE_ENABLE) for dxl_id in FOUR_IDS}
        finally:
            bus.close()
        assert torque == dict.fromkeys(FOUR_IDS, 0), done.stderr
        log = next(tmp_path.glob("palpate-sessions/*/session.jsonl.zst"))
        lines = log_bytes(log).decode().splitlines()
        assert "session" in lines[0], "whole up to its last line"
        assert all(json.loads(line)["event"] for line in lines[:-1])


# ----------------------------------------------------------------------------------------------------
# Fingers that nobody stops press no harder than `palpate check` says: the bus is cut when one touches.


def drawn_rig(rng: np.random.Generator) -> RigFile:
    """The small firm rig with other speeds, force limits and tips."""
    data = tomllib.loads(small(firm_rig()))
    speed = float(rng.uniform(5.0, 60.0))
    tip = {
        "stiffness_n_per_mm": float(rng.uniform(1.0, 12.0)),
        "stiffness_spread": float(rng.uniform(0.0, 0.3)),
    }
    data["closing"] |= {"approach_speed_mm_s": speed, "touch_speed_mm_s": min(speed, 5.0)}
    data["closing"] |= {"max_force_n": float(rng.uniform(8.0, 14.0))}
    friction = {"friction": [0.3, 1.2], "rest_friction": [1.0, 2.0], "cable_n": [-1.0, 1.0]}
    data["emulation"] |= {"stiffness_spread": tip["stiffness_spread"], "mechanics": friction}
    for finger in data["fingers"]:
        finger["tip"] |= tip
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(60), [0]))
def test_a_finger_whose_bus_is_cut_presses_within_its_bound(seed: int, tmp_path: Path) -> None:
    rig = drawn_rig(np.random.default_rng([11, seed]))
    session = emulated_session(seed=seed, rig=rig, objects=small_objects())
    bus = session.cables[rig.bus.port]

    def cut_at_a_touch() -> None:
        bus.cut = bus.cut or any(finger.hardest_n > 0 for finger in session.bench.fingers)

    session.clock.on_tick = cut_at_a_touch
    with pytest.raises((DeviceError, SafetyStop)):
        session.run_grip(tmp_path, session.middle())
    assert bus.cut
    session.rest(2.0)
    hardest = max(finger.hardest_n for finger in session.bench.fingers)
    assert 0.1 < hardest <= unstopped_peak_n(rig)
