"""3MF files: written by the consortium's own library, or by hand where it writes no such thing."""

import locale
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import lib3mf
import numpy as np
import pytest
import trimesh

from palpate.base.confined_reading import read_confined
from palpate.base.errors import InputError
from palpate.cad.parts import SolidFile
from palpate.cad.readers import read_solids
from palpate.cad.stable_states import volume_mm3

Place = tuple[Sequence[Sequence[float]], Sequence[float]]
"""Rotation (3, 3) of column vectors, and where the origin comes to."""

HERE: Place = (np.eye(3).tolist(), (0.0, 0.0, 0.0))
QUARTER: Place = ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (40.0, 0.0, 0.0))


class Written:
    """A 3MF file in the making, by lib3mf."""

    def __init__(self) -> None:
        self.wrapper = lib3mf.get_wrapper()
        self.model = self.wrapper.CreateModel()

    def mesh(self, mesh: trimesh.Trimesh, name: str = "") -> "lib3mf.MeshObject":
        made = self.model.AddMeshObject()
        made.SetGeometry(
            [position_of(vertex) for vertex in mesh.vertices], [triangle_of(face) for face in mesh.faces]
        )
        made.SetName(name)
        return made

    def whole(self, parts: Sequence[tuple["lib3mf.Object", Place]], name: str = "") -> "lib3mf.Object":
        made = self.model.AddComponentsObject()
        for part, place in parts:
            made.AddComponent(part, transform_of(place))
        made.SetName(name)
        return made

    def item(self, part: "lib3mf.Object", place: Place = HERE) -> None:
        self.model.AddBuildItem(part, transform_of(place))

    def read(self, path: Path, units: str | None = None) -> SolidFile:
        self.model.QueryWriter("3mf").WriteToFile(str(path))
        return read_solids(path, units, 0.05)


def position_of(vertex: Sequence[float]) -> "lib3mf.Position":
    made = lib3mf.Position()
    made.Coordinates[:] = [float(value) for value in vertex]
    return made


def triangle_of(face: Sequence[int]) -> "lib3mf.Triangle":
    made = lib3mf.Triangle()
    made.Indices[:] = [int(value) for value in face]
    return made


def transform_of(place: Place) -> "lib3mf.Transform":
    made = lib3mf.Transform()
    for k in range(3):
        for row in range(3):
            made.Fields[row][k] = float(place[0][k][row])
        made.Fields[3][k] = float(place[1][k])
    return made


def volumes(found: SolidFile) -> dict[str, float]:
    return {solid.name: volume_mm3(solid) for solid in found.solids}


@pytest.fixture
def file() -> Iterator[Written]:
    """A new file; lib3mf leaves another locale behind, in which Python reads no UTF-8."""
    before = locale.setlocale(locale.LC_ALL)
    yield Written()
    locale.setlocale(locale.LC_ALL, before)


def test_items_of_the_build_are_parts_each_shape_once(file: Written, tmp_path: Path) -> None:
    plate, pin = (
        file.mesh(trimesh.creation.box((30, 20, 3)), "plate"),
        file.mesh(trimesh.creation.box((4, 4, 20)), "pin"),
    )
    file.mesh(trimesh.creation.box((9, 9, 9)), "not in the build")
    for part, place in ((plate, HERE), (pin, HERE), (pin, QUARTER)):
        file.item(part, place)
    assert volumes(file.read(tmp_path / "set.3mf")) == pytest.approx({"plate": 1800.0, "pin": 320.0})


def test_components_that_overlap_or_touch_are_one_part(file: Written, tmp_path: Path) -> None:
    body, boss = file.mesh(trimesh.creation.box((20, 20, 20))), file.mesh(trimesh.creation.box((10, 10, 10)))
    over, beside = (HERE[0], (10.0, 0.0, 0.0)), (HERE[0], (0.0, 15.0, 0.0))
    file.item(file.whole([(body, HERE), (boss, over), (boss, beside)], "bracket"))
    found = file.read(tmp_path / "part.3mf")
    assert volumes(found) == pytest.approx({"bracket": 8000.0 + 500.0 + 1000.0})
    assert found.left_out == ()


def test_components_are_placed_by_all_transforms_above_them(file: Written, tmp_path: Path) -> None:
    rod = file.mesh(trimesh.creation.box((40, 4, 4)))
    arm = file.whole([(rod, ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (18.0, 18.0, 0.0)))])
    file.item(file.whole([(rod, HERE), (arm, (HERE[0], (0.0, 0.0, 0.0)))], "angle"), QUARTER)
    (solid,) = file.read(tmp_path / "angle.3mf").solids
    assert volume_mm3(solid) == pytest.approx(2 * 640.0 - 64.0)
    lo, hi = solid.vertices_mm.min(axis=0), solid.vertices_mm.max(axis=0)
    # By hand: the rod from x −20 to 20, the arm at x 16 to 20 up to y 38; then turned by a quarter.
    assert lo.tolist() == pytest.approx([40 - 38, -20, -2])
    assert hi.tolist() == pytest.approx([40 + 2, 20, 2])


