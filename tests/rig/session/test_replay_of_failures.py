"""`palpate replay` of sessions that ended badly: by a signal, a fault, a hard press, a missing port."""

import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from command import PALPATE, Ended, log_bytes, log_events, run, run_here
from emulated_session import small_session
from firm_rig import firm_rig
from sampling import sample

from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.transport.replay import Replayer
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.hand import Environment
from palpate.rig.session.log import SessionEvents
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.replay import replay_with

Here = Callable[..., Ended]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    return lambda *args: run_here(args, monkeypatch, capsys)


def slow_rig(folder: Path) -> str:
    """Fingers creep, so that a signal is sure to come while they close."""
    text = firm_rig().read_text(encoding="utf-8")
    slow = text.replace("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 5.0")
    (folder / "slow.toml").write_text(slow)
    return "slow.toml"


def signalled(folder: Path, number: signal.Signals, when: bytes, after_s: float) -> Path:
    """The session of an `identify` that got a signal some time after `when` was in its log."""
    process = subprocess.Popen(
        [PALPATE, "identify", "--rig", slow_rig(folder), "--json"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        end = time.monotonic() + 60
        while not any(when in log_bytes(log) for log in folder.glob("palpate-sessions/*/session.jsonl.zst")):
            assert time.monotonic() < end, f"{when!r} never came"
            time.sleep(0.01)
        time.sleep(after_s)
        process.send_signal(number)
        process.wait(timeout=60)
    finally:
        process.kill()
        process.wait()
    (log,) = folder.glob("palpate-sessions/*/session.jsonl.zst")
    return log.parent


@pytest.mark.parametrize(("number", "after_s"), [(signal.SIGINT, 0.31), (signal.SIGTERM, 0.17)])
def test_a_run_that_was_interrupted(
    tmp_path: Path, here: Here, number: signal.Signals, after_s: float
) -> None:
    session = signalled(tmp_path, number, b'"stage":"closing"', after_s)
    end = log_events(session / "session.jsonl.zst")[-1]
    assert end["how"] == "Interrupted"
    done = here("replay", session)
    assert (done.code, done.err) == (0, ""), done.out
    assert done.out.rstrip().endswith(f"all as recorded; ended by Interrupted: {end['message']}")


def test_a_run_that_was_killed(tmp_path: Path, here: Here) -> None:
    session = signalled(tmp_path, signal.SIGKILL, b'"stage":"closing"', 0.1)
    done = here("replay", session)
    assert (done.code, done.err) == (0, ""), done.out
    assert "the log was cut off after line " in done.out


def test_a_run_that_pressed_too_hard_or_was_held(tmp_path: Path, here: Here) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    for old, new in (
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 70.0"),
        ("max_force_n = 8.0", "max_force_n = 4.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 40.0"),
    ):
        text = text.replace(old, new)
    (tmp_path / "hasty.toml").write_text(text)
    assert run("identify", "--rig", "hasty.toml", "--seed", 5, "--json", cwd=tmp_path).code in (3, 4)
    (log,) = tmp_path.glob("palpate-sessions/*/session.jsonl.zst")
    done = here("replay", log.parent)
    assert (done.code, done.err) == (0, ""), done.out
    end = log_events(log)[-1]
    assert end["how"] != "done"
    assert f"all as recorded; ended by {end['how']}: {end['message']}" in done.out


FAULTS: Mapping[str, Callable[[Any], Callable[[], None]]] = {
    "nothing": lambda _: lambda: None,
    "overload": lambda session: lambda: session.servos[22].report_hardware_error(OVERLOAD_BIT),
    "the bus is cut off": lambda session: lambda: setattr(session.cables["mock://bus"], "cut", True),
    "late answers": lambda session: lambda: setattr(session.cables["mock://bus"], "late_s", 0.04),
    "the bus is unplugged": lambda session: lambda: unplug(session.cables["mock://bus"]),
    "Ctrl-C": lambda _: interrupt,
}


def unplug(cable: Any) -> None:
    def gone(*_: object) -> None:
        raise OSError(5, "Input/output error")

    cable.feed = cable.poll = gone


def interrupt() -> None:
    raise KeyboardInterrupt("Ctrl-C")


WHEN = [(GripPhase.AIMING, 0.013), (GripPhase.CLOSING, 1.0), (GripPhase.TOUCHING, 0.3)]


FAULTY = [(fault, *WHEN[k % 3]) for k, fault in enumerate(FAULTS)]


@pytest.mark.parametrize(
    ("fault", "stage", "after_s"),
    sample(FAULTY, FAULTY[::2]),
)
def test_a_grip_with_a_fault_in_it(tmp_path: Path, fault: str, stage: GripPhase, after_s: float) -> None:
    session = small_session()
    grip = session.middle()
    bring_about = FAULTS[fault](session)

    def on_stage(now: GripPhase) -> None:
        if now is stage:
            session.clock.after(after_s, bring_about)

    ended: list[object] = []
    try:
        ended.append(session.run_grip(tmp_path, grip, on_stage))
    except BaseException as error:
        ended.append((type(error), str(error), getattr(error, "__notes__", [])))
    file = read_session(tmp_path)
    assert file.changed_line is None

    def again(replayer: Replayer, events: SessionEvents) -> None:
        try:
            with Environment(replayer.clock, replayer.open, bus_latency_s(session.rig)).hand(
                session.rig
            ) as hand:
                hand.prepare()
                ended.append(carry_out_grip(hand, grip, lambda _: None))
        except BaseException as error:
            ended.append((type(error), str(error), getattr(error, "__notes__", [])))
            raise

    replayed = replay_with(file, session.rig.bus.port, again)
    assert (replayed.difference, replayed.complete) == (None, True)
    assert replayed.lines == len(file.entries)
    assert str(ended[1]) == str(ended[0])
