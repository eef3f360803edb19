"""Bodies of a surface: which closed shells belong together, and which way round they are.

A shell within another one bounds a void of it; one within that void is a body of its own. Shells must neither
cross nor touch along edges: `mesh_checks` refuses such files before.
"""

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.cad.box_pairs import overlapping_pairs
from palpate.cad.connectivity import component_of
from palpate.cad.surface import TriangleSurface

__all__ = ["bodies"]

_PROBES = 5
"""Vertices of a shell that are asked whether they are inside another: some may touch it."""


def bodies(where: str, surface: TriangleSurface) -> list[Ints]:
    """Faces (k, 3) of each body, outside seen counter-clockwise, in the order of the file.

    A shell that is inside out as a whole, with all it holds, is turned: of a closed surface there is no
    doubt. Shells that touch in a vertex belong together. Raises InputError for a shell without volume, and
    for one within another that is wound the same way, which leaves open whether it bounds a void.
    """
    shell = _components(surface.neighbours)
    shells = np.split(np.argsort(shell, kind="stable"), np.cumsum(np.bincount(shell))[:-1])
    volume = np.array([_volume(surface.corners[faces]) for faces in shells])
    for faces, enclosed in zip(shells, volume, strict=True):
        corners = surface.corners[faces]
        area = np.sqrt(
            (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) ** 2).sum(axis=1)
        )
        if abs(enclosed) <= surface.tolerance * area.sum() / 2:
            raise InputError(f"{where}: the surface {_around(surface, faces)} encloses no volume")
    holder, depth = _nesting(surface, shells)
    for number, within in enumerate(holder):
        if within >= 0 and volume[number] * volume[within] > 0:
            raise InputError(
                f"{where}: the surface {_around(surface, shells[number])} lies inside another and faces the "
                "same way: turn it if it bounds a void, delete it if not"
            )
    outward = depth % 2 == 0
    turned = (volume > 0) != outward
    oriented = np.where(turned[shell][:, None], surface.faces[:, ::-1], surface.faces)
    body = _joined(surface, shell, np.where(outward, np.arange(len(shells)), holder))[shell]
    first = np.unique(body, return_index=True)[1]
    return [oriented[body == body[start]] for start in np.sort(first)]


def _components(neighbours: Ints) -> Ints:
    """The shell (m,) of each face: faces that hang together by edges."""
    count = len(neighbours)
    rows = np.repeat(np.arange(count), 3)
    return component_of(rows, neighbours.ravel(), count)


def _volume(corners: Floats) -> float:
    """Volume that triangles (k, 3, 3) enclose, negative if they face inwards (divergence theorem)."""
    a, b, c = (corners - corners.mean(axis=(0, 1))).transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def _nesting(surface: TriangleSurface, shells: list[Ints]) -> tuple[Ints, Ints]:
    """The innermost shell around each shell, -1 for none, and how many there are around it."""
    lo = np.array([surface.corners[faces].min(axis=(0, 1)) for faces in shells])
    hi = np.array([surface.corners[faces].max(axis=(0, 1)) for faces in shells])
    around: list[list[int]] = [[] for _ in shells]
    for pairs in overlapping_pairs(lo, hi, np.full(len(shells), -1)):
        for inner, outer in np.vstack([pairs, pairs[:, ::-1]]).tolist():
            within = (lo[inner] >= lo[outer]).all() and (hi[inner] <= hi[outer]).all()
            if within and _is_inside(surface, shells[inner], shells[outer]):
                around[inner].append(outer)
    depth = np.array([len(outer) for outer in around])
    return np.array([max(outer, key=lambda k: depth[k], default=-1) for outer in around]), depth


def _is_inside(surface: TriangleSurface, inner: Ints, outer: Ints) -> bool:
    """Does a shell lie inside of another that it does not cross?"""
    vertices = np.unique(surface.faces[inner])
    probes = surface.vertices[vertices[np.linspace(0, len(vertices) - 1, _PROBES).astype(np.int64)]]
    winding = np.array([_winding(surface.corners[outer], point) for point in probes])
    # On the other surface the number is no integer: the clearest answer counts.
    clearest = winding[np.abs(winding - np.round(winding)).argmin()]
    return bool(round(float(clearest)) != 0)


def _winding(corners: Floats, point: Floats) -> float:
    """How often triangles (k, 3, 3) go round a point.

    From the solid angles of the triangles (van Oosterom and Strackee, IEEE Transactions on Biomedical
    Engineering 30(2), 1983).
    """
    a, b, c = (corners - point).transpose(1, 0, 2)
    la, lb, lc = (np.sqrt((side**2).sum(axis=1)) for side in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=1)
    below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(np.arctan2(above, below).sum() / (2 * np.pi))


def _joined(surface: TriangleSurface, shell: Ints, body: Ints) -> Ints:
    """Body of each shell (s,), where shells that share a vertex are of one body."""
    corner = surface.faces.ravel()
    owner = np.zeros(len(surface.vertices), dtype=np.int64)
    own = np.repeat(shell, 3)
    owner[corner] = own
    rows, columns = np.concatenate([own, np.arange(len(body))]), np.concatenate([owner[corner], body])
    return component_of(rows, columns, len(body))


def _around(surface: TriangleSurface, faces: Ints) -> str:
    x, y, z = surface.corners[faces].reshape(-1, 3).mean(axis=0) + 0.0
    return f"around ({x:.5g}, {y:.5g}, {z:.5g}) mm"
