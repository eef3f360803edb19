"""The model test for three contacts, in closed form: orientations that no two of them rule out, but all do.

Each contact holds the position s between two lines along each
of two directions u: its edge's normal and the edge itself (`half_planes`). One direction of each of three
contacts has, up to scale, one relation Σ w u = 0. By Farkas' lemma the three half-planes on the sides that
the signs of w say, and the three on the opposite sides, have a common point iff

    −Σ |w| c ≤ Σ w (A cos θ + B sin θ) ≤ Σ |w| c'

with c and c' the constants of their limits. Each of the eight choices of directions gives one such condition.
They are what the 64 triples of half-planes of three contacts say; the 48 others surround no point.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.segments import cross
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_tree import narrowed
from palpate.recognizer.contact import Contact
from palpate.recognizer.half_planes import half_planes
from palpate.recognizer.sinusoid_bounds import clip_to_sinusoids

__all__ = ["three_contact_hull"]

_ROUNDING_MM = 1e-9


def three_contact_hull(
    catalogue: Catalogue, paired: Ints, contacts: list[Contact], anchor_mm: Floats, lo: Floats, hi: Floats
) -> tuple[Floats, Floats]:
    """Narrow intervals [lo, hi] (n,) of θ to the hull of those at which three contacts fit their edges.

    `paired` (n, 3): the edge of each contact. Where nothing is left, lo > hi. The hull may hold orientations
    that are ruled out, never the other way about.
    """
    if KERNEL is not None:
        sets = [catalogue.edges(contact.finger) for contact in contacts]
        return narrowed(KERNEL, sets, contacts, paired, lo, hi, anchor_mm)
    # Arrays over the choice of direction of the first, the second and the third contact, and over rows.
    one, two, three = (
        _edge_axes(catalogue, paired[:, k], contact, anchor_mm, k) for k, contact in enumerate(contacts)
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
    return clip_to_sinusoids(lo, hi, crest, lower - _ROUNDING_MM, upper + _ROUNDING_MM, height)


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


def _edge_axes(
    catalogue: Catalogue, edge: Ints, contact: Contact, anchor_mm: Floats, place: int
) -> _EdgeAxes:
    g, coefficients = half_planes(catalogue.edges(contact.finger), edge, contact, anchor_mm)
    shape = [1, 1, 1]
    shape[place] = 2
    # Half-planes come in opposite pairs, the one along u second.
    g, limit = np.moveaxis(g, 1, 0), np.moveaxis(coefficients, 1, 0)
    return _EdgeAxes(
        direction=g[1::2].reshape(*shape, -1, 2),
        cosine=limit[1::2, :, 1].reshape(*shape, -1),
        sine=limit[1::2, :, 2].reshape(*shape, -1),
        lower=limit[0::2, :, 0].reshape(*shape, -1),
        upper=limit[1::2, :, 0].reshape(*shape, -1),
    )
