"""Objects files: rings, arrays, the shipped catalogues."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from ezdxf.math import bulge_to_arc
from hypothesis import given
from hypothesis import strategies as st
from shapely import affinity

from palpate.base.array_cache import CACHE_PLACE, map_arrays
from palpate.base.errors import InputError
from palpate.base.geometry import Circle, Floats, ObjectModel
from palpate.base.geometry.object_model import arcs_polygon, circle_facets, circle_polygon
from palpate.config import load_rig, shipped_objects, shipped_rig
from palpate.config.objects_file import ObjectsFile, arrays_of_objects, load_objects, objects_of_arrays
from palpate.config.writers import file_text
from support.oracles.kernel import drawn_catalogue, round_objects

# ----------------------------------------------------------------------------------------------------
# Circles and arcs in objects files: read, checked, written again; the polygons that stand for them.

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
    ring, off_mm, turn_rad = arcs_polygon(points, stray)
    centre, first, last, radius = bulge_to_arc((start.real, start.imag), (end.real, end.imag), bulge)
    np.testing.assert_allclose(np.hypot(*(ring - [centre.x, centre.y]).T), radius, rtol=1e-7, atol=1e-7)
    turn = (last - first) % (2 * math.pi)
    if turn < math.pi and len(ring) > 2:
        segment = radius**2 * (turn - math.sin(turn)) / 2
        assert shapely.Polygon(ring).area <= segment + 1e-6
        assert shapely.Polygon(ring).area >= segment - off_mm * radius * turn - 1e-6
    assert off_mm <= stray + 1e-9
    assert turn_rad == pytest.approx(math.acos(max(1 - off_mm / radius, -1)), abs=1e-4)


@given(st.floats(0.01, 1e4), st.floats(1e-3, 1.0))
def test_a_circle_is_within_what_its_polygon_says(radius: float, stray: float) -> None:
    facets = circle_facets(radius, stray)
    ring, off_mm, _ = circle_polygon(Circle((1.0, 2.0), radius), facets)
    middles = (ring + np.roll(ring, -1, axis=0)) / 2 - [1.0, 2.0]
    assert radius - float(np.hypot(*middles.T).min()) == pytest.approx(off_mm, abs=1e-9 * radius)
    assert off_mm <= stray or facets == 720


# ----------------------------------------------------------------------------------------------------
# Objects files that were read once: taken from the cache they are what was read, or they are read anew.


def _written(path: Path, objects: list[ObjectModel]) -> Path:
    path.write_text(file_text(ObjectsFile(tuple(objects))))
    return path


def _large() -> list[ObjectModel]:
    known = drawn_catalogue(5, least_vertices=3500)
    first = known[0]
    state = replace(
        first.states[0],
        probability=0.25,
        tipping_angle_rad=0.3,
        normal_bound_rad=0.1,
        side_mm=(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 9.0]]),),
    )
    return [replace(first, states=(state,), holds_n=0.5, support_mm=3.0, normal_bound_rad=0.2), *known[1:]]


def _same(one: object, two: object) -> bool:
    """Every field, every bit."""
    if isinstance(one, np.ndarray):
        return isinstance(two, np.ndarray) and (one.shape, one.tobytes()) == (two.shape, two.tobytes())
    if isinstance(one, tuple):
        return isinstance(two, tuple) and len(one) == len(two) and all(map(_same, one, two))
    if isinstance(one, Circle) or not hasattr(one, "__dataclass_fields__"):
        return one == two
    names = [item.name for item in fields(one) if item.name != "notices"]  # type: ignore[arg-type]
    return type(one) is type(two) and all(_same(getattr(one, name), getattr(two, name)) for name in names)


def test_arrays_and_back() -> None:
    objects = (*_large(), *round_objects())
    back, notices = objects_of_arrays(arrays_of_objects(objects, ("one point left out",)))
    assert _same(objects, back)
    assert notices == ("one point left out",)


def test_a_large_file_is_taken_from_the_cache_under_any_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _written(tmp_path / "first.json", _large())
    text = json.loads(path.read_text())
    text["objects"][1]["states"][0]["sections"][0]["polygons"][0]["outer"].insert(
        1, text["objects"][1]["states"][0]["sections"][0]["polygons"][0]["outer"][0]
    )
    path.write_text(json.dumps(text))
    read = load_objects(path)  # tests have no cache
    assert read.notices
    cache = tmp_path / "cache"
    monkeypatch.setenv(CACHE_PLACE, str(cache))
    again = load_objects(path)
    (kept,) = cache.iterdir()
    stamp = kept.stat().st_mtime_ns
    other = path.rename(tmp_path / "second.json")
    taken = load_objects(other)
    assert kept.stat().st_mtime_ns >= stamp
    for found in (again, taken):
        assert _same(read, found)
        assert not found.objects[0].states[0].sections[0].polygons[0].outer.flags.writeable
    assert [line.replace("first", "second") for line in read.notices] == list(taken.notices)
    damaged = bytearray(kept.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    kept.write_bytes(damaged)
    assert _same(read, load_objects(other))
    assert map_arrays(kept)


def test_a_wrong_file_stays_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_PLACE, str(tmp_path / "cache"))
    objects = _large()
    path = _written(tmp_path / "objects.json", objects)
    load_objects(path)
    text = path.read_text().replace(f'"{objects[1].name}"', f'"{objects[0].name}"', 1)
    path.write_text(text)
    for _ in range(2):
        with pytest.raises(InputError, match=r"objects\.json.*name is taken"):
            load_objects(path)


@pytest.mark.parametrize(
    "spoilt",
    [
        {"text": np.frombuffer(b"[[], [[1]]]", np.uint8)},
        {"text": np.frombuffer(b"[[], 3]", np.uint8)},
        {"text": np.frombuffer(b"[" * 100_000, np.uint8)},
        {"text": np.frombuffer(b"\xff\xfe\x00", np.uint8)},
        {"text": np.frombuffer(b"[[], []]", np.uint8)},
        {"sizes": np.array([3, -1])},
        {"sizes": np.array([3.0])},
        {"points": np.zeros((2, 2))},
        {"points": np.zeros(3, np.float32)},
    ],
)
def test_arrays_that_are_no_objects_are_refused(spoilt: dict[str, np.ndarray]) -> None:
    arrays = arrays_of_objects(tuple(drawn_catalogue(5)[:2]), ())
    with pytest.raises(ValueError, match=r"."):
        objects_of_arrays(arrays | spoilt)
    for name in spoilt:
        with pytest.raises(ValueError, match=r"."):
            objects_of_arrays({key: value for key, value in arrays.items() if key != name})


EDGES = {"tr-1": 22, "tr-2": 26, "tr-3": 14, "grip": 14, "gator": 49, "hand": 66}
"""Edge counts of Memo 705, Table I (tr-1 lists half of its edges there)."""

ORDERS = {"tr-1": 2}


def outlines() -> dict[str, Floats]:
    return {
        model.name: model.states[0].sections[0].polygons[0].outer
        for model in load_objects(shipped_objects()).objects
    }


def mismatch(first: shapely.Polygon, second: shapely.Polygon) -> float:
    return float(first.symmetric_difference(second).area / first.area)


def test_names_edge_counts_and_heights_are_the_memo_s() -> None:
    assert {name: len(outline) for name, outline in outlines().items()} == EDGES
    for model in load_objects(shipped_objects()).objects:
        assert [state.name for state in model.states] == ["flat"]
        assert model.states[0].sections[0].z_mm == (0.0, 20.0)


@pytest.mark.parametrize("name", EDGES)
def test_outlines_are_simple_counter_clockwise_centred_and_of_a_size_to_be_felt(name: str) -> None:
    outline = outlines()[name]
    ring = shapely.LinearRing(outline)
    assert ring.is_simple
    assert ring.is_ccw
    centre = shapely.Polygon(outline).centroid
    assert math.hypot(centre.x, centre.y) < 0.1
    assert np.all(np.ptp(outline, axis=0) >= 40)
    assert np.all(np.ptp(outline, axis=0) <= 120)
    edges = np.roll(outline, -1, axis=0) - outline
    assert np.hypot(*edges.T).min() >= 2
    following = np.roll(edges, -1, axis=0)
    turns = np.arctan2(
        edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0], (edges * following).sum(axis=1)
    )
    assert np.degrees(np.abs(turns)).min() > 1, "collinear edges would be one edge"


@pytest.mark.parametrize("name", EDGES)
def test_rotational_symmetry_is_as_stated_and_no_part_is_its_own_mirror_image(name: str) -> None:
    part = shapely.Polygon(outlines()[name])
    for order in range(2, 7):
        turned = affinity.rotate(part, 360 / order, origin=part.centroid)
        if ORDERS.get(name) == order:
            assert mismatch(part, turned) < 1e-9
        else:
            assert mismatch(part, turned) > 0.05
    mirrored = affinity.scale(part, -1, 1, origin=part.centroid)
    assert (
        min(mismatch(part, affinity.rotate(mirrored, angle, origin=part.centroid)) for angle in range(360))
        > 0.05
    )


def test_tr_1_maps_edge_k_onto_edge_k_plus_11() -> None:
    outline = outlines()["tr-1"]
    np.testing.assert_array_equal(np.roll(outline, -11, axis=0), -outline)


@pytest.mark.parametrize("name", EDGES)
def test_every_part_fits_the_bench_wherever_it_is_put(name: str) -> None:
    rig = load_rig(shipped_rig())
    assert rig.emulation is not None
    extent = np.hypot(*outlines()[name].T).max() + rig.emulation.placement_radius_mm
    assert extent + 2 * rig.fingers[0].tip.radius_mm < rig.workspace.radius_mm
