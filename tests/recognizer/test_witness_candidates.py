"""Where candidates for a witness start, and rounding before what decides, against shapely and decimal."""

from decimal import Context, Decimal

import numpy as np
import pytest
import shapely

from palpate.recognizer.witness_candidates import corner_means
from palpate.recognizer.witness_search import round_to_nine_digits


@pytest.mark.parametrize("seed", range(20))
def test_corners_are_those_of_the_polygon(seed: int) -> None:
    """Vertices that coincide but for rounding, are on a side or pad the polygon do not move their mean."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 10 ** rng.uniform(-3, 2), (int(rng.integers(3, 9)), 2)) + rng.normal(0, 50, 2)
    hull = np.asarray(
        shapely.geometry.polygon.orient(shapely.MultiPoint(points).convex_hull).exterior.coords
    )[:-1]
    more = []
    for corner, following in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        more.append(corner)
        if rng.random() < 0.5:
            more.append(corner + rng.normal(0, 1e-14, 2))
        if rng.random() < 0.5:
            more.append(corner + rng.uniform(0.1, 0.9) * (following - corner))
    start = int(rng.integers(len(more)))
    turned = more[start:] + more[:start]
    padded = np.array(turned + turned[:1] * int(rng.integers(3)))
    np.testing.assert_allclose(corner_means(padded[None]), hull.mean(axis=0)[None], rtol=0, atol=1e-9)


def test_a_point_and_a_line_have_a_middle() -> None:
    """Without errors sections are points; two contacts on parallel edges may leave a line."""
    point, line = np.full((1, 4, 2), 3.0), np.array([[[0.0, 0.0], [4.0, 2.0], [1.0, 0.5], [0.0, 0.0]]])
    np.testing.assert_allclose(corner_means(point), [[3.0, 3.0]])
    np.testing.assert_allclose(corner_means(line), [[2.0, 1.0]])


def test_digits_that_rounding_may_change_are_dropped() -> None:
    """Values stay near what they were, at any size, and the last bits do not matter."""
    rng = np.random.default_rng(1)
    value = rng.uniform(1, 10, 200) * 10.0 ** rng.integers(-200, 200, 200)
    found = round_to_nine_digits(value)
    np.testing.assert_allclose(found, value, rtol=1.01e-9)
    eight = [float(Context(prec=8).create_decimal(Decimal(item))) for item in value.tolist()]
    assert np.array_equal(round_to_nine_digits(np.array(eight)), round_to_nine_digits(np.nextafter(eight, 0)))
    assert np.array_equal(round_to_nine_digits(found), found)
