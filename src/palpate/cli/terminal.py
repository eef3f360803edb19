"""The terminal as commands write on it: escaped text, notices, and what goes on at the moment."""

import sys
import time
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Self

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.status import Status

from palpate.base.errors import InputError, printable
from palpate.cli.time_left import TimeLeft

__all__ = ["Doing", "Terminal", "can_ask", "check_can_ask", "print_notices"]


class Terminal(Console):
    """A console on which nothing that comes from devices or files can act on the terminal: it is escaped.

    Into a file or a pipe lines go without the blanks that fill up a table's columns at their end.
    """

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """What rich makes of something, without control characters but its own."""
        rendered = map(_safe, super().render(renderable, options))
        return rendered if self.is_terminal else _stripped(rendered)


def _safe(segment: Segment) -> Segment:
    if segment.control or segment.text.isprintable():
        return segment
    return segment._replace(text="\n".join(map(printable, segment.text.split("\n"))))


def _stripped(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Segments without blanks before the end of a line; those that no end of a line follows stay."""
    blanks: list[Segment] = []
    for segment in segments:
        for part in segment.text.splitlines(keepends=True):
            line = part.rstrip("\n")
            text = line.rstrip(" ")
            if text:
                yield from blanks
                blanks = []
                yield segment._replace(text=text)
            if line != part:
                blanks = []
                yield Segment.line()
            elif text != line:
                blanks.append(segment._replace(text=line[len(text) :]))
    yield from blanks


def can_ask() -> bool:
    """Whether somebody can be asked: standard input is a terminal."""
    return sys.stdin.isatty()


def check_can_ask(why: str, instead: str) -> None:
    """Raise InputError if nobody can be asked: `why` somebody has to be, and what to do `instead`."""
    if not can_ask():
        raise InputError(f"{why}, and there is no terminal to ask on: {instead}")


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
