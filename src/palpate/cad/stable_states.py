"""Stable states of a solid on a plane, with resting probability and tipping angle.

A state is a face of the convex hull with the centre of mass above it. Its x axis is the file's x axis as seen
from above (the file's y axis where x is within 26° of upright): it depends on the way the part was drawn and
not on how its curves were cut into triangles. For parts that a fixture holds, a solid may also rest as it
lies in its file (`as_drawn`).

Probabilities are the quasi-static estimate for a solid dropped at random. All attitudes are equally likely,
the solid hits the plane with the face that is below its centre of mass, and rolls without momentum: where the
centre of mass is not above the face, over the edge between the two, face by face, until it is (Wiegley, Rao &
Goldberg, Computing a statistical distribution of stable poses for a polyhedron, Allerton 1992; Goldberg,
Mirtich et al., Part pose statistics, IEEE Trans. Robotics and Automation 15, 1999).

On a surface that is curved both ways (a dome on its round side, an egg) a solid leans: facets tell how far
the surface is, and only nearly where it is lowest, so it comes to rest on one facet or another near the true
place, leaning by some degrees. About its axis a solid of revolution leans nowhere: the axis itself is upright
then, if facets show that the lowest place is near it.

*Hull.* A solid on a plane rests on a face of its hull. Qhull makes triangles; here those in one plane become
one face again. A face grows from its largest triangle and takes in neighbours whose corners are within 1e-5
of the solid's size from that triangle's plane: more than single precision loses in files, less than any gap
that lets a part rock noticeably.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import ConvexHull
from shapely.geometry.polygon import orient

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.cad.parts import Solid, StableState

_COPLANAR_SHARE = 1e-5


@dataclass(frozen=True, eq=False)
class Hull:
    """Faces of a convex hull, in the solid's frame moved so that its centre of mass is at the origin, mm.

    `points_mm` (n, 3); `triangles` (t, 3) of them, counter-clockwise from outside; `face` (t,): which face
    a triangle belongs to. Of faces: `normal` (f, 3) outwards, `height_mm` (f,) of the origin when the solid
    lies on the face, `middle_mm` (f, 3), the centre of its area. Of edges as seen from one of their two
    faces: `edge_face` (e,), `edge_next` (e,) the face beyond, `edge_mm` (e, 2, 3) its ends, counter-clockwise
    about the face. `size_mm`: the largest extent along the file's axes.
    """

    points_mm: Floats
    triangles: Ints
    face: Ints
    normal: Floats
    height_mm: Floats
    middle_mm: Floats
    edge_face: Ints
    edge_next: Ints
    edge_mm: Floats
    size_mm: float


def centre_of_mass(solid: Solid) -> Floats:
    """Centre (3,) of the volume inside a closed surface, in the solid's frame, mm.

    Raises InputError if there is none.
    """
    start = solid.vertices_mm[solid.faces[0, 0]]
    a, b, c = (solid.vertices_mm[solid.faces[:, k]] - start for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    if volume.sum() <= 0:
        raise InputError(f"{solid.name}: the part encloses no volume")
    centre: Floats = start + volume @ (a + b + c) / (4 * volume.sum())
    return centre


def hull_of(solid: Solid) -> Hull:
    """The hull with its faces. Raises InputError for a flat solid, or one whose surface is not closed."""
    points = solid.vertices_mm - centre_of_mass(solid)
    # Joggled by some 1e-11: exact coplanarity, thousands of points on a circle, takes Qhull minutes.
    found = ConvexHull(points, qhull_options="QJ")
    if (found.equations[:, 3] >= 0).any():
        raise InputError(f"{solid.name}: its centre of mass is outside of it: the surface is not closed")
    triangles, neighbours = _orient_outward(points, found)
    corners = points[triangles]
    legs = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(legs, axis=1)
    size_mm = float(np.ptp(points, axis=0).max())
    face = _faces(corners, neighbours, found.equations, area, _COPLANAR_SHARE * size_mm)
    normal = _sums(legs, face)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    middle = _sums(area[:, None] * corners.mean(axis=1), face) / _sums(area, face)[:, None]
    # The lowest corner is on the table; rounding may bend a face so that it is one just beyond its edge.
    height = np.full(len(normal), -np.inf)
    for other in (np.arange(len(face)), *neighbours.T):
        np.maximum.at(height, face, np.einsum("ijk,ik->ij", corners[other], normal[face]).max(axis=1))
    inner, following = np.repeat(face, 3), face[neighbours.ravel()]
    border = inner != following
    edges = corners[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2, 3)[border]
    # A sliver's own sense of rotation may be lost in rounding, the face's is not.
    arms = edges - middle[inner[border], None]
    reverse = (np.cross(arms[:, 0], arms[:, 1]) * normal[inner[border]]).sum(axis=1) < 0
    edges[reverse] = edges[reverse, ::-1]
    return Hull(
        points, triangles, face, normal, height, middle, inner[border], following[border], edges, size_mm
    )


def _orient_outward(points: Floats, found: ConvexHull) -> tuple[Ints, Ints]:
    """Triangles (t, 3) counter-clockwise from outside; their neighbours (t, 3) across from each corner."""
    triangles, neighbours = found.simplices.astype(np.int64), found.neighbors.astype(np.int64)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    neighbours[inward] = neighbours[inward][:, [0, 2, 1]]
    return triangles, neighbours


def _faces(corners: Floats, neighbours: Ints, planes: Floats, area: Floats, flat_mm: float) -> Ints:
    """Number (t,) of the face of each triangle."""
    off = np.einsum("tkcj,tj->tkc", corners[neighbours], planes[:, :3]) + planes[:, 3, None, None]
    seeds = np.flatnonzero((np.abs(off) <= flat_mm).all(axis=2).any(axis=1))
    # Triangle by triangle plain numbers are ten times as fast as small arrays.
    places, beside = corners.tolist(), neighbours.tolist()
    face = [-1] * len(corners)
    count = 0
    for seed in seeds[np.lexsort((seeds, -area[seeds]))].tolist():
        if face[seed] >= 0:
            continue
        nx, ny, nz, shift = planes[seed].tolist()
        face[seed] = count
        ahead = list(beside[seed])
        while ahead:
            triangle = ahead.pop()
            if face[triangle] < 0 and all(
                abs(nx * x + ny * y + nz * z + shift) <= flat_mm for x, y, z in places[triangle]
            ):
                face[triangle] = count
                ahead += beside[triangle]
        count += 1
    numbers = np.array(face)
    alone = np.flatnonzero(numbers < 0)
    numbers[alone] = count + np.arange(len(alone))
    return numbers


def _sums(values: Floats, face: Ints) -> Floats:
    """Sums of the triangles' values (t, …) over each face."""
    total = np.zeros((int(face.max()) + 1, *values.shape[1:]))
    np.add.at(total, face, values)
    return total


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
    """Distance of the centre of mass inside of each edge (e,) of its face in projection, < 0 beyond it."""
    start, end = hull.edge_mm[:, 0], hull.edge_mm[:, 1]
    along = end - start
    outwards = np.cross(along, hull.normal[hull.edge_face])
    result: Floats = (outwards * start).sum(axis=1) / np.linalg.norm(outwards, axis=1)
    return result


