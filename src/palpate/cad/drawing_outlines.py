"""Outlines of flat parts from the strokes of a drawing: ends that meet are joined, closed loops are nested.

Drawings are stored as strokes in any order and direction, each with its own rounding. Ends nearer than
`JOIN_MM` to each other are the same point; nothing further apart is ever bridged. What joining moves is added
to the loop's deviation. Every second loop from outside is a hole, whatever the file says of filling. Each of
the others, with its holes, is a part of its own: a sheet with several outlines shows several parts, and what
lies in a hole hangs together with nothing around it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints, Polygon
from palpate.base.geometry.outlines import EdgeRings
from palpate.base.geometry.plane import cross, orient_ring, signed_area
from palpate.cad.curves import DrawnCurve, chords_of_chain, control_hull
from palpate.cad.mesh_topology import component_of
from palpate.cad.parts import MAX_SIZE_MM, Drawing, size_problem

JOIN_MM = 5e-3
"""Ends so near to each other are one point: four decimals of an inch, in arcs by centre and angle."""

_TWIN_MM = 1e-6
"""Strokes that run so near to each other are drawn twice."""
_MAX_CURVE_MM = 100 * MAX_SIZE_MM


@dataclass(frozen=True)
class Sheet:
    """The file that is read, and how a point is called in it.

    A point (x, y), mm, has there the coordinates (x · per_mm[0], y · per_mm[1]) in `unit`.
    """

    file: str
    unit: str
    per_mm: tuple[float, float]

    def place(self, *points_mm: Floats) -> str:
        """Points (2,) as they are found in the file."""
        named = (f"({x * self.per_mm[0]:.6g}, {y * self.per_mm[1]:.6g})" for x, y in points_mm)
        return f"{' and '.join(named)} {self.unit}"


@dataclass(frozen=True, eq=False)
class Stroke:
    """Curves that follow each other, mm, and where in the file they come from ("layer 'cut'")."""

    label: str
    curves: tuple[DrawnCurve, ...]


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed outline: open ring `points` (n, 2), mm; the curves are within `off_mm` of its edges."""

    label: str
    points: Floats
    off_mm: float


def close_loops(strokes: Sequence[Stroke], curve_mm: float, sheet: Sheet) -> tuple[Loop, ...]:
    """All strokes as closed loops, curves as chords within `curve_mm`. Each stroke is in one loop.

    What is drawn twice is taken once. Raises InputError, with the place, where an outline is open, where
    strokes branch, and where they are too far away or too short to be joined.
    """
    runs = [_stroke_points(stroke, curve_mm, sheet) for stroke in strokes]
    closed = [_close(run) for run in runs if _closes(run)]
    open_runs = [run for run in runs if not _closes(run)]
    if open_runs:
        closed += _trace(*_snap_ends(open_runs, sheet), sheet)
    if not closed:
        raise InputError(f"{sheet.file}: its lines have no length; draw closed outlines")
    return _without_twins(closed)


def _stroke_points(stroke: Stroke, curve_mm: float, sheet: Sheet) -> Loop:
    """A stroke as points; not closed yet."""
    around = np.concatenate([control_hull(curve) for curve in stroke.curves])
    if not np.all(np.isfinite(around)):
        raise InputError(f"{sheet.file}: {stroke.label} has coordinates that are no finite numbers")
    if np.ptp(around, axis=0).max() > _MAX_CURVE_MM:
        raise InputError(
            f"{sheet.file}: {stroke.label} has a curve at {sheet.place(around[0])} that is longer than "
            f"{_MAX_CURVE_MM:g} mm; parts up to {MAX_SIZE_MM:g} mm are allowed: is the unit right?"
        )
    points, off, gap = chords_of_chain(stroke.curves, curve_mm)
    if gap > JOIN_MM:
        raise InputError(
            f"{sheet.file}: {stroke.label} has a curve from {sheet.place(points[0])} on that jumps by "
            f"{gap:.3g} mm; draw it without a break"
        )
    steps = np.hypot(*np.diff(points, axis=0).T)
    keep = np.concatenate([[True], steps > 0])
    return Loop(stroke.label, points[keep], off + gap)


def _length(points: Floats) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _closes(run: Loop) -> bool:
    return math.dist(run.points[0], run.points[-1]) <= JOIN_MM < _length(run.points)


def _close(run: Loop) -> Loop:
    gap = math.dist(run.points[0], run.points[-1])
    return Loop(run.label, run.points[:-1], run.off_mm + gap)


