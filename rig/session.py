"""The session log: everything that happened, in one append-only file that survives a crash.

JSON Lines, one event a line, flushed line by line: whatever kills the process, every line but perhaps the
last is whole. Raw bytes of every port stand beside the values that were made of them, on the rig's clock. So
does all else that decides what the host does, call by call: `session_file` reads it, and `palpate replay`
runs the session again. `docs/session-log.md` lists the events.
"""

import base64
import fcntl
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recording import Direction
from palpate.errors import InputError
from palpate.rig.session_errors import values_of
from palpate.rig.session_events import SessionEvents, plain

__all__ = ["LOG_NAME", "SessionLog", "check_sum", "session_folder"]

LOG_NAME = "session.jsonl"


def session_folder(root: Path, name: str) -> Path:
    """Make the folder for a session; InputError if it cannot be made.

    A folder of that name is used again: emulated sessions are named after everything that decides them, so
    it holds the same session.
    """
    folder = root / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"session folder {folder} cannot be made: {error.strerror}; choose --sessions"
        ) from error
    return folder


def check_sum(line: str, before: int) -> int:
    """CRC-32 of a line without its check sum, going on from the sum of the line before (0 at first)."""
    return zlib.crc32(line.encode(), before)


class SessionLog(SessionEvents):
    """Writes one session's events: an observer of `identify`, and where a `Recorder` records to.

    Use as a context manager.
    """

    def __init__(self, folder: Path, clock: Clock, header: Mapping[str, object]) -> None:
        """Start the log of a session in `folder` with a header line.

        Raises InputError if it cannot be written, or if another process is writing it now.
        """
        self.path = folder / LOG_NAME
        self._clock = clock
        self._calls: list[str] = []
        self._sum = 0
        try:
            self._file = self.path.open("a", encoding="utf-8", buffering=1)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._file.truncate(0)
        except BlockingIOError as error:
            raise InputError(f"{self.path} is being written by another palpate; choose --sessions") from error
        except OSError as error:
            raise InputError(f"{self.path} cannot be written: {error.strerror}; choose --sessions") from error
        self.event("session", format="palpate/session@1", **header)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        how = "done" if error is None else type(error).__name__
        self.event("end", how=how, message=None if error is None else str(error))
        self._file.close()

    def event(self, kind: str, /, **values: object) -> None:
        """Append one event at the rig's present time."""
        line = {"t_s": round(self._clock.now(), 9), "event": kind} | {k: plain(v) for k, v in values.items()}
        self._write(json.dumps(line, separators=(",", ":"), allow_nan=False))

    def call(self, text: str) -> None:
        """Keep a call of the host for the next line: by itself it is not worth one."""
        self._calls.append(text)

    def opened(self, number: int, port: str, url: str | None) -> None:
        """Log that a port was opened."""
        self.event("opened", port=port, number=number, url=url)

    def passed(self, direction: Direction, instant: float, port: str, data: bytes) -> None:
        """Log bytes."""
        text = base64.b64encode(data).decode()
        self._write(
            f'{{"t_s":{instant:.9f},"event":"bytes","port":{json.dumps(port)},'
            f'"direction":"{direction.value}","base64":"{text}"}}'
        )

    def raised(self, during: str | None, error: BaseException) -> None:
        """Log that a call failed or the run was interrupted."""
        self.event("raised", during=during, **values_of(error))

    def _write(self, line: str) -> None:
        """Add to a line the calls before it and the check sum, and write it."""
        if self._calls:
            line = f'{line[:-1]},"calls":"{"".join(self._calls)}"}}'
            self._calls.clear()
        self._sum = check_sum(line, self._sum)
        self._file.write(f'{line[:-1]},"sum":"{self._sum:08x}"}}\n')
