"""Distinct shapes of a trimesh scene (3MF, STEP): four screws of an assembly are one object."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.files.limits import FACETS
from palpate.base.geometry import Floats, Ints

__all__ = ["ScenePart", "distinct_shapes", "triangles"]

_SAME = 1e-6
"""Transforms whose lengths and angles differ by less are the same but for position and heading."""

_PLACEHOLDER = re.compile(
    r"Open CASCADE STEP translator [\d. ]*|Unnamed\d*|geometry_\d+|=>\[[\d:]*\]"
    r"|COMPOUND|COMPSOLID|SOLID|SHELL",
    re.IGNORECASE,
)
"""What Open CASCADE (FreeCAD, CadQuery) and mesh programs call parts that have no name."""


@dataclass(frozen=True, eq=False)
class ScenePart:
    """A part of a scene where it first occurs: `vertices` (n, 3) in the scene's frame, `faces` (m, 3)."""

    name: str
    vertices: Floats
    faces: Ints


def triangles(where: str, mesh: Any) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and faces (m, 3) of a trimesh geometry; InputError where a face names none of them."""
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"{where}: its vertices do not have 3 coordinates each")
    if not faces.size:
        return vertices, np.zeros((0, 3), dtype=np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"{where}: its faces do not have 3 corners each")
    if len(faces) > FACETS:
        raise InputError(
            f"{where}: has {len(faces)} facets; at most {FACETS} are read: export it more coarsely"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        worst = int(faces.max() if faces.max() >= len(vertices) else faces.min())
        raise InputError(f"{where}: a face has vertex {worst}, counted from 0; there are {len(vertices)}")
    return vertices, faces


def distinct_shapes(where: str, scene: Any, fallback: str) -> list[ScenePart]:
    """Parts of a trimesh scene that differ in more than place and heading, by name or `fallback`."""
    found: list[ScenePart] = []
    seen: dict[str, list[Floats]] = {}
    for node in sorted(scene.graph.nodes_geometry, key=lambda node: _order(scene, node)):
        transform, geometry = scene.graph[node]
        linear = np.asarray(transform, dtype=np.float64)[:3, :3]
        # Equal up to a rotation: the same lengths and angles, and the same handedness.
        kind = np.append((linear.T @ linear).ravel(), np.sign(np.linalg.det(linear)))
        if any(np.abs(kind - other).max() <= _SAME for other in seen.setdefault(geometry, [])):
            continue
        seen[geometry].append(kind)
        mesh = scene.geometry[geometry]
        if not hasattr(mesh, "faces"):
            continue
        name = _real_name(str(geometry)) or fallback
        vertices, faces = triangles(f"{where}: {name}", mesh)
        found.append(ScenePart(name, vertices @ linear.T + np.asarray(transform)[:3, 3], faces))
    return found


def _real_name(name: str) -> str:
    """A part's name; empty for one that a program gives to what nobody has named."""
    name = name.strip()
    return "" if _PLACEHOLDER.fullmatch(name) else name


def _order(scene: Any, node: str) -> tuple[int, str]:
    return list(scene.geometry).index(scene.graph[node][1]), str(node)