def _resting_probability(hull: Hull) -> Floats:
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


LEAST_TIPPING_RAD = math.radians(1.0)
"""A state that a smaller tilt tips over does not survive being touched."""
_CURVED_EDGE_RAD = math.radians(10.5)
"""Over an edge that turns by less, a solid rolls on a curved surface that was cut into facets."""
_MOST_LEANING_RAD = math.radians(20.0)
"""Of a face that rolls on over each of its edges, unless one takes more tilt: a cone is straight one way."""
_ROUNDING_RAD = 1e-6
_UPRIGHT_COSINE = 0.9


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
    probability = _resting_probability(hull)
    tipping, falling, leaning = _tipping_rad(hull)
    triangles = hull.triangles[np.argsort(hull.face, kind="stable")]
    first = np.r_[0, np.cumsum(np.bincount(hull.face))]
    faces = _in_order(hull, probability)
    rotations = _rotations_onto(hull.normal[faces])
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
            support = _convex_corners(corners @ rotation[:2].T)
            states.append(StableState(name, rotation, offset, share, tilt, support, leans))
    return states, out


def _rotations_onto(down: Floats) -> Floats:
    """Rotations (n, 3, 3) that take unit directions (n, 3) of the file to −z, its x axis (or y) above +x."""
    z = -down
    axis = np.where(np.abs(z[:, :1]) < _UPRIGHT_COSINE, np.eye(3)[0], np.eye(3)[1])
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
    edges = turn < math.cos(_CURVED_EDGE_RAD)
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


