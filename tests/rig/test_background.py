"""What runs beside the thread that drives devices: it is done in order, and can neither stop nor delay it."""

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from command import log_bytes, log_events

from palpate.base.errors import InputError, OutputError
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.recorder import Recorder, RecordItem
from palpate.rig.session.log import SessionLog
from palpate.rig.session.log_reader import read_session
from palpate.rig.workers import Background, BackgroundCall


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
    background: Background[int] = Background(lambda _: goes_on.wait(30.0) and None, 10)
    background.put(0)
    while background.busy_s == 0.0:
        time.sleep(0.001)
    begin = time.monotonic()
    for item in range(100):
        background.put(item)
    assert time.monotonic() - begin < 1.0
    assert background.dropped == 90
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
    while not called:
        time.sleep(0.001)
    call("two")
    call("three")
    with pytest.raises(OutputError, match=r"the display failed.*No space left on device.*ended, torque off"):
        call.check()
    assert called == ["one"]


def test_what_fails_at_the_end_raises_nothing_and_is_reported_as_of_a_complete_run() -> None:
    goes_on = threading.Event()

    def fail() -> None:
        goes_on.wait(30.0)
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
    time.sleep(0.15)
    if redirect is not None:
        os.dup2(redirect, log._file.fileno())
    for number in range(events):
        log.event("stage", grip=number, stage="aiming")
    return log


def test_a_full_disk_is_told_once_by_check(tmp_path: Path) -> None:
    log = log_with(tmp_path, 100, os.open("/dev/full", os.O_WRONLY))
    time.sleep(0.2)
    with pytest.raises(OutputError, match=r"session\.jsonl\.zst cannot be written: No space left on device"):
        log.check()
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
    time.sleep(0.5)
    with pytest.raises(OutputError, match=r"the disk has not taken it for 0\.2 s"):
        log.check()
    os.close(reader)
    with log:
        pass


def test_a_log_whose_queue_was_full_says_so_and_is_a_whole_beginning(tmp_path: Path) -> None:
    log = SessionLog(tmp_path, VirtualClock(), {"palpate": "0"}, capacity=3)
    for number in range(100):
        log.event("stage", grip=number, stage="aiming")
    time.sleep(0.2)
    with pytest.raises(OutputError, match=r"queue of 3 lines was full.*the run was ended"):
        log.check()
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
    """A kill loses no more; a busy computer is given a second here."""
    log = log_with(tmp_path, 3, None)
    waited = 0
    while _whole_lines(tmp_path) < 4 and waited < 100:
        time.sleep(0.01)
        waited += 1
    assert _whole_lines(tmp_path) == 4
    with log:
        pass
    assert [event["event"] for event in log_events(tmp_path / "session.jsonl.zst")] == [
        "session",
        *["stage"] * 3,
        "end",
    ]


def _whole_lines(folder: Path) -> int:
    return log_bytes(folder / "session.jsonl.zst").count(b"\n")
