"""Residuals of a calibration by finger, against the bounds that are stated; part of its report."""

import math

import numpy as np

from palpate.views.calibration.values import Spread
from palpate.views.scene.frame import nice_step
from palpate.views.scene.style import (
    CARD,
    FAINT,
    FOUND,
    FOUND_FILL,
    INK,
    LINE,
    MUTED,
    PAPER,
    RULE,
    THIN,
    TRUTH,
)
from palpate.views.svg import Floats, element, escape, number, shorten, text

__all__ = ["draw_histograms"]

_LEFT, _WIDTH, _WORDS, _TOP = 90.0, 640.0, 274.0, 40.0
_HEIGHT, _APART = 96.0, 30.0
_BINS = 48.0  # about
_HELD_OUT = "#f0b27a"


def draw_histograms(fingers: tuple[Spread, ...]) -> str:
    """One histogram a finger over a common axis, as an SVG document of its own."""
    half = _half_range(fingers)
    step = nice_step(2 * half, _BINS)
    count = int(np.ceil(half / step))
    edges: Floats = np.arange(-count, count + 1) * np.float64(step)
    top, shown = _TOP, [_key()]
    for finger in fingers:
        shown.append(_one(finger, edges, top))
        top += _HEIGHT + _APART
    bottom = top - _APART
    shown.append(_axis(edges, bottom))
    return element(
        "svg",
        element("title", "Residuals against the bounds on positions"),
        element("desc", escape(_description(fingers))),
        *shown,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {number(_LEFT + _WIDTH + _WORDS)} {number(bottom + 44)}",
        role="img",
        font_family="sans-serif",
    )


def _half_range(fingers: tuple[Spread, ...]) -> float:
    """How far the axis goes to either side, mm: all bounds and all residuals are on it."""
    seen = [1.15 * finger.bound_mm for finger in fingers if finger.bound_mm is not None]
    for finger in fingers:
        both = np.concatenate([finger.fitted_mm, finger.held_out_mm])
        seen.append(1.05 * float(np.abs(both).max(initial=0.0)))
    return max([*seen, 1e-3])


def _x(value_mm: float, edges: Floats) -> float:
    return _LEFT + _WIDTH * float((value_mm - edges[0]) / (edges[-1] - edges[0]))


def _one(finger: Spread, edges: Floats, top: float) -> str:
    """Bars of one finger, fitted below held out, with its bound and its numbers."""
    fitted, held = (np.histogram(each, edges)[0] for each in (finger.fitted_mm, finger.held_out_mm))
    most = max(1, int((fitted + held).max()))
    bottom = top + _HEIGHT
    shown = [element("rect", x=_LEFT, y=top, width=_WIDTH, height=_HEIGHT, fill=CARD)]
    if finger.bound_mm is not None:
        shown += _beyond(finger.bound_mm, edges, top)
    unit = (_HEIGHT - 10) / most
    for k in range(len(fitted)):
        x, width = _x(edges[k], edges), _WIDTH / len(fitted)
        base = bottom
        for amount, fill, stroke in ((fitted[k], FOUND_FILL, FOUND), (held[k], _HELD_OUT, TRUTH)):
            if amount:
                base -= unit * float(amount)
                bar = {"x": x + 0.5, "y": base, "width": width - 1, "height": unit * float(amount)}
                shown.append(element("rect", **bar, fill=fill, stroke=stroke, stroke_width=THIN))
    shown.append(
        element("line", x1=_LEFT, y1=bottom, x2=_LEFT + _WIDTH, y2=bottom, stroke=RULE, stroke_width=THIN)
    )
    shown.append(text(shorten(finger.name, 13, _LEFT - 24, bold=True), 8, top + 18, size=13, weight="bold"))
    shown.append(text(f"{most}", _LEFT - 8, top + 14, size=11, fill=MUTED, anchor="end"))
    shown.append(text("0", _LEFT - 8, bottom + 1, size=11, fill=MUTED, anchor="end"))
    return "".join(shown) + _words(finger, top)


