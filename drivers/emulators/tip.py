"""An elastic fingertip against outlines: from where the tip is to the force on it and on its taxels.

Stands behind the emulated array and the emulated slide. The tip is a cylinder of compliant skin (an elastic
foundation; Johnson, Contact Mechanics, ch. 4.3): the skin yields along the radius, and how far it has to
yield in each direction is how far the object reaches into the undeformed circle. Each stretch of skin that is
touched pushes back with stiffness times its deepest dent, spread over the stretch in proportion to the dents.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Outline", "Press", "press", "separation_mm"]

Floats = NDArray[np.float64]

_RAYS = 1440  # directions in which dents are taken, a quarter of a degree apart: a corner dents only a few


@dataclass(frozen=True, eq=False)
class Outline:
    """What stands on the table: straight edges from `start` to `end`, each (n, 2) mm in W, and its top."""

    start: Floats
    end: Floats
    top_mm: float


@dataclass(frozen=True, eq=False)
class Press:
    """Force (2,) N on the tip in W, and its share by direction: N per ray at angles `angle` (m,) in W."""

    force_n: Floats
    angle: Floats
    by_ray_n: Floats


def separation_mm(outline: Outline, centre_mm: Floats) -> float:
    """Distance from a point to the nearest edge (mm); the inside of the outline counts as outside."""
    away = _to_edges(outline, centre_mm)
    return float(np.sqrt(np.min(np.einsum("ij,ij->i", away, away))))


def _to_edges(outline: Outline, centre_mm: Floats) -> Floats:
    """Shortest way (n, 2) in mm from each edge to a point."""
    along = outline.end - outline.start
    rel = centre_mm - outline.start
    square = np.einsum("ij,ij->i", along, along)
    share = np.clip(np.einsum("ij,ij->i", rel, along) / square, 0.0, 1.0)
    result: Floats = rel - share[:, None] * along
    return result


def press(outline: Outline, centre_mm: Floats, radius_mm: float, stiffness_n_per_mm: float) -> Press | None:
    """What the outline does to a tip with its axis at `centre_mm` in W; None if it does not touch it."""
    # Served on real ports, this runs for every finger in every millisecond: far edges are left out first.
    away = _to_edges(outline, centre_mm)
    square = np.einsum("ij,ij->i", away, away)
    near = square <= radius_mm**2
    if not near.any():
        return None
    outline = Outline(outline.start[near], outline.end[near], outline.top_mm)
    angle = np.arange(_RAYS) * (2 * math.pi / _RAYS)
    heading = np.column_stack([np.cos(angle), np.sin(angle)])
    # An edge at distance d from the axis is inside the circle for at most acos(d / r) either way of its
    # nearest point; all other rays reach the circle.
    towards = np.arctan2(-away[near, 1], -away[near, 0])
    width = np.arccos(np.minimum(np.sqrt(square[near]) / radius_mm, 1.0)) + 4 * math.pi / _RAYS
    apart = np.abs((angle[:, None] - towards + math.pi) % (2 * math.pi) - math.pi)
    looked = np.flatnonzero(np.any(apart <= width, axis=1))
    dent: Floats = np.zeros(_RAYS)
    dent[looked] = radius_mm - _reach(outline, centre_mm, heading[looked])
    touched = dent > 0
    if not touched.any():
        return None
    by_ray: Floats = np.zeros(_RAYS)
    for stretch in _stretches(touched):
        depth = dent[stretch]
        by_ray[stretch] = stiffness_n_per_mm * depth.max() * depth / depth.sum()
    force = np.asarray(-(by_ray @ heading), dtype=np.float64)
    return Press(force, np.asarray(angle, dtype=np.float64), by_ray)


def _reach(outline: Outline, centre_mm: Floats, heading: Floats) -> Floats:
    """Distance (m,) from the centre to the first edge in each direction; infinite where there is none."""
    along = outline.end - outline.start
    rel = outline.start - centre_mm
    turn = heading[:, None, 0] * along[None, :, 1] - heading[:, None, 1] * along[None, :, 0]
    parallel = np.abs(turn) < 1e-12
    safe = np.where(parallel, 1.0, turn)
    distance = (rel[:, 0] * along[:, 1] - rel[:, 1] * along[:, 0]) / safe
    share = (rel[None, :, 0] * heading[:, None, 1] - rel[None, :, 1] * heading[:, None, 0]) / safe
    met = ~parallel & (distance >= 0) & (share >= 0) & (share <= 1)
    result: Floats = np.where(met, distance, np.inf).min(axis=1)
    return result


def _stretches(touched: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Runs of touched rays round the circle."""
    if touched.all():
        return [np.arange(len(touched))]
    first_free = int(np.argmin(touched))
    order = (np.arange(len(touched)) + first_free) % len(touched)
    flags = touched[order]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [order[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
