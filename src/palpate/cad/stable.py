"""Stable states of a solid on a plane, with resting probability and tipping angle.

A state is a face of the convex hull with the centre of mass above it. Its x axis is the file's x axis as seen
from above (the file's y axis where x is within 26° of upright): it depends on the way the part was drawn and
not on how its curves were cut into triangles.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from palpate.base.geometry import Floats, Ints
from palpate.cad.hull import Hull, centre_of_mass, hull_of
from palpate.cad.resting_probability import margins_mm, resting_probability
from palpate.cad.values import Solid, StableState

__all__ = ["LEAST_TIPPING_RAD", "LeftOut", "rotations_onto", "stable_states"]

LEAST_TIPPING_RAD = math.radians(1.0)
"""A state that a smaller tilt tips over does not survive being touched."""
_CURVED_RAD = math.radians(10.5)
"""Over an edge that turns by less, a solid rolls on a curved surface that was cut into facets."""
_MOST_LEANING_RAD = math.radians(20.0)
"""Of a face that rolls on over each of its edges, unless one takes more tilt: a cone is straight one way."""
_ROUNDING_RAD = 1e-6
_UPRIGHT = 0.9


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A way to rest that is not among the states, and why; `down` (3,) points down in the file's frame.

    `probability` of coming to rest so.
    """

    reason: str
    probability: float
    down: Floats


def stable_states(solid: Solid, least_probability: float = 0.0) -> tuple[list[StableState], list[LeftOut]]:
    """Ways in which a solid rests, most probable first, and those that are too improbable or tip too soon.

    All probabilities together, those left out too, are 1. A state is unstable if a tilt of less than 1°
    takes it over an edge; an edge between facets of a curve (turned by 10.5° at most) does not
    count, since the solid only rolls there. Curved parts have as many states as facets: merge first and
    judge improbable ones then. Raises InputError for a solid without volume.
    """
    hull = hull_of(solid)
    probability = resting_probability(hull)
    tipping, falling, leaning = _tipping_rad(hull)
    triangles = hull.triangles[np.argsort(hull.face, kind="stable")]
    first = np.r_[0, np.cumsum(np.bincount(hull.face))]
    faces = _in_order(hull, probability)
    rotations = rotations_onto(hull.normal[faces])
    offsets = -rotations @ centre_of_mass(solid)
    offsets[:, 2] += hull.height_mm[faces]
    states: list[StableState] = []
    out: list[LeftOut] = []
    for face, rotation, offset in zip(faces, rotations, offsets, strict=True):
        share, tilt = float(probability[face]), float(tipping[face])
        leans = falling[face] == math.inf and leaning[face] < _MOST_LEANING_RAD
        if falling[face] < LEAST_TIPPING_RAD or (tilt < _ROUNDING_RAD and not leans):
            reason = f"unstable: a tilt of {math.degrees(max(tilt, 0.0)):.2g}° tips it over"
            out.append(LeftOut(reason, share, hull.normal[face]))
        elif share < least_probability:
            out.append(LeftOut(f"improbable: {100 * share:.2g} %", share, hull.normal[face]))
        else:
            corners = hull.points_mm[np.unique(triangles[first[face] : first[face + 1]])]
            name = f"state-{len(states) + 1}"
            support = _convex(corners @ rotation[:2].T)
            states.append(StableState(name, rotation, offset, share, tilt, support, leans))
    return states, out


def rotations_onto(down: Floats) -> Floats:
    """Rotations (n, 3, 3) that take unit directions (n, 3) of the file to −z, its x axis (or y) above +x."""
    z = -down
    axis = np.where(np.abs(z[:, :1]) < _UPRIGHT, np.eye(3)[0], np.eye(3)[1])
    x = axis - (axis * z).sum(axis=1)[:, None] * z
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=1)


def _tipping_rad(hull: Hull) -> tuple[Floats, Floats, Floats]:
    """Least tilt (f,) over any edge of each face, over one of no curve (inf: none), and the largest."""
    tilt = np.arctan2(margins_mm(hull), hull.height_mm[hull.edge_face])
    least = np.full(len(hull.normal), math.inf)
    np.minimum.at(least, hull.edge_face, tilt)
    sharp = np.full(len(hull.normal), math.inf)
    turn = (hull.normal[hull.edge_face] * hull.normal[hull.edge_next]).sum(axis=1)
    edges = turn < math.cos(_CURVED_RAD)
    np.minimum.at(sharp, hull.edge_face[edges], tilt[edges])
    largest = np.zeros(len(hull.normal))
    np.maximum.at(largest, hull.edge_face, tilt)
    return least, sharp, largest


def _in_order(hull: Hull, probability: Floats) -> Ints:
    """Faces to rest on by falling probability, then lower ones first, then by direction in the file."""
    some = np.flatnonzero(probability > 0)
    likely = -np.round(probability[some], 4)
    height = np.round(hull.height_mm[some] / hull.size_mm, 4)
    x, y, z = np.round(hull.normal[some], 3).T
    order: Ints = some[np.lexsort((z, y, x, height, likely))]
    return order


def _convex(points: Floats) -> Floats:
    """Corners (n, 2) of the convex hull of points in the plane, counter-clockwise; three are one already."""
    if len(points) == 3:
        p, q = points[1] - points[0], points[2] - points[0]
        return points if p[0] * q[1] > p[1] * q[0] else points[::-1].copy()
    corners: Floats = points[ConvexHull(points).vertices]
    return corners
