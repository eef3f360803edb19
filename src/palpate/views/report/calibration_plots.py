"""Statistics pictures of a calibration report, drawn by matplotlib (extra `plots`)."""

import io
import math
from collections.abc import Callable
from typing import Any, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from palpate.base.geometry import Floats
from palpate.config.calibration_file import CalibrationFile, TouchResidual
from palpate.config.calibration_finger import TactileCalibration
from palpate.views.numerals import at_most, signed
from palpate.views.report.calibration import never_pressed, residuals_mm
from palpate.views.svg import AXIS, CARD, FAINT, FOUND, FOUND_FILL, HUES, INK, MUTED, RULE, TRUTH
from palpate.views.table_picture.frame import nice_step

Shown = TypeVar("Shown")

_STYLE: Any = {
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "palpate",  # equal figures give equal text
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": 9.0,
    "axes.facecolor": CARD,
    "axes.edgecolor": RULE,
    "axes.labelcolor": MUTED,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 9.5,
    "grid.color": FAINT,
    "hatch.color": AXIS,
    "hatch.linewidth": 0.8,
    "legend.frameon": False,
    "patch.linewidth": 0.8,
    "text.color": INK,
    "text.parse_math": False,  # names may hold dollars
    "xtick.color": MUTED,
    "ytick.color": MUTED,
}
_HUES = tuple(hue for hue in HUES if hue != TRUTH)  # of fingers; outliers have a colour of their own
_WIDTH_INCHES = 10.6  # inches
_HELD_OUT = "#f0b27a"
_TYPICAL_ARROW_SHARE = 0.07  # length of a large usual residual's arrow, as a share of the map's side
_MAX_ARROW_SHARE = 0.13  # of the longest arrow
_BINS = 48.0
_DARK, _GREY = "#4a5560", "#c9d1d9"


def svg(draw: Callable[[Shown], Figure], shown: Shown) -> str:
    """The picture of `shown` by one of this module's functions, as an SVG document. Deterministic."""
    text = io.StringIO()
    with mpl.rc_context(_STYLE):
        draw(shown).savefig(
            text, format="svg", metadata={"Date": None, "Creator": None}, bbox_inches="tight", pad_inches=0.08
        )
    return text.getvalue()


def residual_map(file: CalibrationFile) -> Figure:
    """Plan view in W (mm) of all touches; arrows are their residuals along the normals, enlarged."""
    touches = file.residuals.touches_seen if file.residuals is not None else []
    figure = Figure((_WIDTH_INCHES, 7.4), layout="constrained")
    parts = figure.subplot_mosaic([["map", "key"], ["map", "bench"]], width_ratios=(2.6, 1.0))
    axes = parts["map"]
    places = np.array([(touch.x_mm, touch.y_mm) for touch in touches])
    middle, side = (places.min(0) + places.max(0)) / 2, 1.3 * max(10.0, float(np.ptp(places, axis=0).max()))
    axes.set(xlim=middle[0] + np.array([-0.5, 0.5]) * side, ylim=middle[1] + np.array([-0.5, 0.5]) * side)
    axes.set(aspect="equal", xlabel="x in W, mm", ylabel="y in W, mm")
    axes.grid(visible=True)
    usual = [abs(touch.residual_mm) for touch in touches if not touch.outlier]
    large = float(np.quantile(usual, 0.9)) if usual else 0.0
    enlarged = nice_step(_TYPICAL_ARROW_SHARE * side / large, 1.0) if large > 0 else 1.0
    for name, hue in zip([finger.name for finger in file.fingers], _hues(file), strict=True):
        _touches(
            axes, [touch for touch in touches if touch.finger == name], hue, enlarged, _MAX_ARROW_SHARE * side
        )
    for placing in sorted({touch.placing for touch in touches}):
        x, y = places[[touch.placing == placing for touch in touches]].mean(axis=0)
        axes.text(x, y, str(placing + 1), ha="center", va="center", color=MUTED, size=11, weight="bold")
    _bench(parts["bench"], file, places, axes)
    parts["key"].set_axis_off()
    words = f"Arrows: residuals × {enlarged:g}, outward where\nthe tip stood further out than fitted."
    title = f"{words}\nNumbers: placings of references, from 1."
    parts["key"].legend(handles=_key(file, touches), loc="upper left", title=title, alignment="left")
    return figure


