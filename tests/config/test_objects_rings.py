"""Circles and arcs in objects files: read, checked, written again; the polygons that stand for them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from ezdxf.math import bulge_to_arc
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.base.geometry import Circle
from palpate.base.geometry.object_model import arcs_polygon, circle_facets, circle_polygon
from palpate.config.objects_file import load_objects
from palpate.config.writers import file_text

SLOT = [[-20, -10], [20, -10, 1], [20, 10], [-20, 10, 1]]
CIRCLE = {"circle": {"centre": [3, 4], "radius": 20}}


def file_of(tmp_path: Path, outline: object, **keys: object) -> Path:
    table = {"name": "part", "height": 20, "outline": outline} | keys
    path = tmp_path / "objects.json"
    path.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": [table]}))
    return path


@pytest.mark.parametrize("outline", [SLOT, CIRCLE, [[0, 0], [30, 0], [0, 30]]])
def test_what_is_read_is_written_again(tmp_path: Path, outline: object) -> None:
    objects = load_objects(file_of(tmp_path, outline, normal_bound=0.1))
    again = tmp_path / "again.json"
    again.write_text(file_text(objects))
    assert load_objects(again) == objects
    (polygon,) = json.loads(again.read_text())["objects"][0]["states"][0]["sections"][0]["polygons"]
    assert polygon["outer"] == outline


def test_a_circle_is_a_round_state_within_micrometres(tmp_path: Path) -> None:
    (state,) = load_objects(file_of(tmp_path, CIRCLE)).objects[0].states
    assert state.is_round
    (ring,) = state.sections[0].rings
    np.testing.assert_allclose(np.hypot(*(ring - [3, 4]).T), 20, atol=1e-12)
    assert len(ring) % 48 == 0
    assert 0 < state.curves_off_mm <= 0.002
    assert state.curves_turn_rad == math.pi / len(ring)


def test_a_slot_has_the_area_of_a_slot(tmp_path: Path) -> None:
    (state,) = load_objects(file_of(tmp_path, SLOT)).objects[0].states
    area = shapely.Polygon(state.sections[0].rings[0]).area
    assert area == pytest.approx(800 + math.pi * 100, rel=1e-3)
    assert not state.is_round
    assert state.curves_off_mm <= 0.002


@pytest.mark.parametrize(
    ("outline", "words"),
    [
        ({"circle": {"centre": [0, 0], "radius": 0}}, "radius"),
        ({"circle": {"centre": [0], "radius": 1}}, "centre"),
        ({"circle": {"centre": [0, 0]}}, "radius"),
        ({"cirle": {"centre": [0, 0], "radius": 1}}, "circle"),
        ([[0, 0, 0.5], [10, 0, "x"], [0, 10]], "outline point 1"),
        ([[0, 0, 200], [10, 0], [0, 10]], "outline point 0"),
        ([[0, 0, 1], [10, 0], [5, -8]], "intersects itself"),
    ],
)
def test_what_is_no_curve_is_refused_in_one_line(tmp_path: Path, outline: object, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        load_objects(file_of(tmp_path, outline))
    assert "\n" not in str(refused.value)
    assert "type=" not in str(refused.value)


@given(
    st.complex_numbers(max_magnitude=50, allow_nan=False),
    st.complex_numbers(max_magnitude=50, allow_nan=False),
    st.floats(-3, 3).filter(lambda bulge: abs(bulge) > 1e-3),
    st.floats(1e-3, 0.5),
)
def test_arcs_are_those_of_another_reader_of_bulges(
    start: complex, end: complex, bulge: float, stray: float
) -> None:
    if abs(end - start) < 0.1:
        return
    points = np.array([[start.real, start.imag, bulge], [end.real, end.imag, 0.0]])
    flat = arcs_polygon(points, stray)
    centre, first, last, radius = bulge_to_arc((start.real, start.imag), (end.real, end.imag), bulge)
    ring = flat.ring
    np.testing.assert_allclose(np.hypot(*(ring - [centre.x, centre.y]).T), radius, rtol=1e-7, atol=1e-7)
    turn = (last - first) % (2 * math.pi)
    if turn < math.pi and len(ring) > 2:
        segment = radius**2 * (turn - math.sin(turn)) / 2
        assert shapely.Polygon(ring).area <= segment + 1e-6
        assert shapely.Polygon(ring).area >= segment - flat.off_mm * radius * turn - 1e-6
    assert flat.off_mm <= stray + 1e-9
    assert flat.turn_rad == pytest.approx(math.acos(max(1 - flat.off_mm / radius, -1)), abs=1e-4)


@given(st.floats(0.01, 1e4), st.floats(1e-3, 1.0))
def test_a_circle_is_within_what_its_polygon_says(radius: float, stray: float) -> None:
    facets = circle_facets(radius, stray)
    flat = circle_polygon(Circle((1.0, 2.0), radius), facets)
    middles = (flat.ring + np.roll(flat.ring, -1, axis=0)) / 2 - [1.0, 2.0]
    assert radius - float(np.hypot(*middles.T).min()) == pytest.approx(flat.off_mm, abs=1e-9 * radius)
    assert flat.off_mm <= stray or facets == 720
