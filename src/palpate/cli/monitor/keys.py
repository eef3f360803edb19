"""Single keys from the terminal, without waiting for them; none where there is no terminal."""

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Self

__all__ = ["Keys"]


class Keys:
    """Keys as they are typed on stdin, unechoed. A context manager that leaves the terminal as it was.

    `there` says whether anybody can type: stdin is a terminal, and this process is in its foreground.
    """

    def __init__(self) -> None:
        self._fd = _terminal()
        self._before = None if self._fd is None else termios.tcgetattr(self._fd)

    @property
    def there(self) -> bool:
        """Whether keys can come."""
        return self._fd is not None

    def __enter__(self) -> Self:
        if self._fd is not None:
            tty.setcbreak(self._fd, termios.TCSADRAIN)  # Ctrl-C still is a signal
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._fd is not None and self._before is not None:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def typed(self) -> str:
        """What was typed since the last call."""
        if self._fd is None or not select.select([self._fd], [], [], 0)[0]:
            return ""
        data = os.read(self._fd, 64)
        if not data:  # the terminal is gone
            self._fd = None
        return data.decode("utf-8", errors="replace")


def _terminal() -> int | None:
    """The terminal on stdin if this process may read it; a background job that tries is stopped."""
    try:
        fd = sys.stdin.fileno()
        return fd if os.isatty(fd) and os.tcgetpgrp(fd) == os.getpgrp() else None
    except (OSError, ValueError, AttributeError):  # closed, or not a file at all
        return None
