"""Regions of poses: cells, groups, boxes, witnesses, tight bounds."""

import math
from decimal import Context, Decimal

import numpy as np
import pytest
import shapely

from palpate.base.geometry.plane import point_segment_distance, rotate
from palpate.recognizer import Finger, Hypothesis, Recognition, numpy_steps, recognise
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.connected_components import Boxes, component_labels, group_by_links
from palpate.recognizer.contact import Contact
from palpate.recognizer.interpretation_tree import first_level, second_level, split_into_runs, third_level
from palpate.recognizer.interpretations import Interpretations, Query
from palpate.recognizer.numpy_witnesses import corner_means, probe_cells
from palpate.recognizer.pose_region import Cells, Intervals, divide_orientations
from palpate.recognizer.steps import Steps
from palpate.recognizer.tables import round_to_nine_digits
from palpate.recognizer.verification import Poses, verify
from palpate.recognizer.witness_search import enclosures
from support.campaign.sampling import sample
from support.oracles.judge import Scene, asked, drawn
from support.oracles.kernel import both_sides, drawn_catalogue
from support.oracles.shapely_touches import SHIPPED_OBJECTS, grip, holding_truth, outlines, place

# ----------------------------------------------------------------------------------------------------
# Cells hold every feasible configuration; witnesses are feasible.

MODELS = outlines(SHIPPED_OBJECTS)


def interpreted(catalogue: Catalogue, contacts: list[Contact]) -> tuple[Query, Interpretations]:
    """Pairings of one to three contacts."""
    query = Query(catalogue, contacts, np.mean([c.end_mm for c in contacts], axis=0))
    if len(contacts) == 1:
        return query, first_level(catalogue, contacts[0])[0]
    nodes, _ = second_level(query.select(range(2)), first_level(catalogue, contacts[0])[0])
    return query, third_level(query, nodes)[0] if len(contacts) == 3 else nodes


def contains(cells: Cells, row: int, theta: float, position: np.ndarray) -> bool:
    if not cells.lo[row] - 1e-12 <= theta <= cells.hi[row] + 1e-12:
        return False
    corners = cells.polygon[row]
    leg = np.roll(corners, -1, axis=0) - corners
    rel = position - corners
    return bool(
        np.all(leg[:, 0] * rel[:, 1] - leg[:, 1] * rel[:, 0] >= -1e-7 * (1 + np.abs(leg).sum(axis=1)))
    )


def test_runs_reach_as_far_as_their_widest_cell() -> None:
    """Refined cells may lie within others; a run that ended with one of these has lost the truth."""
    spans = [(0.0, 1.0), (0.2, 0.4), (0.9, 1.2), (1.0, 1.1), (1.5, 2.0), (1.6, 1.7), (0.1, 0.3), (0.1, 0.2)]
    lo, hi = np.array(spans).T
    node = np.array([0, 0, 0, 0, 0, 0, 1, 1])
    cells = Cells(node, np.zeros(8, np.int64), lo, hi, np.zeros((8, 1, 2)))
    nodes = Interpretations(np.zeros(2, np.int64), np.array([[3], [5]]), np.full(2, -1.0), np.full(2, 3.0))
    runs, renumbered = split_into_runs(nodes, cells)
    assert list(zip(runs.lo.tolist(), runs.hi.tolist(), strict=True)) == [(0.0, 1.2), (1.5, 2.0), (0.1, 0.3)]
    assert runs.edges.ravel().tolist() == [3, 3, 5]
    assert renumbered.node.tolist() == [0, 0, 0, 0, 1, 1, 2, 2]


def feasible(
    catalogue: Catalogue,
    nodes: Interpretations,
    node: int,
    contacts: list[Contact],
    anchor: np.ndarray,
    theta: np.ndarray,
    position: np.ndarray,
) -> np.ndarray:
    """Which configurations put every contact's centre within its bound of its edge (a disc, not a square)."""
    ok = np.ones(len(theta), dtype=bool)
    cos, sin = np.cos(theta), np.sin(theta)
    for level, contact in enumerate(contacts):
        edges = catalogue.edges(contact.finger)
        edge = int(nodes.edges[node, level])
        x, y = np.asarray(contact.end_mm) - anchor
        local = np.column_stack([cos * x + sin * y, cos * y - sin * x]) - position
        away = point_segment_distance(local, edges.start[edge], edges.direction[edge], edges.length[edge])
        ok &= away <= contact.position_bound_mm
    return ok


