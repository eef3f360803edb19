"""Stability of a state against pushes: does it slide on its base, or may it tip or roll?

A push f at height h moves the centre of pressure by f h / (m g) from below the centre of mass. While it stays
in the convex hull of the base, no edge of it lifts; and a push that slides it is no more than μ m g
(docs/recogniser.md, "Tipping and rolling"). Bounds on motions hold for parts that slide.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Section, State
from palpate.base.vocabulary import PushResponse

__all__ = ["DIRECTIONS", "FRICTION_MOST", "RESERVE", "Stability", "stability_of"]

FRICTION_MOST = 0.8
"""Assumed at most, between part and table: 0.1 to 0.5 for hard ones, about 0.8 on rubber."""
RESERVE = 1.25
"""A finger that runs into a part pushes more than friction, for its inertia (benchmarks/bench_tipping.py)."""
DIRECTIONS = 360
"""Evenly spaced directions, from the object frame's x axis on, in which limits are tabled."""

_TIP_FRICTION_RAD = math.atan(0.7)  # a tip pushes within this of the normal
_LEANING = 1.0  # walls that lean out by more than 45° just above the base may be part of a round one
_THIN = (
    0.25  # of the part's height: a lowest section that is thicker is a foot, and no sample of a round wall
)
_GAP = 0.1  # of the part's height, below which nothing is known: near the table round walls are nearly level
_MOST_KNOWN = 0.9  # of the part's height: where less is, its centre of mass is not known
_WIDEST_MM = 1e4
_LOWEST_CENTRE = 0.25  # of a convex part's height: its centre of mass is no lower (Minkowski and Radon)


@dataclass(frozen=True, eq=False)
class Stability:
    """How a state takes pushes of a rig's fingers.

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
        """From below the centre of mass to the nearest edge of the base, at least."""
        return float(self.reach_mm.min())

    def safe_heights_mm(self) -> Floats:
        """Height (DIRECTIONS,) up to which a push only slides the part, by the surface's inward normal.

        Infinite for a state that slides. The force of a tip is within its friction of the normal.
        """
        if self.response is PushResponse.SLIDES:
            return np.full(DIRECTIONS, np.inf)
        towards = _evenly_spaced()
        cosine = np.cos(towards[:, None] - self.angle_rad)
        # The way from below the centre of mass to the edge of the hull, whose half-planes are given.
        way = np.where(cosine > 1e-6, self.reach_mm / np.maximum(cosine, 1e-6), np.inf).min(axis=1)
        aside = math.ceil(_TIP_FRICTION_RAD * DIRECTIONS / (2 * np.pi))
        least = np.min([np.roll(way, k) for k in range(-aside, aside + 1)], axis=0)
        # Between two directions the edge may be nearer, by up to the cosine of half their angle.
        result: Floats = least * math.cos(math.pi / DIRECTIONS) / (FRICTION_MOST * RESERVE)
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
    if reach[worst] >= FRICTION_MOST * RESERVE * height:
        return Stability(PushResponse.SLIDES, "", height, angle, reach)
    response = PushResponse.MAY_ROLL if base.is_round[worst] else PushResponse.MAY_TIP
    why = _why(response, base.known_by, float(reach[worst]), height)
    return Stability(response, why, height, angle, reach)


@dataclass(frozen=True, eq=False)
class _Base:
    """As in `Stability`; `is_round` (n,): walls lean out just above. `known_by`: if not by its sections."""

    angle_rad: Floats
    reach_mm: Floats
    is_round: Bools
    known_by: str = ""


def _why(response: PushResponse, known_by: str, reach_mm: float, height_mm: float) -> str:
    reaches = f"for all that {known_by} says, its base may reach" if known_by else "its base reaches"
    stands = f"{reaches} only {_down(reach_mm):g} mm from below its centre of mass"
    if response is PushResponse.MAY_ROLL:
        return f"may roll: {stands}, and its walls lean out from there"
    friction = max(_down(reach_mm / (RESERVE * height_mm)), 0.0)
    return f"may tip: {stands}; at {height_mm:g} mm a push tips it where friction is above {friction:g}"


def _down(value: float) -> float:
    return math.floor(100 * value) / 100


def _highest_touch_mm(state: State, span_mm: tuple[float, float]) -> float:
    """How high at most a tip touches a state; 0 if it does not."""
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
    if centre is None or low > (0.0 if state.heights_mm is None else _GAP * state.top_mm):
        return _unseen(low, tips_mm, tilt)
    hull = _hull(sections[0]) - centre
    angle = np.concatenate([_evenly_spaced(), _edge_normals(hull)])
    reach = _support(hull, angle)
    inward, is_round = _curved(sections, centre, angle, reach, state.top_mm)
    # A wall that is round over half of the reach or more says nothing of where the base begins.
    reach = np.where(inward > reach / 2, 0.0, reach - inward) - tolerance_mm
    if tips_mm < reach.min():  # the file knows better, but not in which direction
        return _Base(angle, reach * (tips_mm / float(reach.min())), is_round)
    return _Base(angle, reach, is_round)


def _unseen(low_mm: float, tips_mm: float, tilt_rad: float | None) -> _Base:
    """A base that is not among the sections: judged by the angle at which the file says that it tips."""
    angle = _evenly_spaced()
    unknown = np.zeros(DIRECTIONS, dtype=bool)
    if tilt_rad is None:
        return _Base(angle, np.zeros(DIRECTIONS), unknown, f"a lowest section at {low_mm:g} mm")
    return _Base(angle, np.full(DIRECTIONS, min(tips_mm, _WIDEST_MM)), unknown, "its tipping angle")


def _evenly_spaced() -> Floats:
    return np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)


def _centre_of_mass(state: State, sections: Sequence[Section]) -> tuple[Floats | None, float]:
    """Its place (2,) in the object frame, None if not known, and its height, mm: at least, if not known."""
    lows, highs = np.array([section.z_mm for section in sections]).T
    known = state.heights_mm is None or sum(high - low for low, high in state.heights_mm) >= (
        _MOST_KNOWN * state.top_mm
    )
    if not known:
        return None, _LOWEST_CENTRE * state.top_mm
    regions = [_region(section) for section in sections]
    volume = shapely.area(regions) * np.maximum(highs - lows, 1e-9)
    centres = shapely.get_coordinates(shapely.centroid(regions))
    return volume @ centres / volume.sum(), float(volume @ (lows + highs) / 2 / volume.sum())


def _region(section: Section) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(part.outer, part.holes) for part in section.polygons])


def _hull(section: Section) -> Floats:
    """Corners (n, 2) of a section's convex hull."""
    points = np.concatenate([polygon.outer for polygon in section.polygons])
    corners: Floats = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(points)))[:-1]
    return corners


