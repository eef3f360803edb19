"""Reading a session log that is damaged: one line that says where and what is allowed, never a traceback."""

import fcntl
import json
import re
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import zstandard
from command import log_bytes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from serial import SerialException

from palpate.base.errors import InputError
from palpate.base.file_io import LOG_BYTES, LOG_LINE_BYTES
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.recording import Direction, ErrorRaised, PortBytes, PortOpened, SessionEvent
from palpate.rig.session.log import KINDS, SessionLog, error_of, values_of
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.signals import Interrupted


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
FUZZ = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)


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


def test_what_is_flushed_can_be_read_while_the_log_is_written(tmp_path: Path) -> None:
    with SessionLog(tmp_path, VirtualClock(), {"seed": 7}) as log:
        for number in range(5):
            log.event("stage", grip=number, stage="aiming")
            end = time.monotonic() + 10
            while log_bytes(log.path).count(b"\n") < number + 2:
                assert time.monotonic() < end
                time.sleep(0.01)
    assert len(read_session(tmp_path).entries) == 6


def test_a_log_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    """It is refused by what has been unpacked so far, line by line, and never held as a whole."""
    header = log_bytes(packed_log(tmp_path)).split(b"\n")[0] + b"\n"
    blank = header[:-2].ljust(LOG_LINE_BYTES - 2) + b"}\n"
    packer = zstandard.ZstdCompressor().compressobj()
    packed = packer.compress(header)
    packed += b"".join(packer.compress(blank) for _ in range(LOG_BYTES // len(blank)))
    packed += packer.compress(blank) + packer.flush()
    (tmp_path / "session.jsonl.zst").write_bytes(packed)
    with pytest.raises(InputError, match=r"session.jsonl.zst: holds more than 320 MB: record shorter runs"):
        read_session(tmp_path)


def test_a_line_that_does_not_end_is_refused(tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor().compress(bytes(LOG_BYTES))
    (tmp_path / "session.jsonl.zst").write_bytes(packed)
    with pytest.raises(
        InputError, match=r"session.jsonl.zst: line 1: has more than 4 MB; at most that is read"
    ):
        read_session(tmp_path)


@FUZZ
@given(data=st.data())
def test_any_value_in_any_place_is_survived(tmp_path: Path, data: st.DataObject) -> None:
    path = written(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    number = data.draw(st.integers(0, len(lines) - 1))
    event = json.loads(lines[number])
    event[data.draw(st.sampled_from(sorted(event)))] = data.draw(JSON)
    lines[number] = json.dumps(event)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    read_or_refused(tmp_path)


@FUZZ
@given(line=st.text() | JSON.map(json.dumps) | st.sampled_from(["[" * 100_000, "1" * 5000, "NaN", "null"]))
def test_any_line_is_survived(tmp_path: Path, line: str) -> None:
    path = written(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[4] = line
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
