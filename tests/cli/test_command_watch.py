"""`palpate watch`: the emulated rig, recorded sessions, arrays that go away, terminals, bad options."""

import base64
import json
import os
import pty
import re
import select
import signal
import subprocess
import termios
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from serial import SerialException
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.config import load_rig, shipped_rig
from palpate.config.schema import schema_text
from palpate.drivers.tactile.codec import Decoder
from palpate.drivers.tactile.messages import Describe, Frame, Message, Stop
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.ports import PortTaken
from palpate.jobs.session import open_session
from palpate.rig.array_monitor import ArrayPorts, find_array_ports, stream_arrays
from support.benches.rigs import firm_rig
from support.commands.command import (
    PALPATE,
    PATIENCE_S,
    Ended,
    Here,
    log_events,
    log_lines,
    started,
    violations,
    write_log,
)
from support.devices.ports import Listener

RIG = load_rig(shipped_rig())
SCHEMA = json.loads(schema_text("watch"))


@pytest.fixture(scope="module")
def session(recorded: Callable[[str], Path]) -> Path:
    """The folder of a session of one grip."""
    return recorded("one grip")


def updates(done: Ended) -> list[dict[str, Any]]:
    """The objects of all lines on stdout, after a look at their schema."""
    found = [json.loads(line) for line in done.out.splitlines()]
    assert [violations(item, SCHEMA) for item in (found[0], found[-1])] == [[], []]
    return found


def test_the_emulated_rig_as_json(here: Here) -> None:
    done = here("watch", "--for", 1, "--json")
    assert done.code == 0
    found = updates(done)
    assert 18 <= len(found) <= 21, "at most twenty a second"
    last = found[-1]
    assert list(last) == ["format", "t_s", "rig", "session", "fingers"]
    assert (last["rig"], last["session"], last["t_s"]) == ("bench", None, pytest.approx(1.0, abs=0.05))
    assert [finger["finger"] for finger in last["fingers"]] == ["f1", "f2", "f3"]
    for finger in last["fingers"]:
        assert (finger["rows"], finger["columns"], finger["tared"]) == (8, 20, True)
        assert finger["rate_hz"] == pytest.approx(500, abs=5)
        assert 470 <= finger["frames"] <= 510
        assert [finger[name] for name in ("lost", "faults", "misshapen", "dropped")] == [0] * 4
        assert (finger["force_n"], finger["contact"]) == (0.0, None)
        assert [len(row) for row in finger["counts"]] == [20] * 8
        assert 18 < sum(map(sum, finger["counts"])) / 160 < 22, "the rig file's offset"
    assert "nothing may touch the tips" in done.err
    assert "a recorded session shows touches" in done.err


def test_one_finger_in_lines_at_another_rate_untared(here: Here) -> None:
    done = here("watch", "--for", 2.5, "--finger", "f2", "--rate", 100, "--no-tare")
    assert done.code == 0
    lines = done.out.splitlines()
    assert len(lines) == 3
    assert [line.split()[2] for line in lines] == ["f2"] * 3
    for line in lines[1:]:
        assert re.search(r"f2  not tared; (99|100)\.\d frames/s, the last \d+ ms ago; lost 0", line)
    assert "not tared: forces need it" in done.err


def test_bad_wires_are_counted(here: Here, tmp_path: Path) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    text = text.replace("[emulation]\n", "[emulation]\nflipped_bytes = 0.00005\nlost_packets = 0.02\n")
    (tmp_path / "bad.toml").write_text(text)
    last = updates(here("watch", "--rig", "bad.toml", "--for", 3, "--json"))[-1]
    for finger in last["fingers"]:
        assert finger["lost"] > 0
        assert 730 <= finger["frames"] + finger["lost"] <= 760


def test_a_sessions_touches_are_felt_again(here: Here, session: Path) -> None:
    """Frames are counted as the log's bytes hold them; contacts agree with what the run made of them."""
    done = here("watch", "--session", session, "--speed", 1e5, "--json")
    assert done.code == 0
    found = updates(done)
    log = log_events(session / "session.jsonl.zst")
    for finger in found[-1]["fingers"]:
        assert finger["frames"] == frames_in(log, finger["port"])
        assert finger["lost"] == finger["faults"] == 0
    touching = next(event["t_s"] for event in log if event.get("stage") == "touching")
    retracting = next(event["t_s"] for event in log if event.get("stage") == "retracting")
    (grip,) = (event["touches"] for event in log if event["event"] == "touches")
    felt = [touch for touch in grip if touch["patch"] is not None]
    assert felt
    for touch in felt:
        patch, k = touch["patch"], touch["finger_index"]
        contacts = [
            item["fingers"][k]["contact"] for item in found if touching <= item["t_s"] < retracting + 0.2
        ]
        assert any(contact is not None and agree(contact, patch) for contact in contacts)
    before = [item for item in found if item["t_s"] < 1.0]
    assert before[-1]["fingers"][0]["tared"] is False, "the run had not started the arrays"


