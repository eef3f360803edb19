"""Edge look-up: edges that a further contact may be paired with, by orientation and rough position.

A range look-up in the sorted normals for most states, a descent of the strip tree (memo §3.3) for those with
very many edges.
"""

from collections.abc import Callable

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact

__all__ = ["NearTest", "matching_edges"]

NearTest = Callable[[Ints, Floats, Floats, Floats], Bools]
"""Whether, for query (n,), the contact may lie within stray (n,) mm of segments from start to end (n, 2)."""

_ROUNDING_RAD = 1e-9


def matching_edges(
    catalogue: Catalogue,
    state: Ints,
    lo: Floats,
    hi: Floats,
    contact: Contact,
    near: NearTest,
    most: int | None = None,
) -> tuple[Ints, Ints]:
    """Edges of `state` (m,) whose normals fit `contact` at some θ in [lo, hi] (m,), for m queries.

    Where there are so many that a strip tree is descended, `near` holds as well. Returns (query, edge), flat.
    Raises BudgetSpentError where there are more than `most`.
    """
    normals = contact.outward_normals()
    if normals is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    edges, strips = catalogue.edges(contact.finger), catalogue.strips(contact.finger)
    large = strips.root[state] >= 0
    small = np.flatnonzero(~large)
    margin = float(np.max(edges.span, initial=0.0))
    width = np.minimum(normals.hi_rad - normals.lo_rad + 2 * margin + (hi - lo)[small], 2 * np.pi)
    owner, edge = edges.by_normal(state[small], normals.lo_rad - margin - hi[small], width, most)
    owner = small[owner]
    if not large.any():
        return owner, edge
    rows = np.flatnonzero(large)
    middle = (normals.lo_rad + normals.hi_rad - lo - hi)[rows] / 2
    half = (normals.hi_rad - normals.lo_rad + hi - lo)[rows] / 2 + _ROUNDING_RAD

    def keep(query: Ints, strip: Ints) -> Bools:
        kept = (
            np.abs(wrap_angle(strips.normal[strip] - middle[query])) <= half[query] + strips.half_turn[strip]
        )
        some = np.flatnonzero(kept)
        at = strip[some]
        kept[some] = near(rows[query[some]], strips.start[at], strips.end[at], strips.stray[at])
        return kept

    query, found = strips.descend(state[rows], keep, None if most is None else most - len(owner))
    return np.concatenate([owner, rows[query]]), np.concatenate([edge, found])
