"""Self-intersection of a surface: its interior would be undefined, so it is refused.

Two faces cross where they share a stretch of a line that is longer than eight times the tolerance of the
surface (`vertex_rounding`: a millionth of its size) and lie on both sides of each other there; faces in one
plane overlap if they do so by more than the tolerance. Touching is no crossing (neighbours at their
common vertices, a tip on a face, an edge along an edge), nor is anything between faces thinner than the
tolerance, which have no plane. One face of a pair is cut by the plane of the other (Möller, A fast
triangle-triangle intersection test, Journal of Graphics Tools 2(2), 1997); where they share a stretch, the
order of the four half-planes around it tells crossing from touching.

Nearly all pairs are spared: faces that all face one way, and whose common outline does not cross itself when
seen from there, are a height field, which covers every point of that view at most once (winding number of the
outline; compare Volino and Magnenat-Thalmann, Efficient self-collision detection on smoothly discretized
surface animations, Computer Graphics Forum 13, 1994).
"""

import itertools
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.mesh_topology import TriangleSurface, component_of, overlapping_pairs

_STRETCH_TOLERANCES = 8.0
"""Faces that share less than so many tolerances of a line touch in a point."""
_SAME_ANGLE_RAD = 1e-7
"""Half-planes around a line that differ by less coincide."""


@dataclass(frozen=True, eq=False)
class FaceCrossings:
    """Pairs of faces (k, 2) that pass through or lie in each other, and a point of both (k, 3)."""

    pairs: Ints
    places: Floats


def _crossing_pairs(surface: TriangleSurface, pairs: Ints) -> FaceCrossings:
    """Select the pairs (k, 2) of faces that cross, or lie in one plane and overlap.

    No face may be thin. Pairs with a common edge are left out: see `folded_edges`.
    """
    # Most pairs lie wholly on one side of one of their planes: these two lines decide about nearly all.
    pairs = pairs[_reaches(_sides(surface, pairs))]
    pairs = pairs[_reaches(_sides(surface, pairs[:, ::-1]))]
    corners = surface.faces[pairs]
    pairs = pairs[(corners[:, 0, :, None] == corners[:, 1, None, :]).sum(axis=(1, 2)) < 2]
    pairs = _slender_first(surface, pairs)
    sides = _sides(surface, pairs)
    flat = (sides == 0).all(axis=1)
    in_plane, in_places = _overlap(surface, pairs[flat])
    through, through_places = _pass_through(surface, pairs[~flat], sides[~flat])
    return FaceCrossings(
        np.vstack([pairs[flat][in_plane], pairs[~flat][through]]),
        np.vstack([in_places[in_plane], through_places[through]]),
    )


def _folded_edges(surface: TriangleSurface) -> FaceCrossings:
    """Neighbours that are folded flat onto each other along their common edge."""
    face, side = np.nonzero(surface.neighbours > np.arange(len(surface.faces))[:, None])
    pairs = np.column_stack([face, surface.neighbours[face, side]])
    opposed = (surface.normals[pairs[:, 0]] * surface.normals[pairs[:, 1]]).sum(axis=1) < -0.5
    pairs = _slender_first(surface, pairs[opposed])
    pairs = pairs[(_sides(surface, pairs) == 0).all(axis=1)]
    found, places = _overlap(surface, pairs)
    return FaceCrossings(pairs[found], places[found])


def _slender_first(surface: TriangleSurface, pairs: Ints) -> Ints:
    """Turn pairs so that the second face is the less slender one: its plane is known better."""
    turned = surface.heights[pairs[:, 0]] > surface.heights[pairs[:, 1]]
    return np.where(turned[:, None], pairs[:, ::-1], pairs)


def _sides(surface: TriangleSurface, pairs: Ints) -> Ints:
    """Side (k, 3) of the second face's plane on which each corner of the first is: -1, 0 (in it) or 1."""
    corners = surface.corners[pairs[:, 0]]
    base, normal = surface.corners[pairs[:, 1], 0], surface.normals[pairs[:, 1]]
    height = np.einsum("kvc,kc->kv", corners, normal) - np.einsum("kc,kc->k", base, normal)[:, None]
    result: Ints = (height > surface.tolerance).astype(np.int64) - (height < -surface.tolerance)
    return result


