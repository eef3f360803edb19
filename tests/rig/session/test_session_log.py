"""Session logs, writing in the background, signals, collections."""

import fcntl
import gc
import json
import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from serial import SerialException

from palpate.base.errors import InputError, OutputError
from palpate.base.file_io import LOG_BYTES, LOG_LINE_BYTES
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.recording import (
    Direction,
    ErrorRaised,
    PortBytes,
    PortOpened,
    Recorder,
    RecordItem,
    SessionEvent,
)
from palpate.rig.bench import connect
from palpate.rig.session.log import KINDS, SessionLog, error_of, values_of
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.signals import HeldInterrupts, Interrupted
from palpate.rig.workers import Background, BackgroundCall
from support.benches.session import small_session
from support.commands.command import PATIENCE_S, log_bytes, log_events, until

# ----------------------------------------------------------------------------------------------------
# Reading a session log that is damaged: one line that says where and what is allowed, never a traceback.


def written(folder: Path) -> Path:
    """A short log with every kind of line in it, unpacked."""
    packed = packed_log(folder)
    plain = folder / "session.jsonl"
    plain.write_bytes(log_bytes(packed))
    packed.unlink()
    return plain


def packed_log(folder: Path) -> Path:
    """As palpate writes it."""
    clock = VirtualClock()
    with SessionLog(folder, clock, {"palpate": "0", "seed": 7, "strategy": "planned"}) as log:
        log.note("t0~1.z")
        log.note(PortOpened(0, "mock://bus", "mock://rig/bus"))
        log.note("s0w0:40r0")
        clock.advance_to(0.25)
        log.note(PortBytes(Direction.SENT, "mock://bus", b"\xff\xff\xfd\x00"))
        clock.advance_to(0.5)
        log.note(PortBytes(Direction.RECEIVED, "mock://bus", b"answer"))
        log.note(ErrorRaised("r0", SerialException(5, "gone")))
        log.event("stage", grip=1, stage="aiming")
        log.note(ErrorRaised(None, Interrupted(signal.SIGTERM)))
        log.event("result", result={"x": [1.5, None, "ø"]})
    return log.path


def test_a_whole_log_is_read_as_it_was_written(tmp_path: Path) -> None:
    packed_log(tmp_path)
    file = read_session(tmp_path)
    assert (file.header["seed"], file.changed_line) == (7, None)
    assert file.end == {"how": "done", "message": None}
    assert [entry.line for entry in file.entries] == list(range(2, 10))
    assert [entry.calls for entry in file.entries[:3]] == ["t0~1.z", "s0w0:40r0", ""]
    assert file.entries[1].what == PortBytes(Direction.SENT, "mock://bus", b"\xff\xff\xfd\x00")
    raised = [entry.what for entry in file.entries if isinstance(entry.what, ErrorRaised)]
    assert [item.during for item in raised] == ["r0", None]
    assert str(raised[0].error) == "[Errno 5] gone"
    assert isinstance(raised[1].error, Interrupted)
    assert raised[1].error.signal is signal.SIGTERM
    assert file.told("result") == [{"result": {"x": [1.5, None, "ø"]}}]
    assert isinstance(file.entries[-1].what, SessionEvent)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_error_comes_back(kind: str) -> None:
    args: list[str | int] = ["interrupted"] if kind == "Interrupted" else []
    error = error_of(kind, args)
    assert error is not None
    again = values_of(error)
    assert (again["kind"], str(error_of(again["kind"], again["args"]))) == (kind, str(error))


def test_an_error_of_another_kind_comes_back_as_its_nearest_kin() -> None:
    assert values_of(FileNotFoundError(2, "no such file"))["kind"] == "OSError"
    assert isinstance(error_of("OSError", [2, "no such file"]), FileNotFoundError)
    assert error_of("SystemError", []) is None