def _hues(file: CalibrationFile) -> list[str]:
    return [_HUES[index % len(_HUES)] for index in range(len(file.fingers))]


def _touches(axes: Axes, touches: list[TouchResidual], hue: str, enlarged: float, longest_mm: float) -> None:
    """One finger's touches and residuals; an arrow that would be too long is cut and labelled."""
    at = np.array([(touch.x_mm, touch.y_mm) for touch in touches]).reshape(-1, 2)
    angles = np.radians([touch.normal_deg for touch in touches])
    drawn = enlarged * np.array([touch.residual_mm for touch in touches])
    length = np.clip(drawn, -longest_mm, longest_mm)
    arrows = length[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    axes.quiver(*at.T, *arrows.T, color=hue, angles="xy", scale_units="xy", scale=1, width=0.0025)
    for k in np.flatnonzero(length != drawn):
        x, y = (at[k] + arrows[k]).tolist()
        words = f"{signed(touches[k].residual_mm, '.3f')} mm, cut"
        axes.annotate(words, (x, y), (4, 2), textcoords="offset points", size=8)
    outliers = at[[touch.outlier for touch in touches]]
    axes.plot(*outliers.T, "x", color=TRUTH, markersize=8, markeredgewidth=2)
    held_out = np.array([touch.held_out for touch in touches], dtype=bool)
    axes.plot(*at[~held_out].T, "o", color=hue, markersize=4.5)
    axes.plot(*at[held_out].T, "o", color=hue, markersize=5.5, markerfacecolor="white", markeredgewidth=1.6)


def _key(file: CalibrationFile, touches: list[TouchResidual]) -> list[Line2D]:
    """Legend entries: fingers with their numbers of touches, then the kinds of touches that there are."""
    key = []
    for finger, hue in zip(file.fingers, _hues(file), strict=True):
        count = sum(touch.finger == finger.name for touch in touches)
        name = finger.name if len(finger.name) <= 16 else f"{finger.name[:15]}…"
        key.append(Line2D([], [], marker="o", linestyle="", color=hue, label=f"{name}: {count} touches"))
    if any(touch.held_out for touch in touches):
        hollow: Any = {"marker": "o", "markerfacecolor": "white"}
        key.append(Line2D([], [], linestyle="", color=INK, label="held out of the fit", **hollow))
    if any(touch.outlier for touch in touches):
        key.append(Line2D([], [], marker="x", linestyle="", color=TRUTH, label="outlier, not fitted"))
    return key


def _bench(panel: Axes, file: CalibrationFile, places: Floats, axes: Axes) -> None:
    """The fingers' bases about the window of the map, small."""
    panel.set_title("The bench")
    panel.set(aspect="equal", anchor="S", xticks=[], yticks=[], facecolor="none")
    panel.spines[:].set_visible(False)
    panel.plot(*places.T, ".", color=AXIS, markersize=2)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    panel.add_patch(Rectangle((left, low), right - left, high - low, fill=False, edgecolor=AXIS))
    for finger, hue in zip(file.fingers, _hues(file), strict=True):
        if finger.place is not None:
            panel.plot(*finger.place.base_mm, "s", color=hue)
            name = finger.name if len(finger.name) <= 8 else f"{finger.name[:7]}…"
            panel.annotate(name, finger.place.base_mm, (0, 6), textcoords="offset points", ha="center")
    panel.margins(0.2)


def residual_histograms(file: CalibrationFile) -> Figure:
    """Residuals (mm) of each finger's fitted and held-out touches, stacked; scaled to them, not to bounds."""
    fingers = file.fingers
    figure = Figure((_WIDTH_INCHES, 0.6 + 1.3 * len(fingers)), layout="constrained")
    rows = figure.subplots(len(fingers), 1, sharex=True, squeeze=False)[:, 0]
    both = [residuals_mm(file, finger.name) for finger in fingers]
    reach = max([1e-3, *(1.05 * abs(x) for pair in both for x in pair[0] + pair[1])])
    step = nice_step(2 * reach, _BINS)
    count = math.ceil(reach / step)
    edges = np.arange(-count, count + 1) * step
    for axes, finger, (fitted, held_out) in zip(rows, fingers, both, strict=True):
        axes.hist(
            (fitted, held_out),
            edges,
            stacked=True,
            histtype="stepfilled",
            color=(FOUND_FILL, _HELD_OUT),
            edgecolor=FOUND,
        )
        bound = None if finger.bounds is None else finger.bounds.position_mm
        words = f" – bound on the tip's position ± {at_most(bound, 3)} mm" if bound is not None else ""
        axes.set_title(f"{finger.name}{words}")
        axes.yaxis.set_major_locator(mpl.ticker.MaxNLocator(3, integer=True))
        if bound is not None and bound < edges[-1]:
            for sign in (-1, 1):
                axes.axvline(sign * bound, color=INK, linestyle="dashed")
                axes.axvspan(sign * bound, sign * edges[-1], color=FAINT, zorder=0)
    rows[-1].set(xlabel="residual, mm", xlim=(edges[0], edges[-1]))
    key = [
        Patch(facecolor=FOUND_FILL, edgecolor=FOUND, label="fitted"),
        Patch(facecolor=_HELD_OUT, edgecolor=FOUND, label="held out"),
        Line2D([], [], color=INK, linestyle="dashed", label="bound, where within the scale"),
    ]
    figure.legend(handles=key, loc="outside upper left", ncols=3)
    return figure


def taxel_gains(tactile: TactileCalibration) -> Figure:
    """Relative gains of an array, unrolled and seen from outside, row 0 (the tip's lower end) below."""
    gain, unpressed = np.array(tactile.gain), never_pressed(tactile)
    unusable = {(taxel.row, taxel.col): taxel.what for taxel in tactile.unusable}
    hidden = unpressed.copy()
    for at in unusable:
        hidden[at] = True
    rows, columns = gain.shape
    figure = Figure((_WIDTH_INCHES, 1.0 + max(1.2, min(0.36, 8.0 / columns) * rows)), layout="constrained")
    axes = figure.subplots()
    reach = max(0.05, math.ceil(float(np.abs(gain - 1)[~hidden].max(initial=0.0)) * 20 - 1e-9) / 20)
    colours = LinearSegmentedColormap.from_list("gain", (FOUND, "#f6f6f6", TRUTH))
    x, y = np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5
    shown = np.ma.masked_array(gain, hidden)
    mesh = axes.pcolormesh(x, y, shown, cmap=colours, vmin=1 - reach, vmax=1 + reach, edgecolor=RULE, lw=0.4)
    axes.add_collection(_squares([(int(r), int(c)) for r, c in np.argwhere(unpressed)], "white", "////"))
    for what, fill, cross in (("dead", _GREY, INK), ("unresponsive", _GREY, INK), ("hot", _DARK, "white")):
        places = [at for at, kind in unusable.items() if kind == what]
        axes.add_collection(_squares(places, fill))
        axes.plot(
            [c for _, c in places],
            [r for r, _ in places],
            "x",
            color=cross,
            markersize=7,
            markeredgewidth=1.6,
        )
    axes.set(aspect="equal", anchor="W", facecolor="none", xlabel="column", ylabel="row")
    axes.locator_params(integer=True, min_n_ticks=1)
    figure.colorbar(mesh, ax=axes, shrink=0.9, label="relative gain", ticks=(1 - reach, 1, 1 + reach))
    key = [Patch(facecolor="white", edgecolor=AXIS, hatch="////", label="never pressed")]
    key += [
        Patch(facecolor=_GREY, edgecolor=AXIS, label="× dead or unresponsive"),
        Patch(facecolor=_DARK, label="× hot"),
    ]
    figure.legend(handles=key, loc="outside upper left", ncols=3)
    return figure


def _squares(places: list[tuple[int, int]], fill: str, hatch: str | None = None) -> PatchCollection:
    squares = [Rectangle((column - 0.5, row - 0.5), 1, 1) for row, column in places]
    return PatchCollection(squares, facecolor=fill, edgecolor=AXIS, hatch=hatch, linewidth=0.4)
