"""Sections grown by a tip: Minkowski sums, offsets, bounds of normals, clearance."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.geometry.plane import wrap_angle
from palpate.config import load_objects
from palpate.recognizer import Catalogue, Finger
from palpate.recognizer.minkowski import grow
from palpate.recognizer.offset_curves import GrownSection
from palpate.recognizer.outline_deviations import in_centred_frame, places_on_outlines
from palpate.recognizer.proximity import ALLOWANCE_MM, TipCentres, nearest_places
from palpate.recognizer.tip_clearance import clearance_depths_mm, clearance_tilts_rad
from palpate.recognizer.tolerance_band import PairingEdges, ToleranceBand, pairing_edges
from palpate.recognizer.true_boundary import TrueBoundary
from support.campaign.sampling import sample
from support.commands.repository import SHARED_OUTLINES, needs_shared_outlines
from support.oracles.outlines import places_of_rest, uncovered
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, outlines

# ----------------------------------------------------------------------------------------------------
# Grown sections against shapely's buffer with fine arcs.

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


# ----------------------------------------------------------------------------------------------------
# Edges, and pieces of the true boundary, cover all of the boundary of a grown section, judged by shapely.

RADII_MM = (0.0, 0.05, 0.5, 2.0, 5.0, 8.0)
HEIGHT_MM = 10.0


def comb(seed: int) -> ObjectModel:
    """Teeth with notches, narrower and wider than tips, some of them pointed at the bottom."""
    rng = np.random.default_rng([21, seed])
    x, top = 0.0, []
    for _ in range(int(rng.integers(3, 8))):
        tooth, gap, depth = rng.uniform([2, 0.5, 3], [14, 18, 25])
        left, right = np.sort(rng.uniform(0, 1, 2)) * gap
        top += [
            (x, 30.0),
            (x + tooth, 30.0),
            (x + tooth + left, 30.0 - depth),
            (x + tooth + right, 30.0 - depth),
        ]
        x += tooth + gap
    return flat(f"comb {seed}", [(0.0, 0.0), (x + 5, 0.0), (x + 5, 30.0), (x, 30.0), *top[::-1]])


def star(seed: int) -> ObjectModel:
    rng = np.random.default_rng([22, seed])
    count = int(rng.integers(5, 60))
    angle, reach = np.sort(rng.uniform(0, 2 * np.pi, count)), rng.uniform(8, 35, count)
    return flat(f"star {seed}", np.column_stack([reach * np.cos(angle), reach * np.sin(angle)]).tolist())


def smooth(seed: int) -> ObjectModel:
    """A finely drawn curve, rough by as little as rounding or by 0.1 mm: bends that are hardly any."""
    rng = np.random.default_rng([23, seed])
    angle = np.linspace(0, 2 * np.pi, int(rng.integers(100, 400)), endpoint=False)
    rough = 10 ** rng.uniform(-6, -1) * rng.normal(size=len(angle))
    reach = 25 + 3 * np.sin(rng.integers(2, 9) * angle) + rough
    return flat(f"smooth {seed}", np.column_stack([reach * np.cos(angle), reach * np.sin(angle)]).tolist())


def pieces() -> ObjectModel:
    """A section of three polygons: two that overlap, one that touches, and a hole."""
    hole = np.array([[10.0, 8], [10, 22], [30, 22], [30, 8]])
    rings = (
        Polygon(np.array([[0.0, 0], [40, 0], [40, 30], [0, 30]]), (hole,)),
        Polygon(np.array([[35.0, 5], [70, 11], [66, 24], [35, 20]])),
        Polygon(np.array([[0.0, 30], [15, 30], [8, 48]])),
    )
    return ObjectModel("pieces", (State("flat", (Section((0.0, 20.0), rings),)),))


SLOT = flat("slot", [(0, 0), (60, 0), (60, 40), (38, 40), (38, 10), (22, 10), (22, 40), (0, 40)])
"""A tip of 8 mm just fits in."""


@cache
def drawn(count: int) -> list[ObjectModel]:
    made = [make(seed) for make in (comb, star, smooth) for seed in range(count)]
    return [item for item in made if shapely.Polygon(item.states[0].sections[0].polygons[0].outer).is_valid]


def unknown(boundary: TrueBoundary, row: int, centre: np.ndarray, normal: np.ndarray) -> int:
    """Of how many places (n,) the boundary that configurations are verified by knows nothing.

    Cells that cannot be verified are dropped, so that it may leave out none.
    """
    state, nothing = np.full(len(centre), row), np.zeros(len(centre))
    found = nearest_places(boundary, TipCentres(state, centre, normal, nothing, nothing))
    return int(np.count_nonzero(found.distance > ALLOWANCE_MM))


def lost(model: ObjectModel, each: int) -> dict[float, int]:
    """How many places at which a tip of each radius rests no edge covers, or no piece is at."""
    catalogue, found = Catalogue([model]), {}
    for radius in RADII_MM:
        edges = catalogue.edges(Finger(radius, HEIGHT_MM))
        for row, item in enumerate(catalogue.states):
            polygons = tuple(p for section in item.state.sections_at(HEIGHT_MM) for p in section.polygons)
            section = Section((HEIGHT_MM, HEIGHT_MM), polygons)
            centre, normal = places_of_rest(section, radius, each, np.random.default_rng(row))
            assert len(centre) > each
            seen = centre - item.origin_mm
            found[radius] = int(uncovered(edges, row, seen, normal).sum())
            found[radius] += unknown(catalogue.boundary(Finger(radius, HEIGHT_MM)), row, seen, normal)
    return found


@pytest.mark.parametrize("model", [*outlines(SHIPPED_OBJECTS), SLOT, pieces()], ids=lambda item: item.name)
def test_every_place_of_rest_is_on_an_edge(model: ObjectModel) -> None:
    assert not any(lost(model, 12).values())


@pytest.mark.parametrize("count", sample([60, 6], [6]))
def test_every_place_of_rest_on_drawn_outlines_is_on_an_edge(count: int) -> None:
    models = drawn(count)
    assert len(models) > count
    for model in models:
        assert not any(lost(model, 4).values()), model.name


@needs_shared_outlines
@pytest.mark.parametrize("each", sample([40, 3], [3]))
def test_every_place_of_rest_on_outlines_of_others_is_on_an_edge(each: int) -> None:
    models = load_objects(SHARED_OUTLINES).objects
    for model in models[:: 1 if each > 3 else 5]:
        assert not any(lost(model, each).values()), model.name


# ----------------------------------------------------------------------------------------------------
# Places on outlines against shapely: the nearest point, its arc length, and the outward normal.

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


# ----------------------------------------------------------------------------------------------------
# Outlines coarser than the parts: where fingers can rest on the part is covered by the model's edges.
#
# The part is a smooth curve drawn by many edges, the model a chain through a few of its vertices, with what
# was
# measured between the two as tolerances of places and normals.

TIP_RADII_MM = (0.02, 1.0, 5.0)
FINE = 1200


def curve(seed: int) -> np.ndarray:
    """A smooth closed curve (n, 2), dented by waves."""
    rng = np.random.default_rng([41, seed])
    angle = np.linspace(0, 2 * np.pi, FINE, endpoint=False)
    reach = np.full(FINE, rng.uniform(15, 30))
    for wave in range(2, 7):
        reach += rng.normal() * 4 / wave * np.cos(wave * angle + rng.uniform(0, 6))
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])


def coarse_model(fine: np.ndarray, every: int) -> ObjectModel:
    """A chain through some of the curve's vertices, with its tolerances as they are measured."""
    model = fine[::every]
    there = np.roll(model, -1, axis=0) - model
    turn = np.arctan2(there[:, 1], there[:, 0])
    leg = np.roll(fine, -1, axis=0) - fine
    off = np.arctan2(leg[:, 1], leg[:, 0]) - np.repeat(turn, every)
    lines = shapely.linestrings(np.stack([model, model + there], axis=1))
    away = shapely.distance(np.repeat(lines, every), shapely.points(fine))
    turns = np.abs((off + np.pi) % (2 * np.pi) - np.pi)
    coarse = flat("coarse", model.tolist())
    return replace(coarse, tolerance_mm=float(away.max()) + 1e-6, normal_bound_rad=float(turns.max()) + 1e-9)


