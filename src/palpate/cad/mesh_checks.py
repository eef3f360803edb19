"""Checks of a triangle mesh: one `Solid` per body, or an error that says what is wrong and where.

Equal corners become one vertex, which is all that formats without vertices (STL) leave to do. Shells that
cross are united if each of them is a body, and crossings of a micrometre are smoothed (`mesh_mending`);
nothing else is repaired. A shell within another one bounds a void of it; one within that void is a body of
its own.
"""

from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from scipy.spatial import cKDTree

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.mesh_mending import Mesh, close_cracks, smooth_crossings, unite_bodies, without_fins
from palpate.cad.mesh_topology import (
    TriangleSurface,
    component_of,
    edge_keys,
    overlapping_pairs,
    triangle_surface_of,
    vertex_rounding,
)
from palpate.cad.parts import MIN_SIZE_MM, Solid, size_problem
from palpate.cad.self_crossing import MAX_CROSSINGS, FaceCrossings, find_crossings
from palpate.cad.touching_edges import part_touching_edges

_PROBE_COUNT = 5
"""Vertices of a shell that are asked whether they are inside another: some may touch it."""

_CLEAR_WINDING = 1e-6
"""Winding numbers nearer to an integer are clear: no further vertex is asked."""


class UnsoundSurfaceError(InputError):
    """Refusal of a surface that bounds no solid: the `problem`, and what to do about it."""

    def __init__(self, problem: str, advice: str = "") -> None:
        super().__init__(f"{problem}; {advice}" if advice else problem)
        self.problem = problem

    def __reduce__(self) -> tuple[type[InputError], tuple[str]]:
        return InputError, (str(self),)


class CrowdedEdgeError(UnsoundSurfaceError):
    """Refusal of a surface with an edge of more than two faces."""


class OpenSurfaceError(UnsoundSurfaceError):
    """Refusal of a surface that is not closed."""


def _split_bodies(where: str, surface: TriangleSurface) -> list[Ints]:
    """Faces (k, 3) of each body, outside seen counter-clockwise, in the order of the file.

    A shell that is inside out as a whole, with all it holds, is turned: of a closed surface there is no
    doubt. Shells that touch in a vertex belong together. Raises InputError for a shell without volume, and
    for one within another that is wound the same way, which leaves open whether it bounds a void.
    """
    shell = _shell_of_faces(surface.neighbours)
    shells = np.split(np.argsort(shell, kind="stable"), np.cumsum(np.bincount(shell))[:-1])
    volume = np.array([_volume(surface.corners[faces]) for faces in shells])
    for faces, enclosed in zip(shells, volume, strict=True):
        corners = surface.corners[faces]
        area = np.sqrt(
            (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) ** 2).sum(axis=1)
        )
        if abs(enclosed) <= surface.tolerance * area.sum() / 2:
            raise UnsoundSurfaceError(f"{where}: the surface {_around(surface, faces)} encloses no volume")
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
    body = _join_touching(surface, shell, np.where(outward, np.arange(len(shells)), holder))[shell]
    first = np.unique(body, return_index=True)[1]
    return [oriented[body == body[start]] for start in np.sort(first)]


def _shell_of_faces(neighbours: Ints) -> Ints:
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
    probes = surface.vertices[vertices[np.linspace(0, len(vertices) - 1, _PROBE_COUNT).astype(np.int64)]]
    # On the other surface the number is no integer: the clearest answer counts.
    windings: list[float] = []
    for point in probes:
        windings.append(_winding(surface.corners[outer], point))
        if _off_integer(windings[-1]) <= _CLEAR_WINDING:
            break
    clearest = min(windings, key=_off_integer)
    return round(clearest) != 0


def _off_integer(number: float) -> float:
    return abs(number - round(number))


def _winding(corners: Floats, point: Floats) -> float:
    """Winding number of triangles (k, 3, 3) round a point.

    From the solid angles of the triangles (van Oosterom and Strackee, IEEE Transactions on Biomedical
    Engineering 30(2), 1983).
    """
    a, b, c = (corners - point).transpose(1, 0, 2)
    la, lb, lc = (np.sqrt((side**2).sum(axis=1)) for side in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=1)
    below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(np.arctan2(above, below).sum() / (2 * np.pi))


def _join_touching(surface: TriangleSurface, shell: Ints, body: Ints) -> Ints:
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


_MAX_SPREAD_MM = 10000.0
"""Bodies of one file are all within this."""


