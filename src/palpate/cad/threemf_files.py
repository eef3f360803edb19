"""3MF files: what is to be printed, as checked solids.

A part is what an item of the build refers to: an object's mesh, or its components, united. Objects that are
no model (supports, surfaces), items that are not to be printed, and what slicers keep in an object without
printing it (modifiers, blockers of supports) are left out, and counted. Sources: 3MF Core Specification 1.3
and Production Extension 1.1, https://3mf.io/spec/; PrusaSlicer and Bambu Studio as they write their own
`Metadata`.
"""

import io
import math
import posixpath
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from palpate.base.errors import InputError
from palpate.base.file_io import (
    CAD_BYTES,
    MOST_DRAWN_PIECES,
    MOST_FACETS,
    MOST_MEMBERS,
    MOST_NESTING,
    read_bytes,
    size_in_words,
)
from palpate.base.geometry import Bools, Floats
from palpate.cad.mesh_checks import check_solids
from palpate.cad.mesh_mending import Mesh, unite_bodies
from palpate.cad.parts import GIVE_NO_UNITS, UNIT_MM, Solid, SolidFile, real_name

_UNIT_MM = {
    "micron": 0.001,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}
"""Units of the core specification; a file that names none is in millimetres."""

_ADVICE = "export the part more coarsely"
_MODEL_TYPE = "/3dmodel"  # end of the relationship's type that names the model
_USUAL_MODEL = "3D/3dmodel.model"
_SAME_TRANSFORM = 1e-6
"""Transforms whose lengths and angles differ by less are the same but for position and heading."""

_PRUSA_VOLUMES, _BAMBU_PARTS = "Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config"
_PRINTED = {"ModelPart", "normal_part"}
_SUBTRACTED = {"NegativeVolume", "negative_part"}


def read_3mf(path: Path, units: str | None) -> SolidFile:
    """Read the parts of a 3MF file in mm, each shape once; `units` may repeat the file's.

    Raises InputError for what cannot be read, for units that are not the file's, and for what `mesh_checks`
    refuses.
    """
    package = _Package.open(path)
    root = package.model(package.root)
    if root.unit not in _UNIT_MM:
        raise InputError(f"{path}: unknown unit '{root.unit}'; 3MF allows {', '.join(_UNIT_MM)}")
    if units is not None and UNIT_MM[units] != _UNIT_MM[root.unit]:
        raise InputError(f"{path}: says that it is in {root.unit}, not in {units}: {GIVE_NO_UNITS}")
    scale, solids, refused = _UNIT_MM[root.unit], list[Solid](), list[str]()
    for name, meshes in package.build():
        where = f"{path}: {name}"
        scaled = [(vertices * scale, faces) for vertices, faces in meshes]
        try:
            solids += (
                _unite(where, name, scaled) if len(scaled) > 1 else check_solids(where, name, *scaled[0])
            )
        except InputError as error:
            refused.append(str(error).removeprefix(f"{path}: "))
    left_out = tuple(f"{count} {what}" for what, count in package.left_out.most_common())
    if not (solids or refused):
        also = f"; left out: {', '.join(left_out)}" if left_out else ""
        raise InputError(f"{path}: has no parts to be printed{also}; export the part as a closed solid")
    return SolidFile(tuple(solids), left_out, tuple(refused))


def _unite(where: str, name: str, meshes: Sequence[Mesh]) -> tuple[Solid, ...]:
    """Solids of a part that consists of several: what overlaps or touches is one."""
    bodies = [
        solid
        for number, mesh in enumerate(meshes, 1)
        for solid in check_solids(f"{where}: component {number} of {len(meshes)}", name, *mesh)
    ]
    whole, moved = unite_bodies([(item.vertices_mm, item.faces) for item in bodies])
    off = math.nextafter(max(item.off_mm for item in bodies) + moved, math.inf)
    return check_solids(where, name, *whole, off)


@dataclass(frozen=True, eq=False)
class _Component:
    """Reference to an object; `path` of another model file, "" for the same."""

    path: str
    object_id: str
    matrix: Floats
    shift: Floats


@dataclass(frozen=True, eq=False)
class _Object:
    """An object: its mesh, or the components that it consists of."""

    kind: str
    name: str
    mesh: Mesh | None
    components: tuple[_Component, ...]


@dataclass(frozen=True, eq=False)
class _Model:
    """A model file: its unit, objects by id, and the items of its build with whether they are printed."""

    unit: str
    objects: Mapping[str, _Object]
    items: tuple[tuple[_Component, bool, str], ...]