@pytest.mark.parametrize("lever_mm", [1.0, 1e4])
def test_the_parts_of_a_cell_hold_all_of_it_and_no_more(lever_mm: float) -> None:
    polygon = np.array(
        [[[0.0, 0.0], [9.0, 1.0], [8.0, 3.0], [1.0, 2.0]], [[0.0, 0.0], [0.2, 0.0], [0.1, 7.0], [0.0, 0.0]]]
    )
    cells = Cells(np.array([3, 4]), np.array([0, 1]), np.array([0.1, 1.0]), np.array([0.2, 1.4]), polygon)
    parts, owner = numpy_steps.divide_cells(cells, lever_mm, 4)
    assert np.bincount(owner).tolist() == [4, 4]
    assert np.array_equal(parts.node, cells.node[owner])
    assert np.bincount(owner, parts.volume) == pytest.approx(cells.volume)
    by_orientation = np.all(parts.polygon.reshape(8, -1)[0] == parts.polygon.reshape(8, -1), axis=1)[:4].all()
    assert by_orientation == (lever_mm > 1.0)
    rng = np.random.default_rng(0)
    for row in range(2):
        share = rng.dirichlet(np.ones(4), 200)
        for theta, position in zip(
            rng.uniform(cells.lo[row], cells.hi[row], 200), share @ polygon[row], strict=True
        ):
            assert (
                sum(contains(parts, int(part), theta, position) for part in np.flatnonzero(owner == row)) >= 1
            )


@pytest.mark.parametrize("steps", both_sides())
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("fingers", [2, 3])
def test_cells_hold_every_sampled_feasible_configuration(steps: Steps, seed: int, fingers: int) -> None:
    rng = np.random.default_rng(seed)
    catalogue = Catalogue(MODELS[seed % 6 : seed % 6 + 1])
    contacts: list[Contact] = []
    while len(contacts) < fingers:
        placed = place(MODELS[seed % 6], rng)
        contacts = [c for c in grip(placed, rng, fingers=fingers, bound=1.0, half_range=0.4) if c.touched]
    query, nodes = interpreted(catalogue, contacts)
    anchor = query.anchor_mm
    cells, _ = steps.cut_cells(query, nodes, divide_orientations(nodes, step_rad=0.015, least=3))
    parts, _ = steps.refine_intervals(query, nodes, cells, np.full(len(cells), 3))
    finer, _ = steps.cut_cells(query, nodes, parts)
    hits = 0
    for node in rng.permutation(len(nodes))[:12]:
        rows = np.flatnonzero(cells.node == node)
        theta = rng.uniform(nodes.lo[node], nodes.hi[node], 4000)
        # Sample positions about those that put the first contact on its edge.
        edges = catalogue.edges(contacts[0].finger)
        edge = int(nodes.edges[node, 0])
        on = edges.start[edge] + rng.uniform(0, edges.length[edge], 4000)[:, None] * edges.direction[edge]
        x, y = np.asarray(contacts[0].end_mm) - anchor
        cos, sin = np.cos(theta), np.sin(theta)
        position = np.column_stack([cos * x + sin * y, cos * y - sin * x]) - on
        position += rng.uniform(-1, 1, (4000, 2))
        ok = feasible(catalogue, nodes, int(node), contacts, anchor, theta, position)
        for t, s in list(zip(theta[ok], position[ok], strict=True))[:60]:
            hits += 1
            assert any(contains(cells, int(row), t, s) for row in rows)
            assert any(contains(finer, int(row), t, s) for row in np.flatnonzero(finer.node == node))
    assert hits > 20


