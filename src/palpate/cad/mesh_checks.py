"""Checks of a triangle mesh: one `Solid` for each of its bodies, or what is wrong and where.

Equal corners become one vertex, which is all that formats without vertices (STL) leave to do; nothing else is
repaired.
"""

import numpy as np
from scipy.spatial import cKDTree

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.cad.bodies import bodies
from palpate.cad.connectivity import component_of
from palpate.cad.part_size import MIN_SIZE_MM, size_problem
from palpate.cad.self_crossing import ENOUGH, crossings
from palpate.cad.surface import TriangleSurface, edge_keys, rounding, surface_of
from palpate.cad.values import Solid

__all__ = ["check_solids"]

_FAR_MM = 10000.0
"""Bodies of one file are all within this."""


def check_solids(
    where: str, name: str, vertices_mm: Floats, faces: Ints, off_mm: float = 0.0, units: str | None = None
) -> tuple[Solid, ...]:
    """Check the triangles of one part of a file and split them into bodies that do not touch.

    `vertices_mm` (n, 3), `faces` (m, 3); `where` names the file and `units` what the user said its numbers
    are, if the file itself does not. Corners that differ by no more than `surface.rounding` are merged, and
    faces that lose a side by this are dropped. A closed shell within another one bounds a void of it. Several
    bodies are called name-1, name-2, … in the file's order.

    Raises InputError for anything but closed, oriented surfaces that do not cross themselves or each other,
    enclose a volume, and are 1 to 1000 mm long.
    """
    if not len(faces):
        raise InputError(f"{where}: has no faces; export the part as a closed solid")
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices_mm[used], faces.reshape(-1, 3).astype(np.int64)
    _check_numbers(where, vertices)
    _check_spread(where, vertices, units)
    tolerance = rounding(vertices)
    vertices, faces, moved = _merged(vertices, faces, tolerance)
    if not len(faces):
        raise InputError(f"{where}: has no faces wider than {tolerance:.2g} mm")
    _check_edges(where, vertices, faces)
    surface = surface_of(vertices, faces, tolerance)
    _check_crossings(where, surface)
    parts = bodies(where, surface)
    solids = []
    for number, part in enumerate(parts, start=1):
        kept, renumbered = np.unique(part, return_inverse=True)
        label = name if len(parts) == 1 else f"{name}-{number}"
        whole = where if len(parts) == 1 else f"{where}: body {number} of {len(parts)}"
        _check_size(whole, float(np.ptp(vertices[kept], axis=0).max()), units)
        off = off_mm if moved == 0 else float(np.nextafter(off_mm + moved, np.inf))
        solids.append(Solid(label, vertices[kept], renumbered.reshape(-1, 3), off))
    return tuple(solids)


def _check_numbers(where: str, vertices: Floats) -> None:
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(
            f"{where}: a vertex is at {_point(vertices[bad[0]])}{_more(len(bad), 'vertex', 'vertices')}; "
            "coordinates must be finite numbers"
        )


def _check_spread(where: str, vertices: Floats, units: str | None) -> None:
    """Refuse what cannot hold a body of the right size, or is too far away for single precision."""
    with np.errstate(over="ignore"):
        spread = float(np.ptp(vertices, axis=0).max())
    if not MIN_SIZE_MM <= spread <= _FAR_MM:
        _check_size(where, spread, units)
    if (away := float(np.abs(vertices).max())) > _FAR_MM:
        raise InputError(
            f"{where}: is {away:.4g} mm away from the origin of its file; "
            f"{_FAR_MM:g} mm are possible: move it there and export it again"
        )


def _check_size(where: str, side_mm: float, units: str | None) -> None:
    if problem := size_problem(np.array([side_mm]), units):
        raise InputError(f"{where}: {problem}")


def _merged(vertices: Floats, faces: Ints, tolerance: float) -> tuple[Floats, Ints, float]:
    """Vertices closer together than the tolerance made one, faces between different ones, longest move."""
    distinct, inverse = np.unique(vertices, axis=0, return_inverse=True)
    near = cKDTree(distinct).query_pairs(tolerance, output_type="ndarray")
    label = component_of(near[:, 0], near[:, 1], len(distinct))
    kept = np.zeros((int(label.max()) + 1, 3))
    # The last one written stays: any of them will do.
    kept[label] = distinct
    moved = float(np.sqrt(((kept[label] - distinct) ** 2).sum(axis=1).max()))
    faces = label[inverse.reshape(-1)[faces]]
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return kept, faces[proper], moved


def _check_edges(where: str, vertices: Floats, faces: Ints) -> None:
    """Every edge belongs to two faces, which run along it in opposite directions."""
    keys, reverse = edge_keys(faces, len(vertices))
    undirected, first, count = np.unique(
        np.minimum(keys, reverse).ravel(), return_index=True, return_counts=True
    )
    ends = vertices[np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)[first]]

    def place(bad: Ints) -> str:
        start, end = ends[bad[0]]
        return f"the edge from {_point(start)} to {_point(end)} mm"

    open_edges = np.flatnonzero(count == 1)
    if len(open_edges):
        raise InputError(
            f"{where}: is not watertight: {place(open_edges)} belongs to 1 face"
            f"{_more(len(open_edges), 'edge', 'edges')}; close the surface and export it again"
        )
    crowded = np.flatnonzero(count > 2)
    if len(crowded):
        raise InputError(
            f"{where}: is not the surface of a solid: {place(crowded)} belongs to {count[crowded[0]]} faces"
            f"{_more(len(crowded), 'edge', 'edges')}; 2 are allowed"
        )
    forward = np.bincount(np.searchsorted(undirected, keys[keys < reverse]), minlength=len(undirected))
    twisted = np.flatnonzero(forward != 1)
    if len(twisted):
        raise InputError(
            f"{where}: inside and outside are mixed up: at {place(twisted)} one face is turned over"
            f"{_more(len(twisted), 'edge', 'edges')}; make the normals consistent and export it again"
        )


def _check_crossings(where: str, surface: TriangleSurface) -> None:
    found = crossings(surface)
    if not len(found.pairs):
        return
    count = len(found.pairs) if len(found.pairs) <= ENOUGH else ENOUGH + 1
    more = _more(count, "pair", "pairs") if count <= ENOUGH else f" (and more than {ENOUGH - 1} more pairs)"
    raise InputError(
        f"{where}: intersects itself: two faces cross or overlap at {_point(found.places[0])} mm{more}; "
        "unite the bodies and export them again"
    )


def _point(point: Floats) -> str:
    return "(" + ", ".join(f"{value + 0.0:.5g}" for value in point) + ")"


def _more(count: int, one: str, many: str) -> str:
    """How many there are besides the one that is shown."""
    return "" if count == 1 else f" (and {count - 1} more {one if count == 2 else many})"
