"""Pockets that no tip enters, and touches that graze."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.recognizer import Contact, NormalRange, recognise
from palpate.recognizer.angle_pockets import conservative_pockets
from palpate.recognizer.approach import Approach
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.hypotheses import Hypotheses
from palpate.recognizer.memo_statistics import memo_counts
from palpate.recognizer.prediction import predict
from support.oracles.outlines import exact_pockets, hold, widths_rad
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    exact_contact,
    first_contact,
    flat,
    holding_truth,
    outlines,
    place,
    stop,
    turned,
    unit,
)

# ----------------------------------------------------------------------------------------------------
# Angle pockets against rays cast with shapely, and against paths and outlines that are off.

POINT = Finger(0.0, 10.0)
TIP = Finger(5.0, 10.0)
MODELS = outlines(SHIPPED_OBJECTS)
U = [(-20, -20), (20, -20), (20, 20), (5, 20), (5, -5), (-5, -5), (-5, 20), (-20, 20)]
SPIRAL = [(0, 0), (60, 0), (60, 50), (10, 50), (10, 20), (40, 20), (40, 35), (35, 35), (35, 25), (15, 25)]
SPIRAL += [(15, 45), (55, 45), (55, 5), (0, 5)]


def edges_of(*polygons: Polygon, finger: Finger = POINT, tolerance: float = 0.0) -> EdgeSet:
    state = State("flat", (Section((0.0, 20.0), polygons),))
    return Catalogue([ObjectModel("part", (state,), tolerance)]).edges(finger)


def ring(points: object, *holes: object) -> Polygon:
    return Polygon(np.asarray(points, dtype=float), tuple(np.asarray(hole, dtype=float) for hole in holes))


def solid(edges: EdgeSet) -> shapely.Geometry:
    """The region inside of a single ring of edges, in whatever order they are."""
    legs = [shapely.LineString(ends) for ends in zip(edges.start, edges.end, strict=True)]
    return shapely.union_all(shapely.polygonize(legs))


def points_on(edges: EdgeSet, edge: int, fraction: np.ndarray) -> np.ndarray:
    return edges.start[edge] + fraction[:, None] * (edges.end[edge] - edges.start[edge])


def cast(shape: shapely.Geometry, points: np.ndarray, out: np.ndarray, travel: float = 500.0) -> np.ndarray:
    """Whether each point (m, 2) is free in each direction (d,) away from it, for some travel: (m, d)."""
    heading = np.column_stack([np.cos(out), np.sin(out)])
    ends = [points[:, None] + reach * heading for reach in (1e-5, travel)]
    rays = shapely.linestrings(np.stack(ends, axis=2).reshape(-1, 2, 2))
    return ~shapely.intersects(shape, rays).reshape(len(points), len(out))


def check_against_rays(edges: EdgeSet, shape: shapely.Geometry, rng: np.random.Generator) -> int:
    """No free direction is outside of a pocket, and exact pockets are exact; returns how many were free."""
    pockets = conservative_pockets(edges, 0.0)
    seen = 0
    for edge in range(int(edges.first[1])):
        points = points_on(edges, edge, np.append(rng.uniform(0, 1, 5), [1e-3, 1 - 1e-3]))
        out = edges.normal_rad[edge] + rng.uniform(-math.pi / 2, math.pi / 2, 40)
        free = cast(shape, points, out)
        assert np.all(hold(pockets, np.full(len(out), edge), out + math.pi) | ~free.any(axis=0))
        exact = exact_pockets(edges, np.full(len(points), edge), points, 0.0)
        row = np.repeat(np.arange(len(points)), len(out))
        held = hold(exact, row, np.tile(out + math.pi, len(points))).reshape(free.shape)
        assert np.all(held | ~free)
        # Rays that pass a corner within the rounding allowance may go either way.
        doubtful = held & ~free
        if doubtful.any():
            grazes = np.stack([cast(shape, points, out + turn) for turn in (-1e-3, 1e-3)])
            assert np.all(grazes.any(axis=0)[doubtful])
        seen += int(free.sum())
    return seen


@pytest.mark.parametrize("model", range(6))
def test_no_free_direction_is_left_out_of_the_shipped_objects(model: int) -> None:
    edges = Catalogue(MODELS[model : model + 1]).edges(POINT)
    assert check_against_rays(edges, solid(edges), np.random.default_rng(model)) > 500


def untangled(rng: np.random.Generator, count: int) -> np.ndarray:
    """A simple polygon through random points, made by undoing crossings."""
    points = rng.uniform(-30, 30, (count, 2))
    crossed = True
    while crossed:
        crossed = False
        for a in range(count - 1):
            for b in range(a + 2, count):
                one = shapely.LineString(points[[a, a + 1]])
                two = shapely.LineString(points[[b, (b + 1) % count]])
                if (b + 1) % count != a and one.intersects(two):
                    points[a + 1 : b + 1] = points[a + 1 : b + 1][::-1]
                    crossed = True
    return points


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(4, 13))
def test_no_free_direction_is_left_out_of_random_polygons(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points = untangled(rng, count)
    edges = edges_of(ring(points))
    check_against_rays(edges, solid(edges), rng)


@pytest.mark.parametrize(
    "polygons",
    [
        (ring(SPIRAL),),
        (ring(U), ring([(-3, 30), (3, 30), (3, 34), (-3, 34)])),
        (ring([(0, 0), (60, 0), (60, 40), (0, 40)], [(10, 10), (50, 10), (50, 30), (10, 30)]),),
        (
            ring([(0, 0), (60, 0), (60, 40), (0, 40)], [(10, 10), (50, 10), (50, 30), (10, 30)]),
            ring([(25, 15), (35, 15), (35, 25), (25, 25)]),
        ),
    ],
    ids=["spiral", "two parts", "hole", "island in a hole"],
)
def test_no_free_direction_is_left_out_of_sections_with_several_rings(polygons: tuple[Polygon, ...]) -> None:
    edges = edges_of(*polygons)
    shape = shapely.union_all([shapely.Polygon(part.outer, part.holes) for part in polygons])
    centred = shapely.affinity.translate(shape, -shape.centroid.x, -shape.centroid.y)
    assert check_against_rays(edges, centred, np.random.default_rng(1)) > 100


def test_convex_outlines_have_half_turns() -> None:
    angle = 2 * math.pi * np.arange(9) / 9
    edges = edges_of(ring(30 * np.column_stack([np.cos(angle), np.sin(angle)])))
    for pockets in (
        conservative_pockets(edges, 0.4),
        exact_pockets(edges, np.arange(9), (edges.start + edges.end) / 2, 0.4),
    ):
        assert np.diff(pockets.first).tolist() == [1] * 9
        assert pockets.hi_rad - pockets.lo_rad == pytest.approx(np.full(9, math.pi), abs=1e-8)
        middle = (pockets.hi_rad + pockets.lo_rad) / 2 - edges.normal_rad
        assert middle % (2 * math.pi) == pytest.approx(np.full(9, math.pi))


def test_the_bottom_of_a_slot() -> None:
    """Ten wide and 25 deep: the extreme directions are the slot's diagonals, steeper ones from its middle."""
    edges = edges_of(ring(U))
    bottom = np.flatnonzero((edges.feature == 4) & (edges.length > 9))
    whole = conservative_pockets(edges, 0.0)
    assert widths_rad(whole)[bottom] == pytest.approx(2 * math.atan2(10, 25), abs=1e-5)
    middle = exact_pockets(edges, bottom, (edges.start + edges.end)[bottom] / 2, 0.0)
    assert widths_rad(middle) == pytest.approx(2 * math.atan2(5, 25), abs=1e-5)
    assert hold(middle, np.zeros(1, np.int64), np.array([-math.pi / 2]))[0]
    loose = exact_pockets(edges, bottom, (edges.start + edges.end)[bottom] / 2, 0.5)
    corner = math.hypot(5, 25)
    assert widths_rad(loose) == pytest.approx(2 * (math.atan2(5, 25) + math.asin(1 / corner)), abs=1e-5)