@pytest.mark.parametrize("every", [5, 20])
@pytest.mark.parametrize("seed", sample(range(20), [0, 1]))
def test_normals_within_what_is_stated_are_covered(seed: int, every: int) -> None:
    fine = curve(seed)
    model = coarse_model(fine, every)
    assert model.normal_bound_rad is not None
    assert model.normal_bound_rad < 0.2
    catalogue = Catalogue([model])
    section = flat("fine", fine.tolist()).states[0].sections[0]
    for radius in TIP_RADII_MM:
        edges = catalogue.edges(Finger(radius, 10.0))
        centre, normal = places_of_rest(section, radius, 1, np.random.default_rng(seed))
        assert len(centre) > FINE
        assert not uncovered(edges, 0, centre - catalogue.states[0].origin_mm, normal).any()


def test_a_fine_outline_of_which_normals_are_known_has_no_more_edges_than_an_exact_one() -> None:
    fine = curve(3)
    exact = flat("exact", fine.tolist())
    stated = replace(exact, tolerance_mm=0.05, normal_bound_rad=0.03)
    counts = [len(Catalogue([item]).edges(Finger(5.0, 10.0)).state) for item in (exact, stated)]
    assert counts[0] < 300
    assert counts[1] < 2.5 * counts[0]
    spans = [float(np.max(Catalogue([item]).edges(Finger(5.0, 10.0)).span)) for item in (exact, stated)]
    assert spans[1] < spans[0] + 0.1


