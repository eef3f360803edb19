"""DXF files as others write them: every kind of entity, units, layers, blocks, and what is refused."""

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import shapely
from ezdxf import units as dxf_units
from ezdxf.document import Drawing as Document
from ezdxf.layouts import BaseLayout
from ezdxf.math import Vec2, rational_bspline_from_arc

from palpate.base.errors import InputError
from palpate.cad.dxf_files import _INSUNITS, read_dxf
from palpate.cad.parts import Drawing
from support.commands.repository import cad_file

Draw = Callable[[BaseLayout], object]
SQUARE = [(0, 0), (30, 0), (30, 20), (0, 20)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "part.dxf"


def new(units: int = 4) -> Document:
    document = ezdxf.new("R2000", setup=["linetypes"])
    document.header["$INSUNITS"] = units
    return document


def read(file: Path, document: Document, *layers: str, units: str | None = None) -> tuple[Drawing, ...]:
    document.saveas(file)
    return read_dxf(file, units, 0.005, layers).drawings


def read_one(file: Path, draw: Draw) -> Drawing:
    document = new()
    draw(document.modelspace())
    (found,) = read(file, document)
    return found


def shape(drawing: Drawing) -> shapely.MultiPolygon:
    return shapely.MultiPolygon([(drawing.outline.outer, list(drawing.outline.holes))])


def square(layout: BaseLayout, **attributes: object) -> None:
    layout.add_lwpolyline(SQUARE, close=True, dxfattribs=attributes)


def half_disc(layout: BaseLayout) -> None:
    layout.add_arc((5, 7), 10, 30, 210)
    ends = [Vec2(5, 7) + Vec2.from_deg_angle(angle, 10) for angle in (30, 210)]
    layout.add_line(*ends)


def closed_spline(layout: BaseLayout) -> None:
    """Two exact rational half circles of radius 12."""
    for start in (0, 180):
        curve = rational_bspline_from_arc((3, 4), 12, start, start + 180)
        layout.add_rational_spline(
            curve.control_points, curve.weights(), degree=curve.degree, knots=curve.knots()
        )


def bulged(layout: BaseLayout) -> None:
    layout.add_lwpolyline([(0, 0, 1), (20, 0, 0), (20, 10, 0), (0, 10, -0.5)], format="xyb", close=True)


def old_bulged(layout: BaseLayout) -> None:
    layout.add_polyline2d([(0, 0, 1), (20, 0, 0), (20, 10, 0), (0, 10, -0.5)], format="xyb", close=True)


def mirrored(layout: BaseLayout) -> None:
    """Drawn in coordinates that look from below: x is turned round."""
    attributes = {"extrusion": (0, 0, -1)}
    layout.add_lwpolyline(
        [(0, 0, -1), (-20, 0, 0), (-20, 10, 0), (0, 10, 0.5)],
        format="xyb",
        close=True,
        dxfattribs=attributes,
    )
    layout.add_arc((-5, 5), 2, 0, 120, dxfattribs=attributes)
    layout.add_line((3, 5), (5 - 2 * math.cos(math.radians(120)), 5 + 2 * math.sin(math.radians(120))))


SEGMENT = 6.25**2 * (4 * math.atan(0.5) - math.sin(4 * math.atan(0.5))) / 2
"""Between a chord of 10 and its arc of bulge 0.5: radius 10 (1 + 0.25) / (4 · 0.5)."""
BULGED = 20 * 10 + math.pi * 100 / 2 - SEGMENT
CUT = 2**2 * (math.radians(120) - math.sin(math.radians(120))) / 2


@pytest.mark.parametrize(
    ("draw", "area"),
    [
        (lambda m: [m.add_line(a, b) for a, b in zip(SQUARE, SQUARE[1:] + SQUARE[:1], strict=True)], 600.0),
        (lambda m: m.add_circle((100, -50), 20), math.pi * 400),
        (half_disc, math.pi * 50),
        (lambda m: m.add_ellipse((3, 4), (20, 10), 0.4), math.pi * 500 * 0.4),
        (lambda m: m.add_lwpolyline([*SQUARE, SQUARE[0]]), 600.0),
        (lambda m: m.add_polyline3d([(*p, 5) for p in SQUARE], close=True), 600.0),
        (bulged, BULGED),
        (old_bulged, BULGED),
        (closed_spline, math.pi * 144),
        (mirrored, BULGED - CUT),
    ],
)
def test_area_of_every_kind(file: Path, draw: Draw, area: float) -> None:
    found = read_one(file, draw)
    whole = shape(found)
    assert found.name == "part"
    assert whole.is_valid
    assert whole.area == pytest.approx(area, abs=found.off_mm * whole.length + 1e-6)
    assert found.off_mm <= 0.005 + 1e-6


def test_mirrored_entities_lie_where_they_are_seen(file: Path) -> None:
    (outer, hole) = read_one(file, mirrored).outline.outer, read_one(file, mirrored).outline.holes[0]
    assert outer[:, 0].min() == pytest.approx(0.0, abs=1e-9)
    assert outer[:, 1].min() == pytest.approx(-10.0, abs=0.006)
    assert np.hypot(*(hole - (5, 5)).T) == pytest.approx(2.0)


def test_weights_of_minus_one_are_none(file: Path) -> None:
    document = new()
    points = [(0, 0), (40, 0), (40, 30), (0, 30), (0, 0)]
    spline = document.modelspace().add_spline(dxfattribs={"degree": 1})
    spline.set_open_uniform(points, degree=1)
    plain = read(file, document)
    spline.weights = [-1.0] * len(points)
    for found in (plain, read(file, document)):
        assert [shape(item).area for item in found] == pytest.approx([40 * 30])


def test_free_form_spline_against_its_own_points(file: Path) -> None:
    """ezdxf evaluates the spline; each of its points is within the stated deviation of the outline."""
    document = new()
    control = [(0, 0), (30, -10), (40, 25), (15, 12), (5, 40), (-12, 18), (0, 0)]
    spline = document.modelspace().add_open_spline(control, degree=3)
    (found,) = read(file, document)
    ring = shapely.LinearRing(found.outline.outer)
    points = [tuple(point.vec2) for point in spline.construction_tool().approximate(3000)]
    assert shapely.distance(shapely.points(points), ring).max() <= found.off_mm
    assert shapely.Polygon(points).area == pytest.approx(shape(found).area, abs=found.off_mm * ring.length)


PERIODIC = [(0, 0), (30, -10), (40, 25), (15, 12), (5, 40), (-12, 18)]
WEIGHTS = [1.0, 2.0, 0.5, 1.0, 3.0, 1.0]
KINKED = [(0, 0), (20, -8), (40, 0), (40, 30), (48, 40), (20, 36), (0, 0)]


def periodic(layout: BaseLayout, weights: Sequence[float] = ()) -> None:
    """A closed spline of these poles: the first of them are repeated at the end, its knots go on evenly."""
    spline = layout.add_spline(dxfattribs={"degree": 3})
    spline.control_points = [(x, y, 0) for x, y in PERIODIC + PERIODIC[:3]]
    spline.knots = [*range(len(PERIODIC) + 7)]
    spline.weights = [*weights, *weights[:3]]
    spline.closed = True


def kinked(layout: BaseLayout) -> None:
    """A spline with a knot of its degree's multiplicity, where it has a corner."""
    spline = layout.add_spline(dxfattribs={"degree": 3})
    spline.control_points = [(x, y, 0) for x, y in KINKED]
    spline.knots = [0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2]


@pytest.mark.parametrize(
    ("draw", "area", "bounds"),
    [
        (periodic, 958.679167, (-7.275630, -4.398068, 34.996707, 31.758713)),
        (
            lambda m: periodic(m, WEIGHTS),
            931.866412,
            (-5.365344, -7.293031, 31.912551, 36.459202),
        ),
        (kinked, 859.2, (0.0, -2.912284, 41.400833, 34.734016)),
    ],
    ids=["periodic", "periodic with weights", "a corner within"],
)
def test_closed_splines_against_open_cascade(
    file: Path, draw: Draw, area: float, bounds: tuple[float, ...]
) -> None:
    """Areas and bounds by Open CASCADE 7.9, of its own B-spline curves with these poles and knots."""
    found = read_one(file, draw)
    whole = shape(found)
    assert whole.area == pytest.approx(area, abs=found.off_mm * whole.length)
    assert whole.bounds == pytest.approx(bounds, abs=found.off_mm)


@pytest.mark.parametrize(("scale", "angle"), [((1, 1), 30), ((2, 0.5), 75), ((-1, 1), 10)])
def test_blocks_in_blocks_are_placed(file: Path, scale: tuple[float, float], angle: float) -> None:
    """Against shapely's transforms of the part drawn flat."""
    document = new()
    inner = document.blocks.new("inner", base_point=(2, 1))
    bulged(inner)
    outer = document.blocks.new("outer")
    outer.add_blockref("inner", (5, 6), dxfattribs={"rotation": 20})
    attributes = {"xscale": scale[0], "yscale": scale[1], "rotation": angle}
    document.modelspace().add_blockref("outer", (50, 60), dxfattribs=attributes)
    (found,) = read(file, document)
    flat = shape(read_one(file.with_name("flat.dxf"), bulged))
    moved = shapely.affinity.translate(flat, -2, -1)
    moved = shapely.affinity.translate(shapely.affinity.rotate(moved, 20, (0, 0)), 5, 6)
    moved = shapely.affinity.scale(moved, *scale, origin=(0, 0))
    moved = shapely.affinity.translate(shapely.affinity.rotate(moved, angle, (0, 0)), 50, 60)
    assert shape(found).area == pytest.approx(BULGED * abs(scale[0] * scale[1]), rel=1e-3)
    assert shape(found).hausdorff_distance(moved) < 0.03


def test_a_block_that_is_seen_from_below_is_mirrored(file: Path) -> None:
    """Corners by ezdxf's own matrix of the insertion: x is turned round after the rotation."""
    document = new()
    document.blocks.new("one").add_lwpolyline([(0, 0), (30, 0), (0, 20)], close=True)
    attributes = {"extrusion": (0, 0, -1), "rotation": 90}
    document.modelspace().add_blockref("one", (50, 60), dxfattribs=attributes)
    (found,) = read(file, document)
    corners = [(-50.0, 60.0), (-50.0, 90.0), (-30.0, 60.0)]
    assert shape(found).symmetric_difference(shapely.Polygon(corners)).area < 1e-6


def test_rows_and_columns_of_a_block(file: Path) -> None:
    document = new()
    square(document.blocks.new("one"))
    attributes = {"row_count": 2, "column_count": 3, "row_spacing": 50, "column_spacing": 40}
    document.modelspace().add_blockref("one", (0, 0), dxfattribs=attributes)
    found = read(file, document)
    assert [drawing.name for drawing in found] == [f"part-{k}" for k in range(1, 7)]
    corners = sorted(tuple(drawing.outline.outer.min(axis=0)) for drawing in found)
    assert corners == [(x, y) for x in (0, 40, 80) for y in (0, 50)]


@pytest.mark.parametrize("code", sorted(_INSUNITS))
def test_units_of_the_file(file: Path, code: int) -> None:
    """The factors as ezdxf has them, where it has them."""
    factor = _INSUNITS[code][1]
    document = new(code)
    side = 100 / factor
    document.modelspace().add_lwpolyline([(0, 0), (side, 0), (side, side), (0, side)], close=True)
    (found,) = read(file, document)
    assert np.ptp(found.outline.outer[:, 0]) == pytest.approx(100.0, rel=1e-6)
    if code not in {8, 9}:
        unit, mm = dxf_units.InsertUnits(code), dxf_units.InsertUnits.Millimeters
        assert dxf_units.conversion_factor(unit, mm) == pytest.approx(factor, rel=1e-6)


def test_units_asked_for(file: Path) -> None:
    document = new(0)
    square(document.modelspace())
    with pytest.raises(InputError, match=r"no units \(\$INSUNITS is 0\): give its units"):
        read(file, document)
    (found,) = read(file, document, units="inch")
    assert found.outline.outer.max() == pytest.approx(30 * 25.4)
    document.header["$INSUNITS"] = 4
    assert read(file, document, units="mm")[0].outline.outer.max() == 30
    with pytest.raises(InputError, match=r"is in mm \(\$INSUNITS is 4\), not in inch: give no units"):
        read(file, document, units="inch")
    document.header["$INSUNITS"] = 19
    with pytest.raises(InputError, match=r"\$INSUNITS 19"):
        read(file, document)
    document.header["$INSUNITS"] = 6
    with pytest.raises(InputError, match=r"30000 mm.*it would be 30 mm if its unit were mm"):
        read(file, document)


def layered() -> Document:
    document = new()
    model = document.modelspace()
    for name, x in (("Plate", 0), ("Lid", 100), ("off", 200), ("frozen", 300), ("unplotted", 400)):
        layer = document.layers.add(name)
        model.add_circle((x, 0), 10, dxfattribs={"layer": name})
        if name == "off":
            layer.off()
        if name == "frozen":
            layer.freeze()
        if name == "unplotted":
            layer.dxf.plot = 0
    document.layers.add("empty")
    model.add_text("note", dxfattribs={"layer": "empty"})
    return document


def test_layers(file: Path) -> None:
    document = layered()
    assert len(read(file, document)) == 2
    (plate,) = read(file, document, "PLATE")
    assert plate.outline.outer[:, 0].max() == pytest.approx(10)
    assert len(read(file, document, "Lid", "Plate")) == 2
    for name in ("empty", "off", "none"):
        with pytest.raises(InputError, match=f"visible layer '{name}', only on 'Lid', 'Plate'; left out: "):
            read(file, document, "Plate", name)


def test_layer_0_of_a_block_is_that_of_its_insertion(file: Path) -> None:
    document = layered()
    block = document.blocks.new("bolt")
    square(block)
    document.modelspace().add_blockref("bolt", (0, 100), dxfattribs={"layer": "off"})
    document.modelspace().add_blockref("bolt", (0, 200), dxfattribs={"layer": "Lid"})
    assert len(read(file, document)) == 3
    assert len(read(file, document, "Lid")) == 2
    square(block, layer="Plate")
    document.modelspace().add_blockref("bolt", (0, 300), dxfattribs={"layer": "frozen"})
    # On its own layer it is seen where the insertion is off, but not where that is frozen.
    assert len(read(file, document, "Plate")) == 3


def test_only_continuous_lines_are_outlines(file: Path) -> None:
    document = new()
    model = document.modelspace()
    square(model)
    model.add_line((-5, 10), (35, 10), dxfattribs={"linetype": "CENTER"})
    document.layers.add("hidden edges", linetype="DASHED")
    model.add_circle((15, 10), 4, dxfattribs={"layer": "hidden edges"})
    model.add_circle((6, 10), 3, dxfattribs={"layer": "hidden edges", "linetype": "CONTINUOUS"})
    (found,) = read(file, document)
    (hole,) = found.outline.holes
    assert hole.mean(axis=0) == pytest.approx([6, 10])


def test_what_is_no_outline_is_left_out_and_named(file: Path) -> None:
    document = new()
    model = document.modelspace()
    model.add_text("TITLE")
    model.add_point((1, 1))
    model.add_hatch().paths.add_polyline_path(SQUARE)
    model.add_line((0, 0), (50, 0), dxfattribs={"linetype": "CENTER"})
    model.add_linear_dim((0, 5), (0, 0), (30, 0)).render()
    with pytest.raises(InputError, match="holds no outlines") as raised:
        read(file, document)
    for kind in ("1 TEXT", "1 POINT", "1 HATCH", "1 DIMENSION", "1 LINE in linetype CENTER"):
        assert kind in str(raised.value)
    square(model)
    assert len(read(file, document)) == 1


def test_what_is_left_out_beside_outlines_is_counted(file: Path) -> None:
    document = new()
    model = document.modelspace()
    square(model)
    model.add_text("TITLE")
    model.add_circle((15, 10), 4, dxfattribs={"linetype": "DASHED"})
    model.add_circle((6, 10), 3, dxfattribs={"layer": "holes"})
    model.add_lwpolyline([(1, 1)])
    document.layout("Layout1").add_text("SHEET 1 OF 1")
    document.saveas(file)
    rest = ("1 TEXT", "1 CIRCLE in linetype DASHED", "1 LWPOLYLINE without length")
    paper = "what is in paper space (1 in 'Layout1')"
    assert read_dxf(file, None, 0.005).left_out == (*rest, paper)
    chosen = read_dxf(file, None, 0.005, ("0",))
    assert chosen.left_out == (*rest, "1 on layer 'holes'", paper)
    assert chosen.drawings[0].outline.holes == ()


def test_a_sheet_in_paper_space_is_refused_for_that(file: Path) -> None:
    document = new()
    square(document.layout("Layout1"))
    with pytest.raises(InputError, match=r"model space is empty: .* paper space \(1 in 'Layout1'\)"):
        read(file, document)


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        (lambda m: m.add_line((0, 0, 0), (0, 0, 9)), "a LINE is not flat: it goes from z = 0 mm to 9"),
        (lambda m: m.add_circle((0, 0), 9, dxfattribs={"extrusion": (0, 1, 0)}), "a CIRCLE is not flat"),
        (lambda m: m.add_circle((0, 0, 7), 4), "not flat: layer '0' lies at z = 0 mm, layer '0' at 7"),
        (lambda m: m.add_spline([(0, 0), (9, 9), (20, 0)]), "a SPLINE has fit points but no control points"),
        (lambda m: m.add_3dface([(0, 0), (9, 0), (9, 9)]), "holds a 3DFACE, which is no outline"),
        (lambda m: m.add_polymesh((3, 3)), "a POLYLINE is a mesh"),
        (lambda m: m.add_polyline2d(SQUARE, dxfattribs={"flags": 5}), "a POLYLINE is fitted by a curve"),
        (lambda m: m.add_blockref("nowhere", (0, 0)), "inserts a block 'nowhere' that is not in the file"),
        (lambda m: m.add_line((100, 0), (100, 5)), r"the line between \(100, 0\) and \(100, 5\) mm is in no"),
        (lambda m: m.add_arc((100, 0), 5, 0, 350), r"layer '0': open loop: gap of 0.87\d+ mm between \(10"),
        (lambda m: m.add_circle((30, 10), 5), "two outlines meet at"),
    ],
)
def test_refused_beside_a_good_outline(file: Path, draw: Draw, said: str) -> None:
    document = new()
    square(document.modelspace())
    draw(document.modelspace())
    with pytest.raises(InputError, match=said) as raised:
        read(file, document)
    assert str(file) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_block_that_contains_itself(file: Path) -> None:
    document = new()
    block = document.blocks.new("loop")
    block.add_blockref("loop", (1, 0))
    document.modelspace().add_blockref("loop", (0, 0))
    with pytest.raises(InputError, match="the block 'loop' contains itself"):
        read(file, document)


