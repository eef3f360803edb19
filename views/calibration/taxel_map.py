"""The taxel map of a calibration: gains of an array as colours, and what is unusable or was never pressed.

Part of the calibration report. The array is shown unrolled and seen from outside, row 0, the lowest, below.
"""

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from palpate.views.calibration.values import MEASURED, NEVER_PRESSED, TaxelMap
from palpate.views.scene.marks import heading
from palpate.views.scene.style import AXIS, FOUND, INK, MUTED, PAPER, RULE, THIN, TRUTH, Column
from palpate.views.svg import element, escape, number, text

__all__ = ["draw_taxels"]

_LEFT, _TOP, _GAP, _PANEL = 40.0, 10.0, 34.0, 270.0
_WIDTH, _LARGEST = 690.0, 40.0
_ROW = 22.0
_SWATCH = 16.0
_BAR, _BAR_STEPS = 160.0, 32
_GREY, _DARK = "#c9d1d9", "#4a5560"
_MIDDLE = 246  # grey level of gain 1


def draw_taxels(values: TaxelMap) -> str:
    """The map as an SVG document of its own, which may also be pasted into an HTML page."""
    rows, cols = values.gain.shape
    cell = min(_LARGEST, _WIDTH / cols)
    reach = _reach(values)
    column = Column(_LEFT + _WIDTH + _GAP, _PANEL)
    panel, panel_end = _panel(values, column, reach)
    bottom = _TOP + rows * cell
    return element(
        "svg",
        element("title", escape(f"Taxel map, {values.name}")),
        element("desc", escape(_description(values))),
        *(_taxel(values, row, col, cell, reach) for row in range(rows) for col in range(cols)),
        _outline(_LEFT, _TOP, cols * cell, rows * cell),
        _numbers(rows, cols, cell),
        panel,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {number(column.right + 2)} {number(max(bottom + 44, panel_end))}",
        role="img",
        font_family="sans-serif",
    )


def _measured(values: TaxelMap) -> NDArray[np.bool_]:
    result: NDArray[np.bool_] = np.array(values.kinds) == MEASURED
    return result


def _reach(values: TaxelMap) -> float:
    """How far from 1 the colours go: a round share that holds all measured gains."""
    off = float(np.abs(values.gain[_measured(values)] - 1).max(initial=0.0))
    return max(0.05, math.ceil(off * 20 - 1e-9) / 20)


def _colour(gain: float, reach: float) -> str:
    """From the style's blue below 1 over nearly white to its orange above."""
    share = float(np.clip((gain - 1) / reach, -1, 1))
    end = FOUND if share < 0 else TRUTH
    channels = [round(_MIDDLE + (int(end[k : k + 2], 16) - _MIDDLE) * abs(share)) for k in (1, 3, 5)]
    return "#" + "".join(f"{channel:02x}" for channel in channels)


def _taxel(values: TaxelMap, row: int, col: int, cell: float, reach: float) -> str:
    kind = values.kinds[row][col]
    gain, bound = float(values.gain[row, col]), float(values.gain_bound[row, col])
    words = f"gain {gain:.3f} ± {_percent(bound)}" if kind == MEASURED else kind
    x, y = _LEFT + col * cell, _TOP + (values.gain.shape[0] - 1 - row) * cell
    title = element("title", escape(f"row {row}, column {col}: {words}"))
    return element("g", title, _square(kind, x, y, cell, _colour(gain, reach)))


def _square(kind: str, x: float, y: float, size: float, colour: str) -> str:
    """A taxel: its colour if measured, hatched if never pressed, else grey, dark if hot, and crossed."""
    if kind == MEASURED:
        fill, over = colour, ""
    elif kind == NEVER_PRESSED:
        fill, over = PAPER, _hatch(x, y, size)
    else:
        hot = kind == "hot"
        fill, over = (_DARK, _cross(x, y, size, PAPER)) if hot else (_GREY, _cross(x, y, size, INK))
    return element("rect", x=x, y=y, width=size, height=size, fill=fill, stroke=RULE, stroke_width=0.6) + over