def test_a_file_in_inches_says_so(file: Written, tmp_path: Path) -> None:
    file.model.SetUnit(lib3mf.ModelUnit.Inch)
    file.item(file.mesh(trimesh.creation.box((2, 1, 0.5)), "bar"))
    path = tmp_path / "bar.3mf"
    assert volumes(file.read(path)) == pytest.approx({"bar": 25.4**3})
    with pytest.raises(InputError, match="in inch, not in mm: give no units"):
        read_solids(path, "mm", 0.05)


def test_transforms_are_in_the_units_of_the_file(file: Written, tmp_path: Path) -> None:
    """Bounds and volume by trimesh, of the same wedge moved in inches."""
    file.model.SetUnit(lib3mf.ModelUnit.Inch)
    wedge = trimesh.convex.convex_hull(
        [[0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 0.5], [2, 0, 0.5], [0, 1, 0.5]]
    )
    turned: Place = ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (1.0, 0.0, 0.0))
    upright: Place = ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], (0.0, 0.0, 3.0))
    file.item(file.whole([(file.mesh(wedge), turned)], "wedge"), upright)
    (solid,) = file.read(tmp_path / "wedge.3mf").solids
    assert volume_mm3(solid) == pytest.approx(8193.532)
    assert solid.vertices_mm.min(axis=0) == pytest.approx([0.0, -12.7, 76.2])
    assert solid.vertices_mm.max(axis=0) == pytest.approx([25.4, 0.0, 127.0])


def test_a_mirrored_component_is_turned_inside_out_and_back(file: Written, tmp_path: Path) -> None:
    wedge = trimesh.convex.convex_hull([[0, 0, 0], [20, 0, 0], [0, 10, 0], [0, 0, 8], [20, 0, 8], [0, 10, 8]])
    left = file.mesh(wedge)
    mirror: Place = ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], (0.0, 0.0, 0.0))
    file.item(file.whole([(left, HERE), (left, mirror)], "roof"))
    assert volumes(file.read(tmp_path / "roof.3mf")) == pytest.approx({"roof": 1600.0})


def test_what_is_no_part_is_left_out_and_said(file: Written, tmp_path: Path) -> None:
    file.item(file.mesh(trimesh.creation.box((10, 10, 10)), "cube"))
    support = file.mesh(trimesh.creation.box((3, 3, 3)), "prop")
    support.SetType(lib3mf.ObjectType.Support)
    file.item(support)
    found = file.read(tmp_path / "cube.3mf")
    assert volumes(found) == pytest.approx({"cube": 1000.0})
    assert found.left_out == ("1 of type support",)


BOX = trimesh.creation.box((10, 10, 10))
PIN = trimesh.creation.box((2, 2, 30))


def xml_of(mesh: trimesh.Trimesh) -> str:
    corners = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    return f"<mesh><vertices>{corners}</vertices><triangles>{faces}</triangles></mesh>"


def packed(path: Path, members: dict[str, str], model: str = "3D/3dmodel.model") -> Path:
    """A package by hand."""
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    relations = f'<Relationships><Relationship Target="/{model}" Id="r" Type="{kind}"/></Relationships>'
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in ({"_rels/.rels": relations} | members).items():
            archive.writestr(name, text)
    return path


def model_of(objects: str, items: str) -> str:
    return (
        '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06">'
        f"<resources>{objects}</resources><build>{items}</build></model>"
    )


def test_objects_may_be_in_other_model_files(tmp_path: Path) -> None:
    inner = model_of(f'<object id="7">{xml_of(BOX)}</object>', "")
    part = '<component objectid="7" p:path="/3D/Objects/box.model" transform="1 0 0 0 1 0 0 0 1 5 0 0"/>'
    whole = f'<object id="1" name="moved"><components>{part}</components></object>'
    outer = model_of(whole, '<item objectid="1"/>')
    path = packed(
        tmp_path / "p.3mf", {"Other/top.model": outer, "3D/Objects/box.model": inner}, "Other/top.model"
    )
    (solid,) = read_solids(path, None, 0.05).solids
    assert (solid.name, solid.vertices_mm[:, 0].min()) == ("moved", 0.0)


