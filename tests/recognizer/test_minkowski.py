"""Grown sections against shapely's buffer with fine arcs."""

import numpy as np
import pytest
import shapely
from shapely_bench import SHIPPED_OBJECTS, flat, outlines

from palpate.base.geometry import Polygon, Section
from palpate.recognizer.minkowski import GrownSection, grow

FACET_ERROR_MM = 0.1
NOTCHED = [(0, 0), (40, 0), (40, 30), (24, 30), (20, 12), (16, 30), (0, 30)]
NEARLY_STRAIGHT = [(0, 0), (10, 0), (20, 0.0035), (30, 0.014), (30, 20), (0, 20)]
SQUARE = [(0, 0), (20, 0), (20, 20), (0, 20)]


def section(outer: object, *holes: object) -> Section:
    rings = tuple(np.asarray(hole, dtype=float) for hole in holes)
    return Section((0.0, 20.0), (Polygon(np.asarray(outer, dtype=float), rings),))


def true_boundary(of: Section, radius: float) -> shapely.Geometry:
    solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in of.polygons])
    return solid.buffer(radius, quad_segs=512).boundary if radius else solid.boundary


def as_lines(grown: GrownSection) -> shapely.Geometry:
    return shapely.multilinestrings(shapely.linestrings(np.stack([grown.start, grown.end], axis=1)))


def on_some_edge(points: np.ndarray, grown: GrownSection, rounding: float) -> np.ndarray:
    """Which points lie over an edge's own length, on its line or out by no more than its bulge."""
    rel = points[:, None] - grown.start
    along = np.sum(rel * grown.direction, axis=2)
    across = rel[..., 0] * grown.direction[:, 1] - rel[..., 1] * grown.direction[:, 0]
    over = (along >= -rounding) & (along <= grown.length + rounding)
    return (over & (across >= -rounding) & (across <= grown.bulge + rounding)).any(axis=1)


SECTIONS = {item.name: item.states[0].sections[0] for item in outlines(SHIPPED_OBJECTS)} | {
    "notched": section(NOTCHED),
    "nearly straight": section(NEARLY_STRAIGHT),
    "with a hole": section([(0, 0), (60, 0), (60, 50), (0, 50)], [(20, 15), (42, 18), (38, 35), (18, 30)]),
}


@pytest.mark.parametrize("name", SECTIONS)
@pytest.mark.parametrize("radius", [0.0, 0.05, 1.0, 4.9, 8.0])
def test_every_true_boundary_point_is_on_an_edge(name: str, radius: float) -> None:
    grown = grow(SECTIONS[name], radius, FACET_ERROR_MM)
    boundary = true_boundary(SECTIONS[name], radius)
    points = shapely.get_coordinates(shapely.segmentize(boundary, 0.1))
    # The oracle's own arcs are faceted with a sagitta of about 5e-6 of the radius.
    assert on_some_edge(points, grown, 1e-4).all()


@pytest.mark.parametrize("name", SECTIONS)
@pytest.mark.parametrize("radius", [0.0, 1.0, 4.9, 8.0])
def test_edges_stay_within_the_facet_error(name: str, radius: float) -> None:
    grown = grow(SECTIONS[name], radius, FACET_ERROR_MM)
    points = shapely.points(shapely.get_coordinates(shapely.segmentize(as_lines(grown), 0.2)))
    solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in SECTIONS[name].polygons])
    # Where a finger just fits, as into a slot of tr-2, it may be in the middle though nothing else is free.
    away = np.abs(shapely.distance(solid, points) - radius) if radius else solid.boundary.distance(points)
    assert float(away.max()) <= FACET_ERROR_MM + 1e-4
    assert float(grown.bulge.max()) <= FACET_ERROR_MM + 1e-9