def test_another_part_in_the_way_divides_the_pocket() -> None:
    edges = edges_of(
        ring([(-20, -20), (20, -20), (20, 0), (-20, 0)]), ring([(-3, 20), (3, 20), (3, 24), (-3, 24)])
    )
    top = np.flatnonzero(edges.feature == 2)
    pockets = exact_pockets(edges, top, (edges.start + edges.end)[top] / 2, 0.0)
    assert np.diff(pockets.first).tolist() == [2]
    gap = 2 * math.atan2(3, 20)
    assert widths_rad(pockets) == pytest.approx(math.pi - gap, abs=1e-5)
    # From somewhere on the edge every direction is free.
    assert widths_rad(conservative_pockets(edges, 0.0))[top] == pytest.approx(math.pi, abs=1e-5)


def test_a_wide_part_close_above_divides_even_the_conservative_pocket() -> None:
    edges = edges_of(
        ring([(-20, -20), (20, -20), (20, 0), (-20, 0)]), ring([(-60, 5), (60, 5), (60, 9), (-60, 9)])
    )
    pockets = conservative_pockets(edges, 0.0)
    top = int(np.flatnonzero(edges.feature == 2)[0])
    assert np.diff(pockets.first)[top] == 2
    assert widths_rad(pockets)[top] == pytest.approx(2 * math.atan2(5, 40), abs=1e-5)


