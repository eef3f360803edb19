"""The exact section of a closed triangle surface at a height, as rings and as regions.

Vertices at the very height count as above it, which moves the plane by nothing and spares all special cases;
rings are followed from facet to facet through shared edges, so nothing is matched by coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.cad.resting_surface import RestingSurface
from palpate.cad.values import Region

__all__ = ["SectionRing", "area_of", "regions_of", "slice_surface"]


@dataclass(frozen=True, eq=False)
class SectionRing:
    """A closed outline with the solid on its left: edge k runs from point k to the next, along a facet.

    `points` (n, 2) mm; `facet` (n,): the number of the facet that each edge lies on.
    """

    points: Floats
    facet: Ints


def slice_surface(surface: RestingSurface, height_mm: float) -> list[SectionRing]:
    """Rings in which the plane at `height_mm` cuts the surface; consecutive points may coincide."""
    facets = np.flatnonzero((surface.low < height_mm) & (surface.high >= height_mm))
    if not len(facets):
        return []
    above = surface.vertices_mm[surface.faces[facets], 2] >= height_mm
    after = np.roll(above, -1, axis=1)
    # Seen from outside, a facet's falling edge is on the left of its rising one.
    rows = np.arange(len(facets))
    falling = surface.edges[facets][rows, (above & ~after).argmax(axis=1)]
    rising = surface.edges[facets][rows, (~above & after).argmax(axis=1)]
    order = np.argsort(falling)
    following = order[np.searchsorted(falling[order], rising)].tolist()
    start = surface.vertices_mm[surface.ends[falling, 0]]
    leg = surface.vertices_mm[surface.ends[falling, 1]] - start
    points = start[:, :2] + ((height_mm - start[:, 2]) / leg[:, 2])[:, None] * leg[:, :2]
    seen = [False] * len(facets)
    rings = []
    for first in range(len(facets)):
        if seen[first]:
            continue
        own = []
        at = first
        while not seen[at]:
            seen[at] = True
            own.append(at)
            at = following[at]
        rings.append(SectionRing(points[own], facets[own]))
    return rings


def area_of(points: Floats) -> float:
    """Signed area of a ring (n, 2): positive if counter-clockwise."""
    x, y = (points - points[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def regions_of(rings: Sequence[Floats]) -> tuple[Region, ...]:
    """Polygons with holes from disjoint rings (n, 2) with the solid on their left.

    Raises InputError if a ring lies inside of material, or a hole outside of it.
    """
    areas = [area_of(ring) for ring in rings]
    outers = sorted((k for k in range(len(rings)) if areas[k] > 0), key=lambda k: areas[k])
    holes = [k for k in range(len(rings)) if areas[k] <= 0]
    shells = [shapely.Polygon(rings[k]) for k in outers]
    owned: list[list[Floats]] = [[] for _ in outers]
    for hole in holes:
        inside = shapely.Polygon(rings[hole]).representative_point()
        owner = next(
            (n for n, k in enumerate(outers) if areas[k] > -areas[hole] and shells[n].contains(inside)), None
        )
        if owner is None:
            raise InputError(f"a hole at ({inside.x:.4g}, {inside.y:.4g}) lies outside of the material")
        owned[owner].append(rings[hole])
    return tuple(Region(rings[k], tuple(own)) for k, own in zip(outers, owned, strict=True))
