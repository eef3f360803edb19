"""Nesting of closed loops: which is the outline of a part, and which a hole.

Every second loop from outside is a hole, whatever the file says of filling. Each of the others, with its
holes, is a part of its own: a sheet with several outlines shows several parts, and what lies in a hole hangs
together with nothing around it.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.cad.loop_assembly import Loop, Sheet
from palpate.cad.part_size import size_problem
from palpate.cad.values import Drawing, Region

__all__ = ["parts"]

_STRAIGHT = 1e-9
"""Points so near to the line between their neighbours, relative to the drawing's size, are on it."""
_REPEATED_MM = 1e-6
_ROUNDING = 1e-11
"""What the numbers of files and our own are good for, relative to the largest coordinate."""
_MIN_AREA_MM2 = 1e-6


def parts(loops: Sequence[Loop], stem: str, units: str | None, sheet: Sheet) -> tuple[Drawing, ...]:
    """One drawing for each loop that is no hole: `stem`, or `stem-1`, `stem-2`, … from the largest on.

    `units` as for `size_problem`. Raises InputError where loops cross or touch themselves or each other,
    enclose nothing, or a part is too large or too small.
    """
    points = np.concatenate([loop.points for loop in loops])
    reach = float(np.abs(points).max())
    within_mm = _STRAIGHT * float(np.ptp(points, axis=0).max())
    rings = [_without_straight(loop, within_mm) for loop in loops]
    _check_area([ring for ring in rings if len(ring.points) < 3], sheet)
    _check_crossings(rings, sheet)
    _check_area(rings, sheet)
    depth, parent = _nested([ring.points for ring in rings])
    solid = np.flatnonzero(depth % 2 == 0)
    size = np.array([-abs(_area(rings[k].points)) for k in solid])
    corner = np.array([rings[k].points.min(axis=0) for k in solid])
    # Parts of the same size: from the left, then from below.
    order = solid[np.lexsort((corner[:, 1], corner[:, 0], size))]
    drawings = []
    for number, own in enumerate(order.tolist(), 1):
        _check_size(rings[own], units, sheet)
        name = stem if len(order) == 1 else f"{stem}-{number}"
        holes = np.flatnonzero(parent == own)
        region = Region(
            _turned(rings[own].points, 1.0), tuple(_turned(rings[hole].points, -1.0) for hole in holes)
        )
        off = max(rings[k].off_mm for k in (own, *holes))
        drawings.append(Drawing(name, region, off * (1 + _ROUNDING) + reach * _ROUNDING))
    return tuple(drawings)


def _area(ring: Floats) -> float:
    """Signed area of a ring (n, 2): positive counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


def _check_area(rings: Sequence[Loop], sheet: Sheet) -> None:
    for ring in rings:
        if abs(_area(ring.points)) < _MIN_AREA_MM2:
            at = sheet.place(ring.points[0])
            raise InputError(f"{sheet.file}: {ring.label}: the outline at {at} encloses no area")


def _turned(ring: Floats, sign: float) -> Floats:
    return ring if _area(ring) * sign > 0 else ring[::-1].copy()


def _without_straight(loop: Loop, within_mm: float) -> Loop:
    """The loop without points that repeat the one before or lie on the line between their neighbours."""
    whole = loop.points
    index = np.flatnonzero(np.hypot(*(whole - np.roll(whole, 1, axis=0)).T) > _REPEATED_MM)
    points = whole[index]
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    across = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    aside = np.abs(across[:, 0] * before[:, 1] - across[:, 1] * before[:, 0])
    straight = (aside <= within_mm * np.hypot(*across.T)) & (np.sum(before * after, axis=1) > 0)
    kept = index[~straight]
    if len(kept) < 3:
        return Loop(loop.label, whole[:2], loop.off_mm)
    ring = whole[kept]
    # Each point left out against the edge that stands for it now.
    number = np.searchsorted(kept, np.arange(len(whole)), side="right") - 1
    edges = np.stack([ring[number], ring[(number + 1) % len(ring)]], axis=1)
    away = shapely.distance(shapely.points(whole), shapely.linestrings(edges))
    return Loop(loop.label, ring, loop.off_mm + float(away.max()))


def _check_crossings(rings: Sequence[Loop], sheet: Sheet) -> None:
    """No two edges may meet, but neighbours in their common point."""
    starts = np.concatenate([ring.points for ring in rings])
    ends = np.concatenate([np.roll(ring.points, -1, axis=0) for ring in rings])
    counts = np.array([len(ring.points) for ring in rings])
    owner = np.repeat(np.arange(len(rings)), counts)
    following = np.arange(len(starts)) + 1
    following[np.cumsum(counts) - 1] = np.cumsum(counts) - counts
    edges = shapely.linestrings(np.stack([starts, ends], axis=1))
    one, other = shapely.STRtree(edges).query(edges, predicate="intersects")
    once = one < other
    one, other = one[once], other[once]
    neighbours = (following[one] == other) | (following[other] == one)
    meeting = shapely.intersection(edges[one], edges[other])
    along = shapely.get_type_id(meeting) != shapely.GeometryType.POINT
    wrong = along | ~neighbours
    if not wrong.any():
        return
    # Edges that run along each other tell more than the ends of such.
    k = int(np.argmax(2 * along + wrong))
    where = sheet.place(shapely.get_coordinates(meeting[k])[0])
    first, second = rings[owner[one[k]]], rings[owner[other[k]]]
    if first is second:
        how = "runs back along itself" if along[k] else "meets itself"
        raise InputError(f"{sheet.file}: {first.label}: an outline {how} at {where}")
    label = first.label if first.label == second.label else f"{first.label} and {second.label}"
    how = "run along each other" if along[k] else "meet"
    raise InputError(
        f"{sheet.file}: {label}: two outlines {how} at {where}; outlines must be apart or within each other"
    )


def _nested(rings: Sequence[Floats]) -> tuple[Ints, Ints]:
    """Of rings that do not meet, (n,) each: in how many others one is, and the innermost of these, or -1."""
    polygons = [shapely.Polygon(ring) for ring in rings]
    inner, outer = shapely.STRtree(polygons).query(
        shapely.points(np.array([ring[0] for ring in rings])), predicate="within"
    )
    depth = np.bincount(inner, minlength=len(rings))
    parent = np.full(len(rings), -1)
    innermost = depth[outer] == depth[inner] - 1
    parent[inner[innermost]] = outer[innermost]
    return depth, parent


def _check_size(ring: Loop, units: str | None, sheet: Sheet) -> None:
    problem = size_problem(np.ptp(ring.points, axis=0), units)
    if problem:
        at = sheet.place(ring.points.min(axis=0))
        raise InputError(f"{sheet.file}: {ring.label}: the part at {at} has a wrong size: {problem}")