@pytest.mark.parametrize("travel", [5.0, 12.0, 20.0, 26.0, 40.0])
def test_only_what_the_path_went_by_is_in_the_way(travel: float) -> None:
    """A finger that began inside of a slot or a spiral: rays of the travel's length decide."""
    rng = np.random.default_rng(int(travel))
    for points in (U, SPIRAL):
        edges = edges_of(ring(points))
        pockets = conservative_pockets(edges, 0.0, travel)
        fewest = conservative_pockets(edges, 0.0)
        for edge in range(len(edges.state)):
            at = points_on(edges, edge, rng.uniform(0, 1, 8))
            out = edges.normal_rad[edge] + rng.uniform(-math.pi / 2, math.pi / 2, 60)
            free = cast(solid(edges), at, out, travel)
            every = np.full(len(out), edge)
            held = hold(pockets, every, out + math.pi)
            assert np.all(held | ~free.any(axis=0))
            assert np.all(held | ~hold(fewest, every, out + math.pi))
            exact = exact_pockets(edges, np.full(8, edge), at, 0.0, travel)
            row = np.repeat(np.arange(8), len(out))
            assert np.all(hold(exact, row, np.tile(out + math.pi, 8)) | ~free.ravel())


def test_a_short_travel_from_within_a_slot_says_less() -> None:
    edges = edges_of(ring(U))
    bottom = int(np.flatnonzero((edges.feature == 4) & (edges.length > 9))[0])
    widths = [
        widths_rad(conservative_pockets(edges, 0.0, travel))[bottom] for travel in (5.0, 60.0, math.inf)
    ]
    assert widths[0] == pytest.approx(math.pi, abs=1e-6)
    assert widths[1] == pytest.approx(widths[2])
    assert widths[2] < 1.0


def test_edges_of_holes_cannot_be_reached() -> None:
    outer, hole = [(0, 0), (60, 0), (60, 40), (0, 40)], [(10, 10), (50, 10), (50, 30), (10, 30)]
    island = ring([(25, 15), (35, 15), (35, 25), (25, 25)])
    edges = edges_of(ring(outer, hole), island)
    width = widths_rad(conservative_pockets(edges, 0.5))
    assert width[edges.feature < 4] == pytest.approx(np.full(4, math.pi), abs=1e-6)
    assert width[edges.feature >= 4] == pytest.approx(np.zeros(8), abs=1e-12)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.3, 1.0]), st.sampled_from([0.0, 0.1, 0.5]))
