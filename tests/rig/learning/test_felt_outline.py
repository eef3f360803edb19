"""Bounds of felt outlines, and models of them, judged by shapely on touches that are off by their bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.config import load_objects
from palpate.config.loading import Content
from palpate.config.objects_file import ObjectsFile
from palpate.config.writers import file_text
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange
from palpate.rig.learning.felt_outline import FeltOutline, felt_outline
from palpate.rig.learning.learned_model import NominalOutline, learned_model, nominal_outline
from palpate.rig.learning.touch_choice import open_places_mm, touch_targets
from support.oracles.shapely_touches import flat, touch, unit

TIP_MM, WORKSPACE_MM = 5.0, 90.0
QUARTER = 64
SHAPES = {
    "ell": shapely.Polygon([(-25, -20), (30, -20), (30, 0), (-3, 0), (-3, 25), (-25, 25)]),
    "notched": shapely.Polygon(
        [(-30, -20), (30, -20), (30, 20), (4, 20), (4, 5), (-2, 5), (-2, 20), (-30, 20)]
    ),  # the tip cannot enter the notch
    "comb": shapely.Polygon(
        [(-30, -15), (30, -15), (30, 15), (14, 15), (14, -2), (-14, -2), (-14, 15), (-30, 15)]
    ),
    "disc": shapely.Point(3, -2).buffer(22, 32),
}


def felt_by_tip(shape: shapely.Polygon) -> shapely.Polygon:
    """What a tip can feel of a shape, by its definition."""
    closing = shape.buffer(TIP_MM, QUARTER).buffer(-TIP_MM, QUARTER)
    return shapely.Polygon(closing.exterior)


def touches_round(shape: shapely.Polygon, count: int, rng: np.random.Generator) -> list[Contact]:
    """Touches and misses from all sides, each as far off as its bounds allow."""
    found = []
    for number in range(count):
        angle = 2 * math.pi * (number + rng.uniform()) / count
        aimed = np.array(shape.centroid.coords[0]) + rng.uniform(-32, 32) * unit(angle + math.pi / 2)
        start = aimed + 120 * unit(angle)
        met = touch(
            shape,
            rng,
            radius=TIP_MM,
            bound=0.2,
            half_range=math.radians(6),
            direction=angle + math.pi,
            start=start,
            reach=240.0,
            at_bound=True,
        )
        found.append(replace(met, path_bound_mm=0.4))
    return found


def closed_outline(shape: shapely.Polygon, seed: int) -> FeltOutline:
    """Bounds by so many touches that they close."""
    felt = felt_outline(touches_round(shape, 260, np.random.default_rng(seed)), WORKSPACE_MM)
    assert felt.is_closed
    return felt


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("count", [4, 25, 120, 260])
def test_what_tips_feel_lies_between_the_bounds(name: str, count: int) -> None:
    shape = SHAPES[name]
    felt = felt_outline(touches_round(shape, count, np.random.default_rng(count)), WORKSPACE_MM)
    assert felt.holds_together
    assert felt.inner.difference(felt_by_tip(shape).buffer(1e-3)).is_empty
    assert shape.difference(felt.outer.buffer(1e-6)).is_empty


@pytest.mark.parametrize("name", SHAPES)
def test_the_felt_outline_is_within_the_tolerance_of_the_model(name: str) -> None:
    true, felt = felt_by_tip(SHAPES[name]), closed_outline(SHAPES[name], 1)
    nominal = nominal_outline(felt)
    model = shapely.Polygon(nominal.points_mm)
    assert nominal.tolerance_mm > 0.2
    near = nominal.tolerance_mm + 1e-3
    assert model.exterior.buffer(near, QUARTER).covers(true.exterior)
    assert model.buffer(near, QUARTER).covers(true)
    assert true.buffer(near, QUARTER).covers(model)
    assert true.covers(model.buffer(-near, QUARTER)) or model.buffer(-near, QUARTER).is_empty


def test_bounds_close_only_once_tips_have_passed_all_round() -> None:
    every = touches_round(SHAPES["ell"], 260, np.random.default_rng(1))
    half = [item for item in every if item.start_mm[1] > 0]
    assert not felt_outline(half, WORKSPACE_MM).is_closed
    assert felt_outline(every, WORKSPACE_MM).is_closed


def test_a_part_that_was_moved_meanwhile_contradicts_itself() -> None:
    shape, rng = SHAPES["ell"], np.random.default_rng(2)
    before = touches_round(shape, 260, rng)
    after = touches_round(shapely.affinity.translate(shape, 9, 6), 260, rng)
    assert felt_outline(before, WORKSPACE_MM).holds_together
    assert not felt_outline([*before, *after], WORKSPACE_MM).holds_together


def test_touches_without_normals_prove_nothing_solid() -> None:
    bare = [
        replace(item, normal=None) for item in touches_round(SHAPES["ell"], 260, np.random.default_rng(1))
    ]
    felt = felt_outline(bare, WORKSPACE_MM)
    assert felt.inner.is_empty
    assert not felt.is_closed


@given(
    st.floats(0, math.pi), st.floats(0, 1), st.floats(0, 0.5), st.floats(0, 2 * math.pi), st.floats(0.5, 9)
)
def test_what_a_touch_proves_holds_wherever_on_its_arc_it_was(
    span: float, share: float, off: float, turn: float, distance: float
) -> None:
    normals = NormalRange(-span / 2, span / 2)
    contact = Contact("f", Finger(TIP_MM, 10.0), True, (120.0, 0.0), (0.0, 0.0), 0.5, normals)
    arcs = felt_outline([contact], WORKSPACE_MM).touched
    point = shapely.Point(-TIP_MM * unit(span * (share - 0.5)) + off * unit(turn))
    (barrier,), (near,) = arcs.barriers(TIP_MM), arcs.surroundings(distance)
    assert barrier.is_empty or shapely.hausdorff_distance(barrier, point) <= TIP_MM
    assert near.is_empty or shapely.hausdorff_distance(near, point) <= distance
    places = np.random.default_rng(1).uniform(-12, 12, (20, 2))
    away = shapely.distance(point, shapely.points(places))
    assert (away <= arcs.distances_mm(places)).all()


def test_a_corner_that_is_touched_on_both_walls_at_once_proves_more_than_one_wall() -> None:
    both = NormalRange(math.radians(35.0), math.radians(145.0))
    contact = Contact("f", Finger(TIP_MM, 10.0), True, (0.0, 120.0), (0.0, 5.0), 0.3, both)
    (barrier,) = felt_outline([contact], WORKSPACE_MM).touched.barriers(TIP_MM)
    assert barrier.covers(shapely.Point(0.0, 3.0))
    assert not barrier.covers(shapely.Point(0.0, 5.0))  # the tip was there


def test_touches_are_wanted_where_neighbours_are_missing() -> None:
    every = touches_round(SHAPES["ell"], 260, np.random.default_rng(1))
    near = shapely.Point(30, -10).buffer(9)  # no touch of the right wall
    left = [item for item in every if not (item.touched and near.covers(shapely.Point(item.end_mm)))]
    assert len(left) < len(every)
    outline = felt_by_tip(SHAPES["ell"])
    targets = touch_targets(felt_outline(left, WORKSPACE_MM), outline, 3.0)
    best = targets.places_mm[np.argmax(targets.worth)]
    assert outline.exterior.distance(shapely.Point(best)) < 1e-6
    assert best[0] == pytest.approx(30, abs=1)
    assert -20 < best[1] < 0


def test_where_nothing_is_proven_all_of_the_outline_is_open() -> None:
    few = touches_round(SHAPES["ell"], 12, np.random.default_rng(1))
    outline = felt_by_tip(SHAPES["ell"])
    for count in (0, 1, 5):
        touched = [item for item in few if item.touched]
        bare = [*touched[:count], *(replace(item, normal=None) for item in touched[count:])]
        felt = felt_outline(bare, WORKSPACE_MM)
        assert len(touch_targets(felt, outline, 2.0).places_mm) > 10
        assert 1 <= len(open_places_mm(felt, outline)) <= max(count, 1)
    closed = closed_outline(SHAPES["ell"], 1)
    assert len(open_places_mm(closed, shapely.Polygon(nominal_outline(closed).points_mm))) == 0


def test_a_learned_model_is_read_as_it_was_written() -> None:
    nominal = nominal_outline(closed_outline(SHAPES["ell"], 1))
    model = learned_model(("ell", "learned"), {(6.0, 14.0): nominal}, 12.0, TIP_MM)
    read = load_objects(Content("ell.json", file_text(ObjectsFile((model,))).encode())).objects[0]
    assert read.tolerance_mm == model.tolerance_mm >= nominal.tolerance_mm
    assert read.least_tip_radius_mm == TIP_MM
    assert read.normal_bound_rad == pytest.approx(math.pi)
    (state,) = read.states
    assert state.top_mm == 12.0
    assert state.known_within((6.0, 14.0))
    assert not state.known_within((5.0, 11.0))


def test_a_model_that_discs_have_learned_is_read_as_it_was_written() -> None:
    square = np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])
    model = learned_model(("square", "learned"), {(10.0, 10.0): NominalOutline(square, 1.0)}, 30.0, TIP_MM)
    read = load_objects(Content("square.json", file_text(ObjectsFile((model,))).encode()))
    assert read.objects[0].states[0].known_at(10.0)
    assert len(Catalogue(read.objects).edges(Finger(TIP_MM, 10.0)).state)


def test_a_smaller_tip_is_refused_where_larger_ones_learned() -> None:
    square = np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])
    model = learned_model(("square", "learned"), {(6.0, 14.0): NominalOutline(square, 1.0)}, 30.0, TIP_MM)
    catalogue = Catalogue([model, flat("other", square)])
    assert len(catalogue.edges(Finger(TIP_MM, 10.0, 4.0)).state)
    with pytest.raises(InputError, match="square"):
        catalogue.edges(Finger(4.0, 10.0, 4.0))
    with pytest.raises(InputError, match="above the table"):
        catalogue.edges(Finger(TIP_MM, 10.0))


@pytest.mark.parametrize(("name", "order"), [("bar", 2), ("square", 4), ("ell", 1)])
def test_outlines_that_may_be_symmetric_are_made_so(name: str, order: int) -> None:
    shape = {
        "bar": shapely.box(-30, -10, 30, 10),
        "square": shapely.box(-20, -20, 20, 20),
        "ell": SHAPES["ell"],
    }[name]
    felt = closed_outline(shape, 4)
    nominal = nominal_outline(felt)
    catalogue = Catalogue([learned_model((name, "learned"), {(6.0, 14.0): nominal}, 30.0, TIP_MM)])
    assert catalogue.states[0].symmetry_order == order
    near = shapely.Polygon(nominal.points_mm).exterior.buffer(nominal.tolerance_mm + 1e-3, QUARTER)
    assert near.covers(felt_by_tip(shape).exterior)