def _snap_ends(runs: Sequence[Loop], sheet: Sheet) -> tuple[list[Loop], Ints]:
    """Runs from node to node: with both ends moved to the nodes, and the nodes (m, 2) of their ends.

    Runs that joining makes a point, and such as repeat another, are left out.
    """
    ends = np.concatenate([[run.points[0], run.points[-1]] for run in runs])
    pairs = cKDTree(ends).query_pairs(JOIN_MM, output_type="ndarray")
    node = component_of(pairs[:, 0], pairs[:, 1], len(ends))
    _, first = np.unique(node, return_index=True)
    moved = np.hypot(*(ends[first][node] - ends).T)
    if moved.max() > 2 * JOIN_MM:
        far = int(moved.argmax())
        raise InputError(
            f"{sheet.file}: {runs[far // 2].label} has many strokes shorter than {JOIN_MM:g} mm at "
            f"{sheet.place(ends[far])}; join them into polylines"
        )
    shortest = np.where(node[::2] == node[1::2], [_length(run.points) for run in runs], 0.0)
    shift = np.zeros(len(first))
    np.maximum.at(shift, node, moved + np.repeat(shortest, 2))
    kept: dict[tuple[int, int, int], list[Loop]] = {}
    for k, run in enumerate(runs):
        one, other = int(node[2 * k]), int(node[2 * k + 1])
        if one == other:
            # Shorter than what counts as a point: else it would be closed already.
            continue
        points = run.points.copy()
        points[0], points[-1] = ends[first[one]], ends[first[other]]
        if one > other:
            points = points[::-1]
        off = run.off_mm + float(max(shift[one], shift[other]))
        same = kept.setdefault((min(one, other), max(one, other), len(points)), [])
        if not any(np.abs(points - twin.points).max() <= _TWIN_MM for twin in same):
            same.append(Loop(run.label, points, off))
    netted = [(run, key[:2]) for key, same in kept.items() for run in same]
    return [run for run, _ in netted], np.array([nodes for _, nodes in netted], dtype=np.int64).reshape(-1, 2)


def _trace(runs: list[Loop], nodes: Ints, sheet: Sheet) -> list[Loop]:
    """Follow the runs from node to node; each node has to have two of them."""
    at: dict[int, list[int]] = {}
    for k, pair in enumerate(nodes.tolist()):
        for node in pair:
            at.setdefault(node, []).append(k)
    branches = {node: own for node, own in at.items() if len(own) > 2}
    if branches:
        raise InputError(_branch_message(branches, runs, nodes, sheet))
    loose = [(node, own[0]) for node, own in at.items() if len(own) == 1]
    if loose:
        raise InputError(_gap_message(loose, runs, nodes, sheet))
    left = set(range(len(runs)))
    found = []
    for start in range(len(runs)):
        if start not in left:
            continue
        chain, off, node, k = [], 0.0, int(nodes[start, 0]), start
        while k in left:
            left.discard(k)
            forward = nodes[k, 0] == node
            chain.append((runs[k].points if forward else runs[k].points[::-1])[:-1])
            off = max(off, runs[k].off_mm)
            node = int(nodes[k, 1] if forward else nodes[k, 0])
            k = at[node][0] if at[node][1] == k else at[node][1]
        found.append(Loop(runs[start].label, np.concatenate(chain), off))
    return found


def _branch_message(branches: dict[int, list[int]], runs: list[Loop], nodes: Ints, sheet: Sheet) -> str:
    node, own = next(iter(branches.items()))
    point = runs[own[0]].points[0 if nodes[own[0], 0] == node else -1]
    more = f" (and at {len(branches) - 1} more places)" if len(branches) > 1 else ""
    return (
        f"{sheet.file}: {runs[own[0]].label}: {len(own)} lines meet at {sheet.place(point)}{more}; "
        "an outline passes through a point once: remove the lines that are no outlines"
    )


def _gap_message(loose: list[tuple[int, int]], runs: list[Loop], nodes: Ints, sheet: Sheet) -> str:
    """Name the two loose ends that are nearest to each other."""
    ends = np.array([runs[k].points[0 if nodes[k, 0] == node else -1] for node, k in loose])
    apart, other = (np.asarray(found) for found in cKDTree(ends).query(ends, k=2))
    one = int(apart[:, 1].argmin())
    two = int(other[one, 1]) if other[one, 1] != one else int(other[one, 0])
    k = loose[one][1]
    more = f" (and {len(loose) - 2} more loose ends)" if len(loose) > 2 else ""
    where = f"{sheet.file}: {runs[k].label}"
    if loose[two][1] == k and len(runs[k].points) == 2:
        return (
            f"{where}: the line between {sheet.place(ends[one], ends[two])} is in no outline{more}; remove it"
        )
    return (
        f"{where}: open loop: gap of {math.dist(ends[one], ends[two]):.4g} mm between "
        f"{sheet.place(ends[one], ends[two])}{more}; close it (ends within {JOIN_MM:g} mm are joined)"
    )


