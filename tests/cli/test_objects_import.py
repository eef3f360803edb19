"""`palpate objects import`: meshes and drawings."""

import functools
import json
import math
import re
import signal
from collections.abc import Callable
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import shapely
import trimesh
from shapely import affinity

from palpate.base.geometry import ObjectModel, State
from palpate.config import load_objects
from palpate.config.loading import shipped_rig
from palpate.config.schema import schema_text
from support.benches.parts import ELL, WEDGE, mesh_file, prism
from support.commands.command import Ended, Here, violations
from support.commands.repository import cad_file

pytestmark = pytest.mark.usefixtures("read_here")

# ----------------------------------------------------------------------------------------------------
# `palpate objects import`: from CAD files to objects files that are read again.


@pytest.fixture
def ask(here: Here) -> Here:
    def ask(*args: object) -> Ended:
        all_heights = () if {"--heights", "--rig"} & set(args) else ("--all-heights",)
        return here("objects", "import", *args, *all_heights)

    return ask


COARSE = ("--units", "mm", "--tolerance", 0.5)  # few sections, quickly
AS_IS = ("--units", "mm", "--states", "as-is")


@pytest.fixture
def angle(tmp_path: Path) -> Path:
    return mesh_file(prism(ELL, 20), tmp_path / "angle.stl")


def only(file: Path) -> ObjectModel:
    (model,) = load_objects(file).objects
    return model


def region_at(state: State, height: float) -> shapely.Geometry:
    (section,) = [part for part in state.sections if part.z_mm[0] <= height < part.z_mm[1]]
    return shapely.union_all([shapely.Polygon(item.outer, item.holes) for item in section.polygons])


def cut_of(mesh: trimesh.Trimesh, height: float) -> shapely.Geometry:
    """trimesh's section of a solid: its outlines, inside where an odd number of them is round."""
    path = mesh.section(plane_origin=[0, 0, height], plane_normal=[0, 0, 1])
    rings = [shapely.Polygon(ring[:, :2]) for ring in path.discrete]
    return functools.reduce(shapely.symmetric_difference, rings)


def refused(ended: Ended, message: str, folder: Path) -> None:
    assert (ended.code, ended.out) == (2, "")
    assert message in ended.err
    assert ended.err.startswith("error: ")
    assert ended.err.count("\n") == 1
    assert list(folder.glob("*.json")) == list(folder.glob(".*.part")) == []


def test_an_angle_rests_as_trimesh_says(angle: Path, tmp_path: Path, ask: Here) -> None:
    ended = ask(angle, *COARSE, "--least-probability", 0)
    assert (ended.code, ended.err) == (0, "")
    model = only(tmp_path / "angle.objects.json")
    assert model.name == "angle"
    assert 0 < model.tolerance_mm <= 0.5
    mesh = prism(ELL, 20)
    _, expected = trimesh.poses.compute_stable_poses(mesh, sigma=0, n_samples=1, threshold=0)
    lying = expected[0] + expected[1]
    # Lying on either side it is a mirror image of itself, which fingers do tell apart.
    found = sorted((state.probability or 0.0 for state in model.states), reverse=True)
    assert sum(found) == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert lying == pytest.approx(2 * found[0], abs=2e-3)


def test_sections_are_those_of_the_solid(angle: Path, tmp_path: Path, ask: Here) -> None:
    told = ask(angle, *COARSE, "--json").json["objects"][0]
    for state, out in zip(only(tmp_path / "angle.objects.json").states, told["states"], strict=True):
        mesh = prism(ELL, 20)
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = out["frame"]["rotation"], out["frame"]["offset"]
        mesh.apply_transform(frame)
        assert state.top_mm == pytest.approx(mesh.bounds[1, 2], abs=2e-3)
        for height in np.linspace(0.3, state.top_mm - 0.3, 7):
            expected = cut_of(mesh, float(height))
            found = region_at(state, float(height))
            assert (
                found.symmetric_difference(expected).area
                <= only(tmp_path / "angle.objects.json").tolerance_mm * expected.length + 1e-3
            )


