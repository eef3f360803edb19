"""The live view beside a run: a process of its own, so that nothing it does can slow the run."""

import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Self

__all__ = ["ViewProcess"]


class ViewProcess:
    """Shows a run's session until this process ends. Use as a context manager."""

    def __init__(self, port: int | None) -> None:
        """None: shows nothing."""
        self._port = port
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def begin(self, session: Path) -> None:
        """Start showing the session that this process records; it says its address on stderr."""
        if self._port is None:
            return
        words = ["view", str(session), "--port", str(self._port), "--run", str(os.getpid())]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "palpate", *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the run
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave it: it ends with this process, once the page has the last frame and a stop is confirmed."""