def _reaches(sides: Ints) -> Bools:
    """Does a face have more than a point in the plane?"""
    a, b, c = sides.T
    in_plane = (a == 0).astype(np.int64) + (b == 0) + (c == 0)
    result: Bools = (a * b < 0) | (b * c < 0) | (c * a < 0) | (in_plane >= 2)
    return result


def _overlap(surface: TriangleSurface, pairs: Ints) -> tuple[Bools, Floats]:
    """Do faces in one plane overlap by more than the tolerance, whichever way that is measured?

    Convex shapes overlap unless an edge of one of them separates them. The place is the middle of the two
    faces' common part along the line through their centres.
    """
    first, second = surface.corners[pairs].transpose(1, 0, 2, 3)
    normal = surface.normals[pairs[:, 1]]
    gaps = np.concatenate([_gaps(first, second, normal), _gaps(second, first, normal)], axis=1)
    return gaps.max(axis=1, initial=-np.inf) < -surface.tolerance, (
        first.mean(axis=1) + second.mean(axis=1)
    ) / 2


def _gaps(shape: Floats, other: Floats, normal: Floats) -> Floats:
    """Distance (k, 3) beyond each edge of a shape at which the other begins; negative for overlaps."""
    out = np.cross(np.roll(shape, -1, axis=1) - shape, normal[:, None])
    out /= np.sqrt((out**2).sum(axis=2))[:, :, None]
    own = (out * shape).sum(axis=2)
    third = (out * np.roll(shape, -2, axis=1)).sum(axis=2)
    # Seen from the other side an edge's outward direction is the opposite one.
    turn = np.where(third > own, -1.0, 1.0)
    beyond: Floats = (turn[:, :, None] * (np.einsum("kec,kvc->kev", out, other) - own[:, :, None])).min(
        axis=2
    )
    return beyond


def _pass_through(surface: TriangleSurface, pairs: Ints, sides: Ints) -> tuple[Bools, Floats]:
    """Do first faces, of which some corners are on either side of the second's plane, pass through it?"""
    corners = surface.corners[pairs]
    base, normal = corners[:, 1], surface.normals[pairs[:, 1]]
    ends, edge = _cut_by_plane(corners[:, 0], sides, base[:, 0], normal)
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    length = np.sqrt((way**2).sum(axis=1))
    along = way / np.where(length > 0, length, 1.0)[:, None]
    lo, hi, rim = _clip_to_face(surface.tolerance, start, along, length, base, normal)
    shared = hi - lo > _STRETCH_TOLERANCES * surface.tolerance
    place = start + (lo + hi)[:, None] / 2 * along
    # Half-planes around the stretch, as directions: two of the first face's surface, two of the second's.
    rows = np.arange(len(pairs))
    tip = corners[rows, 0, sides.argmax(axis=1)]
    low = corners[rows, 0, sides.argmin(axis=1)]
    on_edge, at_rim = edge >= 0, rim >= 0
    third = corners[rows, 0, (edge + 2) % 3]
    next_first = surface.vertices[surface.across[pairs[:, 0], edge]]
    next_second = surface.vertices[surface.across[pairs[:, 1], rim]]
    inward = np.cross(normal, along)
    inner = corners[rows, 1, (rim + 2) % 3]
    first = (
        np.where(on_edge[:, None], third, tip) - place,
        np.where(on_edge[:, None], next_first, low) - place,
    )
    second = (
        np.where(at_rim[:, None], inner - place, inward),
        np.where(at_rim[:, None], next_second - place, -inward),
    )
    angles = [np.arctan2((d * normal).sum(axis=1), (d * inward).sum(axis=1)) for d in (*first, *second)]
    return shared & _interleave(*angles), place


def _cut_by_plane(corners: Floats, sides: Ints, base: Floats, normal: Floats) -> tuple[Floats, Ints]:
    """Ends (k, 2, 3) of what a face has in a plane, and which edge of it that is, -1 for none."""
    height = ((corners - base[:, None]) * normal[:, None]).sum(axis=2)
    after = np.roll(height, -1, axis=1)
    crossed = sides * np.roll(sides, -1, axis=1) < 0
    share = height / np.where(crossed, height - after, 1.0)
    points = corners + np.where(crossed, share, 0.0)[:, :, None] * (np.roll(corners, -1, axis=1) - corners)
    candidates = np.concatenate([corners, points], axis=1)
    chosen = np.argsort(~np.concatenate([sides == 0, crossed], axis=1), axis=1, kind="stable")[:, :2]
    ends = np.take_along_axis(candidates, chosen[:, :, None], axis=1)
    # Two corners in the plane: edge k runs from corner k to the next, the third is the odd one out.
    odd = (sides != 0).argmax(axis=1)
    return ends, np.where((sides == 0).sum(axis=1) == 2, (odd + 1) % 3, -1)