def test_a_cube_is_one_state(tmp_path: Path, ask: Here) -> None:
    file = mesh_file(trimesh.creation.box((20, 20, 20)), tmp_path / "cube.ply")
    told = ask(file, "--units", "mm", "--json")
    assert violations(told.json, json.loads(schema_text("import"))) == []
    (cube,) = told.json["objects"]
    (state,) = cube["states"]
    assert (state["merged"], state["probability"], cube["tolerance"]) == (6, 1.0, 0.0)
    assert state["tipping_angle"] == pytest.approx(math.pi / 4, abs=1e-6)
    (section,) = only(tmp_path / "cube.objects.json").states[0].sections
    assert section.z_mm == (0.0, 20.0)
    side = np.hypot(*(np.roll(section.polygons[0].outer, -1, axis=0) - section.polygons[0].outer).T)
    np.testing.assert_allclose(side, [20.0] * 4, atol=2e-6)
    assert "state-1" in told.err


def test_a_cone_is_within_its_tolerance(tmp_path: Path, ask: Here) -> None:
    file = mesh_file(trimesh.creation.cone(10, 20, sections=48), tmp_path / "cone.stl")
    options = ["--units", "mm", "--states", "as-is", "--tolerance", 0.2, "--deviation", 0.1]
    (told,) = ask(file, *options, "--json").json["objects"]
    model = only(tmp_path / "cone.objects.json")
    (state,) = model.states
    assert state.name == "as-is"
    assert state.probability is None
    assert 0.2 < model.tolerance_mm <= 0.3
    assert model.tolerance_mm == told["tolerance"]
    assert 20 < len(state.sections) < 60
    for height in np.linspace(0.05, 19.5, 40):
        found, radius = region_at(state, float(height)), 10 * (1 - height / 20)
        reach = np.hypot(*shapely.get_coordinates(found).T).max()
        assert abs(reach - radius) <= model.tolerance_mm - 0.1 + 1e-6


def test_heights(angle: Path, tmp_path: Path, ask: Here) -> None:
    """Sections near the fingers' heights only: the same ones, and it is said."""
    ask(angle, *COARSE, "--out", "all.json")
    ended = ask(angle, *COARSE, "--heights", "12,5", "--out", "some.json")
    assert ended.code == 0
    assert "state-1 is known at 4.5–5.5 and 11.5–12.5 mm only" in ended.out
    assert "a rig with a finger elsewhere leaves them out" in ended.out
    everywhere, near = only(tmp_path / "all.json"), only(tmp_path / "some.json")
    for full, part in zip(everywhere.states, near.states, strict=True):
        assert part.heights_mm is not None
        for low, high in part.heights_mm:
            assert high - low <= 1.0 + 1e-9
        for height in (5.0, 12.0):
            assert part.known_at(height)
            if height < part.top_mm:
                regions = [region_at(model, height) for model in (part, full)]
                apart = 2 * everywhere.tolerance_mm * regions[0].length
                assert shapely.symmetric_difference(*regions).area <= apart
        assert not part.known_at(1.0) or part.top_mm < 1.0


def test_a_low_part_keeps_its_uppermost_millimetre(tmp_path: Path, ask: Here) -> None:
    file = mesh_file(trimesh.creation.box((20, 30, 3)), tmp_path / "plate.stl")
    ask(file, "--units", "mm", "--states", "as-is", "--heights", "10")
    (state,) = only(tmp_path / "plate.objects.json").states
    assert state.heights_mm == ((2.0, 3.0),)
    assert state.known_at(10.0)


def test_adding_keeps_what_is_there(angle: Path, tmp_path: Path, ask: Here) -> None:
    short = {"name": "plate", "outline": [[0, 0], [70, 0], [70, 25]], "height": 20}
    file = tmp_path / "mine.json"
    content = {"format": "palpate/objects@1", "units": "mm", "objects": [{**short, "name": "angle"}, short]}
    file.write_text(json.dumps(content))
    ended = ask(angle, *AS_IS, "--out", file)
    assert ended.code == 2
    assert f"{file} is there already: add to it with --add" in ended.err
    assert json.loads(file.read_text()) == content

    told = ask(angle, *AS_IS, "--out", file, "--add", "--json").json
    assert not told["objects"][0]["replaced"]  # the other "angle" is not from this file
    written = json.loads(file.read_text())["objects"]
    assert [item["name"] for item in written] == ["angle", "plate", "angle-2"]
    assert written[:2] == content["objects"]
    assert "states" in written[2]

    told = ask(angle, *AS_IS, "--name", "angle-2", "--out", file, "--add", "--json").json
    assert told["objects"][0]["replaced"]
    told = ask(angle, *AS_IS, "--name", "angle 3", "--out", file, "--add", "--json").json
    assert not told["objects"][0]["replaced"]
    assert [item.name for item in load_objects(file).objects] == ["angle", "plate", "angle-2", "angle 3"]


