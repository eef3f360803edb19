"""One card of the picture of objects: layout, names, section with pockets, side view, heights, numbers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import affinity

from palpate.base.errors import join_words, quantity
from palpate.base.geometry import Floats, State
from palpate.base.geometry.outlines import rings_of
from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import (
    Level,
    Range,
    SectionSymmetry,
    StateSections,
    symmetry_of_region,
)
from palpate.rig.catalogue.twins import unreached_region
from palpate.views import svg
from palpate.views.catalogue.check_text import known_words
from palpate.views.table_picture.frame import nice_step


@dataclass(frozen=True, eq=False)
class Card:
    """A drawing of a state: its only section, at some ranges of height, or several from the bottom up."""

    state: StateSections
    shown: tuple[Level, ...]
    ranges_mm: tuple[Range, ...] = ()

    @property
    def is_stack(self) -> bool:
        """True if different sections are drawn over each other."""
        return not self.ranges_mm


MARGIN, GAP = 14.0, 14.0
ROOM = 190.0
"""Side of the square in which a section is drawn."""
_BAR_WIDTH = 78.0
"""Width of the ladder of heights with its numbers."""
_SIDE = 76.0
"""Height of the side view, beneath the ladder."""
WIDTH = 2 * MARGIN + ROOM + 12 + _BAR_WIDTH
LINES, BOTTOM = 102.0, 102.0
HEIGHT = LINES + ROOM + BOTTOM

CONCAVE = "#f6ecd4"
UNREACHED, UNREACHED_LINE = "#e6cfdd", "#8f5a7e"
_SHADES = ((0x9C, 0xC9, 0xE8), (0x08, 0x2F, 0x5C))
"""Colours of the lowest and of the highest section."""


_SIDE_MARGIN = 4.0


def side_rings(state: State) -> tuple[Floats, ...]:
    """Rings (n, 2) of (across, z), mm: of the file, or what sections show that are known everywhere."""
    if state.side_mm or state.heights_mm is not None:
        return state.side_mm
    boxes = [
        shapely.box(x.min(), section.z_mm[0], x.max(), section.z_mm[1])
        for section in state.sections
        for polygon in section.polygons
        for x in (polygon.outer[:, 0],)
    ]
    return tuple(rings_of(shapely.union_all(boxes)))


def _draw_side(rings: tuple[Floats, ...], left: float, top: float) -> str:
    """The view in a box as wide as the ladder of heights, on a line for the table."""
    points = np.concatenate(rings)
    low, high = points.min(axis=0), points.max(axis=0)
    wide, tall = max(high[0] - low[0], 1e-9), max(high[1], 1e-9)
    scale = min((_BAR_WIDTH - 2 * _SIDE_MARGIN) / wide, (_SIDE - 2 * _SIDE_MARGIN) / tall)
    middle, bottom = left + _BAR_WIDTH / 2, top + _SIDE - _SIDE_MARGIN
    origin = np.array([middle - scale * (low[0] + high[0]) / 2, bottom])
    drawn = [origin + ring * (scale, -scale) for ring in rings]
    part = svg.closed_path(
        drawn,
        fill=svg.FOUND_FILL,
        fill_rule="evenodd",
        stroke=svg.FOUND,
        stroke_width=1.0,
        stroke_linejoin="round",
    )
    line = svg.segment((left, bottom), (left + _BAR_WIDTH, bottom), stroke=svg.INK, stroke_width=svg.THIN)
    return part + line


_LADDER_WIDTH, _BEFORE = 14.0, 32.0
_NUMBER_SPACING = 13.0  # of numbers beneath each other
_NUMBER_SIZE = 11.0
_THIN_BAND = 3.0


def shade(z_mm: float, top_mm: float) -> str:
    """Colour of a height: the higher, the darker."""
    share = min(max(z_mm / top_mm, 0.0), 1.0)
    low, high = _SHADES
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(low, high, strict=True))


def _draw_ladder(card: Card, fingers: RigFingers, left: float, top: float, room: float) -> str:
    """The ladder, as high as its `room`, with its upper left corner at `left`, `top`."""
    heights = [at.height_mm for at in fingers.at]
    high = card.state.state.top_mm
    ladder = _Ladder(left + _BEFORE, top + room - 4, (room - 14) / max(high, *heights))
    drawn = [ladder.band((0.0, high), svg.PAPER, svg.AXIS, "2 2")]
    drawn += [ladder.band(run, svg.FAINT, svg.RULE) for run in _runs(card.state.levels, ladder.scale)]
    if card.is_stack:
        for run in _runs(card.state.levels, ladder.scale):
            drawn.append(ladder.band(run, shade(run[0], high), None))
    else:
        drawn += [ladder.band(found, svg.FOUND, None) for found in card.ranges_mm]
    ends = (ladder.left - 14, ladder.bottom), (ladder.right + 14, ladder.bottom)
    drawn.append(svg.segment(*ends, stroke=svg.INK, stroke_width=svg.THIN))
    beside, above = ladder.left - 4, ladder.y(high) + 4
    drawn.append(
        svg.text(
            f"{high:.4g}",
            beside,
            min(above, ladder.bottom - 3),
            size=_NUMBER_SIZE,
            fill=svg.MUTED,
            anchor="end",
        )
    )
    if above < ladder.bottom - _NUMBER_SPACING - 3:
        drawn.append(
            svg.text("0", beside, ladder.bottom - 3, size=_NUMBER_SIZE, fill=svg.MUTED, anchor="end")
        )
    return "".join(drawn) + _fingers(heights, ladder)


@dataclass(frozen=True)
class _Ladder:
    """Scale of heights (mm) on the page."""

    left: float
    bottom: float
    scale: float

    @property
    def right(self) -> float:
        """Right side of the bar."""
        return self.left + _LADDER_WIDTH

    def y(self, z_mm: float) -> float:
        """A height on the page."""
        return self.bottom - self.scale * z_mm

    def band(self, z_mm: Range, fill: str, stroke: str | None, dash: str | None = None) -> str:
        """A part of the bar; never too thin to be seen."""
        low, up = self.y(z_mm[0]), self.y(z_mm[1])
        return svg.rectangle(
            (self.left, up),
            (_LADDER_WIDTH, max(low - up, 0.5)),
            fill=fill,
            stroke=stroke,
            stroke_width=None if stroke is None else 0.8,
            stroke_dasharray=dash,
        )


def _runs(levels: Sequence[Level], scale: float) -> list[Range]:
    """The levels' ranges, with those that would be thinner than a few units joined to the one above."""
    runs: list[Range] = []
    for level in levels:
        low, high = level.z_mm
        if runs and runs[-1][1] == low and scale * (runs[-1][1] - runs[-1][0]) < _THIN_BAND:
            runs[-1] = (runs[-1][0], high)
        else:
            runs.append((low, high))
    return runs


