"""Places on outlines against shapely: the nearest point, its arc length, and the outward normal."""

import math

import numpy as np
import pytest
import shapely
from shapely_bench import SHIPPED_OBJECTS, outlines

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue
from palpate.recognizer.outline_deviations import in_centred_frame, places_on_outlines

FRAME = Polygon(
    np.array([(-40.0, -30.0), (40.0, -30.0), (44.0, 28.0), (-40.0, 32.0)]),
    (np.array([(-20.0, -10.0), (-18.0, 12.0), (20.0, 14.0), (22.0, -12.0)]),),
)


def some_points(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-60, 60, (count, 2))


def test_places_are_the_nearest_ones_on_all_rings() -> None:
    model = ObjectModel("frame", (State("flat", (Section((0, 20), (FRAME,)),)),))
    catalogue = Catalogue([model])
    points = some_points(80, 1)
    origin = catalogue.origins_mm[0]
    found = places_on_outlines(
        catalogue, np.array([0]), [(10.0, 10.0)] * len(points), (points - origin)[None]
    )
    shape = shapely.Polygon(FRAME.outer, FRAME.holes)
    rings = [shape.exterior, *shape.interiors]
    for k, point in enumerate(points):
        ring = int(found.ring[0, k])
        gaps = [ring.distance(shapely.Point(point)) for ring in rings]
        assert found.gap[0, k] == pytest.approx(min(gaps))
        assert gaps[ring] == pytest.approx(min(gaps))
        assert found.perimeter[0, k] == pytest.approx(rings[ring].length)
        foot = found.foot[0, k] + origin
        assert rings[ring].distance(shapely.Point(foot)) < 1e-9
        if not shape.contains(shapely.Point(point)):  # where the centre of a tip is
            away = (point - origin - found.foot[0, k]) / found.gap[0, k]
            assert found.normal[0, k] == pytest.approx(away)


def test_arc_lengths_between_places_are_those_along_the_ring() -> None:
    models = outlines(SHIPPED_OBJECTS)
    catalogue = Catalogue(models)
    for state, model in enumerate(models):
        ring = shapely.LinearRing(model.states[0].sections[0].polygons[0].outer)
        at = np.sort(np.random.default_rng(state).uniform(0, ring.length, 9))
        points = shapely.get_coordinates(shapely.line_interpolate_point(ring, at))
        own = (points - catalogue.origins_mm[state])[None]
        found = places_on_outlines(catalogue, np.array([state]), [(10.0, 10.0)] * 9, own)
        steps = np.diff(found.along[0]) % ring.length
        if not ring.is_ccw:
            steps = -np.diff(found.along[0]) % ring.length
        assert steps == pytest.approx(np.diff(at), abs=1e-6)


def test_points_are_seen_from_poses() -> None:
    points, theta = some_points(5, 2), np.array([0.3, -2.0])
    position = np.array([[3.0, -4.0], [10.0, 1.0]])
    found = in_centred_frame(points, theta, position)
    for row, angle in enumerate(theta.tolist()):
        back = found[row] + position[row]
        cos, sin = math.cos(angle), math.sin(angle)
        assert back @ np.array([[cos, sin], [-sin, cos]]) == pytest.approx(points)
