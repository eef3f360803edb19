"""A solid that rests as it lies in its file: an alternative to `stable`, for parts that a fixture holds."""

import numpy as np
import shapely
from shapely.geometry.polygon import orient

from palpate.base.geometry import Floats
from palpate.cad.hull import centre_of_mass
from palpate.cad.values import Solid, StableState

__all__ = ["AS_DRAWN", "as_drawn", "volume_mm3"]

AS_DRAWN = "as-is"
"""Name of the only state of a solid that is taken as it lies in its file."""

_RESTS = 1e-6  # of its size: vertices that are no higher above the lowest touch the table


def as_drawn(solid: Solid) -> StableState:
    """The state with the file's axes, the lowest point on the table and the centre of mass above the origin.

    `probability` is 1. `tipping_angle_rad` is 0 if nothing holds it so: its centre of mass is not above what
    it rests on.
    """
    centre, lowest = centre_of_mass(solid), float(solid.vertices_mm[:, 2].min())
    offset = np.array([-centre[0], -centre[1], -lowest])
    placed = solid.vertices_mm + offset
    touching = placed[placed[:, 2] <= _RESTS * float(np.ptp(placed, axis=0).max()), :2]
    support = shapely.MultiPoint(touching).convex_hull
    origin = shapely.Point(0.0, 0.0)
    corners, tipping = np.empty((0, 2)), 0.0
    if support.geom_type == "Polygon":
        corners = np.asarray(orient(support).exterior.coords)[:-1]
    if len(corners) and support.contains(origin):
        reach = support.exterior.distance(origin)
        tipping = float(np.arctan2(reach, centre[2] - lowest))
    return StableState(AS_DRAWN, np.eye(3), offset, 1.0, tipping, corners)


def volume_mm3(solid: Solid) -> float:
    """Volume that the surface encloses, by the divergence theorem."""
    about: Floats = solid.vertices_mm.mean(axis=0)
    a, b, c = (solid.vertices_mm[solid.faces[:, k]] - about for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