def _fingers(heights_mm: Sequence[float], ladder: _Ladder) -> str:
    """A pointer at each height of fingers, with its number; numbers that are too near move up."""
    drawn = []
    below = math.inf
    for height in heights_mm:
        y = ladder.y(height)
        tip = np.array([[ladder.right + 1, y], [ladder.right + 8, y - 4], [ladder.right + 8, y + 4]])
        drawn.append(svg.closed_path([tip], fill=svg.TIP))
        below = min(y + 4, below - _NUMBER_SPACING)
        drawn.append(svg.text(f"{height:.4g}", ladder.right + 11, below, size=_NUMBER_SIZE, fill=svg.TIP))
    return "".join(drawn)


_LINE_TOLERANCE = 0.15  # SVG units that a drawn line may be off
_LADDER_GAP = 14.0  # ladder and side view
_MAX_RAYS = 12
_MAX_RANGES = 4
_RAY_SHARE = 0.6  # of the way to the furthest corner


@dataclass(frozen=True)
class TwinNote:
    """`names` of other states, and in `words` how they are like a card's: "feels like"."""

    words: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class CardFacts:
    """Facts about a card's state: `twins` are other states that feel like it, or may."""

    symmetry_order: int
    twins: tuple[TwinNote, ...]


def draw_card(
    card: Card, facts: CardFacts, fingers: RigFingers, corner: tuple[float, float], scale: float
) -> str:
    """The card with its upper left corner at `corner`; `scale`: SVG units per mm."""
    left, top = corner
    middle = np.array([left + MARGIN + ROOM / 2, top + LINES + ROOM / 2])
    page = _Page(card, middle, scale)
    frame = svg.rectangle(
        (left, top), (WIDTH, HEIGHT), rx=4.0, fill=svg.CARD, stroke=svg.RULE, stroke_width=svg.THIN
    )
    if card.is_stack:
        drawing = _stack(card, page, fingers)
    else:
        symmetry = symmetry_of_region(card.shown[0].region)
        tip_mm = min(_radii(card.ranges_mm, fingers), default=fingers.slimmest_mm)
        drawing = _section(card.shown[0], page, tip_mm, symmetry)
    beside, rings = left + WIDTH - MARGIN - _BAR_WIDTH, side_rings(card.state.state)
    ladder = _draw_ladder(card, fingers, beside, top + LINES, ROOM - _SIDE - _LADDER_GAP if rings else ROOM)
    ladder += _draw_side(rings, beside, top + LINES + ROOM - _SIDE) if rings else ""
    return (
        frame
        + _heading(card, left, top)
        + drawing
        + _scale_bar(left + MARGIN, top + HEIGHT - BOTTOM + 12, scale)
        + ladder
        + _beneath(_edges_words(card, facts), facts, left, top)
    )


