"""The installed command: in a process of its own, or its `main` in this one where that is enough."""

import base64
import io
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import pytest
import zstandard
from jsonschema import Draft202012Validator

from palpate.cli.main import main

_Found = TypeVar("_Found")
PALPATE = Path(sys.executable).with_name("palpate")

PATIENCE_S = 600.0
"""Upper bound of every wait for another process: it ends a deadlock, not a test on a busy computer."""


def until(holds: Callable[[], _Found], what: str = "", every_s: float = 0.02) -> _Found:
    """Wait for something true and return it; AssertionError with `what` when patience is over."""
    end = time.monotonic() + PATIENCE_S
    while not (found := holds()):
        assert time.monotonic() < end, what
        time.sleep(every_s)
    return found


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """The one JSON object on stdout; fails if there is anything else."""
        found = json.loads(self.out)
        assert isinstance(found, dict)
        assert self.out.count("\n") == 1, "one object, one line"
        return found


def run(*args: object, cwd: Path) -> Ended:
    """Run the installed command."""
    done = subprocess.run(
        [str(PALPATE), *map(str, args)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


class Started:
    """The installed command while it runs."""

    def __init__(self, words: Sequence[object], folder: Path) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [str(PALPATE), *map(str, words)],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def until(self, holds: Callable[[], _Found], what: str = "") -> _Found:
        """Wait for something true while it runs."""
        return until(lambda: self._runs() and holds(), what)

    def until_logged(self, what: bytes) -> Path:
        """Wait until its session log holds some bytes."""
        logs = lambda: self.folder.glob("palpate-sessions/*/session.jsonl.zst")  # noqa: E731
        return self.until(lambda: next((log for log in logs() if what in log_bytes(log)), None), f"{what!r}")

    def line(self) -> str:
        """The next line of its standard output."""
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def ended(self, *signals: signal.Signals) -> Ended:
        """Send signals and wait for the end."""
        for number in signals:
            self.process.send_signal(number)
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return Ended(self.process.returncode, out, err)

    def _runs(self) -> bool:
        assert self.process.poll() is None, self.process.communicate()
        return True


@contextmanager
def started(*words: object, cwd: Path) -> Iterator[Started]:
    """Start the installed command; it is killed at the end if it still runs."""
    command = Started(words, cwd)
    try:
        yield command
    finally:
        command.process.kill()
        command.process.communicate()


Here = Callable[..., Ended]
"""What the fixture `here` gives: the command in this process, in a folder of its own."""


def run_here(
    args: Sequence[object], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Ended:
    """Run the command's entry point in this process; signal handlers are put back."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    monkeypatch.setattr(sys, "argv", ["palpate", *map(str, args)])
    capsys.readouterr()
    try:
        with pytest.raises(SystemExit) as ended:
            main()
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    told = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return Ended(ended.value.code, told.out, told.err)


def log_events(path: Path) -> list[dict[str, Any]]:
    """Every event of a session log; fails on a line that cannot be read."""
    return [json.loads(line) for line in log_lines(path)]


def log_bytes(path: Path) -> bytes:
    """A session log unpacked, as far as it has been written."""
    return zstandard.ZstdDecompressor().stream_reader(io.BytesIO(path.read_bytes())).read()


def log_lines(path: Path) -> list[str]:
    """The lines of a session log, each whole."""
    text = log_bytes(path).decode()
    assert text.endswith("\n")
    return text.splitlines(keepends=True)


def write_log(path: Path, lines: Iterable[str]) -> None:
    """Pack lines as a session log."""
    path.write_bytes(zstandard.ZstdCompressor().compress("".join(lines).encode()))


def copied(session: Path, folder: Path, change: Callable[[list[str]], list[str]]) -> Path:
    """The session again, with the lines of its log changed."""
    for path in session.iterdir():
        if path.name != "session.jsonl.zst":
            (folder / path.name).write_bytes(path.read_bytes())
    write_log(folder / "session.jsonl.zst", change(log_lines(session / "session.jsonl.zst")))
    return folder


def bytes_sent(events: Iterable[dict[str, Any]], port: str | None = None) -> bytes:
    """What a log's events say was sent, to one port or to all."""
    return b"".join(
        base64.b64decode(event["base64"])
        for event in events
        if event["event"] == "bytes" and event["direction"] == "sent" and port in (None, event["port"])
    )


def torque_writes(sent: bytes) -> list[tuple[int, int]]:
    """(id, value) of every write of Torque Enable (address 64, one byte) among bytes sent to a bus."""
    write = rb"\xff\xff\xfd\x00(.)\x06\x00\x03\x40\x00(.)"
    return [(m[1][0], m[2][0]) for m in re.finditer(write, sent, re.DOTALL)]


# ----------------------------------------------------------------------------------------------------
# What a message has to say, however it is worded.


def missing(message: str, *words: object) -> list[str]:
    """Those of some words, names and values that a message does not hold."""
    return [str(word) for word in words if str(word) not in message]


def violations(value: Any, schema: Any) -> list[str]:
    """What a JSON Schema says is wrong with a value; empty if nothing is."""
    return [
        f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema).iter_errors(value)
    ]
