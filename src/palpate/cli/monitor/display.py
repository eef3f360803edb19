"""How what is watched is shown: on a screen, in lines, or as JSON. The end of the data's way."""

import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import typer
from rich.console import Console
from rich.live import Live

from palpate.base.files.writing import write_text
from palpate.cli.terminal import Terminal
from palpate.config import RigFile
from palpate.config.results import to_json
from palpate.rig.monitor.finger_monitor import FingerView
from palpate.views.monitor.lines import line_of, out_of, summary_of
from palpate.views.monitor.screen import WatchPicture, watch_view

__all__ = ["How", "Shown", "forget_stdout", "how_to_show", "shown_on", "write_picture"]

_SCREEN_S = 0.05
_LINES_S = 1.0
_PICTURE_WIDTH = 80
_PICTURE = """\
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
class Shown:
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
        """What the screen shows of it."""
        kind = " (emulated)" if self.rig.emulated else ""
        title = f"rig {self.rig.name}{kind}" if self.session is None else f"session {self.session.name}"
        force = self.rig.closing.max_force_n
        return WatchPicture(title, self.t_s, self.doing, self.notes, self.views, force, self.keys)


@dataclass(frozen=True, eq=False)
class How:
    """How to show: a screen for people on `console`, or lines on it; and JSON on stdout."""

    console: Console
    screen: bool
    json: bool

    @property
    def interval_s(self) -> float:
        """Time between two updates."""
        return _SCREEN_S if self.screen or self.json else _LINES_S

    def say(self, notes: Sequence[str]) -> None:
        """Say what people should know, where no screen does."""
        for note in () if self.screen else notes:
            typer.echo(note, err=True)

    def sum_up(self, shown: Shown) -> None:
        """Say at the end what every port has been through, where it is not on the screen any more."""
        if self.screen:
            for view in shown.views:
                self.console.print(summary_of(view), highlight=False, markup=False)


def how_to_show(*, json: bool) -> How:
    """A screen where a terminal can have one; beside JSON on stderr, unless stdout is a terminal too."""
    console = Terminal(stderr=json, soft_wrap=True)
    screen = console.is_terminal and not console.is_dumb_terminal
    return How(console, screen and not (json and sys.stdout.isatty()), json)


@contextmanager
def shown_on(how: How) -> Iterator[Callable[[Shown], None]]:
    """What shows an update; the terminal is as it was once the block is left."""
    live = Live(console=how.console, screen=True, auto_refresh=False) if how.screen else None

    def show(shown: Shown) -> None:
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


def write_picture(path: Path, shown: Shown) -> None:
    """Write an update as it looks on a dark terminal (SVG); InputError if the file cannot be written."""
    console = Console(
        record=True,
        width=_PICTURE_WIDTH,
        file=io.StringIO(),
        force_terminal=True,
        color_system="truecolor",
        no_color=False,
        legacy_windows=False,
    )
    console.print(watch_view(shown.picture, width=_PICTURE_WIDTH, colour=True))
    write_text(path, console.export_svg(code_format=_PICTURE, title="palpate watch"))


def forget_stdout() -> None:
    """Let nothing that is still buffered fail when the process ends: who read stdout has gone."""
    sys.stdout = io.StringIO()


def _has_colours(console: Console) -> bool:
    """Whether the scale's colours can be told apart: sixteen are too few."""
    return not console.no_color and console.color_system in ("256", "truecolor")
