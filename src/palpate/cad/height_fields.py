"""Parts of a surface that are height fields, which cannot cross themselves.

Faces that all face one way, and whose common outline does not cross itself when seen from there, cover every
point of that view at most once (winding number of the outline; compare Volino and Magnenat-Thalmann,
Efficient self-collision detection on smoothly discretized surface animations, Computer Graphics Forum 13,
1994). `self_crossing` looks at no pair of faces within such a part, which spares it nearly all pairs.
"""

import itertools

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.connectivity import component_of
from palpate.cad.surface import TriangleSurface

__all__ = ["height_fields"]

_FACING = 0.15
"""Least cosine between a face's normal and the direction it is seen from."""
_SAME_AREA = 1e-9


def height_fields(surface: TriangleSurface) -> Ints:
    """A number (m,) for each face: faces with the same one do not cross each other; -1: not known."""
    views = _views()
    result = _checked(surface, views, _few_views(surface, views))
    # Where one part hides another of the same view, faces are sorted more finely.
    left = result < 0
    nearest = np.where(surface.thin, -1, (surface.normals @ views.T).argmax(axis=1))
    again = _checked(surface, views, np.where(left, nearest, -1))
    return np.where(left & (again >= 0), again + len(left), result)


def _checked(surface: TriangleSurface, views: Floats, view: Ints) -> Ints:
    """Numbers of the height fields among connected faces with the same view (m,), else -1."""
    # A face without a plane goes with a neighbour, so that it does not cut a part in two.
    for side in range(3):
        view = np.where((view < 0) & surface.thin, view[surface.neighbours[:, side]], view)
    part = _parts(surface.neighbours, view)
    rim = part[:, None] != part[surface.neighbours]
    result = part.copy()
    for faces in _grouped(part):
        towards = view[faces[0]]
        if towards < 0 or (len(faces) > 1 and not _is_field(surface, faces, rim[faces], views[towards])):
            result[faces] = -1
    return result


def _views() -> Floats:
    """26 directions: along the axes and between them, of length 1."""
    grid = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
    result: Floats = grid / np.sqrt((grid**2).sum(axis=1))[:, None]
    return result


def _few_views(surface: TriangleSurface, views: Floats) -> Ints:
    """For each face the index of a view that it faces, few views in all; -1 for none."""
    facing = surface.normals @ views.T > _FACING
    area = surface.heights + surface.tolerance
    view = np.full(len(surface.faces), -1)
    left = ~surface.thin
    while left.any():
        best = int((facing[left] * area[left, None]).sum(axis=0).argmax())
        taken = left & facing[:, best]
        view[taken] = best
        left &= ~taken
    return view


def _parts(neighbours: Ints, view: Ints) -> Ints:
    """Number of the part (m,) of each face: neighbours with the same view belong together."""
    face, side = np.nonzero(view[:, None] == view[neighbours])
    return component_of(face, neighbours[face, side], len(view))


def _grouped(part: Ints) -> list[Ints]:
    """The faces of each part."""
    order = np.argsort(part, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(part[order])) + 1)


def _is_field(surface: TriangleSurface, faces: Ints, rim: Bools, view: Floats) -> bool:
    """Does the outline of some faces, seen along `view`, go round every point at most once?

    The faces cover a point as often as their outline winds round it. Where its edges only meet at their
    ends, that is never more than once if it encloses as much as an even-odd filling does.
    """
    axis = np.eye(3)[np.abs(view).argmin()]
    across = np.cross(axis, view)
    across /= np.sqrt(across @ across)
    face, side = np.nonzero(rim)
    ends = np.stack([surface.faces[faces[face], side], surface.faces[faces[face], (side + 1) % 3]], axis=1)
    segments = surface.vertices[ends] @ np.column_stack([across, np.cross(view, across)])
    if not len(segments):
        return False
    outline = shapely.multilinestrings(shapely.linestrings(segments))
    if not outline.is_simple:
        return False
    middle = segments.mean(axis=(0, 1))
    (x0, y0), (x1, y1) = (segments[:, 0] - middle).T, (segments[:, 1] - middle).T
    winding = float((x0 * y1 - x1 * y0).sum() / 2)
    filled = float(shapely.build_area(outline).area)
    return abs(winding - filled) <= _SAME_AREA * filled
