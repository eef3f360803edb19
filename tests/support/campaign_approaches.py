"""Approaches of the campaign: at vertices, along edges, into slots, from the inside, and past everything."""

import math

import numpy as np
import shapely
from shapely_bench import unit
from shapely_contacts import edges_of

from palpate.base.geometry import Floats

CLEAR_MM = 1e-3  # at least, between a tip and the object where an approach begins
RING_MM, REACH_MM = 160.0, 340.0


def approach_to(
    shape: shapely.Geometry, radius: float, rng: np.random.Generator
) -> tuple[Floats, Floats, float]:
    """Start, unit heading and longest travel: mostly roughly to the middle of the object."""
    kind = rng.choice(
        ["middle", "off", "vertex", "edge", "slot", "inside", "graze"],
        p=[0.45, 0.1, 0.12, 0.1, 0.08, 0.1, 0.05],
    )
    if kind == "inside":
        start = _inside(shape, radius, rng)
        if start is not None:
            return start, unit(_direction(rng)), REACH_MM
    begin, end = edges_of(shape)
    k = int(rng.integers(len(begin)))
    along = (end[k] - begin[k]) / np.linalg.norm(end[k] - begin[k])
    outward = np.array([along[1], -along[0]])
    aside = float(rng.choice([0.0, 0.0, 1.0, -1.0, rng.uniform(-1, 1)])) * radius
    aside += float(rng.choice([0.0, 0.0, 1e-9, -1e-6, 1e-3, -0.1]))
    if kind == "vertex":
        heading = unit(_direction(rng))
        target = begin[k] + aside * np.array([-heading[1], heading[0]])
    elif kind == "edge":
        # Square onto the edge, near its end; or along it, just grazing.
        short = float(rng.choice([0.0, 1e-9, 1e-6, 1e-3, 0.1, 0.5])) * np.linalg.norm(end[k] - begin[k])
        heading, target = (-outward, begin[k] + short * along)
        if rng.random() < 0.3:
            heading, target = along * rng.choice([-1, 1]), begin[k] + aside * outward
    elif kind == "graze":
        lean = float(rng.choice([1e-4, 0.003, 0.02]))
        heading = math.cos(lean) * float(rng.choice([-1, 1])) * along - math.sin(lean) * outward
        target = (begin[k] + end[k]) / 2 + radius * outward
    elif kind == "slot":
        heading, target = _into_slot(begin, end, rng)
    else:
        heading = unit(_direction(rng))
        size = math.sqrt(shape.convex_hull.area)
        off = rng.normal(0.0, 0.2) if kind == "middle" else rng.choice([-1, 1]) * rng.uniform(0.3, 1.0)
        off, centre = off * size, shapely.get_coordinates(shape.centroid)[0]
        target = centre + off * np.array([-heading[1], heading[0]])
    return target - RING_MM * heading, heading, REACH_MM


def _direction(rng: np.random.Generator) -> float:
    if rng.random() < 0.15:
        return float(rng.integers(4)) * math.pi / 2
    return float(rng.uniform(-math.pi, math.pi))


def _inside(shape: shapely.Geometry, radius: float, rng: np.random.Generator) -> Floats | None:
    """A free start in a concavity or a hole: within the convex hull; None if a few tries find none."""
    hull = shape.convex_hull
    low, high = np.array(hull.bounds[:2]), np.array(hull.bounds[2:])
    for point in rng.uniform(low, high, (60, 2)):
        at = shapely.Point(point)
        if hull.contains(at) and shapely.distance(shape, at) > radius + CLEAR_MM:
            return np.asarray(point)
    return None


def _into_slot(begin: Floats, end: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Heading roughly along the bisector of a reflex vertex, and that vertex; any if none is reflex."""
    before, after = begin - np.roll(begin, 1, axis=0), end - begin
    joined = np.all(np.roll(end, 1, axis=0) == begin, axis=1)
    reflex = np.flatnonzero(joined & (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < 0))
    k = int(rng.choice(reflex)) if len(reflex) else int(rng.integers(len(begin)))
    into = before[k] / np.linalg.norm(before[k]) - after[k] / np.linalg.norm(after[k])
    angle = math.atan2(into[1], into[0]) + float(rng.choice([0.0, rng.normal(0.0, 0.1)]))
    return unit(angle), begin[k]