def ranges_words(ranges_mm: Sequence[Range], most: int = 3) -> str:
    """Ranges in words, such as "0–8 and 20–25"."""
    words = [f"{low:.4g}–{high:.4g}" for low, high in ranges_mm[:most]]
    if len(ranges_mm) > most:
        words.append(f"{len(ranges_mm) - most} more")
    return join_words(words)


class _Page:
    """Map from mm in the object's frame to SVG units: the card's sections in the middle of their room."""

    def __init__(self, card: Card, middle: Floats, scale: float) -> None:
        bounds = shapely.total_bounds(np.array([level.region for level in card.shown], dtype=object))
        self._centre = (bounds[:2] + bounds[2:]) / 2
        self._middle, self._scale = middle, scale

    def shape(self, region: shapely.Geometry) -> shapely.Geometry:
        """A region on the page, simplified to what is visible."""
        scale, (x, y) = self._scale, self._middle
        move = (scale, 0, 0, -scale, x - scale * self._centre[0], y + scale * self._centre[1])
        return affinity.affine_transform(region, move).simplify(_LINE_TOLERANCE)

    def point(self, at_mm: Floats) -> Floats:
        """A point on the page."""
        moved: Floats = (at_mm - self._centre) * (self._scale, -self._scale) + self._middle
        return moved


def _path(
    shape: shapely.Geometry, fill: str, stroke: str | None, width: float = svg.THIN, dash: str | None = None
) -> str:
    """A region of the page as one path; nothing for an empty one."""
    rings = rings_of(shape)
    if not rings:
        return ""
    return svg.closed_path(
        rings,
        fill=fill,
        fill_rule="evenodd",
        stroke=stroke,
        stroke_width=None if stroke is None else width,
        stroke_dasharray=dash,
        stroke_linejoin="round",
    )


def _section(level: Level, page: _Page, tip_mm: float, symmetry: SectionSymmetry) -> str:
    return (
        _pockets(level, page, tip_mm)
        + _path(page.shape(level.region), svg.FOUND_FILL, svg.FOUND, 1.6)
        + _symmetry_marks(level.region, page, symmetry)
    )


def _stack(card: Card, page: _Page, fingers: RigFingers) -> str:
    """All sections over each other; those that fingers meet in the fingers' colour, with their pockets."""
    top = card.state.state.top_mm
    met = [(item, _radii([item.z_mm], fingers)) for item in card.shown]
    drawn = [_path(page.shape(shapely.union_all([item.region for item in card.shown])), svg.FOUND_FILL, None)]
    drawn += [_pockets(item, page, min(radii)) for item, radii in met if radii]
    drawn += [
        _path(page.shape(item.region), "none", shade(item.z_mm[0], top), 1.3)
        for item, radii in met
        if not radii
    ]
    drawn += [_path(page.shape(item.region), "none", svg.TIP, 2.0) for item, radii in met if radii]
    return "".join(drawn)


def _pockets(level: Level, page: _Page, tip_mm: float) -> str:
    """Draw what lies within the section's hull and outside of it, and what of that no tip reaches."""
    region, hull = page.shape(level.region), page.shape(shapely.convex_hull(level.region))
    outside = _path(hull.difference(region), CONCAVE, None)
    return outside + _path(
        page.shape(unreached_region(level.region, tip_mm)), UNREACHED, UNREACHED_LINE, 0.8, "3 2"
    )


def _symmetry_marks(region: shapely.Geometry, page: _Page, symmetry: SectionSymmetry) -> str:
    """The centre, and a ray towards the furthest corner with its images; a circle where there are many."""
    if symmetry.order == 1:
        return ""
    corners = shapely.get_coordinates(region) - symmetry.centre_mm
    furthest = corners[int(np.hypot(*corners.T).argmax())]
    centre = page.point(symmetry.centre_mm)
    tip = _RAY_SHARE * (page.point(symmetry.centre_mm + furthest) - centre)
    marks = [svg.circle(centre, 2.4, fill=svg.INK)]
    look: dict[str, str | float] = {"stroke": svg.INK, "stroke_width": 0.9, "stroke_dasharray": "5 3"}
    if symmetry.order > _MAX_RAYS:
        radius = float(np.hypot(*tip))
        marks.append(svg.circle(centre, radius, fill="none", **look))
        return "".join(marks)
    for k in range(symmetry.order):
        c, s = math.cos(2 * math.pi * k / symmetry.order), math.sin(2 * math.pi * k / symmetry.order)
        x, y = centre + np.array([[c, -s], [s, c]]) @ tip
        marks.append(svg.segment(centre, (x, y), **look))
    return "".join(marks)


