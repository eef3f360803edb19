"""Balls: what stops them beside stacks of prisms and frusta, judged by distances from meshes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from ball_tips import ball_contacts, first_touch_of_ball, triangles_of, wobbly_triangles
from kernel_switch import needs_kernel, without_kernel
from sampling import sample
from upright_tips import Block, Stack, cone_model, drawn_stack, holds, model_of, square

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Section, State
from palpate.base.vocabulary import TipShape
from palpate.recognizer import Catalogue, Finger, recognise
from palpate.recognizer.ball_obstacle import ball_obstacle, is_exact

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
def test_the_truth_is_never_lost(seed: int, leaning: bool) -> None:
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


@needs_kernel
@pytest.mark.parametrize("seed", sample(range(12), range(4)))
def test_answers_are_the_same_without_the_kernel(seed: int) -> None:
    rng = np.random.default_rng([87, seed])
    foot, body = shapely.box(-21, -16, 21, 16), shapely.box(-19, -9, 15, 18)
    stack = Stack((Block(foot, (0.0, 7.0)), Block(body, (7.0, 30.0))))
    models = [model_of(stack, "a")]
    finger, at = ball(6.0, 10.5 + 0.1 * seed), (3.0, -2.0, 0.4 + seed)
    contacts = ball_contacts(triangles_of(stack, at), finger, at[:2], rng, count=4)
    with_it = recognise(Catalogue(models), contacts).hypotheses
    with without_kernel():
        alone = recognise(Catalogue(models), contacts).hypotheses
    assert len(with_it) == len(alone)
    for one, other in zip(with_it, alone, strict=True):
        for name in ("x_mm", "y_mm", "theta_rad"):
            assert getattr(one.bounds, name) == pytest.approx(getattr(other.bounds, name), abs=1e-9)
    assert holds(list(with_it), "a", at)


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
    with pytest.raises(InputError, match="a ball has no length"):
        Finger(5.0, 10.0, 3.0, TipShape.BALL)
    assert ball(5.0, 10.0).span_mm == (5.0, 15.0)
