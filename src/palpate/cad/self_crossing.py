"""Does a surface pass through itself? Then what it encloses is not defined, and it is refused.

Two faces cross where they share a stretch of a line that is longer than eight times the tolerance of the
surface (`surface.rounding`: a millionth of its size) and lie on both sides of each other there; faces in one
plane overlap if they do so by more than the tolerance. Touching is no crossing, nor is anything between faces
thinner than the tolerance, which have no plane.
"""

import numpy as np

from palpate.cad.box_pairs import overlapping_pairs
from palpate.cad.face_meeting import Meetings, folded_edges, meetings
from palpate.cad.height_fields import height_fields
from palpate.cad.surface import TriangleSurface

__all__ = ["ENOUGH", "crossings"]

ENOUGH = 1000
"""After so many crossings no more are looked for."""
_AT_ONCE = 1 << 16


def crossings(surface: TriangleSurface) -> Meetings:
    """Pairs of faces that cross or overlap each other; the search ends after `ENOUGH`."""
    found = [folded_edges(surface)]
    solid = np.flatnonzero(~surface.thin)
    corners = surface.corners[solid]
    lo = corners.min(axis=1) - surface.tolerance
    hi = corners.max(axis=1) + surface.tolerance
    for pairs in overlapping_pairs(lo, hi, height_fields(surface)[solid]):
        found += [
            meetings(surface, solid[pairs[start : start + _AT_ONCE]])
            for start in range(0, len(pairs), _AT_ONCE)
        ]
        if sum(len(some.pairs) for some in found) > ENOUGH:
            break
    return Meetings(np.vstack([some.pairs for some in found]), np.vstack([some.places for some in found]))
