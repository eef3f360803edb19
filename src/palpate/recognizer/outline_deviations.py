"""Deviations of a stranger's outline from a hypothesis's: a Gaussian process conditioned on touches.

Places on outlines say where along its boundary a hypothesis is touched, seen from its own frame. The outline
is displaced along its normals by a process over arc length with covariance σ² exp(−r² / 2ℓ²), r being the
chord of the circle on which the ring is rolled up, and scaled. A rigid motion of the stranger is not known,
either: kriging with a trend. Normals are the process's derivative (C. E. Rasmussen and C. K. I. Williams,
Gaussian Processes for Machine Learning, MIT Press, 2006, §2.7 and §9.4).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.special import erf, ndtr

from palpate.base.geometry import Floats, Ints, Polygon
from palpate.base.geometry.outlines import EdgeRings
from palpate.base.geometry.plane import orient_ring, rotate
from palpate.recognizer.catalogue import Catalogue

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
    def join(cls, parts: Sequence["OutlinePlaces"]) -> "OutlinePlaces":
        """The places of all parts, one part after the other, on the same outlines."""
        return cls(
            *(np.concatenate([getattr(part, item.name) for part in parts], axis=1) for item in fields(cls))
        )

    def map(self, change: Callable[[Any], Any]) -> "OutlinePlaces":
        """The same change of all arrays: other rows, other columns."""
        return OutlinePlaces(*(change(getattr(self, item.name)) for item in fields(self)))


def places_on_outlines(
    catalogue: Catalogue, states: Ints, spans_mm: Sequence[Span], points: Floats
) -> OutlinePlaces:
    """Places nearest to `points` (h, k, 2), mm in the centred frames of `states` (h,), at heights (k).

    `spans_mm`: from which height to which the tip is that touches at each.
    """
    rows = []
    for state, own in zip(states.tolist(), points, strict=True):
        origin = catalogue.states[state].origin_mm
        found = [
            _nearest(_edges(catalogue, state, span), origin, own, [each == span for each in spans_mm])
            for span in dict.fromkeys(spans_mm)
        ]
        row = [np.zeros((len(spans_mm), *part.shape[1:]), part.dtype) for part in found[0][1]]
        for columns, parts in found:
            for whole, part in zip(row, parts, strict=True):
                whole[columns] = part
        rows.append(row)
    return OutlinePlaces(*(np.stack(column) for column in zip(*rows, strict=True)))


def _nearest(
    edges: EdgeRings, origin_mm: Floats, points: Floats, chosen: Sequence[bool]
) -> tuple[Ints, list[Floats]]:
    """Columns of the chosen points, and the fields of `OutlinePlaces` for these."""
    columns = np.flatnonzero(chosen)
    rel = points[columns][:, None] - (edges.start - origin_mm)
    at = np.clip(np.sum(rel * edges.direction, axis=2), 0.0, edges.length)
    away = rel - at[..., None] * edges.direction
    distance = np.hypot(away[..., 0], away[..., 1])
    best = np.argmin(distance, axis=1)
    pick = np.arange(len(columns)), best
    gap = distance[pick]
    aside = away[pick] / np.maximum(gap, _NEAR_MM)[:, None]
    outward = edges.normal[best]
    outside = (np.sum(aside * outward, axis=1) > 0) & (gap > _NEAR_MM)
    lengths = np.split(edges.length, edges.first[1:])
    along = np.concatenate([np.cumsum(part) - part for part in lengths])
    perimeter = np.concatenate([np.full(len(part), part.sum()) for part in lengths])
    return columns, [
        points[columns] - away[pick],
        np.where(outside[:, None], aside, outward),
        along[best] + at[pick],
        edges.ring[best],
        perimeter[best],
        gap,
    ]


def _edges(catalogue: Catalogue, state: int, span_mm: Span) -> EdgeRings:
    """Edges of a state in a span of heights, the solid on their left; of all sections, if none is there.

    Some may be inside of others: no point outside is nearest to these.
    """
    item = catalogue.states[state].state
    sections = item.sections_within(span_mm) or item.sections
    rings = [
        ring[(ring != np.roll(ring, -1, axis=0)).any(axis=1)]
        for section in sections
        for polygon in section.polygons
        for ring in _oriented_rings(polygon)
    ]
    first = min(item.sections.index(section) for section in sections)
    edges = EdgeRings.of(rings)
    return EdgeRings(edges.start, 1000 * first + edges.ring)


def _oriented_rings(polygon: Polygon) -> list[Floats]:
    """Rings of a polygon with the solid on the left."""
    return [orient_ring(polygon.outer, 1.0), *(orient_ring(hole, -1.0) for hole in polygon.holes)]


def in_centred_frame(points_mm: Floats, theta_rad: Floats, position_mm: Floats) -> Floats:
    """Points (k, 2) or (h, k, 2) of W, relative to the anchor, in the frames of h poses: (h, k, 2)."""
    seen = np.broadcast_to(points_mm, (len(theta_rad), *points_mm.shape[-2:]))
    return rotate(seen, np.broadcast_to(-theta_rad[:, None], seen.shape[:2])) - position_mm[:, None]


_RIGID_SHIFT_MM, _RIGID_TURN_RAD = 100.0, 1.5  # standard deviations of the rigid motion: any
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Deviations:
    """m kinds of strangers, all (m,): standard deviation `sigma_mm` of what varies along the outline, its
    correlation length `length_mm`, and standard deviation `scale` of the size, relative.
    """

    sigma_mm: Floats
    length_mm: Floats
    scale: Floats


@dataclass(frozen=True, eq=False)
class OutlineTouches:
    """Touches at places of h outlines, and what agrees there, for t touches, all (h, t).

    Deviations from −`inward_mm` to `outward_mm` agree, with normals within `normal_rad` of the predicted one.
    `noise_mm` and `noise_rad`: standard deviations of the measurement; `known_mm` and `known_rad`: of what is
    known of the deviation and of the normal once the touch has agreed.
    """

    places: OutlinePlaces
    inward_mm: Floats
    outward_mm: Floats
    normal_rad: Floats
    noise_mm: Floats
    noise_rad: Floats
    known_mm: Floats
    known_rad: Floats

    def append(self, other: "OutlineTouches") -> "OutlineTouches":
        """These touches, and then those of another on the same outlines."""
        numbers = [
            np.concatenate([getattr(self, item.name), getattr(other, item.name)], axis=1)
            for item in fields(self)[1:]
        ]
        return OutlineTouches(OutlinePlaces.join([self.places, other.places]), *numbers)

    def column(self, index: int) -> "OutlineTouches":
        """One of the touches."""
        return self.map(lambda item: item[:, index : index + 1])

    def map(self, change: Callable[[Any], Any]) -> "OutlineTouches":
        """The same change of all arrays: other rows, other columns."""
        numbers = [change(getattr(self, item.name)) for item in fields(self)[1:]]
        return OutlineTouches(self.places.map(change), *numbers)


def agreement(touches: OutlineTouches, deviations: Deviations) -> Floats:
    """Probability (m, h, t) that strangers of each kind agree with a touch, given that they did before."""
    deviation, normal = _conditional_deviations(touches, deviations)
    across, turned = np.hypot(deviation, touches.noise_mm), np.hypot(normal, touches.noise_rad)
    stops = ndtr(touches.outward_mm / across) - ndtr(-touches.inward_mm / across)
    result: Floats = stops * erf(touches.normal_rad / (np.sqrt(2.0) * turned))
    return result


def _conditional_deviations(touches: OutlineTouches, deviations: Deviations) -> tuple[Floats, Floats]:
    """Standard deviations (m, h, t) of every deviation and turn of the normal, given all the touches before.

    Cholesky's factor has them on its diagonal, deviation and normal of one touch after those of the other.
    """
    covariance = _covariance(touches.places, deviations)
    known = np.stack([touches.known_mm, touches.known_rad], axis=2).reshape(len(touches.known_mm), -1)
    index = np.arange(covariance.shape[2])
    covariance[:, :, index, index] += known**2
    diagonal = np.linalg.cholesky(covariance)[:, :, index, index]
    spread = np.sqrt(np.maximum(diagonal**2 - known**2, _LEAST_VARIANCE))
    return spread[:, :, 0::2], spread[:, :, 1::2]


def _covariance(places: OutlinePlaces, deviations: Deviations) -> Floats:
    """Prior covariance (m, h, 2t, 2t) of deviations and turns of the normal, one touch after the other."""
    hypotheses, count = places.along.shape
    smooth = _smooth_covariance(places, deviations)
    support = np.sum(places.normal * places.foot, axis=2)
    sized = (deviations.scale**2)[:, None, None, None] * (support[:, :, None] * support[:, None])
    smooth[..., 0, :, 0] += sized
    result: Floats = smooth.reshape(len(deviations.scale), hypotheses, 2 * count, 2 * count)
    result += motion_covariance(places)
    return result


def motion_covariance(places: OutlinePlaces) -> Floats:
    """Covariance (h, 2t, 2t) of deviations and turns of the normal that any rigid motion causes."""
    hypotheses, count = places.along.shape
    x, y = np.moveaxis(places.foot, 2, 0)
    u, v = np.moveaxis(places.normal, 2, 0)
    trend = np.zeros((hypotheses, count, 2, 3))
    trend[..., 0, :] = -np.stack(
        [u * _RIGID_SHIFT_MM, v * _RIGID_SHIFT_MM, (x * v - y * u) * _RIGID_TURN_RAD], axis=2
    )
    trend[..., 1, 2] = -_RIGID_TURN_RAD
    flat = trend.reshape(hypotheses, 2 * count, 3)
    result: Floats = flat @ flat.swapaxes(1, 2)
    return result


def _smooth_covariance(places: OutlinePlaces, deviations: Deviations) -> Floats:
    """Covariance (m, h, t, 2, t, 2) of deviations that vary along the outline, and of the normal's turns."""
    same = places.ring[:, :, None] == places.ring[:, None]
    turn = 2 * np.pi / places.perimeter[:, :, None]
    u = turn * (places.along[:, :, None] - places.along[:, None])
    sin, cos, chord = np.sin(u) / turn, np.cos(u), 2 * np.sin(u / 2) / turn
    sigma, length = (item[:, None, None, None] for item in (deviations.sigma_mm, deviations.length_mm))
    value = np.where(same, sigma**2 * np.exp(-((chord / length) ** 2) / 2), 0.0)
    slope = -value * sin / length**2
    # The normal turns by −d′ where the displacement d grows.
    result = np.empty((*value.shape[:3], 2, value.shape[3], 2))
    result[..., 0, :, 0] = value
    result[..., 0, :, 1] = slope
    result[..., 1, :, 0] = slope.swapaxes(2, 3)
    result[..., 1, :, 1] = value * (cos - (sin / length) ** 2) / length**2
    return result