def test_sections_of_the_middle_are_feasible() -> None:
    rng = np.random.default_rng(3)
    catalogue = Catalogue(MODELS)
    placed = place(MODELS[4], rng)
    contacts = grip(placed, rng, bound=0.5)
    query, nodes = interpreted(catalogue, contacts)
    anchor = query.anchor_mm
    theta = (nodes.lo + nodes.hi) / 2
    found = probe_cells(query, nodes, Intervals(np.arange(len(nodes)), nodes.lo, nodes.hi))
    assert len(found.tried)
    places = [
        (found.cells.node[row], s)
        for row, polygon in zip(found.tried, found.section, strict=True)
        for s in polygon
    ]
    for node, position in places:
        for level, contact in enumerate(contacts):
            edges = catalogue.edges(contact.finger)
            edge = int(nodes.edges[node, level])
            cos, sin = math.cos(theta[node]), math.sin(theta[node])
            x, y = np.asarray(contact.end_mm) - anchor
            local = np.array([cos * x + sin * y, cos * y - sin * x]) - position
            rel = local - edges.start[edge]
            along, across = rel @ edges.direction[edge], rel @ edges.normal[edge]
            bound = contact.position_bound_mm + 1e-5
            assert -bound <= along <= edges.length[edge] + bound
            assert -bound <= across <= edges.slack_out[edge] + bound


@pytest.mark.parametrize("most", [1, 40, 300])
def test_coarse_cells_cover_those_of_their_region(most: int) -> None:
    catalogue, rng = Catalogue(MODELS), np.random.default_rng(3)
    contacts = grip(place(MODELS[1], rng), rng, fingers=2, half_range=0.6)
    regions = recognise(catalogue, contacts).hypotheses.regions
    assert len(regions.cells) > most
    coarse, first = regions.coarse_cells(most)
    assert len(coarse) <= most + len(regions)
    assert (np.diff(first) > 0).all()
    for k in range(len(regions)):
        own, covers = slice(*regions.first[k : k + 2]), slice(*first[k : k + 2])
        cells, boxes = regions.cells.select(own), coarse.select(covers)
        assert (boxes.state == cells.state[0]).all()
        low, high = boxes.polygon.min(axis=1), boxes.polygon.max(axis=1)
        held = (boxes.lo <= cells.lo[:, None]) & (cells.hi[:, None] <= boxes.hi)
        held &= (low <= cells.polygon.min(axis=1)[:, None]).all(axis=2)
        held &= (cells.polygon.max(axis=1)[:, None] <= high).all(axis=2)
        assert held.any(axis=1).all()
    assert regions.coarse_cells(len(regions.cells))[0] is regions.cells


