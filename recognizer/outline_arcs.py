"""Arcs of a grown outline: exact corners where they meet other pieces, and even facets in between.

A facet that another piece
cuts short hides some of the arc above it, and the arcs' own crossing may lie well beyond the facets'; without
this, a finger that rests near the corner of a notch would be on no edge at all.
"""

import math

import numpy as np

from palpate.geometry import Floats, Ints

__all__ = ["facet_turn", "with_exact_arcs"]

_ON_CURVE_MM = 1e-8


def facet_turn(radius_mm: float, facet_error_mm: float) -> float:
    """Largest turn (rad) that one facet may stand for."""
    if radius_mm <= facet_error_mm:
        return math.pi / 4
    return min(math.pi / 4, 2 * math.acos(1 - facet_error_mm / radius_mm))


def with_exact_arcs(
    ring: Floats, feature: Ints, vertex_at: Floats, radius_mm: float, turn_rad: float
) -> tuple[Floats, Ints]:
    """The ring (n, 2) with each run of facets about one vertex replaced by even facets of its visible arc.

    `feature` (n,): edge k of the section is k, an arc about vertex k is −1 − k. `vertex_at` (m, 2): the
    section's vertices. No facet turns by more than `turn_rad`. Returns the new ring and its features.
    """
    begins = np.flatnonzero(feature != np.roll(feature, 1))
    if len(begins) == 0:
        begins = np.zeros(1, np.int64)
    corners = [_corner(ring, feature, int(at), vertex_at, radius_mm) for at in begins]
    points: list[Floats] = []
    features: list[int] = []
    for run, at in enumerate(begins):
        of = int(feature[at])
        count = int((begins[(run + 1) % len(begins)] - at - 1) % len(ring)) + 1
        here, there = corners[run], corners[(run + 1) % len(begins)]
        old = ring[(at + np.arange(1, count)) % len(ring)]
        inner = old if of >= 0 or len(begins) == 1 else _arc(here, there, old, vertex_at[-1 - of], turn_rad)
        points += [here, *inner]
        features += [of] * (1 + len(inner))
    return _without_empty(np.array(points), np.array(features, dtype=np.int64))


def _arc(here: Floats, there: Floats, old: Floats, centre: Floats, turn_rad: float) -> Floats:
    """Points strictly between the corners of an arc; the old ones where the arc has lost its order."""
    begin, end = here - centre, there - centre
    first = math.atan2(begin[1], begin[0])
    turn = (math.atan2(end[1], end[0]) - first) % (2 * math.pi)
    if turn > math.pi * 1.5:
        return old
    radius = (float(np.hypot(*begin)) + float(np.hypot(*end))) / 2
    count = max(1, math.ceil(turn / turn_rad - 1e-9))
    angle = first + turn * np.arange(1, count) / count
    return np.asarray(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def _corner(ring: Floats, feature: Ints, at: int, vertex_at: Floats, radius_mm: float) -> Floats:
    """Where the curves before and after ring vertex `at` truly meet, if they do so near it."""
    point = ring[at]
    before, after = int(feature[at - 1]), int(feature[at])
    centres = [vertex_at[-1 - of] for of in (before, after) if of < 0]
    if all(abs(float(np.hypot(*(point - c))) - radius_mm) < _ON_CURVE_MM for c in centres):
        return np.asarray(point)
    if len(centres) == 2:
        candidates = _two_circles(centres[0], centres[1], radius_mm)
    else:
        edge = (ring[at - 1], point) if before >= 0 else (point, ring[(at + 1) % len(ring)])
        candidates = _circle_and_line(centres[0], edge[0], edge[1], radius_mm)
        # The straight piece must keep its direction: the corner may shorten it, not turn it round.
        far, near = (edge[0], edge[1]) if before >= 0 else (edge[1], edge[0])
        candidates = [c for c in candidates if float(np.dot(c - far, near - far)) > 0]
    if not candidates:
        return np.asarray(point)
    return min(candidates, key=lambda c: float(np.hypot(*(c - point))))


def _two_circles(a: Floats, b: Floats, radius_mm: float) -> list[Floats]:
    gap = b - a
    half = float(np.hypot(*gap)) / 2
    if not 0.0 < half < radius_mm:
        return []
    reach = math.sqrt(radius_mm**2 - half**2) / (2 * half)
    across = np.array([-gap[1], gap[0]])
    return [np.asarray((a + b) / 2 + sign * reach * across) for sign in (-1.0, 1.0)]


def _circle_and_line(centre: Floats, begin: Floats, end: Floats, radius_mm: float) -> list[Floats]:
    along = (end - begin) / float(np.hypot(*(end - begin)))
    foot = begin + float(np.dot(centre - begin, along)) * along
    square = radius_mm**2 - float(np.sum((foot - centre) ** 2))
    if square < 0:
        return []
    return [np.asarray(foot + sign * math.sqrt(square) * along) for sign in (-1.0, 1.0)]


def _without_empty(ring: Floats, feature: Ints) -> tuple[Floats, Ints]:
    """Without edges of no length."""
    kept = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1) > _ON_CURVE_MM
    return ring[kept], feature[kept]
