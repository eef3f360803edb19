"""Saying on a terminal what goes on at the moment; nothing where there is none. For slow commands."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.status import Status

__all__ = ["Doing"]


class Doing:
    """A moving line on a terminal while something is done. Use as a context manager."""

    def __init__(self, console: Console, what: str) -> None:
        self._status: Status | None = console.status(what) if console.is_terminal else None

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

    def now(self, what: str) -> None:
        """Say what is done now."""
        if self._status is not None:
            self._status.update(what)
