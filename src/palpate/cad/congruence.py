"""Congruence of a solid with itself after a motion: a proof over the whole surface, without sampling.

The result bounds the Hausdorff distance between the surface and the moved surface. Why it holds: the distance
from one triangle is convex, so over a piece of a facet it is nowhere larger than at the corners of the piece;
the distance from the surface is no larger. A facet whose corners come to those of a facet is done with that.
Any other piece is held against the triangle that is nearest to its middle, and cut along that triangle's
border where it reaches beyond it, so that different triangulations of one surface are found to be one.
Vertices and middles that are too far end it at once. Rounding is allowed for with 1e-9 of the size.
"""

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.surface_distance import SurfaceDistance
from palpate.cad.values import Solid

__all__ = ["surface_apart_between_mm", "surface_apart_mm", "surfaces_apart_mm"]

_CLOSE = 1e-6
"""Share of the size that counts as zero."""
_ROUNDING = 1e-9
_WORTH, _SHARE = 1.5, 0.1
"""Where some point is off, a bound of so many times its distance and this share of what is wanted will do."""
_FIRST = 256
"""So many vertices are asked first: a motion that is none of the solid's is mostly found out by them."""
_SHARP = 24
"""After so many rounds of cutting, anything within the wanted distance will do."""
_ROUNDS = 40
_MANY, _TOO_MANY = 3, 6
_PIECES = 100_000
"""Pieces over all rounds, in multiples of facets + `_PIECES`: then anything within will do; then it ends."""


def surface_apart_mm(solid: Solid, rotation: Floats, shift_mm: Floats, within_mm: float) -> float | None:
    """How far a surface is from itself when a vertex v goes to `rotation` (3, 3) @ v + `shift_mm` (3,).

    An upper bound of the Hausdorff distance, both ways; None if it is beyond `within_mm` or if the proof
    would take too long. A proper rotation; whether outside comes to outside is not looked at.
    """
    return surface_apart_between_mm(SurfaceDistance(solid), rotation, shift_mm, within_mm)


def surface_apart_between_mm(
    surface: SurfaceDistance, rotation: Floats, shift_mm: Floats, within_mm: float
) -> float | None:
    """As `surface_apart_mm`, for many motions of the same solid."""
    allowed = within_mm - _ROUNDING * surface.size_mm
    there = _apart(surface, rotation, shift_mm, allowed)
    if there is None:
        return None
    # How far the surface is from the moved one: as far as the surface moved back is from itself.
    back = _apart(surface, rotation.T, -rotation.T @ shift_mm, allowed)
    return None if back is None else max(there, back) + _ROUNDING * surface.size_mm


def surfaces_apart_mm(one: SurfaceDistance, other: SurfaceDistance, within_mm: float) -> float | None:
    """How far two surfaces are apart: as `surface_apart_mm`, of two solids as they are."""
    rounding = _ROUNDING * max(one.size_mm, other.size_mm)
    close, allowed = _CLOSE * one.size_mm, within_mm - rounding
    there = _pieces_off(one, other.corners_mm, other.normal, 0.0, close, allowed, alike=False)
    if there is None:
        return None
    back = _pieces_off(other, one.corners_mm, one.normal, 0.0, close, allowed, alike=False)
    return None if back is None else max(there, back) + rounding


def _apart(surface: SurfaceDistance, rotation: Floats, shift: Floats, within: float) -> float | None:
    """How far no point of the moved surface is from the surface; None if beyond a distance or unproven."""
    if within <= 0:
        return None
    close = min(_CLOSE * surface.size_mm, within)
    points = surface.vertices_mm @ rotation.T + shift
    found = surface.vertex_tree.query(points, distance_upper_bound=within)
    on_vertex, vertex = np.asarray(found[0]), np.asarray(found[1])
    normal = surface.normal @ rotation.T
    least = _vertices_off(surface, points, on_vertex, normal, close, within)
    if least > within:
        return None
    known = np.where(on_vertex <= close, vertex, -1)[surface.faces]
    of_facet = on_vertex[surface.faces].max(axis=1)
    done: Bools = np.asarray((known >= 0).all(axis=1))
    done[done] = np.isin(_key(known[done]), _key(surface.faces))
    most = float(of_facet[done].max(initial=0.0))
    rest = _pieces_off(surface, points[surface.faces[~done]], normal[~done], least, close, within)
    return None if rest is None else max(most, rest)