# ----------------------------------------------------------------------------------------------------
# Rough outlines within a tolerance: the band about the model holds every contact that they allow.
#
# The model's edges are too short to say anything of normals; shapely says which contacts there are.


def wavy(rng: np.random.Generator, step_mm: float) -> np.ndarray:
    count = int(2 * np.pi * 18 / step_mm)
    a = 2 * np.pi * np.arange(count) / count
    radius = 15 + rng.uniform(0, 3) * np.sin(3 * a + 1) + rng.uniform(0, 1) * np.cos(7 * a)
    return radius[:, None] * np.column_stack([np.cos(a), np.sin(a)])


def notched(rng: np.random.Generator, step_mm: float) -> np.ndarray:
    """A block with a notch, sides cut in short edges."""
    half = rng.uniform(1.0, 8.0)
    corners = [(-15, -8), (15, -8), (15, 10), (half, 10), (half - 0.5, 4), (-half, 4), (-half, 10), (-15, 10)]
    return cut(np.array(corners, dtype=float), step_mm)


def cut(ring: np.ndarray, step_mm: float) -> np.ndarray:
    return shapely.get_coordinates(shapely.segmentize(shapely.Polygon(ring), step_mm))[:-1]


def rough(ring: np.ndarray, off_mm: float, rng: np.random.Generator) -> np.ndarray:
    """The ring with points between its vertices, displaced by up to the tolerance to either side of it.

    Near sharp corners they stay, so that the ring does not cross itself.
    """
    points = cut(ring, off_mm / 2)
    across = np.roll(points, 1, axis=0) - np.roll(points, -1, axis=0)
    outward = np.column_stack([-across[:, 1], across[:, 0]]) / np.hypot(*across.T)[:, None]
    size = off_mm * rng.choice([-1.0, 1.0], len(points)) * rng.uniform(size=len(points)) ** 0.3
    leg = np.roll(points, -1, axis=0) - points
    bend = wrap_angle(np.diff(np.arctan2(*leg.T[::-1]), prepend=math.atan2(*leg[-1][::-1])))
    corners = points[np.abs(bend) > math.radians(30)]
    if len(corners):
        near = np.hypot(*(points[:, None] - corners).transpose(2, 0, 1)).min(axis=1)
        size = np.where(near < 2 * off_mm, 0.0, size)
    return points + size[:, None] * outward


