"""Tips that are balls, and tips of a length."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.tips import TipShape
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Catalogue, Finger, is_exact, recognise
from palpate.recognizer.tip_obstacle import ball_obstacle, uncovered_polygons, union_circles
from support.campaign.sampling import sample
from support.oracles.upright_tips import (
    Block,
    Stack,
    ball_contacts,
    cone_model,
    drawn_stack,
    first_touch,
    first_touch_of_ball,
    holds,
    model_of,
    slices,
    square,
    stack_contacts,
    triangles_of,
    wobbly_triangles,
)
from support.oracles.whole_queries import WholeQuery, assert_same_by_numpy

# ----------------------------------------------------------------------------------------------------
# Balls: what stops them beside stacks of prisms and frusta, judged by distances from meshes.

_FACET_MM = 1e-3


def ball(radius_mm: float, height_mm: float) -> Finger:
    return Finger(radius_mm, height_mm, shape=TipShape.BALL)


def stepped(*blocks: tuple[float, float, float], tolerance_mm: float = 0.0) -> ObjectModel:
    """A part of squares: half of each one's side, and from which height to which."""
    sections = tuple(Section((low, high), (square(half),)) for half, low, high in blocks)
    return ObjectModel("stepped", (State("s", sections),), tolerance_mm)


def drawn_ball(rng: np.random.Generator, top_mm: float) -> Finger:
    """One that clears the table, with its lower end beside the stack."""
    radius = float(rng.choice([3.0, 6.0, 9.0]))
    return ball(radius, float(rng.uniform(radius, max(top_mm + 0.6 * radius, radius + 1))))


@pytest.mark.parametrize("seed", sample(range(60), range(12)))
def test_the_grown_outline_stops_a_ball_where_the_solid_does(seed: int) -> None:
    rng = np.random.default_rng([82, seed])
    stack = drawn_stack(rng, leaning=False)
    finger = drawn_ball(rng, stack.top_mm)
    catalogue = Catalogue([model_of(stack)], facet_error_mm=_FACET_MM)
    try:
        edges, origin = catalogue.outlines(finger), catalogue.origins_mm[0]
    except InputError:
        return  # it is met too obliquely
    off = edges.slack_out.max(initial=0.0) + edges.slack_in.max(initial=0.0) + 1e-6
    lines = shapely.MultiLineString(list(np.stack([edges.start + origin, edges.end + origin], axis=1)))
    triangles = triangles_of(stack)
    for _ in range(12):
        angle = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(angle), math.sin(angle), 0.0])
        start = np.array([*rng.uniform(-20, 20, 2), finger.height_mm]) - 110.0 * heading
        travel = first_touch_of_ball(triangles, start, heading, finger.tip_radius_mm)
        end = start + min(travel, 220.0) * heading
        if math.isfinite(travel):
            assert lines.distance(shapely.Point(end[:2])) <= off
        else:
            assert not lines.crosses(shapely.LineString([start[:2], end[:2]])), "it passes by"


@pytest.mark.parametrize("leaning", [False, True])
@pytest.mark.parametrize("seed", sample(range(40), range(8)))
def test_the_truth_is_never_lost_by_balls(seed: int, leaning: bool) -> None:
    rng = np.random.default_rng([83, seed, leaning])
    stacks = [drawn_stack(rng, leaning=leaning) for _ in range(2)]
    catalogue = Catalogue([model_of(stack, name, 0.3) for stack, name in zip(stacks, "ab", strict=True)])
    finger = drawn_ball(rng, stacks[0].top_mm)
    at = (*rng.uniform(-15, 15, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))
    try:
        catalogue.edges(finger)
    except InputError:
        return  # it is met too obliquely
    contacts = ball_contacts(triangles_of(stacks[0], at), finger, at[:2], rng, count=4)
    if any(contact.touched for contact in contacts):
        assert holds(list(recognise(catalogue, contacts).hypotheses), "a", at)