def test_volume_and_radius_of_a_square_cell() -> None:
    square = np.array([[[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]], dtype=float)
    one = np.zeros(1, dtype=np.int64)
    cells = Cells(one, one, np.array([0.1]), np.array([0.4]), square)
    assert cells.volume[0] == pytest.approx(4 * 0.3)
    assert cells.radius[0] == pytest.approx(math.sqrt(2))
    assert cells.centre[0] == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("seed", range(5))
def test_which_diagonal_of_a_rectangle_is_cut_does_not_depend_on_rounding(seed: int) -> None:
    """Both are equally long; in turned rectangles one of them is longer by the last bit."""
    rng = np.random.default_rng(seed)
    angle, size, count = rng.uniform(0, 2 * np.pi, 50), rng.uniform(0.5, 2, (50, 2)), np.zeros(50, np.int64)
    corner = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size[:, None]
    rectangle = rotate(corner, angle[:, None]) + rng.normal(0, 30, (50, 1, 2))
    cells, close = (
        Cells(count, count, np.zeros(50), np.full(50, 1e-4), polygon)
        for polygon in (rectangle, rectangle + rng.normal(0, 1e-13, rectangle.shape))
    )
    (one, owner), (other, of_other) = (
        numpy_steps.divide_cells(cells, 40.0, 4),
        numpy_steps.divide_cells(close, 40.0, 4),
    )
    assert np.array_equal(owner, of_other)
    np.testing.assert_allclose(one.centre, other.centre, rtol=0, atol=1e-9)


# ----------------------------------------------------------------------------------------------------
# Connected regions against every pair of boxes tried, one after the other.

FEW = 160  # up to here boxes are compared each with each


def boxes_of(
    rng: np.random.Generator, count: int, *, states: int, width: float, size: float, spread: float
) -> Boxes:
    """Boxes anywhere: θ over several turns, states of different symmetry."""
    state = rng.integers(0, states, count)
    turn = 2 * np.pi / np.array([1, 2, 4, 12, 3])[state % 5]
    lo = rng.uniform(0, spread, (count, 2))
    return Boxes(
        state=state,
        middle=rng.uniform(-3 * math.pi, 3 * math.pi, count),
        half_width=width * rng.uniform(0.1, 1.0, count),
        turn=turn,
        lo=lo,
        hi=lo + size * rng.uniform(0.1, 1.0, (count, 2)),
    )


def meet(boxes: Boxes, i: int, j: int) -> bool:
    """Whether two boxes have a configuration in common, some whole number of turns apart."""
    if boxes.state[i] != boxes.state[j]:
        return False
    if np.any(boxes.lo[i] > boxes.hi[j]) or np.any(boxes.lo[j] > boxes.hi[i]):
        return False
    nearest = abs(math.remainder(boxes.middle[i] - boxes.middle[j], boxes.turn[i]))
    return bool(nearest <= boxes.half_width[i] + boxes.half_width[j])


def by_pairs(boxes: Boxes) -> list[frozenset[int]]:
    """Components by joining every two boxes that meet."""
    parent = list(range(len(boxes.state)))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    count = len(parent)
    for i in range(count):
        for j in range(i):
            if root(i) != root(j) and meet(boxes, i, j):
                parent[root(i)] = root(j)
    return as_sets(np.array([root(i) for i in range(count)], dtype=np.int64))


def as_sets(label: np.ndarray) -> list[frozenset[int]]:
    groups = [frozenset(np.flatnonzero(label == value).tolist()) for value in np.unique(label)]
    return sorted(groups, key=min)


def check(boxes: Boxes) -> int:
    label = component_labels(boxes, group_by_links)
    assert as_sets(label) == by_pairs(boxes)
    assert sorted(set(label.tolist())) == list(range(int(label.max(initial=-1)) + 1))
    return int(label.max(initial=-1)) + 1


@pytest.mark.parametrize("count", [0, 1, 2, 40, FEW - 1, FEW, FEW + 1, 260])
@pytest.mark.parametrize("states", sample([1, 3], [3]))
def test_boxes_anywhere(count: int, states: int) -> None:
    rng = np.random.default_rng(count + 1000 * states)
    for width, size in ((0.02, 5.0), (0.1, 20.0), (0.5, 15.0), (4.0, 4.0)):
        check(boxes_of(rng, count, states=states, width=width, size=size, spread=100.0))


@pytest.mark.parametrize("seed", sample(range(6), [0]))
def test_many_boxes_over_each_other(seed: int) -> None:
    """Dense in θ, so that what belongs together is often further apart in the order than first looked at."""
    rng = np.random.default_rng(seed)
    groups = []
    for size, spread in ((2.0, 100.0), (5.0, 100.0), (20.0, 400.0)):
        groups.append(check(boxes_of(rng, 300, states=2, width=1.5, size=size, spread=spread)))
    assert max(groups) > 3


@pytest.mark.parametrize("count", [30, 300])
def test_a_chain_across_the_cut(count: int) -> None:
    """Boxes that only meet end to end, all the way round a turn: one component; without one of them still."""
    for order in (1, 2, 4):
        turn = 2 * math.pi / order
        at = turn * np.arange(count) / count - math.pi + 0.1
        half = np.full(count, turn / count / 2 * (1 + 1e-6))
        place = np.zeros((count, 2))
        ring = Boxes(np.zeros(count, np.int64), at, half, np.full(count, turn), place, place + 1)
        assert check(ring) == 1
        rows = np.delete(np.arange(count), [3, count // 2])
        parts = Boxes(*(getattr(ring, name)[rows] for name in ring.__dataclass_fields__))
        assert check(parts) == 2


@pytest.mark.parametrize("count", [60, 240])
def test_boxes_that_only_touch_are_connected(count: int) -> None:
    """Side by side in x, sharing their sides exactly."""
    x = np.arange(count, dtype=float)
    lo = np.column_stack([x, np.zeros(count)])
    middle, half = np.linspace(0.0, 0.1, count), np.full(count, 0.2)
    state, turn = np.zeros(count, np.int64), np.full(count, 2 * math.pi)
    assert check(Boxes(state, middle, half, turn, lo, lo + 1)) == 1
    assert check(Boxes(state, middle, half, turn, lo, lo + np.array([0.999, 1.0]))) == count


def two_groups(first: int, second: int, bridge: int) -> Boxes:
    """Two groups of boxes, one after the other in θ; box `bridge` of the first reaches over to the second."""
    count = first + second
    lo = np.where(np.arange(count)[:, None] < first, 0.0, 50.0) * np.ones(2)
    hi = lo + 1
    hi[bridge] = 51.0
    return Boxes(
        state=np.zeros(count, np.int64),
        middle=np.linspace(0.0, 0.1, count),
        half_width=np.full(count, 0.3),
        turn=np.full(count, 2 * math.pi),
        lo=lo,
        hi=hi,
    )


@pytest.mark.parametrize(("first", "second"), [(120, 100), (100, 120), (101, 100), (200, 1)])
def test_groups_that_one_distant_box_joins(first: int, second: int) -> None:
    assert check(two_groups(first, second, 10)) == 1


def test_groups_of_one_size_that_one_distant_box_joins() -> None:
    assert check(two_groups(100, 100, 10)) == 1


def test_bins_join_all_that_meet() -> None:
    """The way for very many boxes may join more than meets, never less."""
    rng = np.random.default_rng(9)
    for width in (0.2, 1.5):
        boxes = boxes_of(rng, 400, states=3, width=width, size=6.0, spread=200.0)
        label = component_labels(boxes, group_by_links, most_pairs=0)
        for group in by_pairs(boxes):
            assert len({int(label[k]) for k in group}) == 1
        for value in np.unique(label):
            assert len(np.unique(boxes.state[label == value])) == 1


# ----------------------------------------------------------------------------------------------------
# Pieces near a point: every piece with a place within reach is found; places are sampled here.

_SAMPLES = 60


@pytest.mark.parametrize("radius_mm", [0.0, 4.0])
@pytest.mark.parametrize("seed", [1, 2, pytest.param(3, marks=pytest.mark.campaign)])
def test_no_piece_within_reach_is_missed(seed: int, radius_mm: float) -> None:
    rng = np.random.default_rng(seed)
    catalogue = Catalogue(drawn_catalogue(seed, least_vertices=600))
    boundary = catalogue.boundary(Finger(radius_mm, 5.0))
    pieces, count = boundary.pieces, 300
    some = rng.integers(len(pieces), size=count)
    state = pieces.state[some]
    point = pieces.start[some] + rng.normal(0, 1, (count, 2)) * (radius_mm + 1)
    reach = rng.uniform(0, 3, count)
    owner, piece = boundary.pieces_near(state, point, reach)
    found = set(zip(owner.tolist(), piece.tolist(), strict=True))
    assert len(found) == len(owner)
    assert np.all(np.diff(owner * len(pieces) + piece) > 0)
    assert np.array_equal(pieces.state[piece], state[owner])
    within = 0
    for row in range(count):
        rows = np.arange(boundary.first_piece[state[row]], boundary.first_piece[state[row] + 1])
        share = np.linspace(0, 1, _SAMPLES)
        angle = pieces.normal_rad[rows, None] + share * pieces.turn_rad[rows, None]
        rim = radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=2)
        rel = point[row] - pieces.start[rows, None] - rim
        along = pieces.along[rows, None]
        foot = np.clip(np.sum(rel * along, axis=2), 0, pieces.length[rows, None])
        left = rel - foot[..., None] * along
        nearest = np.hypot(left[..., 0], left[..., 1]).min(axis=1)
        expected = rows[nearest <= reach[row] + pieces.off[rows]]
        within += len(expected)
        assert {(row, int(number)) for number in expected} <= found
    # It is a selection: what is left out is by far the most.
    assert within <= len(found) < 3 * within + count


def test_states_without_pieces_have_none() -> None:
    catalogue = Catalogue(drawn_catalogue(1)[:3])
    boundary = catalogue.boundary(Finger(4.0, 500.0))
    assert len(boundary.pieces) == 0
    owner, piece = boundary.pieces_near(np.array([0, 1]), np.zeros((2, 2)), np.full(2, 10.0))
    assert (len(owner), len(piece)) == (0, 0)


# ----------------------------------------------------------------------------------------------------
# Where candidates for a witness start, and rounding before what decides, against shapely and decimal.


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


# ----------------------------------------------------------------------------------------------------
# Bounds of what is left hold all that satisfies the contacts exactly, and hardly more.

_LEVER_MM = 40.0


def scenes(count: int) -> list[tuple[Scene, Recognition]]:
    """Grips of three fingers or more that leave few hypotheses."""
    found = []
    index = 0
    while len(found) < count:
        scene = drawn(5, index, ("memo",))
        index += 1
        if scene.touches >= 3 and len((answer := asked(scene)).hypotheses) <= 8:
            found.append((scene, answer))
    return found


def coarse_widths(item: Hypothesis) -> np.ndarray:
    """Widths (3,) of the box round a hypothesis's cells."""
    origin = np.tile(item.state.origin_mm, (len(item.cells), 1))
    lo, hi = numpy_steps.position_boxes(item.cells, origin, item.constraints.anchor_mm)
    turn = float(item.cells.hi.max() - item.cells.lo.min())
    return np.append(hi.max(axis=0) - lo.min(axis=0), turn)


def widths(item: Hypothesis) -> np.ndarray:
    """Widths (3,) of a hypothesis's bounds."""
    bounds = (item.bounds.x_mm, item.bounds.y_mm, item.bounds.theta_rad)
    return np.array([hi - lo for lo, hi in bounds])


def test_whatever_satisfies_all_contacts_near_a_witness_is_within_the_bounds() -> None:
    rng = np.random.default_rng(0)
    checked = 0
    for _, answer in scenes(12):
        for item in answer.hypotheses:
            if not item.verified:
                continue
            # A walk from the witness on, over what can be reached through feasible configurations.
            at = np.tile([*item.witness_mm, item.configuration.theta_rad * _LEVER_MM], (40, 1))
            for step in range(40):
                going = at + rng.normal(size=at.shape) * rng.choice([0.02, 0.1, 0.4])
                poses = Poses(np.full(40, item.state_index), going[:, 2] / _LEVER_MM, going[:, :2])
                held = verify(Query(answer.catalogue, answer.contacts, answer.anchor_mm), poses).holds
                at[held] = going[held]
                if step % 4 == 3:
                    theta = at[:, 2] / _LEVER_MM
                    place = rotate(at[:, :2] - item.state.origin_mm, theta) + answer.anchor_mm
                    for value, (lo, hi) in zip(
                        (*place.T, theta),
                        (item.bounds.x_mm, item.bounds.y_mm, item.bounds.theta_rad),
                        strict=True,
                    ):
                        assert value.min() >= lo
                        assert value.max() <= hi
                    checked += 1
    assert checked > 100


def test_bounds_of_few_hypotheses_are_narrower_than_their_cells() -> None:
    ratio = []
    for scene, answer in scenes(30):
        for item in answer.hypotheses:
            assert np.all(widths(item) <= coarse_widths(item) + 1e-8)
        item = holding_truth(answer, scene.placed)
        assert item is not None
        ratio.append(widths(item) / coarse_widths(item))
    assert np.median(ratio, axis=0)[:2] == pytest.approx([0.9, 0.9], abs=0.1)
    assert np.min(ratio) < 0.8


def test_bounds_of_many_hypotheses_are_those_of_their_cells() -> None:
    index = 0
    while len((answer := asked(drawn(5, index, ("memo",)))).hypotheses) <= 32:
        index += 1
    hypotheses = answer.hypotheses
    found = enclosures(hypotheses.constraints, hypotheses.regions)
    lo, hi = found.lo, found.hi
    cells, first = hypotheses.regions.cells, hypotheses.regions.first
    assert lo[:, 2] == pytest.approx(np.minimum.reduceat(cells.lo, first[:-1]))
    assert hi[:, 2] == pytest.approx(np.maximum.reduceat(cells.hi, first[:-1]))
