"""The model test for two contacts, in closed form: which orientations let a chord join two edges.

With both contacts in the object's frame, their difference
q_b − q_a = R(−θ) D must lie in the Minkowski difference of the two edges' error rectangles, an octagon whose
sides are parallel to the edges and to their normals. D only turns with θ, so each pair of opposite sides says
lo ≤ d cos(θ − φ) ≤ hi. This is the set that 32 triples of half-planes allow, for an eighth of
the work.
"""

from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.segments import cross
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_tree import narrowed
from palpate.recognizer.contact import Contact
from palpate.recognizer.sinusoid_bounds import clip_to_sinusoids

__all__ = ["two_contact_hull"]

_ROUNDING_MM = 1e-9


def two_contact_hull(
    catalogue: Catalogue, paired: Ints, contacts: Sequence[Contact], lo: Floats, hi: Floats
) -> tuple[Floats, Floats]:
    """Narrow intervals [lo, hi] (n,) of θ to the hull of those at which two contacts fit their edges.

    `paired` (n, 2): the edge of each contact; where one of them is the null edge, the interval is left as it
    is. Where nothing is left, lo > hi. The hull may hold orientations that are ruled out, never the other way
    about.
    """
    if KERNEL is not None:
        sets = [catalogue.edges(contact.finger) for contact in contacts]
        return narrowed(KERNEL, sets, contacts, paired, lo, hi)
    null = (paired < 0).any(axis=1)
    if null.any():
        lo, hi = lo.copy(), hi.copy()
        if not null.all():
            lo[~null], hi[~null] = two_contact_hull(catalogue, paired[~null], contacts, lo[~null], hi[~null])
        return lo, hi
    contact_a, contact_b = contacts
    first, second = catalogue.edges(contact_a.finger), catalogue.edges(contact_b.finger)
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
    return clip_to_sinusoids(
        lo, hi, crest, (middle - half - _ROUNDING_MM), middle + half + _ROUNDING_MM, chord
    )