def test_a_file_that_cannot_be_added_to_is_left_alone(angle: Path, tmp_path: Path, ask: Here) -> None:
    file = tmp_path / "mine.json"
    file.write_text("{}")
    ended = ask(angle, *AS_IS, "--out", file, "--add")
    assert ended.code == 2
    assert str(file) in ended.err
    assert file.read_text() == "{}"
    assert ask(angle, *AS_IS, "--out", tmp_path / "none" / "x.json").code == 2


def test_interrupted_it_leaves_nothing(
    angle: Path, tmp_path: Path, ask: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("os.replace", interrupt)
    ended = ask(angle, *AS_IS)
    assert ended.code == 130
    assert ended.err.strip().splitlines() == ["interrupted", "nothing was written"] or (
        "nothing was written" in ended.err
    )
    assert sorted(item.name for item in tmp_path.iterdir()) == ["angle.stl"]


def test_what_would_topple_is_warned_of(tmp_path: Path, ask: Here) -> None:
    leaning = trimesh.creation.box((10, 10, 40))
    shear = np.eye(4)
    shear[0, 2] = 1.0
    leaning.apply_transform(shear)
    file = mesh_file(leaning, tmp_path / "leaning.stl")
    ended = ask(file, "--units", "mm", "--states", "as-is", "--tolerance", "0.3")
    assert ended.code == 0
    assert "would topple" in ended.out
    assert (
        len(
            ask(file, "--units", "mm", "--states", "as-is", "--tolerance", 0.3, "--out", "b", "--json").json[
                "warnings"
            ]
        )
        == 1
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "units: mm, inch or m"),
        (["--units", "mm", "--thickness", "5"], "a thickness is for drawings"),
        (["--units", "mm", "--tolerance", "0"], "--tolerance is 0 mm; it must be from 0.001 to 5 mm"),
        (["--units", "mm", "--tolerance", "nan"], "--tolerance is nan mm"),
        (["--units", "mm", "--deviation", "-1"], "--deviation is -1 mm; it must be from 0 to 5 mm"),
        (["--units", "mm", "--least-probability", "2"], "--least-probability is 2; it must be from 0 to 1"),
        (
            ["--units", "mm", "--heights", "5,x"],
            '--heights "5,x": "x" is no height in mm; write them as 5,12',
        ),
        (["--units", "mm", "--heights", "5,,6"], '"" is no height'),
        (["--units", "mm", "--heights", "inf"], '"inf" is no height'),
        (["--units", "mm", "--name", " a"], "--name must be printable"),
        (["--units", "mm", "--name", ""], "--name has 0 characters"),
        (["--units", "feet"], "'feet' is not one of"),
    ],
)
def test_options_are_checked(
    angle: Path, tmp_path: Path, ask: Here, options: list[str], message: str
) -> None:
    refused(ask(angle, *options), message, tmp_path)


def test_broken_files_are_refused(tmp_path: Path, ask: Here) -> None:
    mesh = prism(ELL, 20)
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    refused(ask(mesh_file(mesh, tmp_path / "open.stl"), "--units", "mm"), "open.stl", tmp_path)
    (tmp_path / "empty.stl").write_bytes(b"")
    refused(ask(tmp_path / "empty.stl", "--units", "mm"), "empty.stl", tmp_path)
    refused(ask(tmp_path / "missing.stl", "--units", "mm"), "missing.stl", tmp_path)
    (tmp_path / "part.doc").write_bytes(b"x")
    refused(ask(tmp_path / "part.doc", "--units", "mm"), "part.doc", tmp_path)


def test_the_summary_fits_80_columns(angle: Path, ask: Here) -> None:
    ended = ask(angle, *COARSE)
    assert max(map(len, ended.out.splitlines())) <= 80
    assert "prob." in ended.out
    assert "palpate objects show angle.objects.json" in ended.out


def test_units_of_a_real_part(tmp_path: Path, ask: Here) -> None:
    part = cad_file("angle_block.STL")
    told = ask(part, "--units", "inch", "--heights", "5", "--json").json
    (block,) = told["objects"]
    mesh = trimesh.load(part, force="mesh")
    np.testing.assert_allclose(block["size"], np.ptp(mesh.vertices, axis=0) * 25.4, rtol=1e-5)
    assert block["volume"] == pytest.approx(mesh.volume * 25.4**3, rel=1e-4)
    assert load_objects(tmp_path / "angle_block.objects.json").objects[0].name == "angle_block"