class _Package:
    """A 3MF file under way; `left_out` counts what is no part."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        self._models: dict[str, _Model] = {}
        self._pieces = 0
        self.left_out: Counter[str] = Counter()
        self.root = self._root()
        self._roles = self._slicer_roles()

    @classmethod
    def open(cls, path: Path) -> "_Package":
        data = read_bytes(path, CAD_BYTES, _ADVICE)
        try:
            archive = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, ValueError, NotImplementedError, UnicodeDecodeError, EOFError) as error:
            raise InputError(f"{path}: cannot be read as 3MF: {error}") from None
        members = archive.infolist()
        # No member gives more than its directory says: zipfile stops there.
        unpacked = sum(member.file_size for member in members)
        if unpacked > CAD_BYTES:
            most = size_in_words(CAD_BYTES)
            raise InputError(
                f"{path}: is {size_in_words(unpacked)} when unpacked; at most {most} are read: {_ADVICE}"
            )
        if len(members) > MOST_MEMBERS:
            raise InputError(
                f"{path}: holds {len(members)} files; at most {MOST_MEMBERS} are read: "
                "leave out what is no part"
            )
        return cls(path, archive)

    def _xml(self, member: str) -> Element | None:
        """The outermost element of a member, in whatever case its name is; None if there is none."""
        names = {name.casefold(): name for name in self._archive.namelist()}
        name = names.get(member.lstrip("/").casefold())
        if name is None:
            return None
        try:
            return ElementTree.fromstring(self._archive.read(name))
        except (
            ElementTree.ParseError,
            ValueError,
            LookupError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise InputError(f"{self._path}: {name} cannot be read: {error}") from None
        except (NotImplementedError, RuntimeError, EOFError) as error:
            raise InputError(f"{self._path}: {name} cannot be unpacked: {error}") from None

    def _root(self) -> str:
        """Name of the member that holds the model, as the package says."""
        relations = self._xml("_rels/.rels")
        for item in () if relations is None else relations.iter():
            if item.get("Type", "").endswith(_MODEL_TYPE):
                return posixpath.normpath(item.get("Target", _USUAL_MODEL)).lstrip("/")
        return _USUAL_MODEL

    def model(self, member: str) -> _Model:
        """Return a model file of the package, read once."""
        key = member.lstrip("/").casefold()
        if key not in self._models:
            root = self._xml(member)
            if root is None:
                raise InputError(f"{self._path}: has no model: {member} is not in it")
            self._models[key] = _read_model(f"{self._path}: {member}", root)
        return self._models[key]

    def build(self) -> Iterator[tuple[str, list[Mesh]]]:
        """Parts that are to be printed: name, and the meshes that each consists of; each shape once."""
        seen: dict[tuple[str, str], list[Floats]] = {}
        for item, printed, number in self.model(self.root).items:
            if not printed:
                self.left_out["not to be printed"] += 1
                continue
            member = item.path or self.root
            found = self._object(member, item.object_id)
            if found.kind != "model":
                self.left_out[f"of type {found.kind}"] += 1
                continue
            # Equal up to a rotation: the same lengths and angles, and the same handedness.
            linear = item.matrix
            kind = np.append((linear @ linear.T).ravel(), np.sign(np.linalg.det(linear)))
            known = seen.setdefault((member, item.object_id), [])
            if any(np.abs(kind - other).max() <= _SAME_TRANSFORM for other in known):
                continue
            known.append(kind)
            meshes = list(self._meshes(member, item, 0))
            if meshes:
                yield real_name(found.name) or real_name(number) or self._path.stem, meshes

    def _object(self, member: str, object_id: str) -> _Object:
        found = self.model(member).objects.get(object_id)
        if found is None:
            raise InputError(f"{self._path}: {member} has no object '{object_id}', which is referred to")
        return found

    def _meshes(self, member: str, item: _Component, depth: int) -> Iterator[Mesh]:
        """Meshes of an object in the frame in which the item places it."""
        self._pieces += 1
        if depth > MOST_NESTING or self._pieces > MOST_DRAWN_PIECES:
            raise InputError(
                f"{self._path}: object '{item.object_id}' is within itself, or consists of more than "
                f"{MOST_DRAWN_PIECES} others"
            )
        found = self._object(member, item.object_id)
        if found.kind not in ("model", "other"):
            self.left_out[f"of type {found.kind}"] += 1
            return
        if found.mesh is not None:
            for vertices, faces in self._printed_volumes(item.object_id, found.mesh):
                turned = np.linalg.det(item.matrix) < 0
                yield vertices @ item.matrix + item.shift, faces[:, ::-1] if turned else faces
        for part in found.components:
            if self._is_printed(item.object_id, part.object_id):
                inner = _Component(
                    part.path,
                    part.object_id,
                    part.matrix @ item.matrix,
                    part.shift @ item.matrix + item.shift,
                )
                yield from self._meshes(part.path or member, inner, depth + 1)

    def _is_printed(self, object_id: str, part_id: str) -> bool:
        return self._counts(self._roles.get((object_id, part_id), "normal_part"))

    def _counts(self, role: str) -> bool:
        """True if what has a role in a slicer's file is part of the print."""
        if role in _SUBTRACTED:
            raise InputError(
                f"{self._path}: a slicer subtracts a volume ({role}) from the part; export the printed shape"
            )
        if role not in _PRINTED:
            self.left_out[f"of kind {role}"] += 1
        return role in _PRINTED

    def _printed_volumes(self, object_id: str, mesh: Mesh) -> Iterator[Mesh]:
        """The mesh, or those of its volumes that are printed, where PrusaSlicer lists them."""
        volumes = [
            (key, role) for (owner, key), role in self._roles.items() if owner == object_id and ":" in key
        ]
        vertices, faces = mesh
        if not volumes:
            yield mesh
        for key, role in volumes:
            first, last = (int(number) for number in key.split(":"))
            if self._counts(role):
                yield vertices, faces[first : last + 1]

    def _slicer_roles(self) -> dict[tuple[str, str], str]:
        """Roles of volumes by object, and by component or range of triangles ("first:last")."""
        roles: dict[tuple[str, str], str] = {}
        for member in (_PRUSA_VOLUMES, _BAMBU_PARTS):
            root = self._xml(member)
            for owner in () if root is None else root.findall("object"):
                for part in owner.findall("part"):
                    roles[owner.get("id", ""), part.get("id", "")] = part.get("subtype", "normal_part")
                for volume in owner.findall("volume"):
                    said = {item.get("key"): item.get("value", "") for item in volume.findall("metadata")}
                    if (volume.get("firstid") or "").isdigit() and (volume.get("lastid") or "").isdigit():
                        key = f"{volume.get('firstid')}:{volume.get('lastid')}"
                        roles[owner.get("id", ""), key] = said.get("volume_type", "ModelPart")
        return roles


