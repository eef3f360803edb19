"""Watched fingers on a terminal: a screen with taxel maps, or lines, or JSON."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.cells import cell_len
from rich.color import Color
from rich.console import Group, RenderableType
from rich.style import Style
from rich.table import Table
from rich.text import Text

from palpate.base.errors import quantity
from palpate.base.geometry import Bools
from palpate.config.session_results import PatchOut, WatchedFingerOut, WatchOut
from palpate.drivers.tactile import ArrayCounters, ContactPatch, Description, Shape
from palpate.rig.array_monitor import FingerView, TareState


def line_of(view: FingerView, t_s: float) -> str:
    """One line about a finger, for where there is no screen."""
    state = view.tare.value
    if view.counts is None or view.silent:
        state = "no frames"
    elif view.tare is TareState.DONE:
        state = _contact_words(view)
    return (
        f"{t_s:8.2f} s  {view.name}  {state}; {view.rate_hz:.1f} frames/s, "
        f"the last {_age_words(view.age_s)} ago; {_counter_words(view.counters)}"
    )


def summary_of(view: FingerView) -> str:
    """Say what a finger's port has been through, at the end."""
    frames = quantity(view.counters.frames, "frame", "frames")
    return f"{view.name}: {frames}, {_counter_words(view.counters)}"


def _place_words(patch: ContactPatch, shape: Shape) -> str:
    """Say where round the tip a contact is; of a flat array that is not known."""
    if shape is Shape.FLAT:
        return "direction not known: flat array"
    if patch.angle_half_range_rad >= math.pi:
        return "direction not known"
    angle, half = math.degrees(patch.angle_rad), math.degrees(patch.angle_half_range_rad)
    return f"{angle:+.1f}° ± {half:.1f}°"


def _height_words(patch: ContactPatch) -> str:
    """Say how high on the tip a contact is."""
    if math.isnan(patch.height_mm):
        return "height not known"
    return f"height {patch.height_mm:.1f} ± {patch.height_bound_mm:.1f} mm"


def _flag_words(patch: ContactPatch) -> list[str]:
    """Say what the bounds had to allow for."""
    return sorted(flag.value for flag in patch.flags)


def _taxel_words(view: FingerView) -> str:
    """Say how many taxels are not to be trusted; "" if all are."""
    kinds = (
        ("dead", view.dead),
        ("hot", view.hot),
        ("at its largest count", view.saturated & ~view.hot),
    )
    counts = ((name, int(mask.sum())) for name, mask in kinds)
    return ", ".join(f"{count} {name}" for name, count in counts if count)


def _age_words(age_s: float) -> str:
    """A time since, short."""
    return f"{age_s * 1e3:.0f} ms" if age_s < 1 else f"{age_s:.1f} s"


def out_of(views: Sequence[FingerView], *, t_s: float, rig: str, session: str | None) -> WatchOut:
    """One update as a result."""
    fingers = tuple(_finger_out(view) for view in views)
    return WatchOut(t_s=t_s, rig=rig, session=session, fingers=fingers)


def _contact_words(view: FingerView) -> str:
    patch = view.patch
    if patch is None:
        return f"{view.force_n or 0:.3f} N, nothing touched"
    words = [
        f"{patch.force_n:.3f} N",
        f"touched at {_place_words(patch, view.description.shape)}",
        *([] if math.isnan(patch.height_mm) else [_height_words(patch)]),
        *_flag_words(patch),
    ]
    return ", ".join(words)


def _counter_words(counters: ArrayCounters) -> str:
    words = f"lost {counters.lost}, faults {counters.faults}, dropped {counters.dropped}"
    return f"{words}, misshapen {counters.misshapen}" if counters.misshapen else words


def _finger_out(view: FingerView) -> WatchedFingerOut:
    return WatchedFingerOut.of(
        view.counters,
        finger=view.name,
        port=view.port,
        rows=view.description.rows,
        columns=view.description.cols,
        tared=view.tare is TareState.DONE,
        rate_hz=view.rate_hz,
        age_s=view.age_s,
        force_n=view.force_n,
        contact=None if view.patch is None else _patch_out(view.patch),
        dead=_places(view.dead),
        hot=_places(view.hot),
        saturated=_places(view.saturated),
        counts=None if view.counts is None else tuple(tuple(row) for row in view.counts.tolist()),
    )


def _patch_out(patch: ContactPatch) -> PatchOut:
    return PatchOut.of(
        patch,
        centroid_rad=patch.centroid_rad if math.isfinite(patch.centroid_rad) else None,
        force_bound_n=patch.force_bound_n if math.isfinite(patch.force_bound_n) else None,
        flags=tuple(_flag_words(patch)),
    )


