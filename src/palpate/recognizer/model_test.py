"""Model test for two and for three contacts, in closed form: orientations in which they fit their edges.

For a fixed orientation θ a contact on an edge holds the position s of the object in four half-planes
g·s ≤ C + A cos θ + B sin θ, with g constant in the object's frame. By Helly's theorem and Farkas' lemma the
half-planes of all contacts have a common point iff every positively dependent pair or triple of them allows
one, and each triple is again C + A cos θ + B sin θ ≥ 0: one arc of θ.

*Two contacts.* Their difference q_b − q_a = R(−θ) D must lie in the Minkowski difference of the two edges'
error rectangles, an octagon whose sides are parallel to the edges and to their normals. D only turns with θ,
so each pair of opposite sides says lo ≤ d cos(θ − φ) ≤ hi. This is the set that 32 triples of half-planes
allow, for an eighth of the work.

*Three contacts.* Each holds the position s between two lines along each of two directions u: its edge's
normal and the edge itself. One direction of each of three contacts has, up to scale, one relation Σ w u = 0.
By Farkas' lemma the three half-planes on the sides that the signs of w say, and the three on the opposite
sides, have a common point iff

    −Σ |w| c ≤ Σ w (A cos θ + B sin θ) ≤ Σ |w| c'

with c and c' the constants of their limits. Each of the eight choices of directions gives one such condition.
They are what the 64 triples of half-planes of three contacts say; the 48 others surround no point.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import cross
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.interpretations import Query
from palpate.recognizer.tables import split_evenly

_ROUNDING_RAD = 1e-12


def _clip_to_sinusoids(
    lo: Floats, hi: Floats, crest: Floats, least: Floats, most: Floats, height: Floats | float
) -> tuple[Floats, Floats]:
    """Hull of the θ in [lo, hi] (n,) with least ≤ height·cos(θ − crest) ≤ most, each (k, n), for all k.

    Where nothing is left, lo > hi. The hull may hold orientations that are ruled out, never the other way
    about.
    """
    scale = np.maximum(height, 1e-9)
    least, most = least / scale, most / scale
    # |θ − crest| must lie between these two.
    nearest = np.arccos(np.clip(most, -1.0, 1.0)) - _ROUNDING_RAD
    furthest = np.arccos(np.clip(least, -1.0, 1.0)) + _ROUNDING_RAD
    never = (most < -1.0) | (least > 1.0)
    # The allowed set is even about the crest: going down from hi is going up from −hi.
    first = np.where(never, np.inf, _advance_to_allowed(lo - crest, nearest, furthest)).max(axis=0)
    last = np.where(never, np.inf, _advance_to_allowed(crest - hi, nearest, furthest)).max(axis=0)
    return lo + first, hi - last


def _advance_to_allowed(angle: Floats, nearest: Floats, furthest: Floats) -> Floats:
    """Way up from `angle` to the first angle with nearest ≤ |angle| ≤ furthest (modulo 2π)."""
    begin = angle - 2 * np.pi * np.rint(angle / (2 * np.pi))
    at = np.maximum(begin, -furthest)
    at = np.where((at > -nearest) & (at < nearest), nearest, at)
    at = np.where(at > furthest, 2 * np.pi - furthest, at)
    return at - begin


def sinusoid_maximum(a: Floats, b: Floats, lo: Floats, hi: Floats) -> Floats:
    """Maximum of a cos θ + b sin θ over [lo, hi]; a and b of one shape, lo and hi broadcast to it.

    Never too small; over half a turn and more the amplitude stands for it.
    """
    cos_lo, sin_lo, cos_hi, sin_hi = np.cos(lo), np.sin(lo), np.cos(hi), np.sin(hi)
    at_ends = np.maximum(a * cos_lo + b * sin_lo, a * cos_hi + b * sin_hi)
    # Inside, where the wave still rises at lo and falls at hi, is the crest.
    crest = ((b * cos_lo > a * sin_lo) & (b * cos_hi < a * sin_hi)) | (hi - lo >= np.pi)
    return np.where(crest, np.sqrt(a * a + b * b), at_ends)


_ANYWHERE_MM = 1e5  # limit of a half-plane that constrains nothing: coordinates are below 10⁴ mm
_AXES: Floats = np.array([[0.0, 1.0], [0.0, -1.0], [-1.0, 0.0], [1.0, 0.0]])


def half_planes(edges: EdgeSet, edge: Ints, contact: Contact, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """The four half-planes g·s ≤ C + A cos θ + B sin θ of a contact on each of n edges.

    Those of the null edge leave everything that can be: a box of 10⁵ mm.

    s = R(−θ)(p − anchor), where p is the centroid's position in W. Returns g of shape (n, 4, 2) in the
    object's frame and the coefficients (C, A, B) of shape (n, 4, 3), in mm. Order: outer side of the edge,
    inner side, far end, near end.
    """
    null = edge < 0
    if null.any():
        return _with_nulls(edges, edge, null, contact, anchor_mm)
    x, y = np.asarray(contact.end_mm) - anchor_mm
    g = edges.sides[edge]
    coefficients = np.empty((*g.shape[:2], 3))
    coefficients[..., 0] = edges.side_limits[edge] + contact.position_bound_mm
    coefficients[..., 1] = g[..., 0] * x + g[..., 1] * y
    coefficients[..., 2] = g[..., 0] * y - g[..., 1] * x
    return g, coefficients


def _with_nulls(
    edges: EdgeSet, edge: Ints, null: Bools, contact: Contact, anchor_mm: Floats
) -> tuple[Floats, Floats]:
    g, coefficients = np.empty((len(edge), 4, 2)), np.empty((len(edge), 4, 3))
    g[null], coefficients[null] = _AXES, (_ANYWHERE_MM, 0.0, 0.0)
    if not null.all():
        g[~null], coefficients[~null] = half_planes(edges, edge[~null], contact, anchor_mm)
    return g, coefficients


def all_half_planes(query: Query, paired: Ints) -> tuple[Floats, Floats]:
    """Half-planes of k contacts, each on its edge of `paired` (n, k): g (n, 4k, 2), (n, 4k, 3)."""
    parts = [
        half_planes(edges, paired[:, level], contact, query.anchor_mm)
        for level, (edges, contact) in enumerate(zip(query.edges, query.contacts, strict=True))
    ]
    return np.concatenate([g for g, _ in parts], axis=1), np.concatenate([c for _, c in parts], axis=1)


_ROUNDING_MM = 1e-9
_TWO = 2
_ROWS_AT_ONCE = 8192  # keeps the largest temporary array near 20 MB


def narrow(query: Query, paired: Ints, lo: Floats, hi: Floats) -> tuple[Floats, Floats]:
    """Narrow intervals [lo, hi] (n,) to the hull of the θ at which two or three contacts fit their edges.

    `paired` (n, 2 or 3): the edge of each contact; where one of two is the null edge, the interval is left as
    it is. Where nothing is left, lo > hi. The hull may hold orientations that are ruled out, never the other
    way about.
    """
    if len(query.contacts) == _TWO:
        return _narrow_by_two(query, paired, lo, hi)
    parts = [
        _narrow_by_three(query, paired[rows], lo[rows], hi[rows])
        for rows in split_evenly(len(lo), len(lo) // _ROWS_AT_ONCE + 1)
    ]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _narrow_by_two(query: Query, paired: Ints, lo: Floats, hi: Floats) -> tuple[Floats, Floats]:
    null = (paired < 0).any(axis=1)
    if null.any():
        lo, hi = lo.copy(), hi.copy()
        if not null.all():
            lo[~null], hi[~null] = _narrow_by_two(query, paired[~null], lo[~null], hi[~null])
        return lo, hi
    contact_a, contact_b = query.contacts
    first, second = query.edges
    edge_a, edge_b = paired.T
    x, y = contact_b.end_mm[0] - contact_a.end_mm[0], contact_b.end_mm[1] - contact_a.end_mm[1]
    chord = float(np.hypot(x, y))
    normal_a, normal_b = first.normal[edge_a], second.normal[edge_b]
    gap = second.middle[edge_b] - first.middle[edge_a]
    across_a = first.half_across[edge_a] + contact_a.position_bound_mm
    along_a = first.half_along[edge_a] + contact_a.position_bound_mm
    across_b = second.half_across[edge_b] + contact_b.position_bound_mm
    along_b = second.half_along[edge_b] + contact_b.position_bound_mm
    cosine = np.abs(np.sum(normal_a * normal_b, axis=1))
    sine = np.abs(cross(normal_a, normal_b))
    half = np.stack(
        [
            across_a + cosine * across_b + sine * along_b,
            along_a + sine * across_b + cosine * along_b,
            across_b + cosine * across_a + sine * along_a,
            along_b + sine * across_a + cosine * along_a,
        ]
    )
    # A normal n turned by a right angle is the edge's direction; both components of the gap at once.
    middle = np.stack(
        [
            np.sum(normal_a * gap, axis=1),
            cross(normal_a, gap),
            np.sum(normal_b * gap, axis=1),
            cross(normal_b, gap),
        ]
    )
    turned = np.arctan2(y, x) - np.stack([first.normal_rad[edge_a], second.normal_rad[edge_b]])
    crest = np.repeat(turned, 2, axis=0)
    crest[1::2] -= np.pi / 2
    return _clip_to_sinusoids(
        lo, hi, crest, (middle - half - _ROUNDING_MM), middle + half + _ROUNDING_MM, chord
    )


def _narrow_by_three(query: Query, paired: Ints, lo: Floats, hi: Floats) -> tuple[Floats, Floats]:
    # Arrays over the choice of direction of the first, the second and the third contact, and over rows.
    one, two, three = (
        _edge_axes(half_planes(query.edges[k], paired[:, k], contact, query.anchor_mm), k)
        for k, contact in enumerate(query.contacts)
    )
    weights = (
        cross(two.direction, three.direction),
        cross(three.direction, one.direction),
        cross(one.direction, two.direction),
    )
    cosine, sine, least, most = (np.zeros((2, 2, 2, len(paired))) for _ in range(4))
    for weight, side in zip(weights, (one, two, three), strict=True):
        up, down = np.maximum(weight, 0.0), np.maximum(-weight, 0.0)
        cosine += weight * side.cosine
        sine += weight * side.sine
        least -= up * side.upper + down * side.lower
        most += up * side.lower + down * side.upper
    a, b, lower, upper = (part.reshape(8, -1) for part in (cosine, sine, least, most))
    crest, height = np.arctan2(b, a), np.sqrt(a * a + b * b)
    return _clip_to_sinusoids(lo, hi, crest, lower - _ROUNDING_MM, upper + _ROUNDING_MM, height)


@dataclass(frozen=True, eq=False)
class _EdgeAxes:
    """Both directions u of a contact's edge: −lower ≤ u·s − (cosine cos θ + sine sin θ) ≤ upper, mm.

    All of shape (…, n) with the choice of direction at the contact's own place, `direction` (…, n, 2).
    """

    direction: Floats
    cosine: Floats
    sine: Floats
    lower: Floats
    upper: Floats


def _edge_axes(planes: tuple[Floats, Floats], place: int) -> _EdgeAxes:
    shape = [1, 1, 1]
    shape[place] = 2
    # Half-planes come in opposite pairs, the one along u second.
    g, limit = (np.moveaxis(part, 1, 0) for part in planes)
    return _EdgeAxes(
        direction=g[1::2].reshape(*shape, -1, 2),
        cosine=limit[1::2, :, 1].reshape(*shape, -1),
        sine=limit[1::2, :, 2].reshape(*shape, -1),
        lower=limit[0::2, :, 0].reshape(*shape, -1),
        upper=limit[1::2, :, 0].reshape(*shape, -1),
    )
