"""The model test in closed form: which orientations let all contacts lie on their edges.

For a fixed orientation θ, a contact on an edge is four half-planes g·s ≤ C + A cos θ + B sin θ in the
position s of the object, with g constant in the object's frame. By Helly's theorem and Farkas' lemma the
half-planes have a common point iff every positively dependent pair or triple of them allows one, and each
triple is again C + A cos θ + B sin θ ≥ 0: one arc of θ.
"""

from itertools import product

import numpy as np

from palpate.recognizer.arrays import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.segments import cross

__all__ = [
    "PAIR_TRIPLES",
    "TRIPLE_TRIPLES",
    "all_half_planes",
    "arc_hull",
    "half_planes",
    "largest",
    "triple_arcs",
]


def _pair_triples() -> list[tuple[int, int, int]]:
    """Two half-planes that meet at a corner of one contact's rectangle, and one of the other contact's."""
    corners = [(0, 2), (0, 3), (1, 2), (1, 3)]
    one = [(a, b, 4 + c) for (a, b), c in product(corners, range(4))]
    return one + [(4 + a, 4 + b, c) for (a, b), c in product(corners, range(4))]


PAIR_TRIPLES: Ints = np.array(_pair_triples())
"""(32, 3) indices into the eight half-planes of two contacts: all triples that can rule a pairing out."""

TRIPLE_TRIPLES: Ints = np.array([(a, 4 + b, 8 + c) for a, b, c in product(range(4), repeat=3)])
"""(64, 3) indices into the twelve half-planes of three contacts: those that no pair of contacts holds."""


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


def all_half_planes(
    catalogue: Catalogue, paired: Ints, contacts: list[Contact], anchor_mm: Floats
) -> tuple[Floats, Floats]:
    """The half-planes of k contacts, each on its edge of `paired` (n, k): g (n, 4k, 2), (n, 4k, 3)."""
    parts = [
        half_planes(catalogue.edges(contact.finger), paired[:, level], contact, anchor_mm)
        for level, contact in enumerate(contacts)
    ]
    return np.concatenate([g for g, _ in parts], axis=1), np.concatenate([c for _, c in parts], axis=1)


def triple_arcs(g: Floats, coefficients: Floats, triples: Ints) -> Floats:
    """The condition that each triple of half-planes puts on θ: (C, A, B) with C + A cos θ + B sin θ ≥ 0.

    g (n, m, 2), coefficients (n, m, 3), triples (t, 3); returns (n, t, 3). A triple that does not surround
    the origin says nothing: (1, 0, 0).
    """
    a, b, c = (g[:, triples[:, k]] for k in range(3))
    weight = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2)
    tiny = 1e-12
    ccw, cw = np.all(weight >= -tiny, axis=2), np.all(weight <= tiny, axis=2)
    magnitude = np.where(ccw[..., None], np.maximum(weight, 0.0), np.maximum(-weight, 0.0))
    combined = np.einsum("ntk,ntkj->ntj", magnitude, coefficients[:, triples])
    silent = ~(ccw | cw)
    combined[silent] = (1.0, 0.0, 0.0)
    combined[..., 0] += 1e-9
    result: Floats = combined
    return result


def arc_hull(lo: Floats, hi: Floats, conditions: Floats) -> tuple[Floats, Floats]:
    """Narrow intervals [lo, hi] (n,) of θ to the hull of what every condition (n, t, 3) leaves of them.

    Each condition is C + A cos θ + B sin θ ≥ 0. Where nothing is left, lo > hi. The hull may hold
    orientations that are ruled out, never the other way about.
    """
    constant, a, b = conditions[..., 0], conditions[..., 1], conditions[..., 2]
    amplitude = np.hypot(a, b)
    ratio = constant / np.maximum(amplitude, 1e-300)
    always, never = ratio >= 1.0, ratio < -1.0
    half = np.arccos(np.clip(-ratio, -1.0, 1.0)) + 1e-12
    width = (hi - lo)[:, None]
    # The allowed arcs are [begin, begin + 2 half] and its copies a turn before and after, from lo on.
    begin = (np.arctan2(b, a) - half - lo[:, None]) % (2 * np.pi)
    tail = begin - 2 * np.pi + 2 * half
    reaches_lo, starts_inside = tail >= 0, begin <= width
    first = np.where(reaches_lo, 0.0, np.where(starts_inside, begin, np.inf))
    last = np.where(starts_inside, np.minimum(width, begin + 2 * half), np.minimum(width, tail))
    first = np.where(always, 0.0, np.where(never, np.inf, first)).max(axis=1, initial=0.0)
    last = np.where(always, width, np.where(never, -np.inf, last)).min(axis=1, initial=np.inf)
    return lo + first, np.minimum(hi, lo + last)


def largest(coefficients: Floats, lo: Floats, hi: Floats) -> Floats:
    """Maximum of C + A cos θ + B sin θ over [lo, hi]; coefficients (…, 3), lo and hi broadcast to (…)."""
    constant, a, b = coefficients[..., 0], coefficients[..., 1], coefficients[..., 2]
    crest_inside = (np.arctan2(b, a) - lo) % (2 * np.pi) <= hi - lo
    at_ends = np.maximum(a * np.cos(lo) + b * np.sin(lo), a * np.cos(hi) + b * np.sin(hi))
    result: Floats = constant + np.where(crest_inside, np.hypot(a, b), at_ends)
    return result