def _places(mask: Bools) -> tuple[tuple[int, int], ...]:
    return tuple((int(row), int(column)) for row, column in np.argwhere(mask))


_COLOUR_STEPS = 10
_SIGNS = " .:-=+*o#%@"  # nothing, then the steps
# Black, purple, red, orange, yellow: brightness grows evenly, so that it reads without seeing colours.
_RAMP = (
    "#16161d",
    "#30115e",
    "#4d0f6b",
    "#741b6e",
    "#992766",
    "#bd3853",
    "#dc5039",
    "#f17520",
    "#fca108",
    "#f8d03f",
    "#fcfda8",
)
_DEAD, _HOT, _SATURATED = "×", "!", "▲"
_UNTRUSTED = Style(color="#ffffff", bgcolor="#4a5a6a", bold=True)
_FULL = Style(color="#000000", bgcolor=_RAMP[-1], bold=True)


@dataclass(frozen=True)
class Scale:
    """Steps of a scale: where each begins, N, ascending."""

    starts_n: tuple[float, ...]


def scale_of(full_scale_n: float) -> Scale:
    """The scale for arrays whose taxels reach up to `full_scale_n`."""
    starts: list[float] = []
    decade = math.floor(math.log10(full_scale_n / 2))
    while len(starts) < _COLOUR_STEPS:
        found = (digit * 10.0**decade for digit in (5, 2, 1))
        starts += [start for start in found if start <= full_scale_n / 2 * (1 + 1e-9)]
        decade -= 1
    return Scale(tuple(reversed(starts[:_COLOUR_STEPS])))


def _map_rows(view: FingerView, scale: Scale, *, cell: int, step: int, colour: bool) -> list[Text]:
    """The rows of the map, highest taxels on top, `cell` characters for each taxel.

    With `step` > 1 a cell is the strongest of step x step taxels.
    """
    steps = _pool(np.digitize(view.taxel_n, scale.starts_n), step)
    marks = np.full(view.taxel_n.shape, 0)
    for code, mask in ((1, view.saturated), (2, view.dead), (3, view.hot)):
        marks[mask] = code
    marks = _pool(marks, step)
    rows = zip(steps[::-1].tolist(), marks[::-1].tolist(), strict=True)
    return [_map_row(values, signs, cell, colour=colour) for values, signs in rows]


def _step_of(rows: int, columns: int, width: int, height: int) -> int:
    """Number of taxels, either way, that must share a cell so that a map fits."""
    return max(1, math.ceil(columns / width), math.ceil(rows / height))


def legend(scale: Scale, *, colour: bool) -> Text:
    """The scale: where each step begins, in mN."""
    text = Text("taxel ≥ ", no_wrap=False)
    for k, start in enumerate(scale.starts_n, start=1):
        number = f"{start * 1e3:g}"
        if colour:
            text.append(f" {number} ", _style(k))
        else:
            text.append(f" {_SIGNS[k]} {number}")
    text.append(" mN")
    return text


def _marks_legend(*, dead: bool, hot: bool, saturated: bool, colour: bool) -> Text:
    """Say what the signs mean, those that are on the maps; "" if there are none."""
    text = Text()
    kinds = ((dead, _DEAD, "dead", _UNTRUSTED), (hot, _HOT, "hot", _UNTRUSTED))
    for there, sign, words, style in (*kinds, (saturated, _SATURATED, "at its largest count", _FULL)):
        if there:
            text.append(sign, style if colour else "")
            text.append(f" {words}   ")
    return text


def _map_row(values: list[int], marks: list[int], cell: int, *, colour: bool) -> Text:
    """One row; neighbours that look alike are one piece, which is quicker to draw."""
    text = Text(no_wrap=True)
    start = 0
    pairs = list(zip(values, marks, strict=True))
    for k in range(1, len(pairs) + 1):
        if k < len(pairs) and pairs[k] == pairs[start]:
            continue
        value, mark = pairs[start]
        sign = ("", _SATURATED, _DEAD, _HOT)[mark] or ("" if colour else _SIGNS[value])
        style = (Style(), _FULL, _UNTRUSTED, _UNTRUSTED)[mark] if mark else _style(value)
        # A sign stands in one character of a wide cell; the steps' characters fill it.
        one = sign.ljust(cell) if mark or colour else sign * cell
        text.append(one * (k - start), style if colour else None)
        start = k
    return text