def _local(element: Element) -> str:
    """The name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _inside(element: Element, name: str) -> list[Element]:
    """Elements of a name right within another one, in whatever namespace."""
    return [child for child in element if _local(child) == name]


def _attribute(element: Element, name: str) -> str:
    """Value of an attribute, in whatever namespace; empty if there is none."""
    return next((value for key, value in element.attrib.items() if key.rpartition("}")[2] == name), "")


def _read_model(where: str, root: Element) -> _Model:
    objects = {
        _attribute(item, "id"): _read_object(where, item)
        for resources in _inside(root, "resources")
        for item in _inside(resources, "object")
    }
    items = tuple(
        (_read_component(where, item), _attribute(item, "printable") != "0", _attribute(item, "partnumber"))
        for build in _inside(root, "build")
        for item in _inside(build, "item")
    )
    return _Model(root.get("unit", "millimeter"), objects, items)


def _read_object(where: str, item: Element) -> _Object:
    meshes = [_read_mesh(f"{where}: object {_attribute(item, 'id')}", mesh) for mesh in _inside(item, "mesh")]
    parts = tuple(
        _read_component(where, part)
        for components in _inside(item, "components")
        for part in _inside(components, "component")
    )
    kind, name = _attribute(item, "type") or "model", _attribute(item, "name").strip()
    return _Object(kind, name, meshes[0] if meshes else None, parts)


def _read_component(where: str, item: Element) -> _Component:
    text = _attribute(item, "transform")
    numbers = np.append(np.eye(3).ravel(), np.zeros(3))
    if text:
        try:
            numbers = np.array([float(word) for word in text.split()])
        except ValueError:
            numbers = np.empty(0)
    if numbers.shape != (12,) or not np.isfinite(numbers).all():
        raise InputError(f"{where}: the transform '{text[:60]}' is not twelve numbers")
    return _Component(
        _attribute(item, "path"), _attribute(item, "objectid"), numbers[:9].reshape(3, 3), numbers[9:]
    )


def _read_mesh(where: str, mesh: Element) -> Mesh:
    try:
        vertices = np.array(
            [
                [float(vertex.attrib[axis]) for axis in ("x", "y", "z")]
                for group in _inside(mesh, "vertices")
                for vertex in group
            ]
        ).reshape(-1, 3)
        faces = np.array(
            [
                [int(triangle.attrib[corner]) for corner in ("v1", "v2", "v3")]
                for group in _inside(mesh, "triangles")
                for triangle in group
                if _local(triangle) == "triangle"
            ],
            dtype=np.int64,
        ).reshape(-1, 3)
    except (KeyError, ValueError, OverflowError):
        raise InputError(f"{where}: a vertex or a triangle of its mesh cannot be read") from None
    if len(faces) > MOST_FACETS:
        raise InputError(
            f"{where}: has {len(faces)} facets; at most {MOST_FACETS} are read: export it more coarsely"
        )
    outside: Bools = (faces < 0) | (faces >= len(vertices))
    if outside.any():
        worst = int(faces[outside][0])
        raise InputError(f"{where}: a face has vertex {worst}, counted from 0; there are {len(vertices)}")
    return vertices, faces