def _clip_to_face(
    tolerance: float, start: Floats, along: Floats, length: Floats, face: Floats, normal: Floats
) -> tuple[Floats, Floats, Ints]:
    """Interval of a segment in a face's plane that is in the face, and the edge it runs along, or -1.

    A segment along an edge, within the tolerance of it, counts as in the face as far as the edge goes.
    """
    sides = np.roll(face, -1, axis=1) - face
    lengths = np.sqrt((sides**2).sum(axis=2))
    unit = sides / lengths[:, :, None]
    inward = np.cross(normal[:, None], unit)
    offset = ((start[:, None] - face) * inward).sum(axis=2)
    slope = (along[:, None] * inward).sum(axis=2)
    lo, hi = _nonnegative_interval(np.zeros_like(length), length, offset, slope)
    rim = np.full(len(face), -1)
    for k in range(3):
        reach = ((start - face[:, k]) * unit[:, k]).sum(axis=1)
        pace = (along * unit[:, k]).sum(axis=1)
        beside_lo, beside_hi = _nonnegative_interval(
            np.zeros_like(length),
            length,
            np.column_stack([reach, lengths[:, k] - reach]),
            np.column_stack([pace, -pace]),
        )
        away = offset[:, [k, k]] + slope[:, [k, k]] * np.column_stack([beside_lo, beside_hi])
        runs = (np.abs(away).max(axis=1) <= tolerance) & (
            beside_hi - beside_lo > _STRETCH_TOLERANCES * tolerance
        )
        rim = np.where(runs, k, rim)
        lo, hi = np.where(runs, beside_lo, lo), np.where(runs, beside_hi, hi)
    return lo, hi, rim


