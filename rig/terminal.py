"""What is said on stderr beside a result: notices, and on a terminal what goes on at the moment."""

from collections.abc import Iterable
from types import TracebackType
from typing import Self

import typer
from rich.console import Console
from rich.status import Status

__all__ = ["Doing", "print_notices"]


def print_notices(lines: Iterable[str]) -> None:
    """Tell the operator what does not stop the command, a line each."""
    for line in lines:
        typer.echo(f"notice: {line}", err=True)


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