def check_solids(
    where: str, name: str, vertices_mm: Floats, faces: Ints, off_mm: float = 0.0, units: str | None = None
) -> tuple[Solid, ...]:
    """Check the triangles of one part of a file and split them into bodies that do not touch.

    `vertices_mm` (n, 3), `faces` (m, 3); `where` names the file and `units` what the user said its numbers
    are, if the file itself does not. Corners that differ by no more than `surface.rounding` are merged, and
    faces that lose a side by this are dropped. A closed shell within another one bounds a void of it. Several
    bodies are called name-1, name-2, … in the file's order.

    Fragments of less than 1 mm beside a part are left out. Raises InputError for anything but closed and
    oriented surfaces that do not cross themselves or each other, enclose a volume, and are 1 to 1000 mm long.
    """
    if not len(faces):
        raise InputError(f"{where}: has no faces; export the part as a closed solid")
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices_mm[used], faces.reshape(-1, 3).astype(np.int64)
    _check_numbers(where, vertices)
    _check_spread(where, vertices, units)
    tolerance = vertex_rounding(vertices)
    vertices, faces, moved = merge_vertices(vertices, faces, tolerance)
    if not len(faces):
        raise InputError(f"{where}: has no faces wider than {tolerance:.2g} mm")
    before, faces = len(faces), without_fins(faces)
    fins = (
        (f"{before - len(faces)} faces that lie back to back were left out",) if len(faces) < before else ()
    )
    found = _sound_surface(where, (vertices, faces), tolerance)
    surface, vertices, moved = found.surface, found.surface.vertices, moved + found.moved_mm
    parts, fragments = _without_fragments(surface, _split_bodies(where, surface))
    solids = []
    for number, part in enumerate(parts, start=1):
        kept, renumbered = np.unique(part, return_inverse=True)
        label = name if len(parts) == 1 else f"{name}-{number}"
        whole = where if len(parts) == 1 else f"{where}: body {number} of {len(parts)}"
        _check_size(whole, float(np.ptp(vertices[kept], axis=0).max()), units)
        off = off_mm if moved == 0 else float(np.nextafter(off_mm + moved, np.inf))
        mended = (*fins, *found.mended, *fragments)
        solids.append(Solid(label, vertices[kept], renumbered.reshape(-1, 3), off, mended=mended))
    return tuple(solids)


_FRAGMENT_SHARE = 1 / 20
"""Bodies that are too small for parts, but not smaller than the largest by this, may have a wrong unit."""


def _without_fragments(surface: TriangleSurface, bodies: list[Ints]) -> tuple[list[Ints], tuple[str, ...]]:
    """The bodies without those that are too small to be parts; how many these are, in words."""
    sides_mm = [float(np.ptp(surface.vertices[np.unique(body)], axis=0).max()) for body in bodies]
    least_mm = min(MIN_SIZE_MM, _FRAGMENT_SHARE * max(sides_mm))
    parts = [body for body, side in zip(bodies, sides_mm, strict=True) if side >= least_mm]
    fragments = len(bodies) - len(parts)
    if not fragments:
        return bodies, ()
    were = "body was" if fragments == 1 else "bodies were"
    return parts, (f"{fragments} {were} left out: smaller than {least_mm:.3g} mm",)


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
    if not MIN_SIZE_MM <= spread <= _MAX_SPREAD_MM:
        _check_size(where, spread, units)
    if (away := float(np.abs(vertices).max())) > _MAX_SPREAD_MM:
        raise InputError(
            f"{where}: is {away:.4g} mm away from the origin of its file; "
            f"{_MAX_SPREAD_MM:g} mm are possible: move it there and export it again"
        )


def _check_size(where: str, side_mm: float, units: str | None) -> None:
    if problem := size_problem(np.array([side_mm]), units):
        raise InputError(f"{where}: {problem}")


def merge_vertices(vertices: Floats, faces: Ints, tolerance: float) -> tuple[Floats, Ints, float]:
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
        raise OpenSurfaceError(
            f"{where}: is not watertight: {place(open_edges)} belongs to 1 face"
            f"{_more(len(open_edges), 'edge', 'edges')}",
            "close the surface and export it again",
        )
    crowded = np.flatnonzero(count > 2)
    if len(crowded):
        raise CrowdedEdgeError(
            f"{where}: is not the surface of a solid: {place(crowded)} belongs to {count[crowded[0]]} faces"
            f"{_more(len(crowded), 'edge', 'edges')}, not to 2"
        )
    forward = np.bincount(np.searchsorted(undirected, keys[keys < reverse]), minlength=len(undirected))
    twisted = np.flatnonzero(forward != 1)
    if len(twisted):
        raise UnsoundSurfaceError(
            f"{where}: inside and outside are mixed up: at {place(twisted)} one face is turned over"
            f"{_more(len(twisted), 'edge', 'edges')}",
            "make the normals consistent and export it again",
        )