def agree(contact: Mapping[str, float], patch: Mapping[str, float]) -> bool:
    """Whether a contact of the watch is the run's: nearly the same place and force."""
    return (
        abs(contact["angle_rad"] - patch["angle_rad"]) < 0.1
        and abs(contact["height_mm"] - patch["height_mm"]) < 0.5
        and abs(contact["force_n"] - patch["force_n"]) < 0.2 * patch["force_n"]
    )


def frames_in(log: list[dict[str, Any]], port: str) -> int:
    """Frames that the log's bytes of a port hold after the array has described itself."""
    pieces = [
        base64.b64decode(event["base64"])
        for event in log
        if event["event"] == "bytes" and event["port"] == port and event["direction"] == "received"
    ]
    bodies = [item.body for item in Decoder().feed(b"".join(pieces)) if isinstance(item, Message)]
    assert isinstance(bodies[0], Describe)
    return sum(isinstance(body, Frame) for body in bodies)


def test_a_session_as_a_picture(here: Here, session: Path, tmp_path: Path) -> None:
    log = log_events(session / "session.jsonl.zst")
    measured = next(event["t_s"] for event in log if event.get("stage") == "retracting")
    pictures = []
    for name in ("one.svg", "two.svg"):
        done = here("watch", "--session", session, "--for", measured, "--speed", 1e5, "--picture", name)
        assert done.code == 0
        pictures.append((tmp_path / name).read_text(encoding="utf-8"))
    assert pictures[0] == pictures[1]
    assert "touched" in pictures[0]
    assert "grip&#160;1," in pictures[0]
    assert "http" not in pictures[0].replace("http://www.w3.org/2000/svg", ""), "nothing is fetched"


def test_a_session_keeps_the_walls_time(session: Path) -> None:
    wall = VirtualClock()
    with open_session(session).watch(["f1"], speed=4.0, wall=wall) as monitor:
        for _ in monitor.updates(0.05, seconds=1.0):
            pass
    assert wall.now() == pytest.approx(0.25, abs=0.01)


def test_a_changed_log_is_told(here: Here, session: Path, tmp_path: Path) -> None:
    for path in session.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    lines = log_lines(session / "session.jsonl.zst")
    write_log(tmp_path / "session.jsonl.zst", lines[:5] + lines[6:])
    done = here("watch", "--session", tmp_path, "--for", 0.1, "--speed", 1e5)
    assert "line 6 of the log is not as it was written" in done.err
    write_log(tmp_path / "session.jsonl.zst", lines[:1])
    done = here("watch", "--session", tmp_path)
    assert done.code == 2
    assert "array f1 on mock://f1 never says what it is" in done.err


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (("--speed", 2), "--speed is for --session"),
        (("--session", "s", "--rig", "r.toml"), "--session excludes --rig, --no-calibration, --rate and"),
        (("--session", "s", "--rate", 10), "--session excludes"),
        (("--session", "s", "--no-tare"), "--session excludes"),
        (("--session", "s", "--no-calibration"), "--session excludes"),
        (("--session", "nowhere"), "nowhere is not a session"),
        (("--rig", "nowhere.toml"), "nowhere.toml"),
        (("--finger", "thumb"), 'rig "bench" has no finger thumb; it has f1, f2, f3'),
        (("--for", 0), "--for 0: must be above 0"),
        (("--rate", "nan"), "--rate nan: must be above 0"),
        (("--session", "s", "--speed", -1), "--speed -1: must be above 0"),
    ],
)
def test_bad_options_are_one_line(here: Here, args: tuple[object, ...], told: str) -> None:
    done = here("watch", *args)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ")
    assert told in done.err
    assert done.err.count("\n") == 1


def test_a_rate_that_an_array_refuses(here: Here) -> None:
    done = here("watch", "--rate", 5000, "--for", 1)
    assert done.code == 3
    assert "cannot sample at 5000 Hz; choose a rate up to 1000 Hz" in done.err


class Bench:
    """The emulated rig's ports with somebody listening on each, who may also pull one out."""

    def __init__(self) -> None:
        self.place = find_array_ports(RIG)
        self.listeners: dict[str, Listener] = {}
        self.ports: dict[str, SerialBase] = {}
        self.pulled: str | None = None

    def open(self, port: str, baudrate: int) -> SerialBase:
        def check() -> None:
            if self.pulled == port:
                raise SerialException("device reports readiness to read but returned no data")

        self.listeners[port] = Listener(self.place.clock, check)
        self.ports[port] = self.listeners[port].on(self.place.open_port(port, baudrate))
        return self.ports[port]

    def stopped(self, port: str) -> bool:
        """Whether the last that was said to a port's array is STOP, and the port is closed."""
        said = [item for item in Decoder().feed(self.listeners[port].sent) if isinstance(item, Message)]
        return isinstance(said[-1].body, Stop) and not self.ports[port].is_open


