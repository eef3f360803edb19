"""Stops over whole cells against touches simulated one configuration at a time."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely_bench import SHIPPED_OBJECTS, flat, outlines, stop

from palpate.base.geometry import ObjectModel
from palpate.recognizer.approach import Approach
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.constraints import free_path_test, sweep
from palpate.recognizer.contact import Contact, Finger
from palpate.recognizer.pose_region import Cells

MODELS = outlines(SHIPPED_OBJECTS)
CATALOGUE = Catalogue(MODELS)
ORIGIN = np.zeros(2)
SQUARE = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])


def cell(state: int, theta: float, width: float, centre: tuple[float, float], size: float) -> Cells:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size + centre
    one = np.zeros(1, dtype=np.int64)
    return Cells(one, one + state, np.array([theta]), np.array([theta + width]), corners[None])


def shape_at(model: ObjectModel, origin: np.ndarray, theta: float, position: np.ndarray) -> shapely.Geometry:
    """The outline of an object whose centroid is at R(θ)·position."""
    outline = shapely.Polygon(model.states[0].sections[0].polygons[0].outer)
    moved = affinity.translate(outline, *(position - origin))
    return affinity.rotate(moved, theta, origin=(0, 0), use_radians=True)


@settings(max_examples=60)
@given(
    st.integers(0, 5),
    st.floats(-4, 4),
    st.sampled_from([0.0, 0.002, 0.02, 0.1]),
    st.tuples(st.floats(-10, 10), st.floats(-10, 10)),
    st.sampled_from([0.0, 0.3, 2.0]),
    st.sampled_from([0.0, 1.0, 5.0]),
    st.sampled_from([0.0, 0.5]),
    st.floats(-math.pi, math.pi),
    st.floats(-25, 25),
    st.integers(0, 2**32 - 1),
)
def test_interval_encloses_simulated_stops(
    state: int,
    theta: float,
    width: float,
    centre: tuple[float, float],
    size: float,
    radius: float,
    bound: float,
    direction: float,
    offset: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    cells = cell(state, theta, width, centre, size)
    heading = np.array([math.cos(direction), math.sin(direction)])
    start = -150 * heading + offset * np.array([-heading[1], heading[0]])
    path = Approach(Finger(radius, 10.0), (float(start[0]), float(start[1])), direction, 300.0, bound)
    found = sweep(CATALOGUE, cells, ORIGIN, [path])
    for _ in range(6):
        t = theta + width * rng.choice([0.0, 1.0, rng.uniform()])
        s = np.array(centre) + size * rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], 2)
        angle = rng.uniform(0, 2 * math.pi)
        error = bound * np.array([math.cos(angle), math.sin(angle)])
        shape = shape_at(MODELS[state], CATALOGUE.states[state].origin_mm, t, s)
        travel = stop(shape, start + error, direction, radius, 300.0)
        assert travel >= found.earliest[0, 0] - 1e-6
        # A ray that just grazes may pass in the simulation; inside the enclosure it is allowed to miss.
        assert travel <= found.latest[0, 0] + 1e-6


def test_one_configuration_is_predicted_sharply() -> None:
    cells = cell(0, 0.0, 0.0, (0.0, 0.0), 0.0)
    path = Approach(Finger(0.0, 10.0), (-100.0, 3.0), 0.0, 200.0, 0.0)
    found = sweep(Catalogue([SQUARE]), cells, ORIGIN, [path])
    assert found.earliest[0, 0] == pytest.approx(80.0, abs=0.01)
    assert found.latest[0, 0] == pytest.approx(80.0, abs=0.01)


@pytest.mark.parametrize("turn", [k * math.pi / 4 for k in range(8)])
@pytest.mark.parametrize("offset", [-20.0, 0.0, 20.0, 28.284271247461902, -28.284271247461902])
def test_rays_through_corners_and_along_edges(turn: float, offset: float) -> None:
    """Behind the object the ray is outside again, whichever corners it went through."""
    catalogue = Catalogue([SQUARE])
    cells = cell(0, 0.0, 0.0, (0.0, 0.0), 0.0)
    heading = np.array([math.cos(turn), math.sin(turn)])
    start = 100 * heading + offset * np.array([-heading[1], heading[0]])
    path = Approach(Finger(0.0, 10.0), (float(start[0]), float(start[1])), turn, 200.0, 0.0)
    found = sweep(catalogue, cells, ORIGIN, [path])
    assert math.isinf(found.latest[0, 0])
    assert math.isinf(found.earliest[0, 0])


@pytest.mark.parametrize("model", range(6))
def test_rays_through_every_corner_never_end_inside(model: int) -> None:
    """A ray from beyond the object, pointing away through a vertex behind it, meets nothing."""
    catalogue = Catalogue(MODELS[model : model + 1])
    edges = catalogue.edges(Finger(5.0, 10.0))
    cells = cell(0, 0.0, 0.0, (0.0, 0.0), 0.0)
    for begin, end in zip(edges.start, edges.end, strict=True):
        for through, heading in (
            (begin, (end - begin) / np.linalg.norm(end - begin)),
            (begin, np.array([0.6, 0.8])),
        ):
            start = through + 400 * heading
            direction = math.atan2(heading[1], heading[0])
            path = Approach(Finger(5.0, 10.0), (float(start[0]), float(start[1])), direction, 100.0, 0.0)
            assert math.isinf(sweep(catalogue, cells, ORIGIN, [path]).latest[0, 0])


def test_blocked_only_if_blocked_everywhere() -> None:
    catalogue = Catalogue([SQUARE])
    through = Contact("f", Finger(5.0, 10.0), False, (-100.0, 0.0), (100.0, 0.0), 0.3)
    beside = Contact("f", Finger(5.0, 10.0), False, (-100.0, 26.0), (100.0, 26.0), 0.3)
    sharp = cell(0, 0.0, 0.0, (0.0, 0.0), 0.1)
    wide = cell(0, 0.0, 0.0, (0.0, 0.0), 30.0)
    assert not free_path_test(catalogue, sharp, ORIGIN, [through])[0]
    assert free_path_test(catalogue, wide, ORIGIN, [through])[0]
    assert free_path_test(catalogue, sharp, ORIGIN, [beside])[0]


@given(
    st.lists(
        st.tuples(st.integers(0, 5), st.floats(-20, 20), st.floats(0, 2 * math.pi)), min_size=1, max_size=5
    )
)
def test_by_normal_is_a_scan(queries: list[tuple[int, float, float]]) -> None:
    edges = CATALOGUE.edges(Finger(1.0, 10.0))
    state, lo, width = (np.array(column) for column in zip(*queries, strict=True))
    owner, edge = edges.by_normal(state.astype(np.int64), lo, width)
    found = set(zip(owner.tolist(), edge.tolist(), strict=True))
    assert len(found) == len(owner)
    for query in range(len(queries)):
        past = (edges.normal_rad - lo[query]) % (2 * math.pi)
        same = edges.state == state[query]
        certain = same & (past > 1e-9) & (past < width[query] - 1e-9)
        possible = same & ((past <= width[query] + 1e-9) | (past >= 2 * math.pi - 1e-9))
        got = {e for o, e in found if o == query}
        assert set(np.flatnonzero(certain).tolist()) <= got <= set(np.flatnonzero(possible).tolist())
