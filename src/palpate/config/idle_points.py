"""Points of outlines that say nothing: they repeat the one before, or lie on a straight line between others.

Exporters write them; an outline is the same without them. They are dropped, and that is said, since edges of
answers are counted without them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from palpate.base.errors import counted
from palpate.base.geometry import Bools, Floats
from palpate.config.objects_rings import CircleText, Outline
from palpate.config.objects_tables import ObjectsFileText, ObjectText
from palpate.config.outlines import MIN_EDGE_MM

__all__ = ["without_idle_points"]

_STRAIGHT_MM = 1e-7
"""From a straight line; less than what makes two points of one."""
_FAR_MM = 1e9
"""Further out numbers are too coarse to tell; such outlines are refused elsewhere."""


def without_idle_points(text: ObjectsFileText) -> tuple[ObjectsFileText, tuple[str, ...]]:
    """The file's text without such points, and a line for every object that had some."""
    objects, lines = [], []
    for item in text.objects:
        made, repeated, straight = _object(item)
        objects.append(made)
        words = [
            *(
                [f"{counted(repeated, 'point that repeats', 'points that repeat')} the one before"]
                if repeated
                else []
            ),
            *([f"{counted(straight, 'point', 'points')} on a straight line"] if straight else []),
        ]
        if words:
            lines.append(f'object "{item.name}": left out {" and ".join(words)}; edges are counted without')
    return (text.model_copy(update={"objects": objects}) if lines else text), tuple(lines)


def _object(item: ObjectText) -> tuple[ObjectText, int, int]:
    """An object without idle points, and how many were repeated and on straight lines."""
    counts = np.zeros(2, dtype=np.int64)

    def kept(outline: Outline) -> Outline:
        found, *dropped = _outline(outline)
        counts[:] += dropped
        return found

    if item.states is None:
        outline = None if item.outline is None else kept(item.outline)
        made = item.model_copy(update={"outline": outline})
    else:
        states = []
        for state in item.states:
            sections = []
            for section in state.sections:
                polygons = [
                    polygon.model_copy(
                        update={"outer": kept(polygon.outer), "holes": [kept(hole) for hole in polygon.holes]}
                    )
                    for polygon in section.polygons
                ]
                sections.append(section.model_copy(update={"polygons": polygons}))
            states.append(state.model_copy(update={"sections": sections}))
        made = item.model_copy(update={"states": states})
    repeated, straight = counts.tolist()
    return (made if repeated or straight else item), repeated, straight


def _outline(outline: Outline) -> tuple[Outline, int, int]:
    """An outline without idle points, but at least three; how many were repeated and on straight lines."""
    if isinstance(outline, CircleText) or len(outline) < 3:
        return outline, 0, 0
    points = np.array([point[:2] for point in outline], dtype=np.float64)
    bent = np.array([len(point) == 3 and point[2] != 0 for point in outline])
    if (np.abs(points) > _FAR_MM).any():
        return outline, 0, 0
    differs = np.hypot(*(np.roll(points, -1, axis=0) - points).T) >= MIN_EDGE_MM
    some = np.flatnonzero(differs)
    idle = _straight(points[some], bent[some]) if len(some) > 2 else np.zeros(len(some), dtype=bool)
    left = some[~idle]
    if len(left) == len(points) or len(left) < 3:
        return outline, 0, 0
    chosen: Sequence[Any] = outline
    return [chosen[k] for k in left.tolist()], int((~differs).sum()), int(idle.sum())


def _straight(points: Floats, bent: Bools) -> Bools:
    """Which points (n, 2) lie between their neighbours; `bent` (n,): an arc runs to the next point."""
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    across = before + after
    aside = np.abs(across[:, 0] * before[:, 1] - across[:, 1] * before[:, 0])
    idle: Bools = (
        (aside <= _STRAIGHT_MM * np.hypot(*across.T))
        & ((before * after).sum(axis=1) > 0)
        & ~bent
        & ~np.roll(bent, 1)
    )
    kept = points[~idle]
    if len(kept) < 3 or not idle.any():
        return np.zeros(len(points), dtype=bool)
    # Fine curves bend by as little at each point: then all of them count.
    off = shapely.distance(shapely.points(points[idle]), shapely.LinearRing(kept))
    return idle if float(off.max()) <= _STRAIGHT_MM else np.zeros(len(points), dtype=bool)