def _vertices_off(
    surface: SurfaceDistance, points: Floats, on_vertex: Floats, normal: Floats, close: float, within: float
) -> float:
    """Largest distance of the vertices (n, 3), of which some are on vertices; inf if beyond."""
    of_facet = np.zeros(len(points), dtype=np.int64)
    of_facet[surface.faces] = np.arange(len(surface.faces))[:, None]
    left = np.flatnonzero(on_vertex > close)
    few = np.zeros(len(left), dtype=bool)
    few[:: -(-len(left) // _FIRST) or 1] = True
    least = float(on_vertex[on_vertex <= close].max(initial=0.0))
    for some in (left[few], left[~few]):
        off, _ = surface.nearest(points[some], normal[of_facet[some]], close, within)
        least = max(least, float(off.max(initial=0.0)))
        if least > within:
            break
    return least


def _key(faces: Ints) -> Ints:
    """A number for each set of three vertices."""
    first, second, third = np.sort(faces, axis=1).T
    base = np.int64(2_000_000)
    result: Ints = (first * base + second) * base + third
    return result


def _pieces_off(
    surface: SurfaceDistance,
    pieces: Floats,
    normal: Floats,
    least: float,
    close: float,
    within: float,
    *,
    alike: bool = True,
) -> float | None:
    """Bound over triangles (k, 3, 3); `least`: a distance that some point is known to have.

    Unless the surfaces are expected to be `alike`, anything within the wanted distance will do.
    """
    near = close if alike else within
    most, looked = 0.0, 0
    some = len(surface.faces) + _PIECES
    for number in range(_ROUNDS):
        if not len(pieces):
            return most
        looked += len(pieces)
        if looked > _TOO_MANY * some:
            return None
        at_middle, triangle = surface.nearest(pieces.mean(axis=1), normal, near, within)
        least = max(least, float(at_middle.max()))
        if least > within:
            return None
        off = surface.off_mm(pieces, np.repeat(triangle[:, None], 3, axis=1))
        bound = off.max(axis=1)
        hasty = not alike or number >= _SHARP or looked > _MANY * some
        enough = close if least <= close else _WORTH * least + _SHARE * within
        good = bound <= (within if hasty else min(within, enough))
        most = max(most, float(bound[good].max(initial=0.0)))
        pieces, kept = _cut(surface, pieces[~good], triangle[~good], close / 4)
        normal = normal[~good][kept]
    return None


def _cut(surface: SurfaceDistance, pieces: Floats, triangle: Ints, close: float) -> tuple[Floats, Ints]:
    """Pieces cut along the side of their triangle that they reach furthest beyond, or halved if none.

    And which piece each is of.
    """
    inward = surface.inward[triangle]
    start = surface.corners_mm[triangle]
    # (piece, side, corner): how far inside of the side.
    inside = np.einsum("psx,pcsx->psc", inward, pieces[:, :, None] - start[:, None])
    side = inside.min(axis=2).argmin(axis=1)
    rows = np.arange(len(pieces))
    inside = inside[rows, side]
    across = (inside.min(axis=1) < -close) & (inside.max(axis=1) > close)
    parted, of_parted = _parted(pieces[across], inside[across])
    halves = _halved(pieces[~across])
    kept = np.concatenate([rows[across][of_parted], np.repeat(rows[~across], 2)])
    return np.concatenate([parted, halves]), kept


def _parted(pieces: Floats, inside: Floats) -> tuple[Floats, Ints]:
    """Triangles (k, 3, 3) cut where the linear function with values (k, 3) at their corners is zero."""
    rows = np.arange(len(pieces))
    beyond = inside < 0
    # The corner that is alone on its side comes first.
    alone = np.where(beyond.sum(axis=1) == 1, beyond.argmax(axis=1), (~beyond).argmax(axis=1))
    a, b, c = (pieces[rows, (alone + k) % 3] for k in range(3))
    f, g, h = (inside[rows, (alone + k) % 3] for k in range(3))
    p = a + (f / (f - g))[:, None] * (b - a)
    q = a + (f / (f - h))[:, None] * (c - a)
    parts = np.stack([np.stack(part, axis=1) for part in ((a, p, q), (p, b, c), (p, c, q))], axis=1)
    of = np.repeat(rows, 3)
    parts = parts.reshape(-1, 3, 3)
    real = _has_extent(parts)
    return parts[real], of[real]


def _has_extent(parts: Floats) -> Bools:
    """Whether parts (k, 3, 3) are triangles; those without area lie on the side of another part."""
    area = np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
    result: Bools = np.asarray(area > 0)
    return result


def _halved(pieces: Floats) -> Floats:
    """Both halves of triangles, cut at their longest side."""
    rows = np.arange(len(pieces))
    side = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=2).argmax(axis=1)
    a, b, c = (pieces[rows, (side + k) % 3] for k in range(3))
    middle = (a + b) / 2
    halves = np.stack([np.stack(half, axis=1) for half in ((a, middle, c), (middle, b, c))], axis=1)
    return halves.reshape(-1, 3, 3)