def prusa(role: str) -> dict[str, str]:
    """An object of two volumes in one mesh, as PrusaSlicer writes it."""
    both = trimesh.util.concatenate([BOX, PIN])
    model = model_of(f'<object id="1" name="part">{xml_of(both)}</object>', '<item objectid="1"/>')
    volume = (
        '<volume firstid="{}" lastid="{}"><metadata type="volume" key="volume_type" value="{}"/></volume>'
    )
    volumes = volume.format(0, 11, "ModelPart") + volume.format(12, 23, role)
    config = f'<config><object id="1">{volumes}</object></config>'
    return {"3D/3dmodel.model": model, "Metadata/Slic3r_PE_model.config": config}


def bambu(role: str) -> dict[str, str]:
    """An object of two components, as Bambu Studio writes it."""
    meshes = f'<object id="1">{xml_of(BOX)}</object><object id="2">{xml_of(PIN)}</object>'
    parts = '<components><component objectid="1"/><component objectid="2"/></components>'
    model = model_of(f'{meshes}<object id="3" name="part">{parts}</object>', '<item objectid="3"/>')
    config = (
        '<config><object id="3"><part id="1" subtype="normal_part"/>'
        f'<part id="2" subtype="{role}"/></object></config>'
    )
    return {"3D/3dmodel.model": model, "Metadata/model_settings.config": config}


@pytest.mark.parametrize(
    ("members", "volume"),
    [
        (prusa("ModelPart"), 1000.0 + 80.0),
        (prusa("ParameterModifier"), 1000.0),
        (prusa("SupportBlocker"), 1000.0),
        (bambu("normal_part"), 1000.0 + 80.0),
        (bambu("modifier_part"), 1000.0),
    ],
)
def test_what_slicers_do_not_print_is_no_part(tmp_path: Path, members: dict[str, str], volume: float) -> None:
    found = read_solids(packed(tmp_path / "p.3mf", members), None, 0.05)
    assert volumes(found) == pytest.approx({"part": volume})
    assert bool(found.left_out) == (volume == 1000.0)


@pytest.mark.parametrize(
    ("members", "said"),
    [
        (prusa("NegativeVolume"), "a slicer subtracts a volume"),
        ({"3D/3dmodel.model": model_of("", '<item objectid="4"/>')}, "has no object '4'"),
        (
            {"3D/3dmodel.model": model_of(f'<object id="1">{xml_of(BOX)}</object>', "")},
            "no parts to be printed",
        ),
        ({"3D/3dmodel.model": "<model"}, "cannot be read"),
        ({"other.model": ""}, "has no model"),
        (
            {
                "3D/3dmodel.model": model_of(
                    f'<object id="1">{xml_of(BOX)}</object>', '<item objectid="1" printable="0"/>'
                )
            },
            "1 not to be printed",
        ),
        (
            {
                "3D/3dmodel.model": model_of(
                    '<object id="1"><components><component objectid="1"/></components></object>',
                    '<item objectid="1"/>',
                )
            },
            "is within itself",
        ),
        (
            {
                "3D/3dmodel.model": model_of(
                    f'<object id="1">{xml_of(BOX)}</object>', '<item objectid="1" transform="1 0 0"/>'
                )
            },
            "not twelve numbers",
        ),
    ],
)
def test_what_cannot_be_read_has_its_reason(tmp_path: Path, members: dict[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_solids(packed(tmp_path / "p.3mf", members), None, 0.05)


def test_a_component_that_is_open_is_named(tmp_path: Path) -> None:
    open_box = trimesh.Trimesh(BOX.vertices, BOX.faces[:-1], process=False)
    meshes = f'<object id="1">{xml_of(BOX)}</object><object id="2">{xml_of(open_box)}</object>'
    parts = '<components><component objectid="1"/><component objectid="2"/></components>'
    model = model_of(f'{meshes}<object id="3">{parts}</object>', '<item objectid="3"/>')
    with pytest.raises(InputError, match="component 2 of 2: is not watertight"):
        read_solids(packed(tmp_path / "p.3mf", {"3D/3dmodel.model": model}), None, 0.05)


def test_what_is_said_of_long_names_is_short(tmp_path: Path) -> None:
    open_box = trimesh.Trimesh(BOX.vertices, BOX.faces[:-1], process=False)
    long = "n" * 100_000
    for objects, item in (
        (f'<object id="1" name="{long}">{xml_of(open_box)}</object>', '<item objectid="1"/>'),
        ("", f'<item objectid="{long}"/>'),
    ):
        path = packed(tmp_path / "p.3mf", {"3D/3dmodel.model": model_of(objects, item)})
        with pytest.raises(InputError, match=r"watertight|referred to") as raised:
            read_confined(path, "", read_solids, path, None, 0.05)
        assert len(str(raised.value)) < 600
