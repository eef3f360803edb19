"""Resting probability of each face of a hull, for a solid dropped at random: the quasi-static estimate.

All attitudes are equally likely, the solid hits the plane with the face that is below its centre of mass, and
rolls without momentum: where the centre of mass is not above the face, over the edge between the two, face by
face, until it is (Wiegley, Rao & Goldberg, Computing a statistical distribution of stable poses for a
polyhedron, Allerton 1992; Goldberg, Mirtich et al., Part pose statistics, IEEE Trans. Robotics and Automation
15, 1999).
"""

import math

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.cad.hull import Hull

__all__ = ["margins_mm", "resting_probability", "solid_angles"]


def solid_angles(hull: Hull) -> Floats:
    """Solid angle (f,) of every face at the centre of mass; they sum to 4π.

    Triangle by triangle (van Oosterom & Strackee, The solid angle of a plane triangle, IEEE Trans.
    Biomedical Engineering 30, 1983).
    """
    a, b, c = (hull.points_mm[hull.triangles[:, k]] for k in range(3))
    la, lb, lc = (np.linalg.norm(item, axis=1) for item in (a, b, c))

    def dot(p: Floats, q: Floats) -> Floats:
        return np.asarray((p * q).sum(axis=1))

    volume = dot(a, np.cross(b, c))
    below = la * lb * lc + dot(a, b) * lc + dot(a, c) * lb + dot(b, c) * la
    angles = np.zeros(len(hull.normal))
    np.add.at(angles, hull.face, 2 * np.arctan2(volume, below))
    return angles


def margins_mm(hull: Hull) -> Floats:
    """How far inside of each edge (e,) of its face the centre of mass is in projection; beyond it: < 0."""
    start, end = hull.edge_mm[:, 0], hull.edge_mm[:, 1]
    along = end - start
    outwards = np.cross(along, hull.normal[hull.edge_face])
    result: Floats = (outwards * start).sum(axis=1) / np.linalg.norm(outwards, axis=1)
    return result


def resting_probability(hull: Hull) -> Floats:
    """Probability (f,) of coming to rest on each face; they sum to 1."""
    probability = solid_angles(hull) / (4 * math.pi)
    onto = _rolls_onto(hull)
    for face in np.argsort(-hull.height_mm, kind="stable"):
        if onto[face] != face:
            probability[onto[face]] += probability[face]
            probability[face] = 0.0
    return probability


def _rolls_onto(hull: Hull) -> Ints:
    """The face (f,) that each rolls onto, itself if it rests.

    The edge is the one that the way from the middle of the face to the projection of the centre of mass
    crosses. Rolling lowers the centre of mass; where rounding says otherwise the solid stays.
    """
    normal, middle = hull.normal[hull.edge_face], hull.middle_mm[hull.edge_face]
    way = normal * hull.height_mm[hull.edge_face, None] - middle
    start, end = hull.edge_mm[:, 0] - middle, hull.edge_mm[:, 1] - middle

    def left_of(p: Floats, q: Floats) -> Floats:
        return np.asarray((np.cross(p, q) * normal).sum(axis=1) / np.linalg.norm(p, axis=1))

    crossed = np.minimum(left_of(start, way), -left_of(end, way))
    onto = np.arange(len(hull.normal))
    beyond = np.zeros(len(onto), dtype=bool)
    beyond[hull.edge_face[margins_mm(hull) <= 0]] = True
    # Of each face the edge that is crossed most clearly comes last and stands.
    order = np.argsort(crossed, kind="stable")
    last = np.zeros(len(onto), dtype=np.int64)
    last[hull.edge_face[order]] = hull.edge_next[order]
    onto[beyond] = last[beyond]
    higher = hull.height_mm[onto] >= hull.height_mm
    return np.where(higher, np.arange(len(onto)), onto)
