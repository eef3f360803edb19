"""Silhouette of a resting solid, seen from the side: for pictures that say which side is down."""

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.cad.values import Solid, StableState

__all__ = ["silhouette"]

_GRID = 256
"""Cells along the largest side: silhouettes are no finer, so that many facets are few different ones."""
_CHORD = 0.005
"""Share of the size that the outline may be off besides."""


def silhouette(solid: Solid, state: StableState) -> tuple[Floats, ...]:
    """Open rings (n, 2) of (across, z), mm; what is in an odd number of them is part.

    Seen along +y, across is x; along −x where the part is longer in y, across is y.
    """
    resting = solid.vertices_mm @ state.rotation.T + state.offset_mm
    wide, deep = np.ptp(resting[:, :2], axis=0)
    seen = resting[:, [0, 2]] if wide >= deep else resting[:, [1, 2]]
    size = float(np.ptp(seen, axis=0).max())
    cell = size / _GRID
    corners = np.round(seen / cell).astype(np.int64)[solid.faces]
    first, second, third = (corners[:, k] for k in range(3))
    across, along = second - first, third - first
    # Those that face away cover the same as those that are seen.
    turn = across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]
    some = np.unique(corners[turn > 0].reshape(-1, 6), axis=0).reshape(-1, 3, 2)
    whole = shapely.union_all(shapely.polygons(some * cell))
    # Rounded corners leave gaps of a cell between facets.
    closed = whole.buffer(cell, join_style="mitre").buffer(-cell, join_style="mitre")
    plain = shapely.simplify(closed, _CHORD * size)
    polygons = [part for part in shapely.get_parts(plain) if part.geom_type == "Polygon"]
    rings = [ring for part in polygons for ring in (part.exterior, *part.interiors)]
    return tuple(np.asarray(ring.coords)[:-1] for ring in rings if len(ring.coords) > 3)
