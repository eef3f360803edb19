"""Places on outlines: where along its boundary a hypothesis is touched, seen from its own frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from palpate.base.geometry import Floats, Ints, Polygon
from palpate.base.geometry.plane import rotate
from palpate.recognizer.catalogue import Catalogue

__all__ = ["OutlinePlaces", "Span", "in_centred_frame", "places_on_outlines"]

_NEAR_MM = 1e-6

Span = tuple[float, float]
"""Heights (from, to) of a tip's ends, mm."""


@dataclass(frozen=True, eq=False)
class OutlinePlaces:
    """Places on the boundaries of h hypotheses, k on each: all (h, k), vectors (h, k, 2), frames centred.

    `foot` mm, unit `normal` outward; `along` mm: arc length from the ring's beginning, the solid on the left;
    `ring`: which ring of the state, of length `perimeter` mm; `gap` mm: from the foot to the point asked for.
    """

    foot: Floats
    normal: Floats
    along: Floats
    ring: Ints
    perimeter: Floats
    gap: Floats

    @classmethod
    def joined(cls, parts: Sequence["OutlinePlaces"]) -> "OutlinePlaces":
        """The places of all parts, one part after the other, on the same outlines."""
        return cls(
            *(np.concatenate([getattr(part, item.name) for part in parts], axis=1) for item in fields(cls))
        )

    def mapped(self, change: Callable[[Any], Any]) -> "OutlinePlaces":
        """The same change of all arrays: other rows, other columns."""
        return OutlinePlaces(*(change(getattr(self, item.name)) for item in fields(self)))


@dataclass(frozen=True, eq=False)
class _Boundary:
    """n segments of a state's rings, the solid on their left; see `OutlinePlaces`."""

    start: Floats
    direction: Floats
    length: Floats
    along: Floats
    ring: Ints
    perimeter: Floats


def places_on_outlines(
    catalogue: Catalogue, states: Ints, spans_mm: Sequence[Span], points: Floats
) -> OutlinePlaces:
    """Places nearest to `points` (h, k, 2), mm in the centred frames of `states` (h,), at heights (k).

    `spans_mm`: from which height to which the tip is that touches at each.
    """
    rows = []
    for state, own in zip(states.tolist(), points, strict=True):
        found = [_nearest(_boundary(catalogue, state, span), own, [each == span for each in spans_mm])
                 for span in dict.fromkeys(spans_mm)]  # fmt: skip
        row = [np.zeros((len(spans_mm), *part.shape[1:]), part.dtype) for part in found[0][1]]
        for columns, parts in found:
            for whole, part in zip(row, parts, strict=True):
                whole[columns] = part
        rows.append(row)
    return OutlinePlaces(*(np.stack(column) for column in zip(*rows, strict=True)))


def _nearest(boundary: _Boundary, points: Floats, chosen: Sequence[bool]) -> tuple[Ints, list[Floats]]:
    """Which points (columns) are chosen, and the fields of `OutlinePlaces` for these."""
    columns = np.flatnonzero(chosen)
    rel = points[columns][:, None] - boundary.start
    at = np.clip(np.sum(rel * boundary.direction, axis=2), 0.0, boundary.length)
    away = rel - at[..., None] * boundary.direction
    distance = np.hypot(away[..., 0], away[..., 1])
    best = np.argmin(distance, axis=1)
    pick = np.arange(len(columns)), best
    u, v = boundary.direction[best].T
    outward = np.column_stack([v, -u])
    gap = distance[pick]
    aside = away[pick] / np.maximum(gap, _NEAR_MM)[:, None]
    outside = (np.sum(aside * outward, axis=1) > 0) & (gap > _NEAR_MM)
    return columns, [
        points[columns] - away[pick],
        np.where(outside[:, None], aside, outward),
        boundary.along[best] + at[pick],
        boundary.ring[best],
        boundary.perimeter[best],
        gap,
    ]


def _boundary(catalogue: Catalogue, state: int, span_mm: Span) -> _Boundary:
    """The rings of a state in a span of heights; of all its sections, if it has none there.

    Some may be inside of others: no point outside is nearest to these.
    """
    item = catalogue.states[state]
    sections = item.state.sections_within(span_mm) or item.state.sections
    rings = [ring for section in sections for polygon in section.polygons for ring in _oriented(polygon)]
    start = np.concatenate(rings) - item.origin_mm
    step = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    length = np.hypot(*step.T)
    count = [len(ring) for ring in rings]
    parts = np.split(length, np.cumsum(count)[:-1])
    along = np.concatenate([np.cumsum(part) - part for part in parts])
    perimeter = np.array([part.sum() for part in parts])
    first = min(item.state.sections.index(section) for section in sections)
    kept = length > 0
    direction = step[kept] / length[kept, None]
    ring = np.repeat(np.arange(len(rings)), count)
    return _Boundary(
        start[kept], direction, length[kept], along[kept], 1000 * first + ring[kept], perimeter[ring][kept]
    )


def _oriented(polygon: Polygon) -> list[Floats]:
    """Its rings with the solid on the left."""
    return [_turning(polygon.outer, 1.0), *(_turning(hole, -1.0) for hole in polygon.holes)]


def _turning(ring: Floats, sign: float) -> Floats:
    x, y = ring.T
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return ring if sign * area > 0 else ring[::-1]


def in_centred_frame(points_mm: Floats, theta_rad: Floats, position_mm: Floats) -> Floats:
    """Points (k, 2) or (h, k, 2) of W, relative to the anchor, in the frames of h poses: (h, k, 2)."""
    seen = np.broadcast_to(points_mm, (len(theta_rad), *points_mm.shape[-2:]))
    return rotate(seen, np.broadcast_to(-theta_rad[:, None], seen.shape[:2])) - position_mm[:, None]
