"""Mending of surfaces: overlapping bodies are united, cracks closed, and crossings of a micrometre smoothed.

Programs write parts of several bodies into one file, leave cracks where faces meet, and facets that cross by
less than they mean. All is mended by the library manifold3d, but for cracks; how far surfaces move is stated.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.optional_imports import import_extra

_SMOOTHED_MM = 1e-3
"""Surfaces are moved by less than this (manifold3d, Simplify)."""

_CRACK_MM = 0.05
"""Width of what is a crack, and no hole."""

_TYPES = np.float64, np.uint64

Mesh = tuple[Floats, Ints]
"""Vertices (n, 3) and faces (m, 3)."""


def unite_bodies(bodies: Sequence[Mesh]) -> tuple[Mesh, float]:
    """Union of closed bodies that face outwards, and how far (mm) it may be off: what overlaps is one."""
    manifold3d = import_extra("manifold3d", "cad", "uniting bodies that overlap")
    parts = [_manifold_of(manifold3d, body) for body in bodies]
    whole = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add)
    return _mesh_of(whole), float(whole.get_tolerance())


def smooth_crossings(mesh: Mesh) -> tuple[Mesh, float] | None:
    """A surface without crossings of a micrometre, and how far (mm) it may be off; None if none is left."""
    manifold3d = import_extra("manifold3d", "cad", "mending surfaces that cross")
    whole = _manifold_of(manifold3d, mesh)
    if whole.status() != manifold3d.Error.NoError:
        return None
    smooth = whole.simplify(_SMOOTHED_MM)
    return None if smooth.is_empty() else (_mesh_of(smooth), _SMOOTHED_MM + float(whole.get_tolerance()))


def without_fins(faces: Ints) -> Ints:
    """Faces without those that lie on one another back to back: nothing is between them."""
    first = faces.argmin(axis=1)
    a, b, c = (faces[np.arange(len(faces)), (first + k) % 3] for k in range(3))
    _, kind, count = np.unique(
        np.column_stack([a, np.minimum(b, c), np.maximum(b, c)]),
        axis=0,
        return_inverse=True,
        return_counts=True,
    )
    balance = np.bincount(kind.ravel(), np.where(b < c, 1, -1))
    kept = faces[((count != 2) | (balance != 0))[kind.ravel()]]
    return kept if len(kept) else faces


def open_loops(faces: Ints) -> list[Ints]:
    """Vertices (k,) along the edge of each hole, as its facets run; none where holes meet in a vertex."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    is_open = ~np.isin(end * count + start, start * count + end)
    following = dict(zip(end[is_open].tolist(), start[is_open].tolist(), strict=True))
    if len(following) != np.count_nonzero(is_open):
        return []
    loops = []
    while following:
        start, at = following.popitem()
        loop = [start]
        while at != start:
            if at not in following:
                return []
            loop.append(at)
            at = following.pop(at)
        loops.append(np.array(loop))
    return loops


def close_cracks(mesh: Mesh) -> tuple[Mesh, float] | None:
    """A surface whose cracks are closed by facets, and how wide (mm) they were; None: it has holes."""
    vertices, faces = mesh
    more: list[Ints] = []
    widest = 0.0
    for loop in open_loops(faces):
        width, first = _crack(vertices[loop])
        if len(loop) < 3 or width > _CRACK_MM:
            return None
        widest, turned = max(widest, width), np.roll(loop, -first)
        more.append(np.column_stack([np.full(len(loop) - 2, turned[0]), turned[1:-1], turned[2:]]))
    return None if not more else ((vertices, np.vstack([faces, *more])), widest)


def _crack(points: Floats) -> tuple[float, int]:
    """Width of a loop (k, 3) across the line between its ends, and the index of one of them."""
    first = int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())
    away = points - points[first]
    length = np.linalg.norm(away, axis=1)
    along = away[int(length.argmax())] / max(float(length.max()), 1e-12)
    across = away - (away @ along)[:, None] * along
    return 2 * float(np.linalg.norm(across, axis=1).max()), first


def _manifold_of(manifold3d: Any, mesh: Mesh) -> Any:
    vertices, faces = (np.array(item, dtype=kind, order="C") for item, kind in zip(mesh, _TYPES, strict=True))
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))


def _mesh_of(manifold: Any) -> Mesh:
    mesh = manifold.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
    return vertices, np.asarray(mesh.tri_verts, dtype=np.int64)
