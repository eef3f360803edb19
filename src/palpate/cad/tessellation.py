"""Tessellation of STEP files: OpenCASCADE, through cascadio, cuts their shapes into triangles.

Each distinct shape of an assembly comes once, named as in the file; a shape whose faces have several colours
is one. OpenCASCADE writes metres in single precision, whatever the file's unit. The cones that it cut are
told, so that those on which it gave up can be put back (`lost_cones`).
"""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.base.optional_imports import import_extra
from palpate.cad.lost_cones import Cone
from palpate.cad.mesh_files import mesh_triangles
from palpate.cad.parts import real_name

_SAME_TRANSFORM = 1e-6
"""Transforms whose lengths and angles differ by less are the same but for position and heading."""

_DEVIATION_SHARE = 0.4
"""OpenCASCADE is asked for this share of the deviation that is allowed.

On spheres it exceeds what it is asked for, 2.17 times at most; on tori, revolved splines, lofts and fillets
it keeps to it (sampled at radii of 1 to 120 mm and deviations of 2 µm to 0.2 mm).
"""

_MM = 1000.0
"""Millimetres of a metre."""


@dataclass(frozen=True, eq=False)
class StepShape:
    """A shape where it first occurs: `vertices_mm` (n, 3) in the file's frame, `faces` (m, 3).

    `place` (4, 4): from its own frame, of `cones` that were cut, to the file's.
    """

    name: str
    vertices_mm: Floats
    faces: Ints
    place: Floats
    cones: tuple[Cone, ...] = ()


def tessellate(path: Path, within_mm: float, turn_rad: float) -> list[StepShape]:
    """Distinct shapes of a STEP file; chords deviate by `within_mm` and turn by `turn_rad`, at most.

    What OpenCASCADE makes of a damaged file may be a crash, a search without end or more memory than there
    is. Raises InputError for a file without any shape.
    """
    trimesh = import_extra("trimesh", "step", "reading STEP files")
    cascadio = import_extra("cascadio", "step", "reading STEP files")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "tessellated.glb"
        # One thread: the same triangles in the same order, always.
        failed = cascadio.step_to_glb(
            str(path.resolve()),
            str(target),
            tol_linear=within_mm * _DEVIATION_SHARE,
            tol_angular=turn_rad,
            use_parallel=False,
            include_brep=True,
            brep_types={"cone"},
        )
        if failed or not target.is_file():
            raise InputError(f"{path}: OpenCASCADE cannot read it, or it holds no solid; export it again")
        target.write_bytes(_one_mesh_a_shape(target.read_bytes()))
        try:
            scene = trimesh.load_scene(target, process=False, merge_primitives=True)
        except MemoryError:
            raise
        except Exception:
            raise InputError(f"{path}: holds no solid") from None
    return _distinct_shapes(str(path), scene, path.stem)


def _distinct_shapes(where: str, scene: Any, fallback: str) -> list[StepShape]:
    """Shapes of a trimesh scene that differ in more than name, place and heading, by name or `fallback`.

    OpenCASCADE writes a shape again wherever it occurs, and programs write it under several names.
    """
    found: list[StepShape] = []
    seen: dict[tuple[bytes, bytes], list[Floats]] = {}
    rank = {geometry: number for number, geometry in enumerate(scene.geometry)}
    for node in sorted(scene.graph.nodes_geometry, key=lambda node: (rank[scene.graph[node][1]], str(node))):
        transform, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if not hasattr(mesh, "faces"):
            continue
        matrix = np.asarray(transform, dtype=np.float64)
        linear = matrix[:3, :3]
        # Equal up to a rotation: the same lengths and angles, and the same handedness.
        kind = np.append((linear.T @ linear).ravel(), np.sign(np.linalg.det(linear)))
        alike = seen.setdefault((mesh.vertices.tobytes(), mesh.faces.tobytes()), [])
        if any(np.abs(kind - other).max() <= _SAME_TRANSFORM for other in alike):
            continue
        alike.append(kind)
        name = real_name(mesh.metadata["product"]) or fallback
        vertices, faces = mesh_triangles(f"{where}: {name}", mesh)
        cones = tuple(
            Cone(np.array(apex) * _MM, np.array(axis), half) for apex, axis, half in mesh.metadata["cones"]
        )
        place = np.vstack([matrix[:3] * [1, 1, 1, _MM], matrix[3:]])
        found.append(StepShape(name, vertices @ linear.T * _MM + place[:3, 3], faces, place, cones))
    return found


def _one_mesh_a_shape(glb: bytes) -> bytes:
    """The same binary glTF 2.0, told so that trimesh makes one mesh of each shape, with its cones and name.

    A shape whose faces have several colours comes as several lists of triangles, each of which is open, and
    trimesh joins only those that have a material. It cannot read two names that are equal and have braces.
    """
    size = int.from_bytes(glb[12:16], "little")
    header = json.loads(glb[20 : 20 + size])
    header.setdefault("materials", [{}])
    for number, node in enumerate(header.get("nodes", ())):
        node["name"] = f"{number:07}"
    for number, mesh in enumerate(header.get("meshes", ())):
        cones: list[Any] = []
        for triangles in mesh["primitives"]:
            triangles.setdefault("material", 0)
            surfaces = triangles.pop("extensions", {}).get("TM_brep_faces", {}).get("faces", ())
            cones += [(item["apex"], item["axis"], abs(item["semi_angle"])) for item in surfaces if item]
        mesh["extras"] = {"cones": cones, "product": mesh.get("name", "")}
        mesh["name"] = f"shape {number}"
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = glb[20 + size :]
    whole = (20 + len(text) + len(rest)).to_bytes(4, "little")
    return glb[:8] + whole + len(text).to_bytes(4, "little") + glb[16:20] + text + rest