def test_a_real_part_with_a_fin_is_imported(tmp_path: Path, ask: Here) -> None:
    ended = ask(cad_file("wallhole.obj"), "--units", "mm", "--json")
    assert ended.code == 0
    (item,) = ended.json["objects"]
    assert item["volume"] == pytest.approx(1066.667, abs=1e-3)  # as trimesh has it
    assert only(tmp_path / "wallhole.objects.json").name == "wallhole"


def test_a_drawing(tmp_path: Path, ask: Here) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new(units=ezdxf.units.IN)
    corners = [(10, 10), (12, 10), (12, 11), (10, 11)]
    document.modelspace().add_lwpolyline(corners, close=True)
    document.modelspace().add_circle((11, 10.5), 0.25)
    document.saveas(tmp_path / "plate.dxf")
    refused(ask(tmp_path / "plate.dxf"), "give the thickness", tmp_path)
    told = ask(tmp_path / "plate.dxf", "--thickness", 6.35, "--json").json["objects"][0]
    model = only(tmp_path / "plate.objects.json")
    (state,) = model.states
    (section,) = state.sections
    assert (state.name, section.z_mm, told["volume"]) == ("flat", (0.0, 6.35), None)
    assert 0 < model.tolerance_mm <= 0.05
    assert told["states"][0]["frame"]["offset"] == pytest.approx([-11 * 25.4, -10.5 * 25.4, 0], abs=1e-9)
    box = shapely.box(-25.4, -12.7, 25.4, 12.7)
    disc = shapely.Point(0, 0).buffer(6.35, quad_segs=200)
    found = region_at(state, 3.0)
    assert found.symmetric_difference(box.difference(disc)).area < model.tolerance_mm * disc.length
    assert found.hausdorff_distance(affinity.scale(found, -1)) < 0.1


def test_a_prism_in_every_format_is_the_same_object(tmp_path: Path, ask: Here) -> None:
    """The states of a wedge do not depend on the format it came in."""
    found = []
    for suffix in ("stl", "obj", "ply"):
        file = mesh_file(prism(WEDGE, 18), tmp_path / f"wedge.{suffix}")
        ask(file, *COARSE, "--out", f"{suffix}.json")
        found.append(only(tmp_path / f"{suffix}.json"))
    for other in found[1:]:
        for a, b in zip(found[0].states, other.states, strict=True):
            assert a.probability == pytest.approx(b.probability, abs=1e-4)
            assert len(a.sections) == len(b.sections)


def test_a_top_that_is_level_but_for_rounding(tmp_path: Path, ask: Here) -> None:
    """Single precision leaves corners of a level face some nanometres apart."""
    mesh = prism(ELL, 20)
    top = np.flatnonzero(mesh.vertices[:, 2] > 19)
    mesh.vertices[top[::2], 2] += 4e-6
    ended = ask(mesh_file(mesh, tmp_path / "level.stl"), *AS_IS)
    assert (ended.code, ended.err) == (0, "")
    (state,) = only(tmp_path / "level.objects.json").states
    assert state.top_mm == pytest.approx(20, abs=1e-5)
    assert state.sections[-1].z_mm[1] == state.top_mm


def test_the_heights_of_the_shipped_rig_are_the_default(angle: Path, tmp_path: Path, here: Here) -> None:
    rig = tmp_path / "rig.toml"
    text = shipped_rig().read_text()
    rig.write_text(text.replace("height_mm = 10.0", "height_mm = 14.0"))
    assert rig.read_text() != text
    for options, height in (((), 10.0), (("--rig", rig), 14.0), (("--heights", "4,12"), 12.0)):
        out = tmp_path / f"{height}.json"
        told = here("objects", "import", angle, *AS_IS, *options, "--out", out, "--json")
        assert told.code == 0
        (state,) = only(out).states
        assert state.known_at(height)
        assert not state.known_at(17.0)