@pytest.mark.parametrize("seed", sample(range(120), range(10)))
def test_the_truth_is_kept_where_parts_are_off_by_their_tolerance(seed: int) -> None:
    rng = np.random.default_rng([86, seed])
    off = float(rng.choice([0.05, 0.2, 0.5]))
    stacks = [drawn_stack(rng, leaning=False) for _ in range(2)]
    models = [
        replace(model_of(stack, name), tolerance_mm=off + 1e-9)
        for stack, name in zip(stacks, "ab", strict=True)
    ]
    catalogue, finger = Catalogue(models), drawn_ball(rng, stacks[0].top_mm)
    at = (*rng.uniform(-15, 15, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))
    try:
        catalogue.edges(finger)
    except InputError:
        return  # it is met too obliquely
    triangles = wobbly_triangles(stacks[0], off, rng, at)
    contacts = ball_contacts(triangles, finger, at[:2], rng, count=4, bound_mm=0.05, half_rad=0.08)
    if any(contact.touched for contact in contacts):
        assert holds(list(recognise(catalogue, contacts).hypotheses), "a", at)


def test_answers_are_the_same_without_the_kernel() -> None:
    foot, body = shapely.box(-21, -16, 21, 16), shapely.box(-19, -9, 15, 18)
    stack = Stack((Block(foot, (0.0, 7.0)), Block(body, (7.0, 30.0))))
    models, queries = [model_of(stack, "a")], []
    for seed in range(4):
        finger, at = ball(6.0, 10.5 + 0.1 * seed), (3.0, -2.0, 0.4 + seed)
        rng = np.random.default_rng([87, seed])
        contacts = ball_contacts(triangles_of(stack, at), finger, at[:2], rng, count=4)
        assert holds(list(recognise(Catalogue(models), contacts).hypotheses), "a", at)
        queries.append(WholeQuery(models, [contacts]))
    assert_same_by_numpy(queries)


def test_a_disc_at_the_equator_loses_the_truth() -> None:
    """What a rig file that calls a ball a cylinder takes it for."""
    stack = Stack(
        (Block(shapely.box(-20, -20, 20, 20), (0.0, 7.0)), Block(shapely.box(-15, -9, 11, 12), (7, 30)))
    )
    wrong, model = 0, model_of(stack, "a")
    for seed in range(8):
        rng = np.random.default_rng([84, seed])
        at = (3.0, -2.0, 0.4)
        contacts = ball_contacts(triangles_of(stack, at), ball(6.0, 10.0), at[:2], rng, count=5)
        thin = [
            type(item)(item.name, Finger(6.0, 10.0), item.touched, item.start_mm, item.end_mm,
                       item.position_bound_mm, item.normal)
            for item in contacts
        ]  # fmt: skip
        assert holds(list(recognise(Catalogue([model]), contacts).hypotheses), "a", at)
        wrong += not holds(list(recognise(Catalogue([model]), thin).hypotheses), "a", at)
    assert wrong >= 4


def test_beside_upright_walls_a_ball_is_a_disc() -> None:
    box = stepped((10.0, 0.0, 12.0), (10.0, 12.0, 40.0))
    (state,) = Catalogue([box]).states
    met = ball_obstacle(state, ball(6.0, 11.0))
    assert met is not None
    assert met.radius_mm == 6.0
    assert is_exact(state, ball(6.0, 11.0))
    for prepared in (Catalogue.edges, Catalogue.outlines):
        round_tip, disc = (prepared(Catalogue([box]), tip) for tip in (ball(6.0, 11.0), Finger(6.0, 11.0)))
        np.testing.assert_array_equal(round_tip.start, disc.start)


def test_a_part_that_ends_below_the_equator_is_met_by_a_smaller_circle() -> None:
    (state,) = Catalogue([stepped((10.0, 0.0, 8.0))]).states
    met = ball_obstacle(state, ball(5.0, 11.0))
    assert met is not None
    assert met.radius_mm == pytest.approx(4.0)
    assert met.tolerance_mm == 0.0
    assert ball_obstacle(state, ball(5.0, 13.0)) is None, "it passes over the part"


