"""The screen of `palpate watch` as a function of what is to be seen: from `FingerView`s to rich.

Fingers stand side by side as far as the width allows, each with its map, contact, force and counts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from palpate.drivers.tactile.contact import ContactPatch
from palpate.drivers.tactile.messages import Description, Shape
from palpate.rig.monitor.finger_monitor import FingerView, TareState
from palpate.views.monitor.lines import age_words, flag_words, place_words, taxel_words
from palpate.views.monitor.taxel_map import Scale, legend, map_rows, marks_legend, scale_of, step_of

__all__ = ["WatchPicture", "watch_view"]

_LEAST_WIDTH = 25  # of a finger: "lost 0 faults 0 dropped 0"
_HEIGHTS = 5  # what heights take beside a map
_GAP = 2
_MOST_ROWS = 24
_EIGHTHS = " ▏▎▍▌▋▊▉█"


@dataclass(frozen=True, eq=False)
class WatchPicture:
    """All that the screen shows. `title`: of which rig, `notes`: for the operator.

    `full_force_n` is the end of the force's bar; `keys`: the keyboard is read.
    """

    title: str
    t_s: float
    doing: str
    notes: tuple[str, ...]
    fingers: tuple[FingerView, ...]
    full_force_n: float
    keys: bool = False


def watch_view(picture: WatchPicture, *, width: int, colour: bool) -> RenderableType:
    """The screen, `width` characters wide; without `colour`, in characters alone."""
    scale = scale_of(max((view.description.full_scale_n for view in picture.fingers), default=1.0))
    panel, cell = _sizes(picture.fingers, width)
    across = max(1, (width + _GAP) // (panel + _GAP))
    parts: list[RenderableType] = [_head(picture, width), Text()]
    for start in range(0, len(picture.fingers), across):
        table = Table.grid(padding=(0, _GAP, 0, 0))
        row = picture.fingers[start : start + across]
        for _ in row:
            table.add_column(width=panel)
        table.add_row(
            *(_finger(view, scale, panel, cell, picture.full_force_n, colour=colour) for view in row)
        )
        parts += [table, Text()]
    return Group(*parts, *_foot(picture, scale, colour=colour))


def _sizes(fingers: Sequence[FingerView], width: int) -> tuple[int, int]:
    """Width of a finger, and of a taxel in it: 2 characters if as many fingers fit in a row then."""
    columns = max((view.description.cols for view in fingers), default=1)
    narrow = min(max(columns + _HEIGHTS, _LEAST_WIDTH), width)
    wide = max(2 * columns + _HEIGHTS, _LEAST_WIDTH)
    wanted = min(len(fingers), (width + _GAP) // (narrow + _GAP))
    return (wide, 2) if wanted * (wide + _GAP) - _GAP <= width else (narrow, 1)


def _head(picture: WatchPicture, width: int) -> RenderableType:
    left = Text(picture.title, style="bold", overflow="ellipsis", no_wrap=True)
    left.append(f"  {picture.t_s:.2f} s", style="not bold")
    if picture.doing:
        left.append(f"  {picture.doing}", style="not bold")
    keys = Text("q end  t tare  r reset counts" if picture.keys else "", style="dim", no_wrap=True)
    lines: list[RenderableType] = []
    if cell_len(left.plain) + 2 + cell_len(keys.plain) <= width:
        left.append(" " * (width - cell_len(left.plain) - cell_len(keys.plain)))
        lines.append(left.append_text(keys))
    else:
        lines += [left, keys]
    return Group(*lines, *(Text(note, style="dim") for note in picture.notes))


def _finger(
    view: FingerView, scale: Scale, width: int, cell: int, full_force_n: float, *, colour: bool
) -> RenderableType:
    d = view.description
    step = step_of(d.rows, d.cols, width // cell, _MOST_ROWS)
    rows = map_rows(view, scale, cell=cell, step=step, colour=colour)
    if width - len(rows[0]) >= _HEIGHTS:
        rows[0].append(f" {d.row_heights_mm[-1]:.0f}", style="dim")
        rows[-1].append(f" {d.row_heights_mm[0]:.0f} mm", style="dim")
    lines = [
        _name_line(view, width),
        *rows,
        _range_line(view.patch, d, cell, step),
        _axis_line(d, cell, step),
        *_felt_lines(view, width, full_force_n),
        *_count_lines(view),
        *_remarks(view, step),
    ]
    return Group(*lines)


def _name_line(view: FingerView, width: int) -> Text:
    """The finger's name and how it is, in a word."""
    word, style = _state(view)
    text = Text(view.name, style="bold", no_wrap=True, overflow="ellipsis")
    gap = max(1, width - cell_len(view.name) - cell_len(word))
    return text.append(" " * gap).append(word, style=f"not bold {style}")


def _state(view: FingerView) -> tuple[str, str]:
    if view.counts is None or view.silent:
        return "no frames", "yellow"
    if view.tare is not TareState.DONE:
        return view.tare.value, "yellow"
    return ("● touched", "bold green") if view.patch is not None else ("○ free", "dim")