def test_paths_and_outlines_that_are_off_by_their_bounds(seed: int, bound: float, tolerance: float) -> None:
    """A path that is free of the true outline is in the pocket that the model and the stated path give."""
    rng = np.random.default_rng(seed)
    shape = [np.array(U, float), np.array(SPIRAL, float), MODELS[1].states[0].sections[0].polygons[0].outer]
    modelled = shape[rng.integers(3)]
    edges = edges_of(ring(modelled), tolerance=tolerance)
    shift = edges.start[np.argmin(edges.feature)] - modelled[0]
    angle = rng.uniform(0, 2 * math.pi, len(modelled))
    jitter = tolerance * np.column_stack([np.cos(angle), np.sin(angle)])
    true_start = modelled + shift + jitter
    true_end = np.roll(true_start, -1, axis=0)
    truth = shapely.Polygon(true_start)
    if not truth.is_valid:
        return
    pockets = conservative_pockets(edges, bound)
    row_of = {int(feature): row for row, feature in enumerate(edges.feature)}
    for feature in rng.integers(0, len(modelled), 12):
        row = row_of[int(feature)]
        rest = true_start[feature] + rng.uniform() * (true_end[feature] - true_start[feature])
        out = edges.normal_rad[row] + rng.uniform(-1.5, 1.5, 30)
        for direction in out[cast(truth, rest[None], out)[0]]:
            far = rest + 300 * np.array([math.cos(direction), math.sin(direction)])
            errors = rng.uniform(0, 2 * math.pi, 2)
            stated_end, stated_far = (
                point + bound * np.array([math.cos(error), math.sin(error)])
                for point, error in zip((rest, far), errors, strict=True)
            )
            stated = math.atan2(*(stated_far - stated_end)[::-1])
            past = abs((stated - edges.normal_rad[row] + math.pi) % (2 * math.pi) - math.pi)
            if past > math.pi / 2:
                continue
            one, travel = np.array([row]), np.array([stated + math.pi])
            assert hold(pockets, one, travel)[0]
            exact = exact_pockets(edges, one, stated_end[None], bound)
            assert hold(exact, np.zeros(1, np.int64), travel)[0]


@pytest.mark.parametrize("model", range(6))
def test_tips_that_touch_are_in_the_pocket_of_an_edge_where_they_rest(model: int) -> None:
    """Grown by 5 mm: shapely moves the disc, so the arcs are the true ones and not their chords."""
    rng = np.random.default_rng(model)
    edges = Catalogue(MODELS[model : model + 1]).edges(TIP)
    outline = MODELS[model].states[0].sections[0].polygons[0].outer
    shape = shapely.Polygon(outline)
    centroid = np.array([shape.centroid.x, shape.centroid.y])
    pockets = conservative_pockets(edges, 0.0)
    touched = 0
    for _ in range(60):
        direction = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(direction), math.sin(direction)])
        start = centroid - 150 * heading + rng.uniform(-35, 35) * np.array([-heading[1], heading[0]])
        travel = stop(shape, start, direction, 5.0, 300.0)
        if not math.isfinite(travel):
            continue
        rest = start + travel * heading - centroid
        away = shapely.distance(
            shapely.linestrings(np.stack([edges.start, edges.end], axis=1)), shapely.Point(rest)
        )
        row = np.flatnonzero(away <= edges.slack_out + 1e-6)
        assert np.any(hold(pockets, row, np.full(len(row), direction)))
        exact = exact_pockets(edges, row, np.broadcast_to(rest, (len(row), 2)), 0.0)
        assert np.any(hold(exact, np.arange(len(row)), np.full(len(row), direction)))
        touched += 1
    assert touched > 30