def test_heights_all_along_the_tips_of_a_rig(angle: Path, tmp_path: Path, here: Here) -> None:
    rig = tmp_path / "rig.toml"
    text = shipped_rig().read_text()
    rig.write_text(text.replace("stiffness_n_per_mm", "length_mm = 12.0\nstiffness_n_per_mm"))
    for options in (("--rig", rig), ("--heights", "4-16")):
        out = tmp_path / "along.json"
        asked = ["objects", "import", angle, *AS_IS, *options, "--out", out]
        assert here(*asked).code == 0
        (state,) = only(out).states
        assert state.known_within((4.0, 16.0))
        assert not state.known_at(17.0)
        out.unlink()
    for wrong in ("16-4", "4-", "1-2-3", "-4"):
        refused = here("objects", "import", angle, *AS_IS, f"--heights={wrong}", "--out", out)
        assert refused.code == 2
        assert "is no height in mm; write them as 5,12 or, from to, 5-15" in refused.err


def test_heights_are_asked_for_in_one_way(angle: Path, ask: Here) -> None:
    ended = ask(angle, "--heights", "5", "--all-heights")
    assert ended.code == 2
    assert "one of --rig, --heights and --all-heights" in ended.err


def test_what_is_left_out_is_warned_of_and_refused_above_a_fifth(
    angle: Path, tmp_path: Path, ask: Here
) -> None:
    some = ("--units", "mm", "--heights", "5", "--out", "some.json")
    told = ask(angle, *some, "--least-probability", 0.1, "--json")
    assert told.code == 0
    assert any("left out in 9 % of cases" in warning for warning in told.json["warnings"])
    (tmp_path / "some.json").unlink()
    ended = ask(angle, *some, "--least-probability", 0.25)
    assert ended.code == 1
    assert "left out in 46 % of cases" in " ".join(ended.out.split())
    assert "accept the loss" in " ".join(ended.out.split())
    assert not (tmp_path / "some.json").exists()
    ended = ask(angle, *some, "--least-probability", 0.25, "--accept-loss")
    assert ended.code == 0
    assert len(only(tmp_path / "some.json").states) == 2


# ----------------------------------------------------------------------------------------------------
# `palpate objects import` of drawings: layers, parts, what is left out.

PLATE_MM2 = 40.0 * 30.0
BORE_MM2 = math.pi * 25.0
DRAWING = ("--thickness", 5)


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """A plate on layer "cut" with a bore on layer "bore"; beside it a block, within the bore nothing."""
    drawing = ezdxf.new(units=4, setup=True)
    space = drawing.modelspace()
    space.add_lwpolyline([(0, 0), (40, 0), (40, 30), (0, 30)], close=True, dxfattribs={"layer": "cut"})
    space.add_circle((20, 15), 5, dxfattribs={"layer": "bore"})
    space.add_lwpolyline([(60, 0), (85, 0), (85, 12), (60, 12)], close=True, dxfattribs={"layer": "cut"})
    space.add_text("40 x 30", dxfattribs={"layer": "cut"})
    space.add_circle((20, 15), 9, dxfattribs={"layer": "cut", "linetype": "DASHED"})
    path = tmp_path / "plate.dxf"
    drawing.saveas(path)
    return path


def areas_mm2(folder: Path) -> list[float]:
    """Areas of the objects' first sections."""
    (file,) = folder.glob("*.objects.json")
    sections = [model.states[0].sections[0].polygons for model in load_objects(file).objects]
    return [sum(shapely.Polygon(p.outer, p.holes).area for p in polygons) for polygons in sections]


def refused_drawing(ended: Ended, *said: str) -> None:
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert all(words in ended.err for words in said), ended.err


def test_every_visible_layer_has_outlines_and_the_rest_listed(plate: Path, tmp_path: Path, ask: Here) -> None:
    ended = ask(plate, *DRAWING)
    assert ended.code == 0, ended.err
    said = " ".join((ended.out + ended.err).split())
    assert re.search("left out of the drawing: .*1 CIRCLE in linetype DASHED", said), said
    assert re.search("left out of the drawing: .*1 TEXT", said), said
    assert areas_mm2(tmp_path) == pytest.approx([PLATE_MM2 - BORE_MM2, 300.0], rel=1e-2)


def test_a_layer_that_is_not_named_is_not_cut(plate: Path, tmp_path: Path, ask: Here) -> None:
    assert ask(plate, *DRAWING, "--layers", "cut").code == 0
    assert areas_mm2(tmp_path) == pytest.approx([PLATE_MM2, 300.0])