def test_no_dxf_file(file: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_dxf(file, None, 0.01)
    whole = new()
    square(whole.modelspace())
    whole.saveas(file)
    text = file.read_bytes()
    damaged = [
        b"",
        b"0\nSECTION\n",
        b"\0" * 100,
        b"solid cube\nfacet",
        b"AC1018\0\0\0",
        text[: len(text) // 2],
        text[:700],
    ]
    damaged += [text.replace(b"LWPOLYLINE", b"LWPOLYLINE\nx"), text.replace(b"\n10\n", b"\nten\n")]
    for content in damaged:
        file.write_bytes(content)
        with pytest.raises(InputError) as raised:
            read_dxf(file, None, 0.01)
        assert "\n" not in str(raised.value)
        assert "StopIteration" not in str(raised.value)


def test_missing_extra_is_named(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(InputError, match=r"reading DXF files needs ezdxf: .* -m pip install .*\[cad\]'"):
        read_dxf(file, None, 0.01)


@pytest.mark.parametrize(
    ("name", "holes", "size_mm"),
    [
        ("1002_tray_bottom.DXF", [23], [(355.6, 355.6)]),
        (
            "sliding-base.dxf",
            [1, 3, 1, 0],
            [(152.4, 328.676), (152.4, 177.8), (152.4, 152.4), (127.0, 150.876)],
        ),
        ("wrench.dxf", [1], [(82.5734, 23.7944)]),
    ],
)
def test_drawings_that_others_made(name: str, holes: list[int], size_mm: list[tuple[float, float]]) -> None:
    """A plate, a sheet of four parts with a note, and a tool; all are in inches."""
    found = read_dxf(cad_file(name), None, 0.01).drawings
    assert [len(drawing.outline.holes) for drawing in found] == holes
    for drawing, size in zip(found, size_mm, strict=True):
        assert np.ptp(drawing.outline.outer, axis=0) == pytest.approx(size, abs=0.02)
        assert shape(drawing).is_valid
        assert 0 < drawing.off_mm <= 0.0101