def test_what_stands_back_by_less_than_the_circles_differ_is_not_met() -> None:
    # At 10 mm the ball's circle is 6 mm, at 6 mm it is 4.47 mm: of a foot of 11.2 mm corners stand out.
    for foot, layers in ((11.0, 1), (11.2, 2), (12.0, 1)):
        (state,) = Catalogue([stepped((foot, 0.0, 6.0), (10.0, 6.0, 30.0))]).states
        met = ball_obstacle(state, ball(6.0, 10.0))
        assert met is not None
        assert len(met.layers) == layers
        assert is_exact(state, ball(6.0, 10.0)) == (layers == 1)
        assert met.radius_mm == (6.0 if foot == 11.0 else pytest.approx(math.sqrt(20)))


def test_a_tolerance_counts_thrice() -> None:
    (state,) = Catalogue([stepped((10.0, 0.0, 30.0), tolerance_mm=0.2)]).states
    met = ball_obstacle(state, ball(6.0, 10.0))
    assert met is not None
    assert met.tolerance_mm == pytest.approx(0.6)


def test_what_would_be_met_far_from_the_equator_is_refused() -> None:
    item = stepped((20.0, 0.0, 5.0), (10.0, 5.0, 30.0))
    with pytest.raises(
        InputError, match=r'"stepped", state "s": a ball of radius 6 mm at 10.5 mm .* 0 to 5 mm'
    ):
        Catalogue([item]).edges(ball(6.0, 10.5))


@pytest.mark.parametrize("tolerance", [0.0, 0.3])
def test_a_cone_is_met_where_its_wall_leans_against_the_ball(tolerance: float) -> None:
    """Of 45°: R / √2 below the equator, where the slabs of 1 mm may be off by as much."""
    catalogue, finger = Catalogue([cone_model(tolerance)]), ball(4.0, 9.0)
    state = catalogue.states[0]
    met = ball_obstacle(state, finger)
    assert met is not None
    edges = catalogue.outlines(finger)
    middle = np.hypot(*((edges.start + edges.end) / 2).T)
    # Slabs of radius 24 − z from z to z + 1; the ball's circle at the height nearest to 9 mm.
    furthest = max(
        24 - z + math.sqrt(16 - max(9 - (z + 1), z - 9, 0) ** 2) for z in range(12) if abs(9 - z - 0.5) < 4
    )
    assert middle.max() <= furthest + 1e-6
    assert (middle + edges.slack_out).max() >= furthest - 1e-6


def test_a_ball_has_no_length() -> None:
    with pytest.raises(InputError, match="a ball has a radius only"):
        Finger(5.0, 10.0, 3.0, TipShape.BALL)
    assert ball(5.0, 10.0).span_mm == (5.0, 15.0)


# ----------------------------------------------------------------------------------------------------
# Tips of some length: what stops them beside stacks of prisms and frusta, judged by slices of meshes.


def drawn_finger(rng: np.random.Generator, top_mm: float) -> Finger:
    """A tip whose lower end stands beside the stack."""
    height = float(rng.uniform(2.0, top_mm))
    half = float(rng.uniform(0.5, height))
    return Finger(float(rng.choice([1.0, 4.0, 6.0, 9.0])), height, half)