def _without_twins(loops: list[Loop]) -> tuple[Loop, ...]:
    """Leave out loops that run along an earlier one from point to point, wherever they start."""
    boxes = np.array([[*loop.points.min(axis=0), *loop.points.max(axis=0)] for loop in loops])
    near = cKDTree(boxes).query_pairs(2 * _TWIN_MM, output_type="ndarray")
    twins = {max(pair) for pair in near.tolist() if _same_ring(*(loops[k].points for k in pair))}
    return tuple(loop for k, loop in enumerate(loops) if k not in twins)


def _same_ring(one: Floats, other: Floats) -> bool:
    """The same points in the same cyclic order, in either direction."""
    if len(one) != len(other):
        return False
    start = int(np.hypot(*(other - one[0]).T).argmin())
    turned = np.roll(other, -start, axis=0)
    backwards = np.roll(turned[::-1], 1, axis=0)
    return any(bool(np.abs(one - ring).max() <= _TWIN_MM) for ring in (turned, backwards))


_STRAIGHT_SHARE = 1e-9
"""Points so near to the line between their neighbours, relative to the drawing's size, are on it."""
_REPEATED_MM = 1e-6
_ROUNDING_SHARE = 1e-11
"""What the numbers of files and our own are good for, relative to the largest coordinate."""
_MIN_AREA_MM2 = 1e-6


def nest_loops(loops: Sequence[Loop], stem: str, units: str | None, sheet: Sheet) -> tuple[Drawing, ...]:
    """One drawing for each loop that is no hole: `stem`, or `stem-1`, `stem-2`, … from the largest on.

    `units` as for `size_problem`. Raises InputError where loops cross or touch themselves or each other,
    enclose nothing, or a part is too large or too small.
    """
    points = np.concatenate([loop.points for loop in loops])
    reach = float(np.abs(points).max())
    within_mm = _STRAIGHT_SHARE * float(np.ptp(points, axis=0).max())
    rings = [_without_straight(loop, within_mm) for loop in loops]
    _check_area([ring for ring in rings if len(ring.points) < 3], sheet)
    _check_crossings(rings, sheet)
    _check_area(rings, sheet)
    depth, parent = _nesting([ring.points for ring in rings])
    solid = np.flatnonzero(depth % 2 == 0)
    size = np.array([-abs(signed_area(rings[k].points)) for k in solid])
    corner = np.array([rings[k].points.min(axis=0) for k in solid])
    # Parts of the same size: from the left, then from below.
    order = solid[np.lexsort((corner[:, 1], corner[:, 0], size))]
    drawings = []
    for number, own in enumerate(order.tolist(), 1):
        _check_size(rings[own], units, sheet)
        name = stem if len(order) == 1 else f"{stem}-{number}"
        holes = np.flatnonzero(parent == own)
        outline = Polygon(
            orient_ring(rings[own].points, 1.0),
            tuple(orient_ring(rings[hole].points, -1.0) for hole in holes),
        )
        off = max(rings[k].off_mm for k in (own, *holes))
        drawings.append(Drawing(name, outline, off * (1 + _ROUNDING_SHARE) + reach * _ROUNDING_SHARE))
    return tuple(drawings)


def _check_area(rings: Sequence[Loop], sheet: Sheet) -> None:
    for ring in rings:
        if abs(signed_area(ring.points)) < _MIN_AREA_MM2:
            at = sheet.place(ring.points[0])
            raise InputError(f"{sheet.file}: {ring.label}: the outline at {at} encloses no area")


def _without_straight(loop: Loop, within_mm: float) -> Loop:
    """The loop without points that repeat the one before or lie on the line between their neighbours."""
    whole = loop.points
    index = np.flatnonzero(np.hypot(*(whole - np.roll(whole, 1, axis=0)).T) > _REPEATED_MM)
    points = whole[index]
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    across = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    aside = np.abs(cross(across, before))
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
    outline = EdgeRings.of([ring.points for ring in rings])
    owner, following = outline.ring, outline.following
    edges = shapely.linestrings(np.stack([outline.start, outline.end], axis=1))
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


def _nesting(rings: Sequence[Floats]) -> tuple[Ints, Ints]:
    """Depth (n,) of rings that do not meet, and the innermost ring (n,) around each, -1 for none."""
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
