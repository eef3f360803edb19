"""Mechanics of a pushed part: its support, the forces that slide it, and whether it tips or rolls.

Sliding is counted in *slide*: the mean path, in mm, of the points on which the part rests. Friction takes
at least the declared force times the slide, so the work done on the part bounds the slide
(docs/motion-bounds.md). Tipping: a push f at height h moves the centre of pressure by f h
/ (m g) from below the centre of mass. While it stays in the convex hull of the base, no edge of it lifts;
and a push that slides it is no more than μ m g (the same page, "Tipping and rolling"). Bounds on
motions hold for parts that slide.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints, Section, State
from palpate.base.geometry.outlines import region_of
from palpate.base.geometry.plane import signed_area
from palpate.base.vocabulary import PushResponse
from palpate.config.rig_tables import SearchConfig
from palpate.recognizer import Catalogue, CatalogueState, Table

MAX_TABLE_FRICTION = 0.8
"""Assumed at most, between part and table: 0.1 to 0.5 for hard ones, about 0.8 on rubber."""
INERTIA_RESERVE = 1.25
"""A finger that runs into a part pushes more than friction, for its inertia (benchmarks/bench_tipping.py)."""
DIRECTION_COUNT = 360
"""Evenly spaced directions, from the object frame's x axis on, in which limits are tabled."""

_TIP_FRICTION_RAD = math.atan(0.7)  # a tip pushes within this of the normal
_LEANING_SLOPE = 1.0  # walls that lean out by more than 45° just above the base may be part of a round one
_THIN_SHARE = (
    0.25  # of the part's height: a lowest section that is thicker is a foot, and no sample of a round wall
)
_MAX_GAP_SHARE = (
    0.1  # of the part's height, below which nothing is known: near the table round walls are nearly level
)
_KNOWN_SHARE = 0.9  # of the part's height: where less is, its centre of mass is not known
_MAX_REACH_MM = 1e4
_LOWEST_CENTRE_SHARE = 0.25  # of a convex part's height: its centre of mass is no lower (Minkowski and Radon)


@dataclass(frozen=True, eq=False)
class Stability:
    """Stability of a state under pushes of a rig's fingers.

    `angle_rad`, `reach_mm` (n,): directions, in the object frame, and how far the base's hull reaches in each
    from below the centre of mass at least; 0 where that is not known. `height_mm`: of the highest finger that
    touches it, of the upper end of its tip as far as the state is that high; 0 if none does. `why`: one line
    for an operator; empty for a state that slides.
    """

    response: PushResponse
    why: str
    height_mm: float
    angle_rad: Floats
    reach_mm: Floats

    @property
    def margin_mm(self) -> float:
        """Distance from below the centre of mass to the nearest edge of the base, at least."""
        return float(self.reach_mm.min())

    def safe_heights_mm(self) -> Floats:
        """Height (DIRECTIONS,) up to which a push only slides the part, by the surface's inward normal.

        Infinite for a state that slides. The force of a tip is within its friction of the normal.
        """
        if self.response is PushResponse.SLIDES:
            return np.full(DIRECTION_COUNT, np.inf)
        towards = _evenly_spaced()
        cosine = np.cos(towards[:, None] - self.angle_rad)
        # The way from below the centre of mass to the edge of the hull, whose half-planes are given.
        way = np.where(cosine > 1e-6, self.reach_mm / np.maximum(cosine, 1e-6), np.inf).min(axis=1)
        aside = math.ceil(_TIP_FRICTION_RAD * DIRECTION_COUNT / (2 * np.pi))
        least = np.min([np.roll(way, k) for k in range(-aside, aside + 1)], axis=0)
        # Between two directions the edge may be nearer, by up to the cosine of half their angle.
        result: Floats = least * math.cos(math.pi / DIRECTION_COUNT) / (MAX_TABLE_FRICTION * INERTIA_RESERVE)
        return result


def stability_of(state: State, tolerance_mm: float, spans_mm: Sequence[tuple[float, float]]) -> Stability:
    """Stability of a state against fingers whose tips' ends are at some heights (from, to).

    Its outlines are within `tolerance_mm`.

    Of one material, as its sections are. Where it cannot be judged, it may tip.
    """
    height = max((_highest_touch_mm(state, span) for span in spans_mm), default=0.0)
    base = _base_of(state, tolerance_mm)
    angle, reach = base.angle_rad, np.maximum(base.reach_mm, 0.0)
    worst = int(np.argmin(reach))
    if reach[worst] >= MAX_TABLE_FRICTION * INERTIA_RESERVE * height:
        return Stability(PushResponse.SLIDES, "", height, angle, reach)
    response = PushResponse.MAY_ROLL if base.is_round[worst] else PushResponse.MAY_TIP
    why = _why(response, base.known_by, float(reach[worst]), height)
    return Stability(response, why, height, angle, reach)