@pytest.mark.parametrize("finger", [POINT, TIP])
def test_more_allowance_never_takes_a_direction_away(finger: Finger) -> None:
    rng = np.random.default_rng(3)
    edges = Catalogue(MODELS).edges(finger)
    row = rng.integers(0, len(edges.state), 4000)
    direction = edges.normal_rad[row] + math.pi + rng.uniform(-1.6, 1.6, len(row))
    held = [
        hold(conservative_pockets(edges, allowance), row, direction) for allowance in (0.0, 0.2, 0.6, 2.0)
    ]
    for tight, loose in pairwise(held):
        assert np.all(loose | ~tight)
    assert held[-1].sum() > held[0].sum()


def test_conservative_pockets_hold_the_exact_ones() -> None:
    rng = np.random.default_rng(4)
    edges = Catalogue(MODELS).edges(TIP)
    row = np.repeat(np.arange(len(edges.state)), 3)
    points = edges.start[row] + rng.uniform(0, 1, (len(row), 1)) * (edges.end - edges.start)[row]
    exact = exact_pockets(edges, row, points, 0.3)
    whole = conservative_pockets(edges, 0.3)
    ends = np.concatenate([exact.lo_rad + 1e-7, exact.hi_rad - 1e-7])
    wide = np.tile(exact.hi_rad - exact.lo_rad > 1e-6, 2)
    assert np.all(hold(whole, np.tile(row[exact.row], 2)[wide], ends[wide]))


def test_a_state_of_many_edges_is_done_in_parts() -> None:
    """A thousand teeth: every flank sees out between its neighbours, as one in a single part does."""
    angle = 2 * math.pi * np.arange(1000) / 1000
    radius = np.where(np.arange(1000) % 2, 80.0, 79.0)
    edges = edges_of(ring(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])))
    pockets = conservative_pockets(edges, 0.0)
    assert len(pockets) == 1000
    some = np.arange(0, 1000, 97)
    alone = exact_pockets(edges, some, (edges.start + edges.end)[some] / 2, 0.0)
    assert np.all(widths_rad(pockets)[some] >= widths_rad(alone) - 1e-9)
    assert np.all((widths_rad(alone) > 1.0) & (widths_rad(pockets)[some] < 3.1))


def test_outlines_that_meet_in_a_point_have_half_turns() -> None:
    edges = edges_of(
        ring([(0, 0), (30, 0), (30, 30), (0, 30)]), ring([(30, 30), (50, 30), (50, 50), (30, 50)])
    )
    assert widths_rad(conservative_pockets(edges, 0.1)) == pytest.approx(np.full(8, math.pi), abs=1e-8)


def test_edges_that_do_not_meet_have_half_turns() -> None:
    edges = edges_of(ring(U))
    apart = dataclasses.replace(edges, start=edges.start + 1e-13 * np.arange(16).reshape(8, 2))
    assert widths_rad(conservative_pockets(apart, 0.1)) == pytest.approx(np.full(8, math.pi), abs=1e-8)


def test_a_state_below_the_finger_has_no_pockets() -> None:
    low = flat("low", [(0, 0), (9, 0), (9, 9), (0, 9)], height_mm=5.0)
    edges = Catalogue([low, MODELS[0], low]).edges(POINT)
    assert len(conservative_pockets(edges, 0.0)) == len(edges.state) == 22


# ----------------------------------------------------------------------------------------------------
# Touches at the limits of what an approach says of the normal: paths along an edge, points on a vertex.

KITE = flat("kite", [(-38, -9), (21, -31), (44, 6), (-5, 27)])
CATALOGUE = Catalogue([KITE])


def corners(placed: Placed) -> Floats:
    return np.array([placed.on_table(point) for point in KITE.states[0].sections[0].polygons[0].outer])


def normal_of(placed: Placed, edge: int) -> float:
    """Direction of the outward normal of an edge, counted from its first vertex."""
    points = corners(placed)
    along = points[(edge + 1) % len(points)] - points[edge]
    return math.atan2(-along[0], along[1])


