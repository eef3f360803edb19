"""Mesh files written by trimesh and by CAD programs, and what is left of them when they are damaged."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from shared_files import cad_file

from palpate.base.errors import InputError
from palpate.cad.readers import is_drawing, read_drawings, read_solids


def volume(solid):
    return trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False).volume


@pytest.mark.parametrize(
    ("name", "units", "side_mm"),
    [
        ("20mm-xyz-cube.stl", "mm", 20.0),
        ("7_8ths_cube.stl", "mm", 40.0),
        ("angle_block.STL", "inch", 34.34),
        ("featuretype.STL", "inch", 127.0),
    ],
)
def test_files_of_cad_programs(name, units, side_mm):
    (solid,) = read_solids(cad_file(name), units, 0.05)
    oracle = trimesh.load_mesh(cad_file(name))
    scale = {"mm": 1.0, "inch": 25.4}[units]
    assert volume(solid) == pytest.approx(oracle.volume * scale**3, rel=1e-6)
    assert len(solid.faces) == len(oracle.faces)
    assert np.ptp(solid.vertices_mm, axis=0).max() == pytest.approx(side_mm, rel=1e-3)
    assert solid.name == Path(name).stem


def test_a_file_that_is_no_solid_says_where():
    with pytest.raises(
        InputError, match=r"wallhole.obj: .*the edge from \(.*\) to \(.*\) mm belongs to 4 faces"
    ):
        read_solids(cad_file("wallhole.obj"), "mm", 0.05)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply"])
def test_formats_without_units(tmp_path, kind):
    shape = trimesh.creation.cylinder(0.5, 1.0, sections=12)
    path = tmp_path / f"part.{kind[:3]}"
    shape.export(path, file_type=kind)
    (solid,) = read_solids(path, "inch", 0.05)
    assert volume(solid) == pytest.approx(shape.volume * 25.4**3, rel=1e-5)
    with pytest.raises(
        InputError, match=f"{kind[:3].upper()} files have no units: give their units: mm, inch or m"
    ):
        read_solids(path, None, 0.05)
    data = path.read_bytes()
    for length in (0, 3, 60, len(data) // 2, len(data) - 40):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            read_solids(path, "inch", 0.05)


def test_a_second_solid_that_is_cut_off_is_missed(tmp_path):
    text = trimesh.creation.box((9, 9, 9)).export(file_type="stl_ascii")
    path = tmp_path / "two.stl"
    path.write_text(text + text[: len(text) // 2])
    with pytest.raises(InputError, match="cut short"):
        read_solids(path, "mm", 0.05)


def test_names_in_latin_1_are_read(tmp_path):
    path = tmp_path / "part.stl"
    text = trimesh.creation.box((9, 9, 9)).export(file_type="stl_ascii")
    path.write_bytes(text.replace("solid ", "solid Gehäuse", 1).encode("latin-1"))
    assert len(read_solids(path, "mm", 0.05)) == 1


def test_an_obj_of_two_materials_is_one_body(tmp_path):
    lines = trimesh.creation.box((9, 9, 9)).export(file_type="obj").splitlines()
    lines.insert(-5, "usemtl red")
    path = tmp_path / "part.obj"
    path.write_text("\n".join(["mtllib none.mtl", *lines]))
    (solid,) = read_solids(path, "mm", 0.05)
    assert len(solid.faces) == 12


def test_a_3mf_file_has_units_names_and_each_shape_once(tmp_path):
    scene = trimesh.Scene()
    pin, plate = trimesh.creation.cylinder(2, 20, sections=16), trimesh.creation.box((30, 20, 3))
    scene.add_geometry(plate, geom_name="plate")
    scene.add_geometry(pin, geom_name="pin", node_name="a")
    move = trimesh.transformations.translation_matrix((0, 50, 0))
    scene.add_geometry(pin, geom_name="pin", node_name="b", transform=move)
    path = tmp_path / "set.3mf"
    scene.export(path)
    for units in (None, "mm"):
        solids = read_solids(path, units, 0.05)
        assert sorted((s.name.rstrip("_0123456789"), round(volume(s), 3)) for s in solids)[-1] == (
            "plate",
            1800.0,
        )
        assert volume(min(solids, key=volume)) == pytest.approx(pin.volume)
    with pytest.raises(InputError, match="millimeter, not in inch"):
        read_solids(path, "inch", 0.05)


@pytest.mark.parametrize(
    ("name", "hidden", "extra"),
    [
        ("part.stl", "trimesh", "cad"),
        ("part.3mf", "lxml", "cad"),
        ("part.step", "cascadio", "step"),
    ],
)
def test_a_missing_extra_is_named(tmp_path, monkeypatch, name, hidden, extra):
    path = tmp_path / name
    path.write_bytes(trimesh.creation.box((9, 9, 9)).export(file_type="stl"))
    monkeypatch.setitem(sys.modules, hidden, None)
    with pytest.raises(InputError, match=rf"needs {hidden}: .* -m pip install .*\[{extra}\]'"):
        read_solids(path, "mm" if name == "part.stl" else None, 0.05)


def test_what_is_read_by_whom(tmp_path):
    assert is_drawing(Path("a.DXF"))
    assert not is_drawing(Path("a.STP"))
    with pytest.raises(InputError, match=r"unknown kind of file; allowed are \.3mf, \.dxf"):
        is_drawing(Path("a.blend"))
    with pytest.raises(InputError, match="is a drawing"):
        read_solids(Path("a.svg"), None, 0.05)
    with pytest.raises(InputError, match="is a solid"):
        read_drawings(Path("a.stl"), None, 0.05)
    with pytest.raises(InputError, match="there is no such file"):
        read_solids(tmp_path / "a.stl", "mm", 0.05)
