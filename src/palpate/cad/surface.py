"""A closed triangle surface with its adjacency and planes; every edge belongs to two faces."""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints

__all__ = ["TriangleSurface", "edge_keys", "rounding", "surface_of"]

_ROUNDING = 2.0**-20
"""Eight times the spacing of single-precision numbers, in which most files are written."""


@dataclass(frozen=True, eq=False)
class TriangleSurface:
    """`vertices` (n, 3), `faces` (m, 3) and their `corners` (m, 3, 3).

    Edge k of a face runs from its corner k to the next one. `neighbours` (m, 3): the face on the other side
    of each edge, `across` (m, 3): the vertex of that face that is not on the edge. `normals` (m, 3) of length
    1, or 0 for faces thinner than `tolerance`; `heights` (m,): the smallest altitude of each face.
    """

    vertices: Floats
    faces: Ints
    corners: Floats
    neighbours: Ints
    across: Ints
    normals: Floats
    heights: Floats
    tolerance: float

    @property
    def thin(self) -> Bools:
        """Faces without a plane: nowhere wider than the tolerance (m,)."""
        result: Bools = self.heights <= self.tolerance
        return result


def rounding(vertices: Floats) -> float:
    """What two vertices (n, 3) of a file may differ by and still be meant as one, in their unit.

    A millionth of the largest coordinate or side, whichever is larger: some times the rounding of single
    precision.
    """
    return float(_ROUNDING * max(np.abs(vertices).max(), np.ptp(vertices, axis=0).max()))


def edge_keys(faces: Ints, count: int) -> tuple[Ints, Ints]:
    """A number for each directed edge (m, 3) of faces over `count` vertices, and that of its reverse."""
    start, end = faces, np.roll(faces, -1, axis=1)
    return start * count + end, end * count + start


def surface_of(vertices: Floats, faces: Ints, tolerance: float) -> TriangleSurface:
    """Take a surface apart whose every directed edge has its reverse in exactly one other face."""
    keys, reverse = edge_keys(faces, len(vertices))
    order = np.argsort(keys, axis=None)
    twins = order[np.searchsorted(keys.ravel(), reverse, sorter=order)]
    corners = vertices[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.sqrt((sides**2).sum(axis=2).max(axis=1))
    twice = np.cross(sides[:, 0], sides[:, 1])
    size = np.sqrt((twice**2).sum(axis=1))
    heights = np.divide(size, longest, out=np.zeros(len(faces)), where=longest > 0)
    normals = np.where((heights > tolerance)[:, None], twice / np.where(size > 0, size, 1.0)[:, None], 0.0)
    return TriangleSurface(
        vertices,
        faces,
        corners,
        twins // 3,
        faces[twins // 3, (twins % 3 + 2) % 3],
        normals,
        heights,
        tolerance,
    )
