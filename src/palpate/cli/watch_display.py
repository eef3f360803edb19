"""Display of `palpate watch`: screen, lines or JSON, the keys typed, and the update loop."""

import io
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import typer
from rich.console import Console
from rich.live import Live

from palpate.base.file_io import write_text
from palpate.cli.terminal import Terminal
from palpate.config import RigFile
from palpate.config.fields import to_json
from palpate.jobs.monitor import Monitor
from palpate.rig.array_monitor import FingerView, MonitoredFinger
from palpate.views.watch_screen import WatchPicture, line_of, out_of, summary_of, watch_view

with suppress(ImportError):  # Windows has no terminals of this kind: no keys there
    import termios
    import tty

_SCREEN_INTERVAL_S = 0.05
_LINES_INTERVAL_S = 1.0
_PICTURE_COLUMNS = 80
_PICTURE_TEMPLATE = """\
<svg viewBox="-10 -25 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: "DejaVu Sans Mono", Menlo, Consolas, monospace;
font-size: {char_height}px; line-height: {line_height}px; }}
{styles}
</style>
<defs>
<clipPath id="{unique_id}-clip-terminal">
<rect width="{terminal_width}" height="{terminal_height}"/>
</clipPath>
{lines}
</defs>
<rect fill="#0c0c12" x="-10" y="-25" width="{width}" height="{height}" rx="8"/>
<g clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""


@dataclass(frozen=True, eq=False)
class WatchUpdate:
    """One update, with all that any way of showing needs."""

    rig: RigFile
    session: Path | None
    t_s: float
    doing: str
    notes: tuple[str, ...]
    views: tuple[FingerView, ...]
    keys: bool

    @property
    def picture(self) -> WatchPicture:
        """Picture of it on the screen."""
        kind = " (emulated)" if self.rig.emulated else ""
        title = f"rig {self.rig.name}{kind}" if self.session is None else f"session {self.session.name}"
        force = self.rig.closing.max_force_n
        return WatchPicture(title, self.t_s, self.doing, self.notes, self.views, force, self.keys)


@dataclass(frozen=True, eq=False)
class DisplayMode:
    """Way of showing: a screen for people on `console`, or lines on it; and JSON on stdout."""

    console: Console
    screen: bool
    json: bool

    @property
    def interval_s(self) -> float:
        """Time between two updates."""
        return _SCREEN_INTERVAL_S if self.screen or self.json else _LINES_INTERVAL_S

    def say(self, notes: Sequence[str]) -> None:
        """Say what people should know, where no screen does."""
        for note in () if self.screen else notes:
            typer.echo(note, err=True)

    def sum_up(self, shown: WatchUpdate) -> None:
        """Say at the end what every port has been through, where it is not on the screen any more."""
        if self.screen:
            for view in shown.views:
                self.console.print(summary_of(view), highlight=False, markup=False)


def choose_display(*, json: bool) -> DisplayMode:
    """A screen where a terminal can have one; beside JSON on stderr, unless stdout is a terminal too."""
    console = Terminal(stderr=json, soft_wrap=True)
    screen = console.is_terminal and not console.is_dumb_terminal
    return DisplayMode(console, screen and not (json and sys.stdout.isatty()), json)


@contextmanager
def open_display(how: DisplayMode) -> Iterator[Callable[[WatchUpdate], None]]:
    """Return what shows an update; the terminal is as it was once the block is left."""
    live = Live(console=how.console, screen=True, auto_refresh=False) if how.screen else None

    def show(shown: WatchUpdate) -> None:
        if how.json:
            session = None if shown.session is None else str(shown.session)
            typer.echo(to_json(out_of(shown.views, t_s=shown.t_s, rig=shown.rig.name, session=session)))
        if live is not None:
            width, colour = how.console.width, _has_colours(how.console)
            live.update(watch_view(shown.picture, width=width, colour=colour), refresh=True)
        elif not how.json:
            for view in shown.views:
                typer.echo(line_of(view, shown.t_s))

    if live is None:
        yield show
    else:
        with live:
            yield show


def write_picture(path: Path, shown: WatchUpdate) -> None:
    """Write an update as it looks on a dark terminal (SVG); InputError if the file cannot be written."""
    console = Console(
        record=True,
        width=_PICTURE_COLUMNS,
        file=io.StringIO(),
        force_terminal=True,
        color_system="truecolor",
        no_color=False,
        legacy_windows=False,
    )
    console.print(watch_view(shown.picture, width=_PICTURE_COLUMNS, colour=True))
    write_text(path, console.export_svg(code_format=_PICTURE_TEMPLATE, title="palpate watch"))


def discard_stdout() -> None:
    """Let nothing that is still buffered fail when the process ends: who read stdout has gone."""
    sys.stdout = io.StringIO()


def _has_colours(console: Console) -> bool:
    """True if the scale's colours can be told apart: sixteen are too few."""
    return not console.no_color and console.color_system in ("256", "truecolor")


class Keys:
    """Keys as they are typed on stdin, unechoed. A context manager that leaves the terminal as it was.

    `there` says whether anybody can type: stdin is a terminal, and this process is in its foreground.
    """

    def __init__(self) -> None:
        self._fd = _terminal()
        self._before = None if self._fd is None else termios.tcgetattr(self._fd)

    @property
    def there(self) -> bool:
        """True if keys can come."""
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
        """Return what was typed since the last call."""
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
    except (OSError, ValueError, AttributeError):  # closed, not a file at all, or of another kind of system
        return None


def show_updates(monitor: Monitor, how: DisplayMode, keys: Keys, seconds: float | None) -> WatchUpdate:
    """Show updates until the end; returns what was shown last."""
    begin = 0.0 if monitor.session is not None else monitor.clock.now()

    def seen(views: Sequence[FingerView]) -> WatchUpdate:
        return WatchUpdate(
            rig=monitor.rig,
            session=monitor.session,
            t_s=monitor.clock.now() - begin,
            doing=monitor.stage(),
            notes=monitor.notes,
            views=tuple(views),
            keys=keys.there,
        )

    last = seen(monitor.views())
    with open_display(how) as show:
        for views in monitor.updates(
            how.interval_s, seconds=seconds, goes_on=lambda: handle_keys(keys.typed(), monitor.fingers)
        ):
            last = seen(views)
            show(last)
    return last


def handle_keys(typed: str, fingers: Sequence[MonitoredFinger]) -> bool:
    """Do what was typed: t tares, r resets the counters; returns False for q."""
    for key in typed.lower():
        if key == "q":
            return False
        for finger in fingers:
            if key == "t":
                finger.tare()
            elif key == "r":
                finger.reset_counters()
    return True