def middles_touched(placed: Placed, radius: float) -> list[Contact]:
    """Two more touches, without errors, square onto the middles of the first and the third edge."""
    found = []
    points = corners(placed)
    for edge in (0, 2):
        normal = normal_of(placed, edge)
        end = (points[edge] + points[edge + 1 - 4]) / 2 + radius * unit(normal)
        start = end + 70.0 * unit(normal)
        found.append(exact_contact(f"middle {edge}", radius, start, end, normal, 0.02))
    return found


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("measured", [True, False])
def test_a_path_along_an_edge_that_is_off_by_more_than_its_end(seed: int, measured: bool) -> None:
    """The start is off by the path's bound, so that the path as stated leads away from the edge it met."""
    rng = np.random.default_rng(seed)
    placed, radius, off = place(KITE, rng), 4.0, float(rng.uniform(1.0, 3.0))
    edge, side = int(rng.integers(4)), float(rng.choice([-1.0, 1.0]))
    normal = normal_of(placed, edge)
    along = turned(unit(normal), side * math.pi / 2)
    heading = along * math.cos(0.004) - unit(normal) * math.sin(0.004)
    points = corners(placed)
    foot = (points[edge] + points[(edge + 1) % 4]) / 2 + radius * unit(normal)
    start = foot - 90.0 * heading
    travel = first_contact(placed.shape, start, heading, radius, 200.0)
    end = start + travel * heading
    stated = start - off * unit(normal)
    contact = Contact(
        "grazing",
        Finger(radius, 10.0),
        True,
        (float(stated[0]), float(stated[1])),
        (float(end[0]), float(end[1])),
        0.0,
        NormalRange(normal - 0.001, normal + 0.001) if measured else None,
        path_bound_mm=off,
    )
    assert travel < 100.0
    found = recognise(CATALOGUE, [contact, *middles_touched(placed, radius)])
    assert holding_truth(found, placed) is not None


def on_a_vertex(placed: Placed, vertex: int) -> tuple[Contact, float]:
    """A point that comes square to the edge after a vertex, with the normal of the edge before it; how far
    that faces away from where the point came.
    """
    near, far = normal_of(placed, vertex), normal_of(placed, (vertex - 1) % 4)
    end = corners(placed)[vertex]
    heading = turned(unit(near + math.pi), 0.5)
    away = math.acos(np.clip(np.dot(unit(far), -heading), -1.0, 1.0)) - math.pi / 2
    return exact_contact(f"vertex {vertex}", 0.0, end - 80.0 * heading, end, far, 0.03), away


@pytest.mark.parametrize("vertex", range(4))
@pytest.mark.parametrize("seed", range(3))
def test_a_point_on_a_vertex_has_the_normal_of_either_edge(vertex: int, seed: int) -> None:
    placed = place(KITE, np.random.default_rng(seed))
    contact, away = on_a_vertex(placed, vertex)
    assert away > 0.03
    contacts = [contact, *middles_touched(placed, 0.0)]
    for first in range(3):
        ordered = contacts[first:] + contacts[:first]
        assert holding_truth(recognise(CATALOGUE, ordered), placed) is not None
    late = recognise(CATALOGUE, contacts[1:]).extend(contacts[:1])
    assert holding_truth(late, placed) is not None
    assert memo_counts(CATALOGUE, contacts).model >= 1


def test_what_is_predicted_of_a_point_holds_the_normals_of_both_edges() -> None:
    placed = place(KITE, np.random.default_rng(5))
    contact, _ = on_a_vertex(placed, 1)
    known = recognise(CATALOGUE, [contact, *middles_touched(placed, 0.0)])
    path = Approach(contact.finger, contact.start_mm, contact.direction_rad, 200.0, 0.0)
    assert isinstance(known.hypotheses, Hypotheses)
    item = predict(CATALOGUE, known.hypotheses, known.anchor_mm, [path]).of(0, 0)
    assert item.normal_rad is not None
    lo, hi = item.normal_rad
    for edge in (0, 1):
        assert (normal_of(placed, edge) - lo) % (2 * math.pi) <= hi - lo + 1e-9