@dataclass(frozen=True, eq=False)
class _Base:
    """Base as in `Stability`; `is_round` (n,): walls lean out just above. `known_by`: if not by sections."""

    angle_rad: Floats
    reach_mm: Floats
    is_round: Bools
    known_by: str = ""


def _why(response: PushResponse, known_by: str, reach_mm: float, height_mm: float) -> str:
    reaches = f"for all that {known_by} says, its base may reach" if known_by else "its base reaches"
    stands = f"{reaches} only {_round_down(reach_mm):g} mm from below its centre of mass"
    if response is PushResponse.MAY_ROLL:
        return f"may roll: {stands}, and its walls lean out from there"
    friction = max(_round_down(reach_mm / (INERTIA_RESERVE * height_mm)), 0.0)
    return f"may tip: {stands}; at {height_mm:g} mm a push tips it where friction is above {friction:g}"


def _round_down(value: float) -> float:
    return math.floor(100 * value) / 100


def _highest_touch_mm(state: State, span_mm: tuple[float, float]) -> float:
    """Greatest height at which a tip touches a state; 0 if it does not."""
    if not state.known_within(span_mm):
        return span_mm[1]
    return max((min(section.z_mm[1], span_mm[1]) for section in state.sections_within(span_mm)), default=0.0)


def _base_of(state: State, tolerance_mm: float) -> _Base:
    sections = sorted(state.sections, key=lambda section: section.z_mm)
    centre, height_of_centre = _centre_of_mass(state, sections)
    tilt = state.tipping_angle_rad
    tips_mm = math.inf
    if tilt is not None and tilt < math.pi / 2:
        tips_mm = height_of_centre * math.tan(tilt) - tolerance_mm
    low = sections[0].z_mm[0]
    if centre is None or low > (0.0 if state.heights_mm is None else _MAX_GAP_SHARE * state.top_mm):
        return _base_by_tilt(low, tips_mm, tilt)
    hull = _hull(sections[0]) - centre
    angle = np.concatenate([_evenly_spaced(), _edge_normals(hull)])
    reach = _support(hull, angle)
    inward, is_round = _round_walls(sections, centre, angle, reach, state.top_mm)
    # A wall that is round over half of the reach or more says nothing of where the base begins.
    reach = np.where(inward > reach / 2, 0.0, reach - inward) - tolerance_mm
    if tips_mm < reach.min():  # the file knows better, but not in which direction
        return _Base(angle, reach * (tips_mm / float(reach.min())), is_round)
    return _Base(angle, reach, is_round)


def _base_by_tilt(low_mm: float, tips_mm: float, tilt_rad: float | None) -> _Base:
    """A base that is not among the sections: judged by the angle at which the file says that it tips."""
    angle = _evenly_spaced()
    unknown = np.zeros(DIRECTION_COUNT, dtype=bool)
    if tilt_rad is None:
        return _Base(angle, np.zeros(DIRECTION_COUNT), unknown, f"a lowest section at {low_mm:g} mm")
    return _Base(angle, np.full(DIRECTION_COUNT, min(tips_mm, _MAX_REACH_MM)), unknown, "its tipping angle")


def _evenly_spaced() -> Floats:
    return np.linspace(0.0, 2 * np.pi, DIRECTION_COUNT, endpoint=False)


def _centre_of_mass(state: State, sections: Sequence[Section]) -> tuple[Floats | None, float]:
    """Place (2,) in the object frame, None if not known, and height, mm: at least, if not known."""
    lows, highs = np.array([section.z_mm for section in sections]).T
    known = state.heights_mm is None or sum(high - low for low, high in state.heights_mm) >= (
        _KNOWN_SHARE * state.top_mm
    )
    if not known:
        return None, _LOWEST_CENTRE_SHARE * state.top_mm
    regions = [region_of(section.polygons) for section in sections]
    volume = shapely.area(regions) * np.maximum(highs - lows, 1e-9)
    centres = shapely.get_coordinates(shapely.centroid(regions))
    return volume @ centres / volume.sum(), float(volume @ (lows + highs) / 2 / volume.sum())


def _hull(section: Section) -> Floats:
    """Corners (n, 2) of a section's convex hull."""
    points = np.concatenate([polygon.outer for polygon in section.polygons])
    corners: Floats = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(points)))[:-1]
    return corners


def _edge_normals(corners: Floats) -> Floats:
    """Angles (n,) of the outward normals of a convex polygon's edges: where its support is least."""
    edge = np.roll(corners, -1, axis=0) - corners
    edge = edge * math.copysign(1.0, signed_area(corners))
    result: Floats = np.arctan2(-edge[:, 0], edge[:, 1])
    return result


