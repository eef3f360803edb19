"""Carried regions: a part that is moved is in the region of before, grown by the motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.geometry.plane import rotate
from palpate.recognizer import Motion, recognise
from palpate.recognizer.carried_region import CarriedRegion
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.pose_region import Cells, WitnessedCells
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    grip,
    holding_truth,
    outlines,
    place,
    until_touched,
)

# ----------------------------------------------------------------------------------------------------
# Whatever a motion does within its bounds, what was in a cell is in what is left of the cells that hold it.

angles = st.floats(-10.0, 10.0)
widths = st.floats(1e-3, 0.2)
shares = st.floats(0.0, 1.0)
places = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


def square(state: int, middle: float, half: float, at: np.ndarray, size: float) -> Cells:
    corners = at + size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    one = np.array([state])
    return Cells(one, one, np.array([middle - half]), np.array([middle + half]), corners[None])


def holds(polygon: np.ndarray, point: np.ndarray) -> bool:
    leg, away = np.roll(polygon, -1, axis=0) - polygon, point - polygon
    return bool((leg[:, 0] * away[:, 1] - leg[:, 1] * away[:, 0] >= -1e-7).all())


@given(
    angles,
    widths,
    places,
    st.tuples(shares, shares, shares),
    st.tuples(shares, shares, angles),
    widths,
    shares,
)
def test_a_moved_part_is_in_the_clipped_cells(
    middle: float,
    half: float,
    at: tuple[float, float],
    inside: tuple[float, float, float],
    moved: tuple[float, float, float],
    new_half: float,
    off: float,
) -> None:
    shift_mm, turn_rad = 0.5, 0.03
    cells = square(0, middle, half, np.array(at), 1.0)
    theta = middle + half * (2 * inside[0] - 1)
    s = np.array(at) + 2 * np.array(inside[1:]) - 1
    region = CarriedRegion.of(cells, np.array([shift_mm]), np.array([turn_rad]))
    assert region is not None
    direction = np.array([math.cos(moved[2]), math.sin(moved[2])])
    after = rotate(s, np.array(theta)) + moved[0] * shift_mm * direction
    theta += turn_rad * (2 * moved[1] - 1)
    seen = rotate(after, np.array(-theta))
    new = square(
        0, theta + new_half * (2 * off - 1) + 2 * math.pi, new_half, seen + np.array([0.3, -0.2]), 5.0
    )
    left, rows = region.clip(new)
    assert rows.tolist() == [0]
    assert holds(left.polygon[0], seen)
    assert left.volume[0] < new.volume[0]
    spots = WitnessedCells(new, seen[None], np.array([True]))
    # The candidate is at the middle orientation.
    lever = new_half * float(np.hypot(*seen))
    if (
        moved[0] * shift_mm + 2 * lever < shift_mm
        and abs(moved[1] - 0.5) * turn_rad + new_half < turn_rad / 2
    ):
        assert region.clip_witnessed(spots).holds.all()


@pytest.mark.parametrize("turn_rad", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("new_half", [0.01, 0.5, 3.1])
def test_wide_intervals_of_orientations_lose_nothing(turn_rad: float, new_half: float) -> None:
    cells = square(0, 0.3, 0.02, np.zeros(2), 0.2)
    region = CarriedRegion.of(cells, np.array([0.1]), np.array([turn_rad]))
    assert region is not None
    for theta in np.linspace(0.3 - turn_rad, 0.3 + turn_rad, 41):
        for off in (-0.9, 0.0, 0.9):
            middle = theta + off * new_half
            left, rows = region.clip(square(0, middle, new_half, np.zeros(2), 0.1))
            assert rows.tolist() == [0]
            turns = (theta - left.middle[0] + math.pi) % (2 * math.pi) - math.pi
            assert abs(turns) <= left.half_width[0] + 1e-9


def test_cells_where_the_part_cannot_be_are_left_out() -> None:
    cells = square(3, 0.0, 0.01, np.array([5.0, 5.0]), 0.2)
    region = CarriedRegion.of(cells, np.array([0.1]), np.array([0.01]))
    assert region is not None
    others = [
        square(2, 0.0, 0.01, np.array([5.0, 5.0]), 0.2),
        square(3, 0.1, 0.01, np.array([5.0, 5.0]), 0.2),
        square(3, 0.0, 0.01, np.array([6.0, 5.0]), 0.2),
        square(3, 0.0, 0.01, np.array([5.3, 5.0]), 0.2),
    ]
    left, rows = region.clip(Cells.join(others))
    assert rows.tolist() == [3]
    candidates = WitnessedCells(others[3], np.array([[5.5, 5.0]]), np.array([True]))
    assert not region.clip_witnessed(candidates).holds.any()
    assert left.volume[0] < others[3].volume[0]


def test_of_many_cells_neighbours_are_one_part_and_nothing_is_lost() -> None:
    """A part in any of 2,000 cells of two states, moved within its bounds; far from all, nothing is left."""
    rng = np.random.default_rng(5)
    middles, states = rng.uniform(-0.2, 0.2, 2000), rng.integers(0, 2, 2000)
    at = np.column_stack([10 * middles, rng.uniform(-1.0, 1.0, 2000)])
    cells = Cells.join([square(int(states[k]), middles[k], 2e-4, at[k], 0.02) for k in range(len(middles))])
    region = CarriedRegion.of(cells, np.full(2000, 0.1), np.full(2000, 0.01))
    assert region is not None
    assert len(region.state) < 600
    for k in rng.integers(0, 2000, 60).tolist():
        direction = rng.uniform(-math.pi, math.pi)
        moved = rotate(at[k], np.array(middles[k])) + 0.1 * np.array(
            [math.cos(direction), math.sin(direction)]
        )
        theta = middles[k] + rng.uniform(-0.01, 0.01)
        seen = rotate(moved, np.array(-theta))
        left, rows = region.clip(square(int(states[k]), theta, 1e-4, seen, 3.0))
        assert rows.tolist() == [0]
        assert holds(left.polygon[0], seen)
    for state, theta, place_mm in ((0, 0.0, [9.0, 0.0]), (1, 1.0, [0.0, 0.0]), (2, 0.0, [0.0, 0.0])):
        assert not len(region.clip(square(state, theta, 1e-4, np.array(place_mm), 0.1))[1])


def test_a_motion_without_bounds_leaves_no_region() -> None:
    cells = square(0, 0.0, 0.01, np.zeros(2), 0.2)
    assert CarriedRegion.of(cells, np.array([math.inf]), np.array([0.01])) is None
    assert CarriedRegion.of(cells, np.array([0.1]), np.array([math.inf])) is None
    assert CarriedRegion.of(cells.select([]), np.empty(0), np.empty(0)) is None


# ----------------------------------------------------------------------------------------------------
# What a motion adds to the bounds is the motion, not several times as much.


@pytest.mark.parametrize("seed", range(6))
def test_bounds_grow_by_the_motion(seed: int) -> None:
    rng = np.random.default_rng([24, seed])
    models = outlines(SHIPPED_OBJECTS)
    catalogue = Catalogue(models)
    placed = place(models[seed], rng)
    found = recognise(catalogue, until_touched(grip, placed, rng, fingers=6, aim=0.3))
    shift_mm, turn_rad, count = 0.2, 0.005, len(catalogue.states)
    moved = found.move(Motion(np.full(count, shift_mm), np.full(count, turn_rad)))
    before, after = holding_truth(found, placed), holding_truth(moved, placed)
    assert before is not None
    assert after is not None
    lever_mm = float(np.hypot(*before.state.origin_mm))
    was, now = before.bounds, after.bounds
    assert now.orientation_half_rad <= was.orientation_half_rad + turn_rad + 1e-3
    assert now.position_half_mm <= was.position_half_mm + 1.05 * (shift_mm + lever_mm * turn_rad) + 0.1