@pytest.mark.parametrize(
    ("event", "change", "problem"),
    [
        ("bytes", {"direction": "up"}, '"direction" is "up"; allowed: "sent", "received"'),
        ("bytes", {"base64": "?"}, '"base64" is not base64'),
        ("bytes", {"base64": ""}, '"base64" is empty'),
        ("bytes", {"port": 3}, '"port" is 3; it must be a text'),
        ("bytes", {"t_s": None}, '"t_s" is null; it must be a time in s'),
        ("bytes", {"t_s": 10**400}, '"t_s" is 1'),
        ("bytes", {"calls": "w"}, '"calls" is not a row of calls'),
        ("opened", {"number": -1}, '"number" is -1; it must be a whole number from 0'),
        ("raised", {"kind": "Oops"}, 'the error "Oops" cannot be raised again; allowed: DeviceError, '),
        ("raised", {"args": {}}, '"args" is a table; it must be a list of texts and whole numbers'),
        ("stage", {"event": []}, '"event" is a list; it must be a text'),
    ],
)
def test_what_is_wrong_is_said_with_its_line(
    tmp_path: Path, event: str, change: dict[str, Any], problem: str
) -> None:
    path = written(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    number = next(k for k, line in enumerate(lines) if json.loads(line)["event"] == event)
    lines[number] = json.dumps(json.loads(lines[number]) | change)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_session(tmp_path)
    assert str(refused.value).startswith(f"{path}: line {number + 1}: {problem}")


def test_nothing_may_follow_the_end(tmp_path: Path) -> None:
    path = written(tmp_path)
    with path.open("a") as log:
        log.write('{"t_s":1,"event":"stage"}\n')
    with pytest.raises(InputError, match='line 10: comes after "end"'):
        read_session(tmp_path)


@pytest.mark.parametrize("number", range(9))
def test_a_changed_a_lost_and_a_doubled_line_are_noticed_by_the_check_sum(
    tmp_path: Path, number: int
) -> None:
    path = written(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    changed = lines[number].replace('"t_s":0', '"t_s":1', 1)
    path.write_text("".join([*lines[:number], changed, *lines[number + 1 :]]), encoding="utf-8")
    assert read_session(tmp_path).changed_line == number + 1
    if 0 < number < 8:
        path.write_text("".join(lines[:number] + lines[number + 1 :]), encoding="utf-8")
        assert read_session(tmp_path).changed_line == number + 1
        path.write_text("".join(lines[: number + 1] + lines[number:]), encoding="utf-8")
        assert read_session(tmp_path).changed_line == number + 2


def read_or_refused(folder: Path) -> None:
    """A damaged log is read up to where it is whole, or refused in one line with its file and line."""
    try:
        read_session(folder)
    except InputError as error:
        said = str(error)
    else:
        return
    assert said.isprintable()
    assert re.search(r"session\.jsonl(\.zst)?: ", said)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=4,
)
FUZZ = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)


@FUZZ
@given(data=st.data())
def test_any_damage_to_bytes_is_survived(tmp_path: Path, data: st.DataObject) -> None:
    raw = bytearray(written(tmp_path).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw) - 1))
        length = data.draw(st.integers(0, 40))
        raw[at : at + length] = data.draw(st.binary(max_size=10))
        if not raw:
            break
    (tmp_path / "session.jsonl").write_bytes(raw)
    read_or_refused(tmp_path)


@FUZZ
@given(data=st.data())
def test_any_damage_to_a_packed_log_is_survived(tmp_path: Path, data: st.DataObject) -> None:
    raw = bytearray(packed_log(tmp_path).read_bytes())
    # How long it is depends on how much was ready to be packed at a time.
    at = data.draw(st.integers(0, 100_000)) % len(raw)
    raw[at : at + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=10))
    (tmp_path / "session.jsonl.zst").write_bytes(raw)
    read_or_refused(tmp_path)


def test_a_packed_log_that_was_cut_off_anywhere_is_read_up_to_there(tmp_path: Path) -> None:
    path = packed_log(tmp_path)
    raw, lines = path.read_bytes(), log_bytes(path).splitlines(keepends=True)
    for end in range(len(raw)):
        path.write_bytes(raw[:end])
        left = log_bytes(path)
        assert b"".join(lines).startswith(left)
        if not left:
            with pytest.raises(InputError, match="has no whole line"):
                read_session(tmp_path)
            continue
        assert len(read_session(tmp_path).entries) == left.count(b"\n") - 1


