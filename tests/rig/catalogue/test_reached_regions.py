"""The cheap proof that two outlines are near agrees with their exact distance, and is nearly always had."""

import math

import numpy as np
import pytest
import shapely
from stacked_parts import polygon, rectangle

from palpate.base.geometry import Floats
from palpate.cad.planar_congruence import PlanarMotion, stack_distance_mm
from palpate.rig.catalogue.twins import ReachedRegion, is_certainly_within

HOLE = np.array(polygon(8, 5.0))


def star(rng: np.random.Generator) -> Floats:
    """Forty corners, about 20 mm from the origin."""
    angles = np.arange(40) * 2 * math.pi / 40
    ring: Floats = np.column_stack([np.cos(angles), np.sin(angles)])
    return ring * (20 + rng.uniform(-2, 2, (40, 1)))


@pytest.mark.parametrize("seed", range(40))
def test_what_is_sure_is_so(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ring = star(rng)
    turn, shift = rng.uniform(-math.pi, math.pi), rng.uniform(-30, 30, 2)
    c, s = math.cos(turn), math.sin(turn)
    there = [
        (points + rng.uniform(-0.8, 0.8, points.shape)) @ np.array([[c, s], [-s, c]]) + shift
        for points in (ring, HOLE)
    ]
    first, second = shapely.Polygon(ring, [HOLE]), shapely.Polygon(there[0], there[1:])
    exact = stack_distance_mm([first], [second], turn, shift)
    one, other, motion = ReachedRegion(first), ReachedRegion(second), PlanarMotion(turn, shift, 0.0)
    assert not is_certainly_within(one, other, motion, 0.995 * exact)
    assert is_certainly_within(one, other, motion, 1.05 * exact), "arcs are no coarser than that"


def test_a_hole_and_a_peak_are_seen_from_both_sides() -> None:
    plain = shapely.Polygon(rectangle(40, 30))
    holed = shapely.Polygon(rectangle(40, 30), [rectangle(4, 4, 18, 13)])
    still = PlanarMotion(0.0, np.zeros(2), 0.0)
    for first, second in ((plain, holed), (holed, plain)):
        assert not is_certainly_within(ReachedRegion(first), ReachedRegion(second), still, 2.0)
    assert is_certainly_within(ReachedRegion(plain), ReachedRegion(plain), still, 1e-3)


def test_nothing_is_near_nothing_else() -> None:
    still = PlanarMotion(0.0, np.zeros(2), 0.0)
    empty, square = ReachedRegion(shapely.Polygon()), ReachedRegion(shapely.Polygon(rectangle(4, 4)))
    assert not is_certainly_within(empty, square, still, 10.0)
    assert not is_certainly_within(square, empty, still, 10.0)
