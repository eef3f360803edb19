"""Polygons, regions and rings of edges: the same outline in each of its forms, against shapely."""

import math

import numpy as np
import pytest
import shapely

from palpate.base.geometry import Polygon
from palpate.base.geometry.outlines import EdgeRings, oriented_rings_of, polygons_of, region_of, rings_of
from palpate.base.geometry.plane import orient_ring, segment_distance, signed_area, turn_between

SQUARE = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
HOLE = np.array([[2.0, 2], [4, 2], [3, 5]])
PLATE = Polygon(SQUARE[::-1], (HOLE,))


def test_a_region_has_the_polygons_that_it_was_made_of() -> None:
    region = region_of([PLATE, Polygon(SQUARE + 20.0)])
    assert region.area == pytest.approx(200 - 3)
    assert region_of(polygons_of(region)).equals(region)
    assert sorted(map(len, rings_of(region))) == [3, 4, 4]


def test_lines_and_points_of_a_collection_are_no_polygons() -> None:
    mixed = shapely.GeometryCollection([shapely.Point(0, 0), shapely.LineString(SQUARE), shapely.Polygon()])
    assert polygons_of(mixed) == ()
    assert region_of(()).is_empty


def test_rings_are_oriented_with_the_material_on_their_left() -> None:
    assert [signed_area(ring) for ring in oriented_rings_of(region_of([PLATE]))] == [100, -3]
    assert signed_area(orient_ring(SQUARE, -1.0)) == -100


def test_edges_follow_each_other_round_their_ring() -> None:
    edges = EdgeRings.of([SQUARE, HOLE[::-1]])
    assert edges.first.tolist() == [0, 4]
    assert edges.following.tolist() == [1, 2, 3, 0, 5, 6, 4]
    assert (edges.following[edges.before] == np.arange(7)).all()
    assert edges.length.sum() == pytest.approx(region_of([PLATE]).length)
    outside = (edges.start + edges.end) / 2 + 0.01 * edges.normal
    assert not shapely.contains_xy(region_of([PLATE]), outside).any()


def test_no_rings_have_no_edges() -> None:
    edges = EdgeRings.of([])
    assert len(edges.first) == len(edges.following) == len(edges.before) == len(edges.normal) == 0


def test_distances_from_segments_are_shapelys() -> None:
    points, starts, ends = np.random.default_rng(3).normal(size=(3, 200, 2))
    ends[:5] = starts[:5]
    lines = shapely.linestrings(np.stack([starts, ends], axis=1))
    assert segment_distance(points, starts, ends) == pytest.approx(
        shapely.distance(lines, shapely.points(points))
    )


def test_turns_are_signed() -> None:
    turns = turn_between(np.array([[1.0, 0], [1, 0], [0, 0]]), np.array([[0.0, 2], [1, -1], [1, 1]]))
    assert turns == pytest.approx([math.pi / 2, -math.pi / 4, 0])