def _edge_normals(corners: Floats) -> Floats:
    """Angles (n,) of the outward normals of a convex polygon's edges: where its support is least."""
    edge = np.roll(corners, -1, axis=0) - corners
    doubled = float(
        np.sum(corners[:, 0] * np.roll(corners[:, 1], -1) - corners[:, 1] * np.roll(corners[:, 0], -1))
    )
    edge = edge * math.copysign(1.0, doubled)
    result: Floats = np.arctan2(-edge[:, 0], edge[:, 1])
    return result


def _support(corners: Floats, angle_rad: Floats) -> Floats:
    """How far corners (m, 2) reach from the origin in directions (n,), mm."""
    towards = np.stack([np.cos(angle_rad), np.sin(angle_rad)])
    result: Floats = (corners @ towards).max(axis=0)
    return result


def _curved(
    sections: Sequence[Section], centre: Floats, angle_rad: Floats, reach_mm: Floats, top_mm: float
) -> tuple[Floats, Bools]:
    """How far (n,) inside of the lowest section a round part's base may begin, and where (n,) it is round.

    A round wall is r(z) = r₀ + √(2 R z) just above the base. The lowest section stands for some height of it;
    r₀ follows from the next one that is wider.
    """
    none: tuple[Floats, Bools] = np.zeros(len(angle_rad)), np.zeros(len(angle_rad), dtype=bool)
    top = sections[0].z_mm[1]
    if top > _THIN * top_mm or len(sections) < 2:
        return none
    inward, is_round = none
    for below, above in pairwise(sections[: _sections_below(sections, top)]):
        if above.z_mm[0] - below.z_mm[1] > _GAP * top_mm:
            break
        wider = np.maximum(_support(_hull(above) - centre, angle_rad) - reach_mm, 0.0)
        ratio = math.sqrt(above.z_mm[1] / top)
        inward = np.maximum(inward, wider / (ratio - 1))
        is_round |= wider > _LEANING * max(above.z_mm[0], 1e-9)
    return inward, is_round | (inward > reach_mm / 2)


def _sections_below(sections: Sequence[Section], top_mm: float) -> int:
    """How many of the lowest sections to look at: two, and those below four times the first one's top."""
    count = sum(section.z_mm[1] <= 4 * top_mm for section in sections)
    return max(count, 2)