@pytest.mark.parametrize("radius", [1.0, 4.9])
def test_true_normals_are_within_span(radius: float) -> None:
    for of in SECTIONS.values():
        grown = grow(of, radius, FACET_ERROR_MM)
        solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in of.polygons])
        points = shapely.get_coordinates(
            shapely.segmentize(solid.buffer(radius, quad_segs=512).boundary, 0.3)
        )
        nearest = shapely.get_coordinates(shapely.shortest_line(shapely.points(points), solid))[1::2]
        true = (points - nearest) / radius
        rel = points[:, None] - grown.start
        along = np.sum(rel * grown.direction, axis=2)
        across = rel[..., 0] * grown.direction[:, 1] - rel[..., 1] * grown.direction[:, 0]
        normal = np.column_stack([grown.direction[:, 1], -grown.direction[:, 0]])
        turned = np.arccos(np.clip(true @ normal.T, -1, 1))
        fits = (along >= -1e-4) & (along <= grown.length + 1e-4) & (across >= -1e-4)
        fits &= (across <= grown.bulge + 1e-4) & (turned <= grown.span + 5e-3)
        assert fits.any(axis=1).all()


def test_rings_close_bit_for_bit() -> None:
    for of in SECTIONS.values():
        grown = grow(of, 4.9, FACET_ERROR_MM)
        assert {tuple(p) for p in grown.start} == {tuple(p) for p in grown.end}


@pytest.mark.parametrize("clockwise", [False, True])
def test_features_are_named_as_in_the_file(clockwise: bool) -> None:
    corners = np.array(SQUARE[::-1] if clockwise else SQUARE, dtype=float)
    grown = grow(section(corners), 3.0, FACET_ERROR_MM)
    middle = (grown.start + grown.end) / 2
    for at, feature in zip(middle, grown.feature, strict=True):
        if feature >= 0:
            edge = shapely.LineString([corners[feature], corners[(feature + 1) % 4]])
            assert edge.distance(shapely.Point(at)) == pytest.approx(3.0, abs=1e-9)
        else:
            assert np.hypot(*(at - corners[-1 - feature])) == pytest.approx(3.0, abs=FACET_ERROR_MM)
    assert set(grown.feature.tolist()) == {0, 1, 2, 3, -1, -2, -3, -4}


def test_features_of_a_hole_follow_those_of_the_outer_ring() -> None:
    hole = [(20, 15), (42, 18), (38, 35), (18, 30)]
    grown = grow(section([(0, 0), (60, 0), (60, 50), (0, 50)], hole), 2.0, FACET_ERROR_MM)
    middle = (grown.start + grown.end) / 2
    inside = shapely.contains_xy(shapely.Polygon(hole), middle[:, 0], middle[:, 1])
    assert set(grown.feature[inside].tolist()) == {4, 5, 6, 7}


def test_a_hole_smaller_than_the_finger_closes() -> None:
    grown = grow(
        section([(0, 0), (60, 0), (60, 50), (0, 50)], [(28, 23), (32, 23), (32, 27), (28, 27)]), 5.0, 0.1
    )
    assert set(grown.feature[grown.feature >= 0].tolist()) == {0, 1, 2, 3}


def test_solid_lies_on_the_left() -> None:
    for of in SECTIONS.values():
        grown = grow(of, 0.0, FACET_ERROR_MM)
        solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in of.polygons])
        normal = np.column_stack([grown.direction[:, 1], -grown.direction[:, 0]])
        inner = (grown.start + grown.end) / 2 - 1e-5 * normal
        assert shapely.contains_xy(solid, inner[:, 0], inner[:, 1]).all()


def test_repeated_and_collinear_vertices_change_nothing() -> None:
    plain = grow(section(SQUARE), 3.0, FACET_ERROR_MM)
    outer = [(0, 0), (0, 0), (7, 0), (20, 0), (20, 20), (20, 20), (10, 20), (0, 20)]
    fussy = grow(section(outer), 3.0, FACET_ERROR_MM)
    assert as_lines(plain).hausdorff_distance(as_lines(fussy)) < 1e-7
    assert flat("x", SQUARE).tolerance_mm == 0.0