def _support(corners: Floats, angle_rad: Floats) -> Floats:
    """Distance that corners (m, 2) reach from the origin in directions (n,), mm."""
    towards = np.stack([np.cos(angle_rad), np.sin(angle_rad)])
    result: Floats = (corners @ towards).max(axis=0)
    return result


def _round_walls(
    sections: Sequence[Section], centre: Floats, angle_rad: Floats, reach_mm: Floats, top_mm: float
) -> tuple[Floats, Bools]:
    """Distance (n,) inside the lowest section at which a round part's base may begin, and where it is round.

    A round wall is r(z) = r₀ + √(2 R z) just above the base. The lowest section stands for some height of it;
    r₀ follows from the next one that is wider.
    """
    none: tuple[Floats, Bools] = np.zeros(len(angle_rad)), np.zeros(len(angle_rad), dtype=bool)
    top = sections[0].z_mm[1]
    if top > _THIN_SHARE * top_mm or len(sections) < 2:
        return none
    inward, is_round = none
    for below, above in pairwise(sections[: _sections_below(sections, top)]):
        if above.z_mm[0] - below.z_mm[1] > _MAX_GAP_SHARE * top_mm:
            break
        wider = np.maximum(_support(_hull(above) - centre, angle_rad) - reach_mm, 0.0)
        ratio = math.sqrt(above.z_mm[1] / top)
        inward = np.maximum(inward, wider / (ratio - 1))
        is_round |= wider > _LEANING_SLOPE * max(above.z_mm[0], 1e-9)
    return inward, is_round | (inward > reach_mm / 2)


def _sections_below(sections: Sequence[Section], top_mm: float) -> int:
    """Number of the lowest sections to look at: two, and those below four times the first one's top."""
    count = sum(section.z_mm[1] <= 4 * top_mm for section in sections)
    return max(count, 2)


_BASE_SAMPLES = 24  # of an evenly loaded base, along the longer side of its box
_CENTRES_PER_SIDE = 31  # centres of rotation looked at, along each side of thrice the part's reach
_GRID_ALLOWANCE = 1.03  # allowance for both grids
_MAX_MEDIAN_ROUNDS = 60
_MEDIAN_TOLERANCE_MM = 1e-4


@dataclass(frozen=True)
class StateSupport:
    """Support of a state that rests on the table.

    `holds_n`: what it bears at its middle; infinite: it is taken to lie still. Per mm of slide the centroid
    moves at most `shift`, the part turns at most `turn_rad_per_mm`, and no point of its outline moves more
    than `leverage`. A force f anywhere on the outline does not move it if f · `leverage` ≤ `holds_n`.
    `centre_mm` (2,): its centre of mass in the file's frame. Pushed with all that it bears, the centre of
    friction is carried off by so much that leverages grow by `carried`; under less, by that share of it.
    """

    holds_n: float
    shift: float
    turn_rad_per_mm: float
    leverage: float
    centre_mm: Floats
    carried: float


@dataclass(frozen=True, eq=False)
class SupportTable(Table):
    """Supports of n states: the columns of `Support`, (n,) each, and `centre_mm` (n, 2)."""

    holds_n: Floats
    shift: Floats
    turn_rad_per_mm: Floats
    leverage: Floats
    centre_mm: Floats
    carried: Floats

    def leverage_at(self, states: Ints, distance_mm: Floats) -> Floats:
        """Leverage as in `leverage`, of points at distances (m,) from the centre of mass, of `states` (m,).

        The centre of friction moves with the mean velocity, and everything turns about it.
        """
        near = 1 + distance_mm * self.turn_rad_per_mm[states]
        result: Floats = np.minimum(self.leverage[states], near)
        return result


def supports_of(catalogue: Catalogue, search: SearchConfig, height_mm: float) -> SupportTable:
    """Supports of all states of a catalogue, touched at `height_mm` at most.

    What an object says goes before what the rig file says.
    """
    found = [support_of(item, search, height_mm) for item in catalogue.states]
    columns = (np.array([getattr(item, name.name) for item in found]) for name in fields(SupportTable))
    return SupportTable(*columns)


def support_of(item: CatalogueState, search: SearchConfig, height_mm: float) -> StateSupport:
    """Support of one state.

    The pressure balances about the centre of mass, which is that of the sections, as of one material. A push
    at a height carries it on by height × push / weight, and while the part slides or stands no push is above
    friction × weight.
    """
    holds = item.holds_n or search.part_holds_n
    if holds is None:
        return StateSupport(math.inf, 0.0, 0.0, 1.0, item.origin_mm, 0.0)
    centre = _centre_of_mass_mm(item.state)
    sections = item.state.sections
    outline = np.concatenate([ring for section in sections for ring in section.rings])
    hull = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(outline))) - centre
    carried_mm, unsure_mm = MAX_TABLE_FRICTION * height_mm, item.tolerance_mm + item.rounding_mm
    off = float(np.hypot(*(centre - item.origin_mm))) + carried_mm
    declared = item.support_mm or search.part_support_mm
    if declared is not None:
        reach = float(np.hypot(*hull.T).max()) + unsure_mm
        turn = 1 / declared
        return StateSupport(holds, 1 + off * turn, turn, 1 + reach * turn, centre, carried_mm * turn)
    lowest = min(sections, key=lambda section: section.z_mm[0])
    base = region_of(lowest.polygons)
    base = shapely.affinity.translate(base, *(-centre))
    shift, turn, leverage = _evenly_loaded(base, hull, off, unsure_mm)
    return StateSupport(holds, shift, turn, leverage, centre, carried_mm * turn * leverage)


