"""STEP files, written by Gmsh 4.15 and CadQuery 2.8 (OpenCASCADE 7.8, 7.9), of shapes that are known."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from palpate.base.errors import InputError
from palpate.cad.readers import read_solids

HERE = Path(__file__).parent / "step"
read_here = pytest.mark.usefixtures("read_here")  # but not what may crash its reader


def volume(solid):
    return trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False).volume


def off_sphere(p):
    return np.abs(np.sqrt((p**2).sum(axis=1)) - 20)


def off_torus(p):
    return np.abs(np.hypot(np.hypot(p[:, 0], p[:, 1]) - 30, p[:, 2]) - 8)


def off_cylinder(p):
    return np.abs(np.maximum(np.hypot(p[:, 0], p[:, 1]) - 10, np.maximum(-p[:, 2], p[:, 2] - 30)))


def off_cone(p):
    side = (np.hypot(p[:, 0], p[:, 1]) - 15 + p[:, 2] / 3) * 3 / np.sqrt(10)
    return np.abs(np.maximum(side, np.maximum(-p[:, 2], p[:, 2] - 30)))


@read_here
@pytest.mark.parametrize(
    ("name", "off"),
    [("sphere", off_sphere), ("torus", off_torus), ("cylinder", off_cylinder), ("cone", off_cone)],
)
def test_chords_stay_within_what_is_said(name, off):
    (solid,) = read_solids(HERE / f"{name}.step", None, 0.2).solids
    share = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)]) / 6
    points = np.einsum("sc,mcx->msx", share, solid.vertices_mm[solid.faces]).reshape(-1, 3)
    assert 0.2 / 9 < solid.off_mm < 0.2 / 9 * 1.01  # finer than asked where few facets do
    assert off(points).max() <= solid.off_mm


@read_here
@pytest.mark.parametrize(
    ("unit", "scale", "units"),
    [("SI_UNIT(.CENTI.,.METRE.)", 10.0, None), ("SI_UNIT(.MILLI.,.METRE.)", 1.0, "mm")],
)
def test_units_are_those_of_the_file_and_chords_are_in_mm_all_the_same(tmp_path, unit, scale, units):
    path = tmp_path / "sphere.step"
    path.write_text((HERE / "sphere.step").read_text().replace("SI_UNIT(.MILLI.,.METRE.)", unit))
    (solid,) = read_solids(path, units, 0.2 * scale).solids
    assert np.ptp(solid.vertices_mm, axis=0).max() == pytest.approx(40 * scale, rel=1e-5)
    middles = solid.vertices_mm[solid.faces].mean(axis=1)
    assert 0.02 / 3 * scale < np.abs(np.sqrt((middles**2).sum(axis=1)) - 20 * scale).max() <= 0.2 * scale
    with pytest.raises(InputError, match="give no units"):
        read_solids(path, "inch", 0.2)


INCH = """#114 = ( CONVERSION_BASED_UNIT('INCH',#901) LENGTH_UNIT() NAMED_UNIT(#902) );
#901 = LENGTH_MEASURE_WITH_UNIT({size},#903);
#902 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#903 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"""


@read_here
@pytest.mark.parametrize("size", ["LENGTH_MEASURE(25.4)", "25.4"])
def test_inches_are_read_with_and_without_the_type_of_their_size(tmp_path, size):
    text = (HERE / "cylinder.step").read_text()
    mm = "#114 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
    assert mm in text
    path = tmp_path / "part.step"
    path.write_text(text.replace(mm, INCH.format(size=size)))
    (solid,) = read_solids(path, "inch", 1.0).solids
    (metric,) = read_solids(HERE / "cylinder.step", None, 1.0 / 25.4).solids
    np.testing.assert_allclose(
        np.ptp(solid.vertices_mm, axis=0), 25.4 * np.ptp(metric.vertices_mm, axis=0), rtol=1e-5
    )


