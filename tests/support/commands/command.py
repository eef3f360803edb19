"""The installed command: in a process of its own, or its `main` in this one where that is enough."""

import io
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zstandard

from palpate.cli.main import main

PALPATE = Path(sys.executable).with_name("palpate")


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


def run(*args: object, cwd: Path, timeout_s: float = 120.0) -> Ended:
    """Run the installed command."""
    done = subprocess.run(
        [str(PALPATE), *map(str, args)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


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


def torque_writes(sent: bytes) -> list[tuple[int, int]]:
    """(id, value) of every write of Torque Enable (address 64, one byte) among bytes sent to a bus."""
    write = rb"\xff\xff\xfd\x00(.)\x06\x00\x03\x40\x00(.)"
    return [(m[1][0], m[2][0]) for m in re.finditer(write, sent, re.DOTALL)]


# ----------------------------------------------------------------------------------------------------
# What a message has to say, however it is worded.


def missing(message: str, *words: object) -> list[str]:
    """Those of some words, names and values that a message does not hold."""
    return [str(word) for word in words if str(word) not in message]
