"""Geometric checks that an outline is simple and apart from others; errors name the place of a fault.

Used for cross sections of objects and for obstacles of a rig, whose values already have the right types.
Nothing is repaired.
"""

import numpy as np
import shapely

from palpate.base.geometry import Floats

MIN_EDGE_MM = 1e-6
"""Points closer together than this are the same point."""

MIN_AREA_MM2 = 1e-6
"""An outline that encloses less encloses no area."""

_MAX_OVERLAP_MM2 = 1e-9

OutlineFault = tuple[int | None, str]
"""Index of the offending point (None: the whole outline) and what is wrong with it."""


def outline_problem(points: Floats) -> OutlineFault | None:
    """Say what keeps the outline through `points` (shape (n, 2), mm) from being simple, if anything."""
    if len(points) < 3:
        return None, f"has {len(points)} points; an outline needs at least 3"
    lengths = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    short = np.flatnonzero(lengths < MIN_EDGE_MM)
    if len(short):
        return _describe_repeat(points, int(short[0]))
    if not shapely.LinearRing(points).is_simple:
        return None, _describe_crossing(points)
    if shapely.Polygon(points).area < MIN_AREA_MM2:
        return None, "encloses no area"
    return None


def polygons_problem(
    polygons: list[tuple[Floats, list[Floats]]],
) -> tuple[int, int | None, str] | None:
    """Check simple outlines against each other: (polygon, hole or None, what is wrong), or None.

    `polygons`: (outer, holes) of one section, each outline of shape (n, 2), mm.
    """
    solids = [shapely.Polygon(*polygon) for polygon in polygons]
    near_solids = shapely.STRtree(solids)
    for index, (outer, holes) in enumerate(polygons):
        shell = shapely.Polygon(outer)
        cut = [shapely.Polygon(hole) for hole in holes]
        near_holes = shapely.STRtree(cut)
        for number, hole in enumerate(cut):
            if not shapely.contains_properly(shell, hole):
                outside = (
                    hole.difference(shell) if not shell.covers(hole) else hole.intersection(shell.boundary)
                )
                x, y = outside.representative_point().coords[0]
                where = "lies outside" if not shell.covers(hole) else "touches"
                return index, number, f"{where} the outer outline at ({x:.4g}, {y:.4g})"
            for other in _earlier(near_holes, hole, number):
                x, y = hole.intersection(cut[other]).representative_point().coords[0]
                return index, number, f"touches or overlaps hole {other} at ({x:.4g}, {y:.4g})"
        for other in _earlier(near_solids, solids[index], index):
            common = solids[index].intersection(solids[other])
            if common.area > _MAX_OVERLAP_MM2:
                x, y = common.representative_point().coords[0]
                return index, None, f"overlaps polygon {other} at ({x:.4g}, {y:.4g})"
    return None


def _earlier(tree: shapely.STRtree, shape: shapely.Polygon, number: int) -> list[int]:
    """Numbers of the shapes before this one that it intersects, in their order."""
    met = tree.query(shape, predicate="intersects")
    return sorted(met[met < number].tolist())


def _describe_repeat(points: Floats, first: int) -> OutlineFault:
    last = len(points) - 1
    if first == last:
        return last, "repeats point 0; an outline closes by itself, leave the last point out"
    return first + 1, f"repeats point {first}; leave one of them out"


def _describe_crossing(points: Floats) -> str:
    """Name the first two edges that meet where they should not, and the place."""
    edges = shapely.linestrings(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
    tree = shapely.STRtree(edges)
    # Edge by edge: all that meet may be as many as the square of the edges.
    pairs = ((k, other) for k in range(len(edges)) for other in np.sort(tree.query(edges[k], "intersects")))
    for first, second in pairs:
        if first >= second:
            continue
        meeting = edges[first].intersection(edges[second])
        gap = min(second - first, len(edges) - second + first)
        if gap == 1 and meeting.geom_type == "Point":
            continue
        x, y = (
            meeting.representative_point().coords[0]
            if meeting.geom_type != "LineString"
            else meeting.coords[0]
        )
        verb = "meets" if meeting.geom_type == "Point" else "runs back along"
        return f"intersects itself at ({x:.4g}, {y:.4g}): edge {first} {verb} edge {second}"
    return "intersects itself"