@pytest.mark.parametrize("seed", sample(range(60), range(12)))
def test_the_grown_outline_stops_a_tip_where_the_solid_does(seed: int) -> None:
    rng = np.random.default_rng([61, seed])
    stack = drawn_stack(rng, leaning=False)
    finger = drawn_finger(rng, stack.top_mm)
    catalogue = Catalogue([model_of(stack)], facet_error_mm=_FACET_MM)
    edges, origin = catalogue.outlines(finger), catalogue.origins_mm[0]
    grown = shapely.MultiLineString(list(np.stack([edges.start + origin, edges.end + origin], axis=1)))
    outlines = slices(stack, finger.span_mm)
    for _ in range(12):
        angle = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(angle), math.sin(angle)])
        start = rng.uniform(-20, 20, 2) - 110.0 * heading
        travel = first_touch(outlines, start, heading, finger.tip_radius_mm)
        end = start + min(travel, 220.0) * heading
        if math.isfinite(travel):
            assert grown.distance(shapely.Point(end)) <= _FACET_MM + 1e-6
        for point in shapely.get_coordinates(shapely.LineString([start, end]).intersection(grown)):
            assert outlines.distance(shapely.Point(point)) <= finger.tip_radius_mm + 1e-6


@pytest.mark.parametrize("leaning", [False, True])
@pytest.mark.parametrize("seed", sample(range(40), range(8)))
def test_the_truth_is_never_lost_by_long_tips(seed: int, leaning: bool) -> None:
    rng = np.random.default_rng([62, seed, leaning])
    stacks = [drawn_stack(rng, leaning=leaning) for _ in range(2)]
    models = [model_of(stack, name) for stack, name in zip(stacks, "ab", strict=True)]
    finger = drawn_finger(rng, stacks[0].top_mm)
    at = (*rng.uniform(-15, 15, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))
    contacts = stack_contacts(slices(stacks[0], finger.span_mm), finger, at, rng, count=5)
    if not any(contact.touched for contact in contacts):
        return
    assert holds(list(recognise(Catalogue(models), contacts).hypotheses), "a", at)


def test_a_disc_at_the_tips_middle_loses_the_truth() -> None:
    """What a rig file without length_mm takes a tip of 12 mm for."""
    wrong = 0
    for seed in range(12):
        rng = np.random.default_rng([63, seed])
        stack = drawn_stack(rng, leaning=False)
        finger = Finger(5.0, stack.blocks[0].z_mm[1] + 3.0, 6.0)
        at = (3.0, -2.0, 0.4)
        contacts = stack_contacts(slices(stack, finger.span_mm), finger, at, rng, count=5)
        thin = [
            type(item)(item.name, Finger(5.0, finger.height_mm), item.touched, item.start_mm, item.end_mm,
                       item.position_bound_mm, item.normal)
            for item in contacts
        ]  # fmt: skip
        catalogue = Catalogue([model_of(stack, "a")])
        assert holds(list(recognise(catalogue, contacts).hypotheses), "a", at)
        wrong += not holds(list(recognise(catalogue, thin).hypotheses), "a", at)
    assert wrong >= 6


@pytest.mark.parametrize("tolerance", [0.0, 0.5])
def test_of_a_cone_the_widest_circle_along_the_tip_counts(tolerance: float) -> None:
    catalogue = Catalogue([cone_model(tolerance)])
    assert catalogue.states[0].state.is_round
    edges = catalogue.outlines(Finger(5.0, 8.5, 4.0))
    near = np.hypot(*((edges.start + edges.end) / 2).T)
    # From 4.5 mm on: the section from 4 to 5 mm, of radius 20. Into the bore no tip goes.
    radius = 20 + 5 - catalogue.states[0].tolerance_mm
    assert near.max() <= radius + 1e-9
    assert near.min() >= radius * math.cos(math.pi / 24) - 1e-9
    touchable = catalogue.edges(Finger(5.0, 8.5, 4.0))
    outer = {int(feature) for feature in touchable.feature}
    assert len(outer) == (1 if tolerance == 0 else 2), "another one within both tolerances may stand out"
    assert catalogue.edges(Finger(5.0, 30.0, 10.0)).count[0] == 0, "it ends 8 mm above the cone"


