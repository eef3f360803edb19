"""Rotational symmetry, with shapes made to be mistaken for symmetric ones."""

import math

import numpy as np
import pytest

from palpate.geometry import Polygon, Section, State
from palpate.recognizer.symmetry import centroid, symmetry_order


def state(*sections: list[tuple[float, float]] | np.ndarray) -> State:
    return State(
        "flat",
        tuple(
            Section((10.0 * k, 10.0 * (k + 1)), (Polygon(np.asarray(ring, dtype=float)),))
            for k, ring in enumerate(sections)
        ),
    )


def order(of: State) -> int:
    return symmetry_order(of, centroid(of), 1e-3)


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