@dataclass(frozen=True, eq=False)
class _SoundSurface:
    """A closed surface without crossings, how far it was moved to be one, and what was `mended`, in words."""

    surface: TriangleSurface
    moved_mm: float = 0.0
    mended: tuple[str, ...] = ()


def _sound_surface(where: str, mesh: Mesh, tolerance: float) -> _SoundSurface:
    """The surface of a mesh, mended where that is possible. Raises InputError where it is not."""
    moved, words = 0.0, tuple[str, ...]()
    try:
        _check_edges(where, *mesh)
    except OpenSurfaceError:
        closed = close_cracks(mesh)
        smoothed = None if closed is None else smooth_crossings(closed[0])
        if closed is None or smoothed is None:
            raise
        mesh, moved = smoothed[0], closed[1] + smoothed[1]
        words = (f"cracks of up to {closed[1]:.2g} mm were closed",)
        _check_edges(where, *mesh)
    except CrowdedEdgeError:
        parted = part_touching_edges(mesh, tolerance)
        if parted is None:
            raise
        mesh, moved = parted
        words = (f"edges that touch one another were parted by {moved:.2g} mm",)
        _check_edges(where, *mesh)
    surface = triangle_surface_of(*mesh, tolerance)
    crossings = find_crossings(surface)
    if not len(crossings.pairs):
        return _SoundSurface(surface, moved, words)
    found = _without_crossings(surface, crossings)
    if found is None:
        _refuse_crossings(where, crossings)
    return _SoundSurface(found.surface, moved + found.moved_mm, (*words, *found.mended))


def _without_crossings(surface: TriangleSurface, crossings: FaceCrossings) -> _SoundSurface | None:
    """The surface without crossings; None if that cannot be had."""
    mesh: Mesh = surface.vertices, surface.faces
    moved, words = 0.0, tuple[str, ...]()
    shell = _shell_of_faces(surface.neighbours)
    between = shell[crossings.pairs]
    if (between[:, 0] != between[:, 1]).any():
        bodies = [_own_mesh(surface, shell == number) for number in range(int(shell.max()) + 1)]
        if any(_volume(vertices[faces]) <= 0 for vertices, faces in bodies):
            return None  # one may bound a void
        mesh, moved = unite_bodies(bodies)
        words = ("bodies that cross were united",)
        made = _surface_without_crossings(mesh, surface.tolerance)
        if made is not None:
            return _SoundSurface(made, moved, words)
    smoothed = smooth_crossings(mesh)
    made = None if smoothed is None else _surface_without_crossings(smoothed[0], surface.tolerance)
    if smoothed is None or made is None:
        return None
    return _SoundSurface(made, moved + smoothed[1], (*words, "crossings of less than 1 µm were smoothed"))


def _surface_without_crossings(mesh: Mesh, tolerance: float) -> TriangleSurface | None:
    """The surface of a mesh; None if it is not closed, or crosses itself."""
    if not len(mesh[1]):
        return None
    try:
        _check_edges("", *mesh)
    except InputError:
        return None
    surface = triangle_surface_of(*mesh, tolerance)
    return None if len(find_crossings(surface).pairs) else surface


def _own_mesh(surface: TriangleSurface, chosen: Bools) -> Mesh:
    """Some faces, with the vertices that they use."""
    used, faces = np.unique(surface.faces[chosen], return_inverse=True)
    return surface.vertices[used], faces.reshape(-1, 3)


def _refuse_crossings(where: str, found: FaceCrossings) -> NoReturn:
    count = len(found.pairs) if len(found.pairs) <= MAX_CROSSINGS else MAX_CROSSINGS + 1
    more = (
        _more(count, "pair", "pairs")
        if count <= MAX_CROSSINGS
        else f" (and more than {MAX_CROSSINGS - 1} more pairs)"
    )
    raise UnsoundSurfaceError(
        f"{where}: intersects itself: two faces cross or overlap at {_point(found.places[0])} mm{more}",
        "unite the bodies and export them again",
    )


def _point(point: Floats) -> str:
    return "(" + ", ".join(f"{value + 0.0:.5g}" for value in point) + ")"


def _more(count: int, one: str, many: str) -> str:
    """Number of faults besides the one that is shown, in words."""
    return "" if count == 1 else f" (and {count - 1} more {one if count == 2 else many})"