def _style(step: int) -> Style:
    dark = step < 7
    return Style(color="#ffffff" if dark else "#000000", bgcolor=Color.parse(_RAMP[step]).name)


def _pool(values: NDArray[np.int_], step: int) -> NDArray[np.int_]:
    """The largest of each step x step block."""
    if step == 1:
        return values
    rows, columns = (math.ceil(size / step) * step for size in values.shape)
    padded = np.zeros((rows, columns), dtype=values.dtype)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(rows // step, step, columns // step, step)
    largest: NDArray[np.int_] = blocks.max(axis=(1, 3))
    return largest


_MIN_FINGER_COLUMNS = 25  # of a finger: "lost 0 faults 0 dropped 0"
_HEIGHTS_COLUMNS = 5  # what heights take beside a map
_GAP = 2
_MAX_MAP_ROWS = 24
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
    narrow = min(max(columns + _HEIGHTS_COLUMNS, _MIN_FINGER_COLUMNS), width)
    wide = max(2 * columns + _HEIGHTS_COLUMNS, _MIN_FINGER_COLUMNS)
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
    step = _step_of(d.rows, d.cols, width // cell, _MAX_MAP_ROWS)
    rows = _map_rows(view, scale, cell=cell, step=step, colour=colour)
    if d.row_heights_mm and width - len(rows[0]) >= _HEIGHTS_COLUMNS:
        rows[0].append(f" {d.row_heights_mm[-1]:.0f}", style="dim")
        rows[-1].append(f" {d.row_heights_mm[0]:.0f} mm", style="dim")
    lines = [
        _name_line(view, width),
        *(rows if d.taxels > 1 else ()),  # a contact source has no map
        _range_line(view.patch, d, cell, step),
        _axis_line(d, cell, step),
        *_force_lines(view, width, full_force_n),
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
    if patch is None or d.shape is not Shape.CYLINDER or d.cols < 2:
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
    """Return which character of a map's row an angle falls in; may be outside of it."""
    pitch = (d.columns[-1] - d.columns[0]) / (d.cols - 1)
    return math.floor(((angle_rad - d.columns[0]) / pitch + 0.5) / step * cell)


def _axis_line(d: Description, cell: int, step: int) -> Text:
    """The outermost columns' places, and the middle between them; nothing where they have none."""
    if not d.columns:
        return Text()
    unit = (lambda value: f"{value:.0f} mm") if d.shape is Shape.FLAT else _degrees
    width = math.ceil(d.cols / step) * cell
    left, right = unit(d.columns[0]), unit(d.columns[-1])
    middle = unit((d.columns[0] + d.columns[-1]) / 2)
    room = width - len(left) - len(right)
    between = middle.center(room) if room >= len(middle) + 2 else " " * max(1, room)
    return Text(f"{left}{between}{right}", style="dim", no_wrap=True)


def _degrees(angle_rad: float) -> str:
    return f"{np.degrees(angle_rad):+.0f}°" if abs(angle_rad) > 1e-9 else "0°"


def _force_lines(view: FingerView, width: int, full_force_n: float) -> list[Text]:
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
        Text.assemble("at     ", (_place_words(patch, view.description.shape), "bold")),
        Text(_height_words(patch)),
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
    rate.append(f"  age {_age_words(view.age_s)}", style="bold yellow" if view.silent else "")
    wrong = Text()
    for name, count in (("lost", c.lost), ("faults", c.faults), ("dropped", c.dropped)):
        wrong.append(f"{name} {count} ", style="bold yellow" if count else "dim")
    if c.misshapen:
        wrong.append(f"misshapen {c.misshapen}", style="bold yellow")
    return [rate, wrong]


def _remarks(view: FingerView, step: int) -> list[Text]:
    taxels = _taxel_words(view)
    lines = [f"taxels: {taxels}"] if taxels else []
    if step > 1:
        lines.append(f"a cell is the strongest of {step} x {step} taxels")
    flags = [] if view.patch is None else _flag_words(view.patch)
    return [Text(line, style="yellow") for line in (*lines, *flags)]


def _foot(picture: WatchPicture, scale: Scale, *, colour: bool) -> list[RenderableType]:
    def anywhere(name: str) -> bool:
        return any(getattr(view, name).any() for view in picture.fingers)

    signs = _marks_legend(
        dead=anywhere("dead"), hot=anywhere("hot"), saturated=anywhere("saturated"), colour=colour
    )
    return [legend(scale, colour=colour), *([signs] if signs.plain else [])]