def test_a_log_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    """It is refused by what has been unpacked so far, line by line, and never held as a whole."""
    header = log_bytes(packed_log(tmp_path)).split(b"\n")[0] + b"\n"
    blank = header[:-2].ljust(LOG_LINE_BYTES - 2) + b"}\n"
    packer = zstandard.ZstdCompressor().compressobj()
    packed = packer.compress(header)
    packed += b"".join(packer.compress(blank) for _ in range(LOG_BYTES // len(blank)))
    packed += packer.compress(blank) + packer.flush()
    (tmp_path / "session.jsonl.zst").write_bytes(packed)
    with pytest.raises(InputError, match=r"session.jsonl.zst: holds more than 640 MB: record shorter runs"):
        read_session(tmp_path)


def test_a_line_that_does_not_end_is_refused(tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor().compress(bytes(LOG_BYTES))
    (tmp_path / "session.jsonl.zst").write_bytes(packed)
    with pytest.raises(
        InputError, match=r"session.jsonl.zst: line 1: has more than 16 MB; at most that is read"
    ):
        read_session(tmp_path)


@FUZZ
@given(data=st.data())
def test_any_value_in_any_place_and_any_line_are_survived(tmp_path: Path, data: st.DataObject) -> None:
    path = written(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    number = data.draw(st.integers(0, len(lines) - 1))
    event = json.loads(lines[number])
    event[data.draw(st.sampled_from(sorted(event)))] = data.draw(JSON)
    odd = st.sampled_from(["[" * 100_000, "1" * 5000, "NaN", "null"])
    lines[number] = data.draw(st.just(json.dumps(event)) | st.text() | JSON.map(json.dumps) | odd)
    path.write_bytes("\n".join(lines).encode("utf-8", "surrogatepass") + b"\n")
    read_or_refused(tmp_path)


def test_a_look_at_the_log_does_not_keep_a_run_from_writing_it(tmp_path: Path) -> None:
    path = packed_log(tmp_path)
    with path.open("rb") as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        threading.Timer(0.02, lambda: fcntl.flock(looking, fcntl.LOCK_UN)).start()
        packed_log(tmp_path)
        fcntl.flock(looking, fcntl.LOCK_SH)
        with pytest.raises(InputError, match="is being written by another palpate"):
            packed_log(tmp_path)
    assert len(read_session(tmp_path).entries) == 8


# ----------------------------------------------------------------------------------------------------
# What runs beside the thread that drives devices: it is done in order, and can neither stop nor delay it.


def test_items_are_consumed_in_order() -> None:
    found: list[int] = []
    background = Background(found.extend)
    for item in range(5000):
        background.put(item)
    assert background.close(10.0)
    assert found == list(range(5000))
    assert background.dropped == 0


def test_a_consumer_that_hangs_delays_nobody_and_what_is_too_much_is_counted() -> None:
    goes_on = threading.Event()
    background: Background[int] = Background(lambda _: goes_on.wait(timeout=PATIENCE_S) and None, 10)
    background.put(0)
    until(lambda: background.busy_s > 0.0)
    for item in range(100):
        background.put(item)
    assert background.dropped == 90, "the consumer hangs, and nobody waited for it"
    assert not background.close(0.01)
    goes_on.set()
    assert not background.close(10.0)


def test_the_first_failure_is_kept_and_nothing_is_told_after_it() -> None:
    called: list[str] = []

    def fail(text: str) -> None:
        called.append(text)
        raise OSError(28, "No space left on device")

    call = BackgroundCall("the display", fail)
    call("one")
    until(lambda: called)
    call("two")
    call("three")
    with pytest.raises(OutputError, match=r"the display failed.*No space left on device.*ended, torque off"):
        call.check()
    assert called == ["one"]


def test_what_fails_at_the_end_raises_nothing_and_is_reported_as_of_a_complete_run() -> None:
    goes_on = threading.Event()

    def fail() -> None:
        goes_on.wait(timeout=PATIENCE_S)
        raise OSError(28, "No space left on device")

    with BackgroundCall("the display", fail) as call:
        call()
        goes_on.set()
    assert isinstance(call.late_failure, OutputError)
    assert "the display failed" in str(call.late_failure)
    assert "the run was complete" in str(call.late_failure)
    assert "torque" not in str(call.late_failure)


def test_errors_of_the_run_go_before_those_of_its_display() -> None:
    def fail(_: str) -> None:
        raise OSError(28, "No space left on device")

    call = BackgroundCall("the display", fail)
    call("one")
    with pytest.raises(InputError, match="the run's"), call:
        raise InputError("the run's own")


class Broken:
    """A sink that raises whatever it is told."""

    def __init__(self) -> None:
        self.told = 0

    def note(self, what: RecordItem) -> None:
        del what
        self.told += 1
        raise OSError(28, "No space left on device")

    def check(self) -> None:
        """Nothing more to say."""


def test_a_recording_that_fails_stays_with_itself() -> None:
    sink = Broken()
    recorder = Recorder(VirtualClock(), sink)
    recorder.clock.now()
    recorder.clock.sleep(1.0)
    assert recorder.clock.now() == 1.0
    assert sink.told == 1
    with pytest.raises(OutputError, match="No space left on device"):
        recorder.check()
    recorder.check()  # once is enough


def log_with(folder: Path, events: int, redirect: int | None) -> SessionLog:
    """A log whose file is, after its header, something else."""
    log = SessionLog(folder, VirtualClock(), {"palpate": "0"}, stalled_s=0.2)
    until(lambda: log_bytes(log.path))  # the header goes to the file itself
    if redirect is not None:
        os.dup2(redirect, log._file.fileno())
    for number in range(events):
        log.event("stage", grip=number, stage="aiming")
    return log


def failure(log: SessionLog) -> str:
    """What `check` raises once the log's thread has met it."""

    def raised() -> str:
        try:
            log.check()
        except OutputError as error:
            return str(error)
        return ""

    return until(raised)


def test_a_full_disk_is_told_once_by_check(tmp_path: Path) -> None:
    log = log_with(tmp_path, 100, os.open("/dev/full", os.O_WRONLY))
    assert "session.jsonl.zst cannot be written: No space left on device" in failure(log)
    log.check()
    with log:
        log.event("stage", grip=0, stage="aiming")
    assert read_session(tmp_path).end is None


def test_a_disk_that_failed_last_is_told_at_the_end(tmp_path: Path) -> None:
    log = log_with(tmp_path, 1, os.open("/dev/full", os.O_WRONLY))
    with pytest.raises(OutputError, match="No space left on device"), log:
        pass


def test_a_disk_that_takes_nothing_counts_as_gone(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writer, bytes(65536))
    os.set_blocking(writer, True)
    log = log_with(tmp_path, 1, writer)
    assert "the disk has not taken it for 0.2 s" in failure(log)
    os.close(reader)
    with log:
        pass


def test_a_log_whose_queue_was_full_says_so_and_is_a_whole_beginning(tmp_path: Path) -> None:
    log = SessionLog(tmp_path, VirtualClock(), {"palpate": "0"}, capacity=3)
    for number in range(100):
        log.event("stage", grip=number, stage="aiming")
    assert re.search(r"queue of 3 lines was full.*the run was ended", failure(log))
    with log:
        log.event("stage", grip=100, stage="aiming")
    events = log_events(tmp_path / "session.jsonl.zst")
    assert [event.get("grip") for event in events] == [None, *range(len(events) - 1)]
    assert len(events) < 100


def test_lines_dropped_after_the_last_look_are_reported_at_the_end(tmp_path: Path) -> None:
    log = SessionLog(tmp_path, VirtualClock(), {"palpate": "0"}, capacity=3)
    for number in range(100):
        log.event("stage", grip=number, stage="aiming")
    with pytest.raises(OutputError, match=r"queue of 3 lines was full.*the run was complete"), log:
        pass
    assert read_session(tmp_path).end is None


def test_lines_are_on_the_disk_a_tenth_of_a_second_later(tmp_path: Path) -> None:
    """A kill loses no more; a busy computer is given longer here."""
    log = log_with(tmp_path, 3, None)
    until(lambda: _whole_lines(tmp_path) == 4)
    with log:
        pass
    assert [event["event"] for event in log_events(tmp_path / "session.jsonl.zst")] == [
        "session",
        *["stage"] * 3,
        "end",
    ]


def _whole_lines(folder: Path) -> int:
    return log_bytes(folder / "session.jsonl.zst").count(b"\n")


# ----------------------------------------------------------------------------------------------------
# Signals are held back until the host asks the outside, or has not asked for a while.


class Told(Exception):
    """What the handler of these tests raises."""


def tell(number: int, frame: object) -> None:
    del frame
    raise Told(signal.Signals(number).name)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    before = {number: signal.signal(number, tell) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_the_next_look(number: signal.Signals) -> None:
    with HeldInterrupts() as held:
        held.check()
        signal.raise_signal(number)
        signal.raise_signal(number)
        with pytest.raises(Told, match=number.name):
            held.check()
        held.check()
    assert signal.getsignal(number) is tell


def test_a_signal_that_nobody_looked_for_comes_at_the_end() -> None:
    reached: list[bool] = []

    def work() -> None:
        with HeldInterrupts():
            signal.raise_signal(signal.SIGINT)
            reached.append(True)

    with pytest.raises(Told):
        work()
    assert reached
    assert signal.getsignal(signal.SIGINT) is tell


def test_a_long_computation_is_interrupted_all_the_same() -> None:
    def compute() -> None:
        end = time.process_time() + 30.0
        signal.raise_signal(signal.SIGTERM)
        while time.process_time() < end:
            pass

    with pytest.raises(Told, match="SIGTERM"), HeldInterrupts():
        compute()


def test_a_handler_that_was_replaced_meanwhile_stays() -> None:
    with HeldInterrupts():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


# ----------------------------------------------------------------------------------------------------
# Garbage collections while fingers may move: they do not look through everything that palpate holds.


def test_what_is_there_before_fingers_move_is_not_looked_through_while_they_do() -> None:
    held = len(gc.get_objects())
    with connect(small_session().bench_rig) as hand:
        hand.prepare()
        assert len(gc.get_objects()) < held / 20, "a full collection looks at these"
    assert len(gc.get_objects()) > held / 2
    assert gc.get_freeze_count() == 0