def _cross(x: float, y: float, size: float, colour: str) -> str:
    inner, arm = size * 0.25, number(size * 0.5)
    return element(
        "path",
        d=f"M{number(x + inner)},{number(y + inner)}l{arm},{arm}m0,-{arm}l-{arm},{arm}",
        stroke=colour,
        stroke_width=2.0,
        fill="none",
    )


def _hatch(x: float, y: float, size: float) -> str:
    """Slanting lines across a square, which meet those of its neighbours."""
    lines = [
        f"M{number(x + max(0.0, at - size))},{number(y + min(at, size))}"
        f"L{number(x + min(at, size))},{number(y + max(0.0, at - size))}"
        for at in (size / 3 * k for k in range(1, 6))
    ]
    return element("path", d="".join(lines), stroke=AXIS, stroke_width=THIN, fill="none")


def _outline(x: float, y: float, width: float, height: float) -> str:
    return element("rect", x=x, y=y, width=width, height=height, fill="none", stroke=AXIS, stroke_width=THIN)


def _numbers(rows: int, cols: int, cell: float) -> str:
    """Numbers of rows and columns, no more than are legible."""
    bottom = _TOP + rows * cell
    shown = [
        text(str(col), _LEFT + (col + 0.5) * cell, bottom + 15, size=11, fill=MUTED, anchor="middle")
        for col in range(0, cols, max(1, math.ceil(22 / cell)))
    ]
    shown += [
        text(str(row), _LEFT - 8, bottom - (row + 0.5) * cell + 4, size=11, fill=MUTED, anchor="end")
        for row in range(0, rows, max(1, math.ceil(14 / cell)))
    ]
    words = "columns, seen from outside; row 0 is at the tip's lower end"
    return "".join(shown) + text(words, _LEFT, bottom + 34, size=11, fill=MUTED)


def _panel(values: TaxelMap, column: Column, reach: float) -> tuple[str, float]:
    """Right of the map: what colours and marks mean, and how many taxels there are of each kind."""
    y = _TOP + 12
    shown = [heading("Relative gain", column, y), _bar(column.left + 12, y + 22, reach)]
    y += 62
    for kind, words in _kinds(values):
        y += _ROW
        square = _square(kind, column.left + 12, y - 12, _SWATCH, _colour(1.0, reach))
        shown += [
            square,
            _outline(column.left + 12, y - 12, _SWATCH, _SWATCH),
            text(words, column.left + 40, y, size=12.5),
        ]
    return "".join(shown), y + 12


def _bar(x: float, y: float, reach: float) -> str:
    """The scale of colours; each step goes to the end, so that no seams show between them."""
    step = _BAR / _BAR_STEPS
    shown = [
        element(
            "rect",
            x=x + k * step,
            y=y,
            width=_BAR - k * step,
            height=14.0,
            fill=_colour(1 + reach * (2 * (k + 0.5) / _BAR_STEPS - 1), reach),
        )
        for k in range(_BAR_STEPS)
    ]
    shown.append(_outline(x, y, _BAR, 14.0))
    shown += [
        text(
            f"{1 + share * reach:.2f}",
            x + _BAR * (share + 1) / 2,
            y + 29,
            size=11,
            fill=MUTED,
            anchor="middle",
        )
        for share in (-1.0, 0.0, 1.0)
    ]
    return "".join(shown)


def _kinds(values: TaxelMap) -> list[tuple[str, str]]:
    """Kinds of taxels that are there, with how many; those that were measured first."""
    counts = Counter(kind for row in values.kinds for kind in row)
    shown = []
    for kind in sorted(counts, key=lambda kind: (kind != MEASURED, kind == NEVER_PRESSED, kind)):
        words = f"{kind}: {counts[kind]}"
        if kind == MEASURED:
            words += f", median ± {_percent(float(np.median(values.gain_bound[_measured(values)])))}"
        shown.append((kind, words))
    return shown


def _percent(share: float) -> str:
    """A bound, rounded up."""
    return f"{math.ceil(share * 1000 - 1e-9) / 10:.1f} %"


def _description(values: TaxelMap) -> str:
    """The map in words, for those who do not see it."""
    rows, cols = values.gain.shape
    kinds = "; ".join(words for _, words in _kinds(values))
    return f"{rows} x {cols} taxels of {values.name}; {kinds}."
