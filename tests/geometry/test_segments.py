"""Segments, rays and capsules against shapely and against sampling."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.geometry.plane import capsule_interval, distance_range, point_segment_distance

COORDINATE = st.integers(-40, 40).map(lambda value: value / 2)
POINT = st.tuples(COORDINATE, COORDINATE)
SEGMENT = st.tuples(POINT, POINT).filter(lambda ends: ends[0] != ends[1])


def parts(
    segment: tuple[tuple[float, float], tuple[float, float]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    begin, end = (np.array([p]) for p in segment)
    length = np.linalg.norm(end - begin, axis=1)
    return begin, (end - begin) / length[:, None], length


@given(POINT, SEGMENT)
def test_point_to_segment(point: tuple[float, float], segment: tuple) -> None:
    away = point_segment_distance(np.array([point]), *parts(segment))
    assert away[0] == pytest.approx(shapely.LineString(segment).distance(shapely.Point(point)), abs=1e-9)


@given(SEGMENT, SEGMENT)
def test_distances_between_segments(one: tuple, two: tuple) -> None:
    a, b, c, d = (np.array([p]) for p in (*one, *two))
    shortest, longest = distance_range(a, b, c, d)
    first, second = shapely.LineString(one), shapely.LineString(two)
    assert shortest[0] == pytest.approx(first.distance(second), abs=1e-9)
    fraction = np.linspace(0, 1, 23)[:, None]
    points_1, points_2 = a + fraction * (b - a), c + fraction * (d - c)
    between = np.linalg.norm(points_1[:, None] - points_2, axis=2)
    assert between.max() == pytest.approx(longest[0], abs=1e-9)
    assert between.min() >= shortest[0] - 1e-9


@given(POINT, st.floats(-3.2, 3.2), SEGMENT, st.floats(0.01, 8.0))
def test_capsule_interval_holds_exactly_what_is_near(
    origin: tuple[float, float], angle: float, segment: tuple, radius: float
) -> None:
    heading = np.array([[np.cos(angle), np.sin(angle)]])
    enter, leave = capsule_interval(np.array([origin]), heading, *parts(segment), np.array([radius]))
    travel = np.linspace(-90, 90, 721)
    points = shapely.points(np.array(origin) + travel[:, None] * heading)
    away = shapely.distance(shapely.LineString(segment), points)
    within = (travel >= enter[0]) & (travel <= leave[0])
    assert np.all(within[away < radius - 1e-7])
    assert not np.any(within[away > radius + 1e-7])
