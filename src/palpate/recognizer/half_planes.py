"""Half-planes: the constraints of a contact on an edge on the object's position, for every orientation.

For a fixed orientation θ they are g·s ≤ C + A cos θ + B sin θ in the position s of the object, with g
constant in the object's frame. By Helly's theorem and Farkas' lemma the half-planes of all contacts have a
common point iff every positively dependent pair or triple of them allows one, and each triple is again C + A
cos θ + B sin θ ≥ 0: one arc of θ.
"""

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet

__all__ = ["all_half_planes", "half_planes"]

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