def test_a_layer_that_is_not_there_is_refused_with_those_that_are(plate: Path, ask: Here) -> None:
    refused_drawing(ask(plate, *DRAWING, "--layers", "cut,edge"), "plate.dxf", "edge", "bore", "cut")


@pytest.mark.parametrize("part", ["2", "plate-2"])
def test_a_part_is_taken_by_its_number_or_its_name(plate: Path, tmp_path: Path, ask: Here, part: str) -> None:
    assert ask(plate, *DRAWING, "--parts", part).code == 0
    assert areas_mm2(tmp_path) == pytest.approx([300.0])


def test_a_part_that_is_chosen_has_the_name_that_is_given(plate: Path, tmp_path: Path, ask: Here) -> None:
    told = ask(plate, *DRAWING, "--parts", "plate-2", "--name", "front", "--out", "one.json", "--json").json
    assert [item["name"] for item in told["objects"]] == ["front"]
    told = ask(plate, *DRAWING, "--name", "front", "--out", "all.json", "--json").json
    assert [item["name"] for item in told["objects"]] == ["front-1", "front-2"]


@pytest.mark.parametrize("part", ["3", "0", "block"])
def test_a_part_that_is_not_there_is_refused_with_those_that_are(plate: Path, ask: Here, part: str) -> None:
    refused_drawing(ask(plate, *DRAWING, "--parts", part), "plate.dxf", f'no part "{part}"', "plate-1")


def test_layers_and_parts_are_for_what_has_them(plate: Path, tmp_path: Path, ask: Here) -> None:
    solid = mesh_file(prism(ELL, 20), tmp_path / "angle.stl")
    refused_drawing(ask(solid, "--units", "mm", "--layers", "cut"), "angle.stl", "layers")
    refused_drawing(ask(plate, solid, *DRAWING, "--units", "mm", "--parts", "1"), "--parts is for one file")


def test_what_lies_in_a_hole_is_a_part_of_its_own(tmp_path: Path, ask: Here) -> None:
    drawing = ezdxf.new(units=4, setup=True)
    for radius in (30, 20, 10):
        drawing.modelspace().add_circle((0, 0), radius)
    drawing.saveas(tmp_path / "rings.dxf")
    assert ask("rings.dxf", *DRAWING).code == 0
    assert areas_mm2(tmp_path) == pytest.approx([math.pi * 500, math.pi * 100], rel=1e-2)


def dxf_disc(path: Path) -> None:
    drawing = ezdxf.new(units=4)
    drawing.modelspace().add_circle((71, -8), 25)
    drawing.modelspace().add_circle((71, -8), 6)
    drawing.saveas(path)


def dxf_arcs(path: Path) -> None:
    drawing = ezdxf.new(units=4)
    drawing.modelspace().add_lwpolyline([(46, -8, 1), (96, -8, 1)], format="xyb", close=True)
    drawing.modelspace().add_arc((71, -8), 6, 20, 200)
    drawing.modelspace().add_arc((71, -8), 6, 200, 20)
    drawing.saveas(path)


def svg_circles(path: Path) -> None:
    shapes = '<circle cx="71" cy="-8" r="25"/><path d="M77 -8 A6 6 0 0 1 65 -8 A6 6 0 0 1 77 -8 Z"/>'
    size = 'width="200mm" height="200mm" viewBox="0 -100 200 200"'
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{shapes}</svg>')


@pytest.mark.parametrize("drawn", [dxf_disc, dxf_arcs, svg_circles])
def test_a_disc_is_written_as_circles(tmp_path: Path, ask: Here, drawn: Callable[[Path], None]) -> None:
    file = tmp_path / f"disc.{drawn.__name__[:3]}"
    drawn(file)
    ended = ask(file, *DRAWING)
    assert ended.code == 0, ended.err
    assert "50 × 50 mm" in ended.out
    (model,) = json.loads((tmp_path / "disc.objects.json").read_text())["objects"]
    (polygon,) = model["states"][0]["sections"][0]["polygons"]
    circles = [polygon["outer"]["circle"], *(hole["circle"] for hole in polygon["holes"])]
    assert [circle["centre"] for circle in circles] == [[0, 0], [0, 0]]
    assert model["tolerance"] < 0.01
    assert [circle["radius"] for circle in circles] == pytest.approx([25, 6], abs=model["tolerance"])
    (loaded,) = load_objects(tmp_path / "disc.objects.json").objects
    assert loaded.states[0].is_round