@pytest.mark.parametrize("seed", sample(range(30), range(8)))
def test_circles_that_bound_a_union(seed: int) -> None:
    """Against shapely: a circle bounds the union if points just beside it are in it on one side only."""
    rng = np.random.default_rng([64, seed])
    polygons = []
    for _ in range(int(rng.integers(1, 6))):
        inner, outer = np.sort(rng.choice(np.arange(1, 12), 2, replace=False)).astype(float)
        rings = [{"circle": {"centre": [0, 0], "radius": float(outer)}}]
        table = {"outer": rings[0]} | ({} if rng.uniform() < 0.4 else {
            "holes": [{"circle": {"centre": [0, 0], "radius": float(inner)}}]})  # fmt: skip
        polygons.append(table)
    tables = [
        {"name": f"p{k}", "states": [{"name": "s", "sections": [{"z": [0, 1], "polygons": [item]}]}]}
        for k, item in enumerate(polygons)
    ]
    text = {"format": "palpate/objects@1", "units": "mm", "objects": tables}
    read = objects_from_text(ObjectsFileText.model_validate(text), "here").objects
    rings = tuple(item.states[0].sections[0].polygons[0] for item in read)
    found = union_circles(rings)
    radii = [curve.radius_mm for item in rings for curve in item.curves]

    def solid(radius: float) -> bool:
        return any(
            (item.curves[1].radius_mm if len(item.curves) > 1 else -1.0) < radius < item.curves[0].radius_mm
            for item in rings
        )

    bounding = {radius for radius in radii if solid(radius - 0.01) != solid(radius + 0.01)}
    kept = [radius for radius, is_bound in zip(radii, found, strict=True) if is_bound]
    assert sorted(kept) == sorted(bounding), "each once"


def test_only_what_is_covered_for_certain_is_left_out() -> None:
    small, middle, large = square(9.0), square(9.9), square(10.0)
    assert uncovered_polygons((small, middle, large), 0.0) == (large,)
    assert uncovered_polygons((small, large, middle), 0.1) == (large, middle), (
        "0.1 mm may be twice the tolerance"
    )
    assert uncovered_polygons((large, large), 0.0) == (large,)
    assert uncovered_polygons((large, large), 0.3) == (large,), "what is true of the one is true of the other"
    ring = Polygon(square(10.0).outer, (square(5.0).outer,))
    assert uncovered_polygons((square(4.0), ring), 0.0) == (square(4.0), ring), "it stands in the hole"


def test_known_along_the_tip() -> None:
    section = Section((0.0, 20.0), (square(10.0),))
    state = State("s", (section,), height_mm=20.0, heights_mm=((2.0, 8.0), (8.0, 12.0), (15.0, 20.0)))
    assert state.known_within((3.0, 11.0)), "what is known goes on"
    assert not state.known_within((3.0, 13.0))
    assert not state.known_within((11.0, 16.0))
    assert state.known_within((16.0, 30.0)), "above it nothing is"
    assert state.known_within((21.0, 30.0))
    assert not state.known_within((0.0, 3.0))
    assert [state.known_at(z) for z in (1.0, 2.0, 12.0, 13.0, 25.0)] == [False, True, True, False, True]


def test_outlines_of_a_turned_model_are_as_long() -> None:
    rng = np.random.default_rng(65)
    stack = drawn_stack(rng, leaning=False)
    model = model_of(stack)
    turned = ObjectModel(
        "turned",
        (
            State(
                "standing",
                tuple(
                    Section(
                        part.z_mm,
                        tuple(
                            Polygon(
                                shapely.get_coordinates(
                                    affinity.rotate(shapely.Polygon(item.outer), 90, origin=(0, 0))
                                )[:-1]
                            )
                            for item in part.polygons
                        ),
                    )
                    for part in model.states[0].sections
                ),
            ),
        ),
    )
    finger = Finger(5.0, 8.0, 6.0)
    lengths = [Catalogue([item]).outlines(finger).length.sum() for item in (model, turned)]
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-6)


@pytest.mark.parametrize("half", [-1.0, math.nan, math.inf])
def test_lengths_that_are_none(half: float) -> None:
    with pytest.raises(InputError, match="half the length"):
        Finger(5.0, 10.0, half)
