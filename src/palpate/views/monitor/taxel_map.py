"""Taxel maps on the terminal: forces as characters and colours.

The scale has ten steps, 1-2-5, of which the top one begins at half the array's full scale or below: taxels of
one touch differ by a factor of a hundred. Where there is no colour the steps are characters. Taxels that
cannot be trusted have a sign of their own on both.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.color import Color
from rich.style import Style
from rich.text import Text

from palpate.rig.monitor.finger_monitor import FingerView

__all__ = ["Scale", "legend", "map_rows", "scale_of", "step_of"]

_STEPS = 10
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
    """Where each step begins, N, ascending."""

    starts_n: tuple[float, ...]


def scale_of(full_scale_n: float) -> Scale:
    """The scale for arrays whose taxels reach up to `full_scale_n`."""
    starts: list[float] = []
    decade = math.floor(math.log10(full_scale_n / 2))
    while len(starts) < _STEPS:
        found = (digit * 10.0**decade for digit in (5, 2, 1))
        starts += [start for start in found if start <= full_scale_n / 2 * (1 + 1e-9)]
        decade -= 1
    return Scale(tuple(reversed(starts[:_STEPS])))


def map_rows(view: FingerView, scale: Scale, *, cell: int, step: int, colour: bool) -> list[Text]:
    """The rows of the map, highest taxels on top, `cell` characters for each taxel.

    With `step` > 1 a cell is the strongest of step x step taxels.
    """
    steps = _pooled(np.digitize(view.taxel_n, scale.starts_n), step)
    marks = np.full(view.taxel_n.shape, 0)
    for code, mask in ((1, view.saturated), (2, view.dead), (3, view.hot)):
        marks[mask] = code
    marks = _pooled(marks, step)
    rows = zip(steps[::-1].tolist(), marks[::-1].tolist(), strict=True)
    return [_row(values, signs, cell, colour=colour) for values, signs in rows]


def step_of(rows: int, columns: int, width: int, height: int) -> int:
    """How many taxels either way must share a cell so that a map fits."""
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


def marks_legend(*, dead: bool, hot: bool, saturated: bool, colour: bool) -> Text:
    """What the signs mean, those that are on the maps; "" if there are none."""
    text = Text()
    kinds = ((dead, _DEAD, "dead", _UNTRUSTED), (hot, _HOT, "hot", _UNTRUSTED))
    for there, sign, words, style in (*kinds, (saturated, _SATURATED, "at its largest count", _FULL)):
        if there:
            text.append(sign, style if colour else "")
            text.append(f" {words}   ")
    return text


def _row(values: list[int], marks: list[int], cell: int, *, colour: bool) -> Text:
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


def _pooled(values: NDArray[np.int_], step: int) -> NDArray[np.int_]:
    """The largest of each step x step block."""
    if step == 1:
        return values
    rows, columns = (math.ceil(size / step) * step for size in values.shape)
    padded = np.zeros((rows, columns), dtype=values.dtype)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(rows // step, step, columns // step, step)
    largest: NDArray[np.int_] = blocks.max(axis=(1, 3))
    return largest
