"""Rotational symmetry, with shapes made to be mistaken for symmetric ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from exact_contacts import exact_contact
from shapely import affinity
from shapely_bench import Placed, flat, grip, holding_truth, place, unit

from palpate.base.geometry import Polygon, Section, State
from palpate.recognizer import Catalogue, Contact, Finger, recognise
from palpate.recognizer.symmetry import Symmetry, centroid, rotational_symmetry, symmetrise


def state(*sections: list[tuple[float, float]] | np.ndarray) -> State:
    return State(
        "flat",
        tuple(
            Section((10.0 * k, 10.0 * (k + 1)), (Polygon(np.asarray(ring, dtype=float)),))
            for k, ring in enumerate(sections)
        ),
    )


def order(of: State) -> int:
    return symmetry(of).order


def symmetry(of: State) -> Symmetry:
    return rotational_symmetry(of, centroid(of), 1e-3)


def regular(sides: int, radius: float = 30.0, turn: float = 0.3) -> np.ndarray:
    angle = turn + 2 * math.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + (7.0, -4.0)


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 12])
def test_regular_polygons(sides: int) -> None:
    assert order(state(regular(sides))) == sides


def test_rectangle_with_split_edges() -> None:
    assert order(state([(0, 0), (13, 0), (40, 0), (40, 20), (0, 20)])) == 2


def test_mirror_symmetry_is_none() -> None:
    assert order(state([(0, 0), (40, 0), (30, 20), (10, 20)])) == 1


def test_hourglass_whose_vertices_turn_onto_each_other() -> None:
    # All vertices of an X-shaped part lie on a square; the edges between them do not turn by 90°.
    hourglass = [(-20, -20), (20, -20), (5, 0), (20, 20), (-20, 20), (-5, 0)]
    assert order(state(hourglass)) == 2
    square_vertices = [(-20, -20), (0, -6), (20, -20), (6, 0), (20, 20), (0, 6), (-20, 20), (-6, 0)]
    assert order(state(square_vertices)) == 4
    without_one = [(-20, -20), (20, -20), (6, 0), (20, 20), (0, 6), (-20, 20), (-6, 0)]
    assert order(state(without_one)) == 1


def test_all_sections_count() -> None:
    square = [(-20, -20), (20, -20), (20, 20), (-20, 20)]
    assert order(state(square, [(-10, -5), (10, -5), (10, 5), (-10, 5)])) == 2
    assert order(state(square, [(0, 0), (10, 0), (0, 10)])) == 1


def test_a_displaced_boss_breaks_symmetry() -> None:
    square = np.array([(-20, -20), (20, -20), (20, 20), (-20, 20)], dtype=float)
    assert order(state(square, square / 4)) == 4
    assert order(state(square, square / 4 + (3.0, 0.0))) == 1


def test_a_hole_counts() -> None:
    outer = np.array([(-20, -20), (20, -20), (20, 20), (-20, 20)], dtype=float)
    hole = np.array([(-8, -3), (8, -3), (8, 3), (-8, 3)], dtype=float)
    holed = State("flat", (Section((0.0, 10.0), (Polygon(outer, (hole,)),)),))
    assert order(holed) == 2


def test_two_parts_that_change_places() -> None:
    part = np.array([(10, 0), (20, 0), (10, 15)], dtype=float)
    both = State("flat", (Section((0.0, 10.0), (Polygon(part), Polygon(-part))),))
    assert order(both) == 2


def test_off_by_more_than_the_tolerance() -> None:
    assert order(state([(0, 0), (40, 0), (40, 20.01), (0, 20)])) == 1
    assert order(state([(0, 0), (40, 0), (40, 20.0004), (0, 20)])) == 2


def test_centroid_of_several_sections_is_that_of_area() -> None:
    of = state([(0, 0), (2, 0), (2, 2), (0, 2)], [(10, 0), (14, 0), (14, 3), (10, 3)])
    assert centroid(of) == pytest.approx([(4 * 1 + 12 * 12) / 16, (4 * 1 + 12 * 1.5) / 16])


def wavy(vertices: int, lobes: int, depth: float) -> np.ndarray:
    """A round of many vertices whose radius goes up and down by `depth`, as often as there are lobes."""
    angle = 0.2 + 2 * math.pi * np.arange(vertices) / vertices
    radius = 30.0 + depth * np.cos(lobes * angle)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]) + (3.0, 11.0)


@pytest.mark.parametrize("lobes", [2, 3, 5])
@pytest.mark.parametrize("vertices", [600, 2400])
def test_steps_that_are_each_within_the_tolerance_and_together_are_not(lobes: int, vertices: int) -> None:
    assert order(state(wavy(vertices, lobes, 0.1))) == lobes
    assert order(state(wavy(vertices, lobes, 4e-4))) == vertices


def test_a_round_of_many_vertices_keeps_its_order() -> None:
    found = symmetry(state(regular(6000)))
    assert found.order == 6000
    assert found.off_mm < 1e-9


@pytest.mark.parametrize("sides", [5, 8, 12])
def test_every_turn_is_off_by_no_more_than_is_said(sides: int) -> None:
    """Coordinates as files have them, with three decimals."""
    ring = np.round(regular(sides), 3)
    found = symmetry(state(ring))
    assert found.order == sides
    outline = shapely.Polygon(ring).exterior
    off = [
        shapely.hausdorff_distance(
            affinity.rotate(outline, 360 * k / sides, origin=tuple(centroid(state(ring)))), outline
        )
        for k in range(1, sides)
    ]
    assert max(off) <= found.off_mm <= 1e-3
    assert found.lean_rad <= 2 * found.off_mm / 10


def touching(placed: Placed, name: str, radius: float, point: np.ndarray, normal: float) -> Contact:
    """Square onto a point (2,) of the outline, where its outward normal is the given one: without errors."""
    at, out = placed.on_table(point), unit(normal + placed.theta)
    start, end = (at + (radius + far) * out for far in (90.0, 0.0))
    return exact_contact(name, radius, start, end, normal + placed.theta, 1e-6)


@pytest.mark.parametrize("askew", [0, 1])
@pytest.mark.parametrize("first", range(4))
def test_notches_that_are_a_little_askew_on_two_sides(askew: int, first: int) -> None:
    """A finger that they are too narrow for meets a plain square; a point in one feels the difference."""
    nick = np.array([(-20.0, -20.0), (-1.5, -20.0), (-1.5, -18.0), (1.5, -18.0), (1.5, -20.0)])
    sides = [nick.copy() for _ in range(4)]
    sides[askew][2, 1] = sides[askew + 2][2, 1] = -18.0 + 9e-4
    ring = np.vstack([points @ np.array(_turn(k)).T for k, points in enumerate(sides)])
    model = flat("nicked", ring)
    assert order(model.states[0]) == 4
    placed = Placed(model, 4.0, -7.0, 0.6)
    begin, end = ring[5 * first + 2], ring[5 * first + 3]
    out = (first - 1) * math.pi / 2
    beside, next_side = 20 * unit(out) + 11 * unit(out + math.pi / 2), out + math.pi / 2
    contacts = [
        touching(placed, "side", 6.0, beside, out),
        touching(placed, "next", 6.0, 20 * unit(next_side) + 9 * unit(out), next_side),
        touching(placed, "floor", 0.0, (begin + end) / 2, math.atan2(begin[0] - end[0], end[1] - begin[1])),
    ]
    assert holding_truth(recognise(Catalogue([model]), contacts), placed) is not None


def _turn(quarters: int) -> list[list[float]]:
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    return [[cos, -sin], [sin, cos]]


def test_an_oval_lies_as_it_does() -> None:
    """Its answers are turned by no more than their bounds say, but for half a turn."""
    angle = 2 * math.pi * np.arange(1800) / 1800
    model = flat("oval", np.column_stack([20.2 * np.cos(angle), 19.95 * np.sin(angle)]))
    catalogue = Catalogue([model])
    for seed in (0, 2, 6, 8):
        rng = np.random.default_rng(seed)
        placed = place(model, rng)
        contacts = grip(placed, rng, radius=3.0, bound=0.01, half_range=math.radians(1), aim=0.02)
        bounds = [item.bounds.theta_rad for item in recognise(catalogue, contacts).hypotheses]
        assert any((placed.theta - lo) % math.pi <= hi - lo for lo, hi in bounds)


def shaken(ring: np.ndarray, size: float, seed: int) -> np.ndarray:
    """Every vertex off by at most a size, as a mesh has it that was stored in single precision."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * math.pi, len(ring))
    return ring + size * np.sqrt(rng.random(len(ring)))[:, None] * np.column_stack(
        [np.cos(turn), np.sin(turn)]
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_state_made_symmetric_is_so_and_hardly_off(seed: int) -> None:
    outer, hole = shaken(regular(24), 2e-4, seed), shaken(regular(8, 12.0), 2e-4, seed + 100)
    given = State("flat", (Section((0.0, 20.0), (Polygon(outer, (hole[::-1],)),)),))
    before, about = symmetry(given), centroid(given)
    assert before.order == 8
    made = symmetrise(given, about, before.order, 1e-3)
    assert made is not None
    after = rotational_symmetry(made, about, 1e-3)
    assert after.order == 8
    assert after.off_mm < 1e-12
    assert before.off_mm > 1e-5
    for ring, other in zip(made.sections[0].rings, given.sections[0].rings, strict=True):
        assert np.hypot(*(ring - other).T).max() <= before.off_mm


def test_what_has_vertices_on_straight_lines_is_left_as_it_is() -> None:
    ring = np.insert(regular(6), 1, regular(6)[:2].mean(axis=0), axis=0)
    given = state(shaken(ring, 1e-10, 0))
    assert symmetry(given).order == 6
    assert symmetrise(given, centroid(given), 6, 1e-3) is None


@pytest.mark.parametrize("seed", range(6))
def test_one_edge_of_each_orbit_is_enough_for_a_round_part_of_some_tolerance(seed: int) -> None:
    rng = np.random.default_rng([5, seed])
    outline = shaken(regular(32, float(rng.uniform(10, 30))), 1e-6, seed)
    model = replace(flat("round", outline), tolerance_mm=0.05)
    catalogue = Catalogue([model])
    item, edges = catalogue.states[0], catalogue.edges(Finger(5.0, 10.0))
    assert item.symmetry_order == 32
    assert np.count_nonzero(edges.representative) * 32 == len(edges.state)
    assert 0.05 < item.tolerance_mm < 0.0501
    true = flat(
        "round", outline + 0.05 * np.column_stack([np.cos(turn := rng.uniform(0, 7, 32)), np.sin(turn)])
    )
    placed = place(true, rng)
    found = recognise(catalogue, grip(placed, rng, bound=0.1, half_range=math.radians(10), at_bound=True))
    assert holding_truth(found, placed) is not None