def _nonnegative_interval(lo: Floats, hi: Floats, offset: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Interval between lo and hi (k,) in which all of offset + t · slope (k, e) are at least 0."""
    level = slope == 0
    root = -offset / np.where(level, 1.0, slope)
    lo = np.maximum(lo, np.where(slope > 0, root, -np.inf).max(axis=1))
    hi = np.minimum(hi, np.where(slope < 0, root, np.inf).min(axis=1))
    outside = (level & (offset < 0)).any(axis=1) | (hi < lo)
    return np.where(outside, 0.0, lo), np.where(outside, 0.0, hi)


def _interleave(first: Floats, again: Floats, second: Floats, beyond: Floats) -> Bools:
    """Is exactly one of the angles `first`, `again` between `second` and `beyond`, and none at them?"""
    turn = 2 * np.pi
    width = (beyond - second) % turn
    inside = []
    clear = np.ones(len(first), dtype=bool)
    for angle in (first, again):
        from_second = (angle - second) % turn
        inside.append(from_second < width)
        for gap in (from_second, (angle - beyond) % turn):
            clear &= np.minimum(gap, turn - gap) > _SAME_ANGLE_RAD
    result: Bools = clear & (inside[0] != inside[1])
    return result


_LEAST_FACING_COSINE = 0.15
"""Least cosine between a face's normal and the direction it is seen from."""
_SAME_AREA_SHARE = 1e-9


def height_fields(surface: TriangleSurface) -> Ints:
    """A number (m,) for each face: faces with the same one do not cross each other; -1: not known."""
    views = _views()
    result = _check_views(surface, views, _few_views(surface, views))
    # Where one part hides another of the same view, faces are sorted more finely.
    left = result < 0
    nearest = np.where(surface.thin, -1, (surface.normals @ views.T).argmax(axis=1))
    again = _check_views(surface, views, np.where(left, nearest, -1))
    return np.where(left & (again >= 0), again + len(left), result)


def _check_views(surface: TriangleSurface, views: Floats, view: Ints) -> Ints:
    """Numbers of the height fields among connected faces with the same view (m,), else -1."""
    # A face without a plane goes with a neighbour, so that it does not cut a part in two.
    for side in range(3):
        view = np.where((view < 0) & surface.thin, view[surface.neighbours[:, side]], view)
    part = _part_of_faces(surface.neighbours, view)
    alone = np.bincount(part)[part] == 1
    field = _are_fields(surface, part, np.where(alone, -1, view), views)
    return np.where((view >= 0) & (alone | field[part]), part, -1)


def _views() -> Floats:
    """26 directions: along the axes and between them, of length 1."""
    grid = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
    result: Floats = grid / np.sqrt((grid**2).sum(axis=1))[:, None]
    return result


def _few_views(surface: TriangleSurface, views: Floats) -> Ints:
    """Index of a view that each face faces, few views in all; -1 for none."""
    facing = surface.normals @ views.T > _LEAST_FACING_COSINE
    area = surface.heights + surface.tolerance
    view = np.full(len(surface.faces), -1)
    left = ~surface.thin
    while left.any():
        best = int((facing[left] * area[left, None]).sum(axis=0).argmax())
        taken = left & facing[:, best]
        view[taken] = best
        left &= ~taken
    return view


def _part_of_faces(neighbours: Ints, view: Ints) -> Ints:
    """Number of the part (m,) of each face: neighbours with the same view belong together."""
    face, side = np.nonzero(view[:, None] == view[neighbours])
    return component_of(face, neighbours[face, side], len(view))


def _are_fields(surface: TriangleSurface, part: Ints, view: Ints, views: Floats) -> Bools:
    """Does the outline of each part (p,), seen along its view, if any, go round every point at most once?

    The faces cover a point as often as their outline winds round it. Where its edges only meet at their
    ends, that is never more than once if it encloses as much as an even-odd filling does.
    """
    found = np.zeros(int(part.max()) + 1, dtype=bool)
    face, side = np.nonzero((part[:, None] != part[surface.neighbours]) & (view >= 0)[:, None])
    if not len(face):
        return found
    order = np.argsort(part[face], kind="stable")
    face, side = face[order], side[order]
    parts, first, count = np.unique(part[face], return_index=True, return_counts=True)
    ends = np.stack([surface.faces[face, side], surface.faces[face, (side + 1) % 3]], axis=1)
    segments = surface.vertices[ends] @ _planes(views)[view[face]]
    of_segment = np.repeat(np.arange(len(parts)), count)
    outlines = shapely.multilinestrings(shapely.linestrings(segments), indices=of_segment)
    simple = shapely.is_simple(outlines)
    middle = np.add.reduceat(segments.mean(axis=1), first) / count[:, None]
    (x0, y0), (x1, y1) = (segments - middle[of_segment][:, None]).transpose(1, 2, 0)
    winding = np.add.reduceat(x0 * y1 - x1 * y0, first) / 2
    filled = shapely.area(shapely.build_area(outlines[simple]))
    found[parts[simple]] = np.abs(winding[simple] - filled) <= _SAME_AREA_SHARE * filled
    return found


def _planes(views: Floats) -> Floats:
    """Two directions (k, 3, 2) across each view, of length 1: to the right and upwards."""
    across = np.cross(np.eye(3)[np.abs(views).argmin(axis=1)], views)
    across /= np.sqrt((across**2).sum(axis=1))[:, None]
    result: Floats = np.stack([across, np.cross(views, across)], axis=2)
    return result


MAX_CROSSINGS = 1000
"""After so many crossings no more are looked for."""
_PAIRS_AT_ONCE = 1 << 16


def find_crossings(surface: TriangleSurface) -> FaceCrossings:
    """Pairs of faces that cross or overlap each other; the search ends after `ENOUGH`."""
    found = [_folded_edges(surface)]
    solid = np.flatnonzero(~surface.thin)
    corners = surface.corners[solid]
    lo = corners.min(axis=1) - surface.tolerance
    hi = corners.max(axis=1) + surface.tolerance
    for pairs in overlapping_pairs(lo, hi, height_fields(surface)[solid]):
        found += [
            _crossing_pairs(surface, solid[pairs[start : start + _PAIRS_AT_ONCE]])
            for start in range(0, len(pairs), _PAIRS_AT_ONCE)
        ]
        if sum(len(some.pairs) for some in found) > MAX_CROSSINGS:
            break
    return FaceCrossings(
        np.vstack([some.pairs for some in found]), np.vstack([some.places for some in found])
    )
