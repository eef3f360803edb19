"""The terminal as commands write on it: escaped text, notices, and what goes on at the moment."""

import time
from collections.abc import Iterable
from types import TracebackType
from typing import Self

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.status import Status

from palpate.cli.time_left import TimeLeft
from palpate.errors import printable

__all__ = ["Doing", "Terminal", "print_notices"]


class Terminal(Console):
    """A console on which nothing that comes from devices or files can act on the terminal: it is escaped."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """What rich makes of something, without control characters but its own."""
        for segment in super().render(renderable, options):
            safe = segment.control or segment.text.isprintable()
            yield segment if safe else segment._replace(text=_safe(segment.text))


def _safe(text: str) -> str:
    return "\n".join(map(printable, text.split("\n")))


def print_notices(lines: Iterable[str]) -> None:
    """Tell the operator what does not stop the command, a line each."""
    for line in lines:
        typer.echo(f"notice: {printable(line)}", err=True)


class Doing:
    """A moving line on a terminal while something is done. Use as a context manager.

    `written_every_s`: into a file or a pipe a line is written so often; never, if it is None.
    """

    def __init__(self, console: Console, what: str, written_every_s: float | None = None) -> None:
        self._left = TimeLeft()
        self._console, self._every_s, self._written_s = console, written_every_s, time.monotonic()
        self._status: Status | None = console.status(escape(what)) if console.is_terminal else None

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
        """Say what is done now; how much time is left stands after a count such as "3 of 40"."""
        words = self._left.after(what)
        if self._status is not None:
            self._status.update(escape(words))
        elif self._every_s is not None and time.monotonic() - self._written_s >= self._every_s:
            self._written_s = time.monotonic()
            self._console.print(escape(words), soft_wrap=True)