def test_arrays_are_stopped_and_ports_closed_when_one_goes_away() -> None:
    bench = Bench()
    place = ArrayPorts(bench.place.clock, bench.open, bench)

    def watched() -> None:
        with stream_arrays(RIG, RIG.fingers, place, place.clock, 250.0) as fingers:
            bench.pulled = "mock://f2"
            place.clock.sleep(0.1)
            for finger in fingers:
                finger.poll()

    with pytest.raises(DeviceError, match=r"tactile array f2 on .* is gone .*check its cable"):
        watched()
    assert not any(port.is_open for port in bench.ports.values())
    assert bench.stopped("mock://f1")
    assert bench.stopped("mock://f3")
    assert "mock://bus" not in bench.ports, "nobody talks to the servos"


def test_the_first_port_is_closed_again_if_the_second_is_taken() -> None:
    bench = Bench()

    def open_port(port: str, baudrate: int) -> SerialBase:
        if port == "mock://f2":
            raise PortTaken("taken")
        return bench.open(port, baudrate)

    place = ArrayPorts(bench.place.clock, open_port, bench)
    words = "port mock://f2 of array f2 is in use: another program has it.*session"
    with pytest.raises(PortTaken, match=words), stream_arrays(RIG, RIG.fingers, place, place.clock, 250.0):
        pytest.fail("nothing to watch")
    assert bench.stopped("mock://f1")


def test_it_ends_when_nobody_reads_any_more(tmp_path: Path) -> None:
    with started("watch", "--finger", "f1", "--json", "--for", "30", cwd=tmp_path) as command:
        process = command.process
        assert process.stdout is not None
        assert process.stderr is not None
        command.line()
        process.stdout.close()
        assert process.wait(timeout=PATIENCE_S) == 0
        assert [line for line in process.stderr.read().splitlines() if "emulated" not in line][1:] == []
        process.stdout = None


def test_a_signal_ends_it_as_other_commands(tmp_path: Path) -> None:
    with started("watch", "--finger", "f1", cwd=tmp_path) as command:
        assert " f1  " in command.line()
        done = command.ended(signal.SIGINT)
    assert done.code == 130
    assert done.err.splitlines()[-2:] == ["interrupted", "nothing was moved"]


@pytest.mark.parametrize(
    ("term", "args", "screen"),
    [("xterm-256color", (), True), ("dumb", (), False), ("xterm-256color", ("--json",), True)],
)
def test_a_screen_where_there_is_one(
    here: Here, monkeypatch: pytest.MonkeyPatch, term: str, args: tuple[str, ...], screen: bool
) -> None:
    """It is left again at the end; beside JSON it is on stderr."""
    monkeypatch.setenv("FORCE_COLOR", "1")  # what rich takes for a terminal
    monkeypatch.setenv("TERM", term)
    done = here("watch", "--for", 0.2, "--finger", "f1", *args)
    assert done.code == 0
    shown, other = (done.err, done.out) if args else (done.out, done.err)
    assert ("\x1b[?1049h" in shown) == ("\x1b[?1049l" in shown) == screen
    assert ("f1: " in shown.rpartition("\x1b")[2]) == screen, "a summary stays"
    assert "\x1b" not in other
    if not screen:
        assert re.match(r" +0\.2\d s  f1  0\.\d+ N, nothing touched; ", done.out)


def test_keys_on_a_terminal(tmp_path: Path) -> None:
    """q ends it, and the terminal is as it was afterwards."""
    outside, inside = pty.openpty()
    before = termios.tcgetattr(inside)
    process = subprocess.Popen(
        # a session's leader makes the terminal that it opens first its own
        ["sh", "-c", f'exec "{PALPATE}" watch <>{os.ttyname(inside)} >&0 2>&0'],
        cwd=tmp_path,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"},
        start_new_session=True,
    )
    try:
        read_until(outside, rb"[45]\d\d\.\d.frames/s")
        assert termios.tcgetattr(inside) != before
        os.write(outside, b"trq")
        read_until(outside, rb"f3: \d+ frames?, lost 0")
        assert process.wait(timeout=PATIENCE_S) == 0
        assert termios.tcgetattr(inside) == before
    finally:
        process.kill()
        process.wait()
        os.close(outside)
        os.close(inside)


def read_until(fd: int, pattern: bytes) -> None:
    """Wait until `pattern` has come."""
    data, end = b"", time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if select.select([fd], [], [], 1.0)[0]:
            data += os.read(fd, 65536)
        if re.search(pattern, data):
            return
    pytest.fail(f"{pattern!r} did not come: {data[-500:]!r}")