def _centre_of_mass_mm(state: State) -> Floats:
    """Centre of mass (2,) of a state in its file's frame, as of one material, seen from above."""
    total, moment = 0.0, np.zeros(2)
    for section in state.sections:
        lo, hi = section.z_mm
        for polygon in section.polygons:
            shape = shapely.Polygon(polygon.outer, polygon.holes)
            volume = shape.area * (hi - lo)
            total += volume
            moment += volume * shapely.get_coordinates(shape.centroid)[0]
    result: Floats = moment / total
    return result


def _evenly_loaded(
    base: shapely.Geometry, hull: Floats, off_mm: float, unsure_mm: float
) -> tuple[float, float, float]:
    """Shift, turn and leverage of the whole base, under a pressure that is known.

    The worst centre of rotation is looked for. All from the centre of mass. `hull` (v, 2): corners of the
    part's convex hull; the outline may be `unsure_mm` further from where the pressure balances.
    """
    points, load = _pressure(base)
    rho = _mean_distance_from_median(points, load) / _GRID_ALLOWANCE
    along = np.linspace(-3, 3, _CENTRES_PER_SIDE) * np.hypot(*hull.T).max()
    centres = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    # A row of centres at a time stays in the processor's caches.
    mean = np.concatenate([_distances(row, points) @ load for row in np.split(centres, _CENTRES_PER_SIDE)])
    furthest = _distances(centres, hull).max(axis=1)
    leverage = max(float(np.max((furthest + unsure_mm) / mean)), 1.0)
    distance = np.hypot(*centres.T)
    shift = max(float(np.max((distance + off_mm) / mean)), 1.0)
    return shift * _GRID_ALLOWANCE, 1 / rho, leverage * _GRID_ALLOWANCE


def _distances(one: Floats, other: Floats) -> Floats:
    """Distances (m, n) of points (m, 2) from points (n, 2): large catalogues have many states to look at.

    By the law of cosines, whose rounding is 1e-7 of the points' distances from the origin.
    """
    square: Floats = (-2 * one) @ other.T
    square += (one**2).sum(axis=1)[:, None]
    square += (other**2).sum(axis=1)
    return np.sqrt(np.maximum(square, 0.0, out=square), out=square)


def _pressure(base: shapely.Geometry) -> tuple[Floats, Floats]:
    """Points (n, 2) evenly over an area, and the share (n,) that each bears of a weight at the origin.

    The pressure is a linear function of the place, but never pulls: a stiff part on an elastic foundation.
    Evenly loaded if nothing balances so.
    """
    points = every = _grid_in(base)
    while len(points) >= _BASE_SAMPLES:
        lever = np.column_stack([np.ones(len(points)), points])
        load = lever @ np.linalg.lstsq(lever.T @ lever, np.array([1.0, 0.0, 0.0]))[0]
        if load.min() >= 0:
            return points, load
        points = points[load > 0]
    return every, np.full(len(every), 1 / len(every))


def _grid_in(base: shapely.Geometry) -> Floats:
    """Points (n, 2) evenly over an area."""
    x0, y0, x1, y1 = base.bounds
    step = max(x1 - x0, y1 - y0) / _BASE_SAMPLES
    while True:
        x, y = (np.arange(lo + step / 2, hi, step) for lo, hi in ((x0, x1), (y0, y1)))
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        inside: Floats = points[shapely.contains_xy(base, points)]
        if len(inside) >= _BASE_SAMPLES:
            return inside
        step /= 2


def _mean_distance_from_median(points: Floats, load: Floats) -> float:
    """Least mean distance from any one point, by Weiszfeld's iteration (1937)."""
    median = load @ points
    for _ in range(_MAX_MEDIAN_ROUNDS):
        weight = load / np.maximum(np.hypot(*(points - median).T), 1e-9)
        before, median = median, weight @ points / weight.sum()
        if (
            math.dist(before, median) < _MEDIAN_TOLERANCE_MM
        ):  # about its least the mean distance hardly changes
            break
    return float(load @ np.hypot(*(points - median).T))
