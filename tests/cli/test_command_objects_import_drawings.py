"""`palpate objects import` of drawings: layers, parts, what is left out."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import ezdxf
import pytest
import shapely
from command import Ended, run_here
from solids import ELL, mesh_file, prism

from palpate.config import load_objects

Ask = Callable[..., Ended]

PLATE_MM2 = 40.0 * 30.0
BORE_MM2 = math.pi * 25.0
DRAWING = ("--thickness", 5)


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ask:
    monkeypatch.chdir(tmp_path)

    def ask(*args: object) -> Ended:
        return run_here(["objects", "import", *args, "--all-heights"], monkeypatch, capsys)

    return ask


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


def refused(ended: Ended, *said: str) -> None:
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert all(words in ended.err for words in said), ended.err


def test_every_visible_layer_has_outlines_and_the_rest_listed(plate: Path, tmp_path: Path, ask: Ask) -> None:
    ended = ask(plate, *DRAWING)
    assert ended.code == 0, ended.err
    said = " ".join((ended.out + ended.err).split())
    assert re.search("left out of the drawing: .*1 CIRCLE in linetype DASHED", said), said
    assert re.search("left out of the drawing: .*1 TEXT", said), said
    assert areas_mm2(tmp_path) == pytest.approx([PLATE_MM2 - BORE_MM2, 300.0], rel=1e-2)


def test_a_layer_that_is_not_named_is_not_cut(plate: Path, tmp_path: Path, ask: Ask) -> None:
    assert ask(plate, *DRAWING, "--layers", "cut").code == 0
    assert areas_mm2(tmp_path) == pytest.approx([PLATE_MM2, 300.0])


def test_a_layer_that_is_not_there_is_refused_with_those_that_are(plate: Path, ask: Ask) -> None:
    refused(ask(plate, *DRAWING, "--layers", "cut,edge"), "plate.dxf", "edge", "bore", "cut")


@pytest.mark.parametrize("part", ["2", "plate-2"])
def test_a_part_is_taken_by_its_number_or_its_name(plate: Path, tmp_path: Path, ask: Ask, part: str) -> None:
    assert ask(plate, *DRAWING, "--parts", part).code == 0
    assert areas_mm2(tmp_path) == pytest.approx([300.0])


@pytest.mark.parametrize("part", ["3", "0", "block"])
def test_a_part_that_is_not_there_is_refused_with_those_that_are(plate: Path, ask: Ask, part: str) -> None:
    refused(ask(plate, *DRAWING, "--parts", part), "plate.dxf", f'no part "{part}"', "plate-1")


def test_layers_and_parts_are_for_what_has_them(plate: Path, tmp_path: Path, ask: Ask) -> None:
    solid = mesh_file(prism(ELL, 20), tmp_path / "angle.stl")
    refused(ask(solid, "--units", "mm", "--layers", "cut"), "angle.stl", "layers")
    refused(ask(plate, solid, *DRAWING, "--units", "mm", "--parts", "1"), "--parts is for one file")


def test_what_lies_in_a_hole_is_a_part_of_its_own(tmp_path: Path, ask: Ask) -> None:
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
def test_a_disc_is_written_as_circles(tmp_path: Path, ask: Ask, drawn: Callable[[Path], None]) -> None:
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