def _convex_corners(points: Floats) -> Floats:
    """Corners (n, 2) of the convex hull of points in the plane, counter-clockwise; three are one already."""
    if len(points) == 3:
        p, q = points[1] - points[0], points[2] - points[0]
        return points if p[0] * q[1] > p[1] * q[0] else points[::-1].copy()
    corners: Floats = points[ConvexHull(points).vertices]
    return corners


_NEAR_AXIS_RAD = math.radians(20.0)
"""How far from the axis facets that stand for an upright state may be."""
_TILT_SAMPLES = 41


def settle_leaning(solid: Solid, states: Sequence[StableState]) -> tuple[list[StableState], list[LeftOut]]:
    """The states without those that lean, which become one for either end of the axis or are left out."""
    kept = [state for state in states if not state.leans]
    leaning = [state for state in states if state.leans]
    for end in () if solid.axis is None else (solid.axis, -solid.axis):
        near = [state for state in leaning if -state.rotation[2] @ end > math.cos(_NEAR_AXIS_RAD)]
        if near and _is_lowest_on_axis(solid, end):
            kept.insert(0, upright_state(solid, end, near))
            leaning = [state for state in leaning if not any(state is item for item in near)]
    if not leaning:
        return kept, []
    reason = "lies on a surface that is curved both ways, of which facets do not tell how far it leans"
    share = sum(state.probability for state in leaning)
    return kept, [LeftOut(f"{reason}: {100 * share:.2g} %", share, -leaning[0].rotation[2])]


def upright_state(solid: Solid, down: Floats, states: Sequence[StableState]) -> StableState:
    """The state with a direction (3,) down, in place of others."""
    rotation = _rotations_onto(down[None])[0]
    centre = centre_of_mass(solid)
    offset = -rotation @ centre
    offset[2] += _height_mm(solid, centre, down)
    return replace(
        states[0],
        rotation=rotation,
        offset_mm=offset,
        probability=sum(state.probability for state in states),
        tipping_angle_rad=max(min(state.tipping_angle_rad for state in states), 0.0),
        support_mm=np.zeros((1, 2)),
        leans=False,
    )


def _is_lowest_on_axis(solid: Solid, down: Floats) -> bool:
    """True if the centre of mass is lowest on the axis, as far as can be told, and higher further off."""
    centre = centre_of_mass(solid)
    aside = _rotations_onto(down[None])[0][0]
    leaning = [
        _height_mm(solid, centre, math.cos(tilt) * down + math.sin(tilt) * aside)
        for tilt in np.linspace(0.0, _NEAR_AXIS_RAD, _TILT_SAMPLES).tolist()
    ]
    # The true surface is as far as this from the facets: twice as much higher is higher for certain.
    return min(leaning) > leaning[0] - solid.off_mm and leaning[-1] > leaning[0] + 2 * solid.off_mm


def _height_mm(solid: Solid, centre: Floats, down: Floats) -> float:
    """Height of the centre above a plane that the solid lies on."""
    return float(((solid.vertices_mm - centre) @ down).max())


_AS_DRAWN = "as-is"
"""Name of the only state of a solid that is taken as it lies in its file."""

_TOUCHING_SHARE = 1e-6  # of its size: vertices that are no higher above the lowest touch the table


def state_as_drawn(solid: Solid) -> StableState:
    """The state with the file's axes, the lowest point on the table and the centre of mass above the origin.

    `probability` is 1. `tipping_angle_rad` is 0 if nothing holds it so: its centre of mass is not above what
    it rests on.
    """
    centre, lowest = centre_of_mass(solid), float(solid.vertices_mm[:, 2].min())
    offset = np.array([-centre[0], -centre[1], -lowest])
    placed = solid.vertices_mm + offset
    touching = placed[placed[:, 2] <= _TOUCHING_SHARE * float(np.ptp(placed, axis=0).max()), :2]
    support = shapely.MultiPoint(touching).convex_hull
    origin = shapely.Point(0.0, 0.0)
    corners, tipping = np.empty((0, 2)), 0.0
    if support.geom_type == "Polygon":
        corners = np.asarray(orient(support).exterior.coords)[:-1]
    if len(corners) and support.contains(origin):
        reach = support.exterior.distance(origin)
        tipping = float(np.arctan2(reach, centre[2] - lowest))
    return StableState(_AS_DRAWN, np.eye(3), offset, 1.0, tipping, corners)


def volume_mm3(solid: Solid) -> float:
    """Volume that the surface encloses, by the divergence theorem."""
    about: Floats = solid.vertices_mm.mean(axis=0)
    a, b, c = (solid.vertices_mm[solid.faces[:, k]] - about for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