def _range_line(patch: ContactPatch | None, d: Description, cell: int, step: int) -> Text:
    """Beneath the map: the columns that the contact's normals point through."""
    if patch is None or d.shape is Shape.FLAT or d.cols < 2:
        return Text()
    ends = [patch.angle_rad + sign * patch.angle_half_range_rad for sign in (-1, 0, 1)]
    width = math.ceil(d.cols / step) * cell
    low, middle, high = (_character(angle, d, cell, step) for angle in ends)
    line = [" "] * width
    for k in range(max(low, 0), min(high, width - 1) + 1):
        line[k] = "─"
    for k, sign in ((low, "├"), (high, "┤"), (middle, "┼" if high > low else "│")):
        if 0 <= k < width:
            line[k] = sign
    return Text("".join(line), style="bold green", no_wrap=True)


def _character(angle_rad: float, d: Description, cell: int, step: int) -> int:
    """Which character of a map's row an angle falls in; may be outside of it."""
    pitch = (d.columns[-1] - d.columns[0]) / (d.cols - 1)
    return math.floor(((angle_rad - d.columns[0]) / pitch + 0.5) / step * cell)


def _axis_line(d: Description, cell: int, step: int) -> Text:
    """The outermost columns' places, and the middle between them."""
    unit = (lambda value: f"{value:.0f} mm") if d.shape is Shape.FLAT else _degrees
    width = math.ceil(d.cols / step) * cell
    left, right = unit(d.columns[0]), unit(d.columns[-1])
    middle = unit((d.columns[0] + d.columns[-1]) / 2)
    room = width - len(left) - len(right)
    between = middle.center(room) if room >= len(middle) + 2 else " " * max(1, room)
    return Text(f"{left}{between}{right}", style="dim", no_wrap=True)


def _degrees(angle_rad: float) -> str:
    return f"{np.degrees(angle_rad):+.0f}°" if abs(angle_rad) > 1e-9 else "0°"


def _felt_lines(view: FingerView, width: int, full_force_n: float) -> list[Text]:
    """Force with its bar, where the contact is; always four lines, so that nothing jumps."""
    patch, force = view.patch, view.force_n
    if force is None:
        return [Text(f"force  – ({_state(view)[0]})"), _bar(0.0, width, full_force_n), Text(), Text()]
    if patch is None:
        return [Text(f"force  {force:.3f} N"), _bar(force, width, full_force_n), Text(), Text()]
    bound = f"± {patch.force_bound_n:.2f} N" if math.isfinite(patch.force_bound_n) else "N or more"
    return [
        Text.assemble("force  ", (f"{patch.force_n:.3f}", "bold"), f" {bound}"),
        _bar(patch.force_n, width, full_force_n),
        Text.assemble("at     ", (place_words(patch, view.description.shape), "bold")),
        Text(f"height {patch.height_mm:.1f} ± {patch.height_bound_mm:.1f} mm"),
    ]


def _bar(force_n: float, width: int, full_n: float) -> Text:
    """A bar from 0 to the force that a finger of this rig may press with."""
    end = f" {full_n:g} N"
    room = width - len(end) - 2
    eighths = round(max(0.0, min(1.0, force_n / full_n)) * room * 8)
    bar = "█" * (eighths // 8) + (_EIGHTHS[eighths % 8] if eighths % 8 else "")
    style = "bold red" if force_n >= full_n else "green"
    return Text.assemble("▕", (bar.ljust(room), style), "▏", (end, "dim"), no_wrap=True)


def _count_lines(view: FingerView) -> list[Text]:
    c = view.counters
    rate = Text(f"{view.rate_hz:.1f} frames/s")
    rate.append(f"  age {age_words(view.age_s)}", style="bold yellow" if view.silent else "")
    wrong = Text()
    for name, count in (("lost", c.lost), ("faults", c.faults), ("dropped", c.dropped)):
        wrong.append(f"{name} {count} ", style="bold yellow" if count else "dim")
    if c.misshapen:
        wrong.append(f"misshapen {c.misshapen}", style="bold yellow")
    return [rate, wrong]


def _remarks(view: FingerView, step: int) -> list[Text]:
    taxels = taxel_words(view)
    lines = [f"taxels: {taxels}"] if taxels else []
    if step > 1:
        lines.append(f"a cell is the strongest of {step} x {step} taxels")
    flags = [] if view.patch is None else flag_words(view.patch)
    return [Text(line, style="yellow") for line in (*lines, *flags)]


def _foot(picture: WatchPicture, scale: Scale, *, colour: bool) -> list[RenderableType]:
    def anywhere(name: str) -> bool:
        return any(getattr(view, name).any() for view in picture.fingers)

    signs = marks_legend(
        dead=anywhere("dead"), hot=anywhere("hot"), saturated=anywhere("saturated"), colour=colour
    )
    return [legend(scale, colour=colour), *([signs] if signs.plain else [])]
