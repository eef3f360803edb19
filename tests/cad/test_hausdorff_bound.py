"""The bound on how far walls are from an outline: worked by hand, and never less than at any point."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from palpate.base.geometry import Floats
from palpate.cad.section_bounds import FacetPieces, OutlineEdges, distance_bound, outline_edges

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
DOWN, RIGHT = (0.0, -1.0), (1.0, 0.0)


def pieces_of(
    points: list[tuple[float, float]],
    first: tuple[float, float],
    last: tuple[float, float],
    bare: bool = False,
) -> FacetPieces:
    return FacetPieces(np.array([points]), np.array([first]), np.array([last]), np.array([bare]))


def needed(pieces: FacetPieces, outline: OutlineEdges, target: float) -> tuple[float, bool]:
    middles = outline.start + outline.along * outline.length[:, None] / 2
    return distance_bound(pieces, outline, cKDTree(middles), np.arange(len(middles)), target, 0.0)


def test_a_wall_on_an_edge_needs_nothing() -> None:
    found, good = needed(pieces_of([(1, 0), (9, 0), (5, 0)], DOWN, DOWN), outline_edges([SQUARE]), 0.1)
    assert good
    assert found == pytest.approx(0.0, abs=1e-12)


def test_a_wall_beside_an_edge_needs_its_distance() -> None:
    found, good = needed(pieces_of([(1, -0.05), (9, 0.03), (5, 0)], DOWN, DOWN), outline_edges([SQUARE]), 0.1)
    assert good
    assert found == pytest.approx(0.05)


def test_a_wall_that_is_turned_needs_a_fourth_of_the_sine_of_the_edge() -> None:
    turn = 0.02
    normal = (math.sin(turn), -math.cos(turn))
    wall = pieces_of([(4, 0), (4.1, 0), (4, 0)], normal, normal)
    assert needed(wall, outline_edges([SQUARE]), 0.1)[0] == pytest.approx(10 / 4 * math.sin(turn))
    assert not needed(wall, outline_edges([SQUARE]), 0.04)[1]


def test_a_riser_in_a_long_wall_passes_for_nothing() -> None:
    riser = pieces_of([(5, 0), (5, 0.001), (5, 0)], RIGHT, RIGHT)
    found, good = needed(riser, outline_edges([SQUARE]), 0.5)
    assert not good
    assert found > 0.5


def test_a_face_without_a_normal_need_only_be_near() -> None:
    level = pieces_of([(5, 0), (5, 0.25), (5.1, 0)], RIGHT, RIGHT, bare=True)
    assert needed(level, outline_edges([SQUARE]), 0.3) == (pytest.approx(0.25), True)


def test_a_convex_corner_passes_for_the_normals_between_its_walls() -> None:
    corner = pieces_of([(10.1, -0.1), (10, 0)], DOWN, RIGHT)
    assert needed(corner, outline_edges([SQUARE]), 0.2) == (pytest.approx(math.hypot(0.1, 0.1)), True)


def test_a_convex_corner_passes_not_where_the_outline_has_none() -> None:
    assert not needed(pieces_of([(5, 0.0), (5, 0.001)], DOWN, RIGHT), outline_edges([SQUARE]), 0.5)[1]
    assert not needed(pieces_of([(10, 0), (10, 0.01)], RIGHT, (0.0, 1.0)), outline_edges([SQUARE]), 0.5)[1]


def test_a_long_wall_may_be_shared_by_two_edges() -> None:
    bent = np.array([[0.0, 0.0], [5.0, -0.01], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    found, good = needed(pieces_of([(0, 0), (10, 0), (5, 0)], DOWN, DOWN), outline_edges([bent]), 0.02)
    assert good
    assert 0.00999 <= found <= 0.02


def of_point(point: Floats, normal: Floats, outline: OutlineEdges) -> float:
    """What a point asks of the outline's edges alone, the plain way."""
    best = np.inf
    for start, along, length, own in zip(
        outline.start, outline.along, outline.length, outline.normal, strict=True
    ):
        share = np.clip((point - start) @ along, 0, length)
        angle = math.acos(np.clip(normal @ own, -1, 1))
        tilt = length / 4 * (math.sin(angle) if angle < math.pi / 2 else 1.0)
        best = min(best, max(float(np.linalg.norm(point - start - share * along)), tilt))
    return best


@pytest.mark.parametrize("seed", range(20))
def test_no_point_of_a_wall_needs_more_than_the_wall(seed: int) -> None:
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0, 2 * np.pi, 40))
    outline = outline_edges([10 * np.column_stack([np.cos(angle), np.sin(angle)])])
    at = int(random.integers(40))
    corners = outline.start[at] + random.normal(0, 0.4, (3, 2))
    normal = outline.normal[at]
    wall = FacetPieces(corners[None], normal[None], normal[None], np.array([False]))
    found, good = needed(wall, outline, 2.0)
    inside = random.dirichlet([1, 1, 1], 200) @ corners
    # Vertices may serve in place of edges, so the outline's edges alone need no less.
    worst = max(of_point(point, normal, outline) for point in np.vstack([corners, inside]))
    assert good
    nearest = max(float(np.hypot(*(outline.start - point).T).min()) for point in inside)
    assert found >= min(worst, nearest) - 1e-9