def _beyond(bound: float, edges: Floats, top: float) -> list[str]:
    """What lies beyond the bound, shaded, and the bound itself."""
    left, right = _x(-bound, edges), _x(bound, edges)
    end = _LEFT + _WIDTH
    shown = [
        element("rect", x=x, y=top, width=width, height=_HEIGHT, fill=FAINT)
        for x, width in ((_LEFT, left - _LEFT), (right, end - right))
    ]
    shown += [
        element(
            "line",
            x1=x,
            y1=top,
            x2=x,
            y2=top + _HEIGHT,
            stroke=INK,
            stroke_width=LINE,
            stroke_dasharray="5 3",
        )
        for x in (left, right)
    ]
    return shown


def _words(finger: Spread, top: float) -> str:
    """The numbers right of the bars."""
    used = np.concatenate([finger.fitted_mm, finger.held_out_mm])
    lines = [(f"{len(finger.fitted_mm)} fitted, {len(finger.held_out_mm)} held out", INK)]
    if len(used):
        rms, largest = float(np.sqrt((used**2).mean())), float(np.abs(used).max())
        lines.append((f"rms {rms:.3f} mm, largest {largest:.3f} mm", MUTED))
    if finger.bound_mm is not None:
        over = int((np.abs(used) > finger.bound_mm).sum())
        bound = f"bound ± {math.ceil(finger.bound_mm * 1000 - 1e-9) / 1000:.3f} mm"
        lines.append((f"{bound}, {over or 'none'} beyond", TRUTH if over else MUTED))
    if finger.outliers:
        lines.append((f"outliers, not shown: {finger.outliers}", MUTED))
    at = _LEFT + _WIDTH + 18
    return "".join(
        text(line, at, top + 20 + 20 * k, size=12.5, fill=fill) for k, (line, fill) in enumerate(lines)
    )


def _axis(edges: Floats, y: float) -> str:
    step = nice_step(float(edges[-1] - edges[0]), 6)
    decimals = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    shown = []
    for k in range(int(np.ceil(edges[0] / step)), int(np.floor(edges[-1] / step)) + 1):
        x = _x(k * step, edges)
        words = f"{abs(k * step):.{decimals}f}"
        shown.append(element("line", x1=x, y1=y, x2=x, y2=y + 5, stroke=MUTED, stroke_width=THIN))
        shown.append(text(f"−{words}" if k < 0 else words, x, y + 19, size=11, fill=MUTED, anchor="middle"))
    shown.append(text("residual, mm", _LEFT + _WIDTH / 2, y + 38, size=11, fill=MUTED, anchor="middle"))
    return "".join(shown)


def _key() -> str:
    """What colours and lines mean, above all histograms."""
    shown = []
    x, y = _LEFT, 18.0
    for fill, stroke, words, room in (
        (FOUND_FILL, FOUND, "fitted", 90.0),
        (_HELD_OUT, TRUTH, "held out", 105.0),
    ):
        shown.append(
            element(
                "rect", x=x, y=y - 10, width=14.0, height=11.0, fill=fill, stroke=stroke, stroke_width=THIN
            )
        )
        shown.append(text(words, x + 21, y, size=12.5))
        x += room
    shown.append(
        element(
            "line",
            x1=x + 7,
            y1=y - 12,
            x2=x + 7,
            y2=y + 3,
            stroke=INK,
            stroke_width=LINE,
            stroke_dasharray="5 3",
        )
    )
    shown.append(text("bound on the tip's position", x + 21, y, size=12.5))
    return element("rect", width=_LEFT + _WIDTH, height=28.0, fill=PAPER) + "".join(shown)


def _description(fingers: tuple[Spread, ...]) -> str:
    """The histograms in words, for those who do not see them."""
    words = []
    for finger in fingers:
        used = np.abs(np.concatenate([finger.fitted_mm, finger.held_out_mm]))
        bound = "no bound" if finger.bound_mm is None else f"bound {finger.bound_mm:.3f} mm"
        words.append(f"{finger.name}: {len(used)} touches, largest {used.max(initial=0.0):.3f} mm, {bound}.")
    return " ".join(words)