@read_here
def test_a_part_that_nobody_has_named_is_named_after_its_file():
    (solid,) = read_solids(HERE / "cylinder.step", None, 0.1).solids
    assert solid.name == "cylinder"


@read_here
def test_a_product_with_a_name_keeps_it(tmp_path):
    text = (HERE / "cylinder.step").read_text()
    path = tmp_path / "part.step"
    path.write_text(text.replace("Open CASCADE STEP translator 7.8 1", "locating pin"))
    (solid,) = read_solids(path, None, 0.1).solids
    assert solid.name == "locating pin"


@read_here
def test_bodies_and_voids():
    assert [volume(solid) for solid in read_solids(HERE / "two.step", None, 0.1).solids] == pytest.approx(
        [6000, 1000]
    )
    (hollow,) = read_solids(HERE / "hollow.step", None, 0.1).solids
    assert volume(hollow) == pytest.approx(27000 - 125)


CIRCLE_OF_UNITS = """ISO-10303-21;
DATA;
#3=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#4))REPRESENTATION_CONTEXT('',''));
#4=(CONVERSION_BASED_UNIT('INCH',#5)LENGTH_UNIT()NAMED_UNIT(*));
#5=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#6);
#6=(CONVERSION_BASED_UNIT('INCH',#7)LENGTH_UNIT()NAMED_UNIT(*));
#7=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#4);
ENDSEC;
END-ISO-10303-21;
"""


def test_damaged_files_are_refused(tmp_path):
    text = (HERE / "cylinder.step").read_text()
    path = tmp_path / "part.stp"
    for damaged, said in (
        ("", "does not start"),
        (text[: len(text) // 2], "cut short"),
        (text.replace("CLOSED_SHELL", "CLOSED_SHEL"), "OpenCASCADE|solid"),
        (text.replace("LENGTH_UNIT()", ""), "unit"),
        (CIRCLE_OF_UNITS, "states no unit of length"),
    ):
        path.write_text(damaged)
        with pytest.raises(InputError, match=said):
            read_solids(path, None, 0.1)


@read_here
def test_faces_of_several_colours_are_one_closed_part():
    (solid,) = read_solids(HERE / "painted.step", None, 0.1).solids
    assert len(solid.faces) == 12
    assert volume(solid) == pytest.approx(20 * 30 * 10, rel=1e-5)


@read_here
def test_a_part_that_is_refused_does_not_cost_the_others():
    found = read_solids(HERE / "plate_and_chip.step", None, 0.1)
    assert [volume(solid) for solid in found.solids] == [pytest.approx(6000, rel=1e-5)]
    (line,) = found.refused
    assert "0.5" in line
    assert "must be from 1 mm" in line


@read_here
def test_each_shape_of_an_assembly_is_one_solid():
    """A plate, and a pin five times: two in a sub-assembly that occurs twice; volumes by Open CASCADE."""
    plate, pin = read_solids(HERE / "assembly.step", None, 0.1).solids
    assert (plate.name, pin.name) == ("assembly", "pin")  # Open CASCADE wrote no name of the plate
    assert volume(plate) == pytest.approx(6000.0, rel=1e-5)
    assert volume(pin) == pytest.approx(904.778684, abs=715.9 * pin.off_mm)
    assert np.ptp(pin.vertices_mm, axis=0) == pytest.approx([12, 12, 23], abs=2 * pin.off_mm)


@read_here
def test_shapes_of_one_name_with_braces_are_read(tmp_path):
    text = re.sub(
        r"PRODUCT\('[^']*','[^']*'", "PRODUCT('{a}','{a}'", (HERE / "plate_and_chip.step").read_text()
    )
    path = tmp_path / "part.step"
    path.write_text(text)
    found = read_solids(path, None, 0.1)
    assert [solid.name for solid in found.solids] == ["{a}"]
    assert found.refused[0].startswith("{a}: its largest side is 0.5")
