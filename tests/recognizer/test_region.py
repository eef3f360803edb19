"""Cells hold every feasible configuration; witnesses are feasible."""

import math

import numpy as np
import pytest
from shapely_bench import SHIPPED_OBJECTS, grip, outlines, place

from palpate.base.geometry.plane import point_segment_distance, rotate
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.interpretation_tree import Interpretations, first_level, next_level
from palpate.recognizer.pose_region import (
    Cells,
    Intervals,
    build_cells,
    divide_longest,
    divide_orientations,
    probe_cells,
    refine_intervals,
)

MODELS = outlines(SHIPPED_OBJECTS)


def interpreted(catalogue: Catalogue, contacts: list[Contact]) -> tuple[Interpretations, np.ndarray]:
    anchor = np.mean([c.end_mm for c in contacts], axis=0)
    nodes, _ = first_level(catalogue, contacts[0])
    for count in range(2, len(contacts) + 1):
        nodes, _ = next_level(catalogue, nodes, contacts[:count], anchor)
    return nodes, anchor


def contains(cells: Cells, row: int, theta: float, position: np.ndarray) -> bool:
    if not cells.lo[row] - 1e-12 <= theta <= cells.hi[row] + 1e-12:
        return False
    corners = cells.polygon[row]
    leg = np.roll(corners, -1, axis=0) - corners
    rel = position - corners
    return bool(
        np.all(leg[:, 0] * rel[:, 1] - leg[:, 1] * rel[:, 0] >= -1e-7 * (1 + np.abs(leg).sum(axis=1)))
    )


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
    parts, owner = divide_longest(cells, lever_mm, 4)
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


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("fingers", [2, 3])
def test_cells_hold_every_sampled_feasible_configuration(seed: int, fingers: int) -> None:
    rng = np.random.default_rng(seed)
    catalogue = Catalogue(MODELS[seed % 6 : seed % 6 + 1])
    contacts: list[Contact] = []
    while len(contacts) < fingers:
        placed = place(MODELS[seed % 6], rng)
        contacts = [c for c in grip(placed, rng, fingers=fingers, bound=1.0, half_range=0.4) if c.touched]
    nodes, anchor = interpreted(catalogue, contacts)
    cells = build_cells(
        catalogue, nodes, contacts, anchor, divide_orientations(nodes, step_rad=0.015, least=3)
    )
    parts, _ = refine_intervals(catalogue, nodes, cells, contacts, anchor, 3)
    finer = build_cells(catalogue, nodes, contacts, anchor, parts)
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
    nodes, anchor = interpreted(catalogue, contacts)
    theta = (nodes.lo + nodes.hi) / 2
    found = probe_cells(
        catalogue, nodes, contacts, anchor, Intervals(np.arange(len(nodes)), nodes.lo, nodes.hi)
    )
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
    (one, owner), (other, of_other) = divide_longest(cells, 40.0, 4), divide_longest(close, 40.0, 4)
    assert np.array_equal(owner, of_other)
    np.testing.assert_allclose(one.centre, other.centre, rtol=0, atol=1e-9)