def contacts(ring: np.ndarray, radius: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Centres of a tip (k, 2) that touches the ring without entering it, and its normals (k,) there."""
    leg = np.roll(ring, -1, axis=0) - ring
    face = np.arctan2(-leg[:, 0], leg[:, 1])
    bend = wrap_angle(face - np.roll(face, 1))
    at, share = np.repeat(np.arange(len(ring)), 4), rng.uniform(size=4 * len(ring))
    foot = np.concatenate([ring[at] + share[:, None] * leg[at], ring[at]])
    normal = np.concatenate([face[at], face[at] - share * np.maximum(bend[at], 0.0)])
    centre = foot + radius * np.column_stack([np.cos(normal), np.sin(normal)])
    solid = shapely.Polygon(ring)
    shapely.prepare(solid)
    points = shapely.points(centre)
    clear = (shapely.distance(points, solid.exterior) >= radius - 1e-9) & ~shapely.contains(solid, points)
    return centre[clear], normal[clear]


def is_held(band: PairingEdges, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Which contacts some edge of the band holds, with its slack and its range of normals."""
    edges = band.edges
    rel = centre[:, None] - edges.start
    along = np.sum(rel * edges.direction, axis=2)
    inward = edges.direction[:, 0] * rel[..., 1] - edges.direction[:, 1] * rel[..., 0]
    face = np.arctan2(-edges.direction[:, 0], edges.direction[:, 1])
    held = (along >= -band.along - 1e-6) & (along <= edges.length + band.along + 1e-6)
    held &= (inward <= band.inward + 1e-6) & (inward >= -band.outward - 1e-6)
    held &= np.abs(wrap_angle(normal[:, None] - face)) <= edges.span + 1e-9
    return held.any(axis=1)


@pytest.mark.parametrize("shape", [wavy, notched])
@given(
    seed=st.integers(0, 2**32 - 1),
    radius=st.sampled_from([0.3, 1.0, 3.0, 5.0]),
    off=st.sampled_from([0.1, 0.2, 0.5]),
    length=st.floats(0.5, 3.9),
)
@settings(max_examples=3, derandomize=True)
def test_band_holds_every_contact_of_rough_outlines(
    shape: object, seed: int, radius: float, off: float, length: float
) -> None:
    rng = np.random.default_rng(seed)
    ring = shape(rng, length * off)
    true = rough(ring, 0.999 * off, rng)
    assume(shapely.Polygon(true).is_valid)
    band = pairing_edges(Section((0.0, 10.0), (Polygon(ring, ()),)), radius, ToleranceBand(off), 0.1)
    centre, normal = contacts(true, radius, rng)
    assert len(centre) > 20
    assert is_held(band, centre, normal).all()


def test_a_flat_side_leaves_what_the_closed_form_says() -> None:
    side = shapely.box(-30, -20, 30, 0)
    start = np.column_stack([-np.arange(-5.0, 5.0, 0.1), np.zeros(100)])
    tilt = clearance_tilts_rad(side, start, start - np.array([0.1, 0.0]), 5.0, 0.1)
    exact = math.acos(1 - 2 * 0.1 / 5.0)
    assert np.all(tilt >= exact - 1e-9)
    assert np.all(tilt <= 1.1 * exact + math.radians(0.5))


def test_a_small_tip_may_have_any_normal() -> None:
    side = shapely.box(-30, -20, 30, 0)
    tilt = clearance_tilts_rad(side, np.array([[0.1, 0.0]]), np.array([[0.0, 0.0]]), 0.2, 0.1)
    assert tilt.tolist() == [math.pi]


def test_a_tip_on_a_flat_side_is_no_deeper_than_the_tolerance() -> None:
    side = shapely.box(-30, -20, 30, 0)
    start = np.column_stack([-np.arange(-5.0, 5.0, 0.5), np.full(20, 5.0)])
    some = np.ones(20)
    depth = clearance_depths_mm(side, start, start - np.array([0.5, 0.0]), 1.5 * some, 0.3 * some, 4.9)
    assert np.all(depth >= 0.1)
    assert np.all(depth <= 0.12)


def test_hardly_any_tolerance_or_clearance_takes_no_more_points() -> None:
    side = shapely.box(-30, -20, 30, 0)
    start, end = np.array([[1e-9, 0.0]]), np.array([[0.0, 0.0]])
    assert clearance_tilts_rad(side, start, end, 5.0, 1e-12)[0] > 0
    some = np.ones(1)
    assert clearance_depths_mm(side, start, end, some, 0.1 * some, 1e-9).tolist() == [0.1]