def _radii(ranges_mm: Sequence[Range], fingers: RigFingers) -> list[float]:
    """Radii of the tips that are at heights within the ranges."""
    return [
        at.tip_radius_mm
        for at in fingers.at
        for low, high in ranges_mm
        if low <= at.span_mm[1] and at.span_mm[0] <= high
    ]


def _heading(card: Card, left: float, top: float) -> str:
    room, x = WIDTH - 2 * MARGIN, left + MARGIN
    state = card.state.state
    if card.is_stack:
        drawn = f"{len(card.shown)} of " if len(card.shown) < len(card.state.levels) else ""
        what = f"{drawn}{len(card.state.levels)} sections up to {state.top_mm:.4g} mm"
    else:
        what = f"one section, at {ranges_words(card.ranges_mm)} mm"
    rests = []
    if state.probability is not None:
        rests.append(f"comes to rest so {100 * state.probability:.3g} %")
    if state.tipping_angle_rad is not None:
        rests.append(f"tips at {math.degrees(state.tipping_angle_rad):.3g}°")
    known = "" if state.heights_mm is None else _known(state.heights_mm, state.top_mm, room)
    lines = [
        (state.name, 12.5, svg.INK),
        *((line, 11.5, svg.MUTED) for line in (what, ", ".join(rests), known) if line),
    ]
    name = svg.shorten_middle(card.state.object_name, 14, room, bold=True)
    shown = [svg.text(name, x, top + 22, size=14, weight="bold")]
    for number, (line, size, fill) in enumerate(lines):
        y = top + 40 + 16 * number
        shown.append(svg.text(svg.shorten_middle(line, size, room), x, y, size=size, fill=fill))
    return "".join(shown)


def _edges_words(card: Card, facts: CardFacts) -> str:
    if facts.symmetry_order == 0:
        return _fold(0)
    edges = [level.edges for level in card.state.levels]
    low, high = min(edges), max(edges)
    count = quantity(low, "edge", "edges") if low == high else f"{low}–{high} edges"
    return f"{count}, {_fold(facts.symmetry_order)}"


def _fold(order: int) -> str:
    return {0: "round", 1: "not symmetric"}.get(order, f"{order}-fold symmetric")


def _beneath(words: str, facts: CardFacts, left: float, top: float) -> str:
    room, x, y = WIDTH - 2 * MARGIN, left + MARGIN, top + HEIGHT - BOTTOM + 42
    shown = [svg.text(svg.shorten(words, 11.5, room), x, y, size=11.5, fill=svg.MUTED)]
    for number, twins in enumerate(facts.twins, 1):
        shown.append(svg.text(_twins_words(twins, room), x, y + 16 * number, size=11.5, fill=svg.TRUTH))
    return "".join(shown)


def _twins_words(twins: TwinNote, room: float) -> str:
    """List as many names as fit, and count the others; of a name that is too long, beginning and end."""
    most = min(len(twins.names), int(room / svg.text_width("; ", 11.5)))
    for count in range(most, 1, -1):
        words = f"{twins.words} {'; '.join(twins.names[:count])}{_more_words(twins, count)}"
        if svg.text_width(words, 11.5) <= room:
            return words
    before, more = f"{twins.words} ", _more_words(twins, 1)
    left = room - svg.text_width(before + more, 11.5)
    return f"{before}{svg.shorten_middle(twins.names[0], 11.5, left)}{more}"


def _more_words(twins: TwinNote, shown: int) -> str:
    return f" and {len(twins.names) - shown} more" if len(twins.names) > shown else ""


def _known(known_mm: Sequence[Range], top_mm: float, room: float) -> str:
    """Say at which heights it is known, with as many of the ranges as there is room for."""
    for most in range(_MAX_RANGES, 0, -1):
        words = known_words(known_mm, top_mm, most)
        if svg.text_width(words, 11.5) <= room:
            return words
    return known_words(known_mm, top_mm, 0)


def _scale_bar(x: float, y: float, scale: float) -> str:
    step = nice_step(ROOM / scale, 5)
    length = step * scale
    line = f"M{x:.2f},{y - 4:.2f}v8M{x:.2f},{y:.2f}h{length:.2f}M{x + length:.2f},{y - 4:.2f}v8"
    bar = svg.element("path", d=line, fill="none", stroke=svg.INK, stroke_width=svg.THIN)
    return bar + svg.text(f"{step:g} mm", x + length + 6, y + 4, size=11, fill=svg.INK)
