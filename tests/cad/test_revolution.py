"""Solids of revolution and bounds on the Hausdorff distance."""

import math

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial import cKDTree

from palpate.base.geometry import Floats
from palpate.base.geometry.outlines import EdgeRings
from palpate.cad.parts import Solid
from palpate.cad.revolution import solid_of_revolution
from palpate.cad.section_bounds import FacetPieces, distance_bound
from palpate.cad.stable_states import stable_states
from palpate.cad.state_merging import merge_states
from palpate.rig.catalogue.import_states import Shares, import_states
from support.campaign.sampling import sample

# ----------------------------------------------------------------------------------------------------
# Solids of revolution whose facets are irregular: hulls of points drawn on true ones.

WITHIN = 0.3
CONE = [[0, 0], [15, 0], [5, 30], [0, 30]]


def drawn(profile, seed, number=90, turn=None):
    """A solid about z: on each circle of the profile corners at angles of its own; convex ones only."""
    rng = np.random.default_rng(seed)
    points = []
    for radius, height in profile:
        angle = 2 * np.pi * (np.arange(number) + rng.uniform(-0.3, 0.3, number)) / number
        points.append(
            np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(number, height)])
        )
    mesh = trimesh.convex.convex_hull(np.vstack(points))
    if turn is not None:
        mesh.apply_transform(turn)
    return Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))


def off_true_mm(solid, profile):
    """How far points all over a surface are from the profile, turned about z."""
    mesh = trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False)
    points = trimesh.sample.sample_surface(mesh, 20_000, seed=1)[0]
    line = shapely.LineString(profile)
    flat = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    return float(shapely.distance(shapely.points(flat), line).max())


@pytest.mark.parametrize("seed", range(3))
def test_an_irregular_cone_is_turned_anew_and_no_further_off_than_it_says(seed):
    cone = drawn(CONE, seed)
    made = solid_of_revolution(cone, WITHIN)
    assert made is not None
    assert 0 < made.off_mm <= WITHIN
    sagitta = 15 * (1 - math.cos(1.6 * math.pi / 90))  # of the widest gap between corners
    assert off_true_mm(made, CONE) <= made.off_mm + sagitta
    assert abs(made.axis[2]) == pytest.approx(1.0)


def test_its_lying_states_become_one_as_probable_as_trimesh_finds_them():
    fine = trimesh.creation.revolve(np.array(CONE, dtype=float), sections=360)
    down, share = fine.compute_stable_poses(n_samples=1, threshold=0.0)
    upright = {
        side: sum(p for pose, p in zip(down, share, strict=True) if side * pose[2, 2] > 0.9)
        for side in (1, -1)
    }
    made = solid_of_revolution(drawn(CONE, 5), WITHIN)
    found = import_states(made, Shares(0.6 + made.off_mm, 0.01, (10.0,), 0.001, as_is=False), lambda _: None)
    lying, *standing = [state.text.probability for state in found.states]
    assert lying == pytest.approx(1 - sum(upright.values()), abs=2e-3)
    assert standing == pytest.approx(sorted(upright.values(), reverse=True), abs=2e-3)


def test_an_axis_may_lie_anyhow_in_the_file():
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.7]))
    turn[:3, 3] = [40, -7, 3]
    made = solid_of_revolution(drawn(CONE, 1, turn=turn), WITHIN)
    assert abs(made.axis @ turn[:3, 2]) == pytest.approx(1.0, abs=1e-6)


def test_a_dome_stands_upright_on_its_round_side():
    """Its centre of mass is 3/8 of the radius from the flat face: the axis is upright."""
    polar = np.linspace(0.0, math.pi / 2, 40)
    profile = [[0, 15], *np.column_stack([15 * np.sin(polar), 15 * (1 - np.cos(polar))])[::-1], [0, 0]]
    made = solid_of_revolution(drawn(profile[1:-1], 3), WITHIN / 2)
    states, _ = stable_states(made)
    found, out = merge_states(made, states, no_sections, 0.01, 0.005)
    assert [abs(item.state.rotation[2] @ made.axis) for item in found] == pytest.approx([1.0, 1.0])
    assert sum(item.probability for item in out) < 0.01


def no_sections(_state, heights_mm):
    return [shapely.Polygon()] * len(heights_mm)


def test_a_ball_is_a_ball():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6000, 3))
    mesh = trimesh.convex.convex_hull(10 * points / np.linalg.norm(points, axis=1)[:, None])
    ball = Solid("ball", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))
    made = solid_of_revolution(ball, WITHIN)
    surface = trimesh.Trimesh(made.vertices_mm, made.faces, process=False)
    radius = np.linalg.norm(trimesh.sample.sample_surface(surface, 20_000, seed=1)[0], axis=1)
    inner = np.linalg.norm(mesh.triangles.mean(axis=1), axis=1).min()
    assert inner - made.off_mm <= radius.min()
    assert radius.max() <= inner + made.off_mm
    found = import_states(made, Shares(0.4, 0.1, (10.0,), 0.01, as_is=False), lambda _: None)
    (state,) = found.states
    assert state.text.probability == 1.0
    assert state.result.edges == (1, 1)  # a circle


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.box((20, 20, 30)),
        trimesh.creation.cylinder(radius=10, height=30, sections=6),
        trimesh.creation.icosphere(subdivisions=1, radius=10),
    ],
)
def test_what_is_none_or_a_prism_is_left_as_it_is(mesh):
    part = Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))
    assert solid_of_revolution(part, WITHIN) is None


@pytest.mark.parametrize("sections", [64, 315])
def test_what_is_alike_all_round_keeps_its_facets(sections):
    """But for the rounding of a file with single precision, which is taken out."""
    mesh = trimesh.creation.cylinder(radius=10, height=30, sections=sections)
    vertices = np.asarray(mesh.vertices).astype(np.float32).astype(float)
    part = Solid("part", vertices, np.asarray(mesh.faces, dtype=np.int64))
    made = solid_of_revolution(part, WITHIN)
    assert np.array_equal(made.faces, part.faces)
    assert np.linalg.norm(made.vertices_mm - vertices, axis=1).max() <= made.off_mm < 1e-5
    assert made.symmetry.order == sections
    found = import_states(made, Shares(0.1, 0.03, (10.0,), 0.01, as_is=False), lambda _: None)
    # Two, lying and standing: the mesh's own lying states are as many as sections.
    assert [state.result.merged for state in found.states] in ([sections, 2], [2, sections])
    assert sum(state.text.probability for state in found.states) == pytest.approx(1.0, abs=1e-3)


def test_a_flat_on_a_shaft_is_not_turned_away():
    shaft = drawn([[8, 0], [8, 30]], 0)
    points = shaft.vertices_mm.copy()
    points = points[points[:, 0] < 7.0]
    mesh = trimesh.convex.convex_hull(points)
    part = Solid("shaft", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))
    assert solid_of_revolution(part, WITHIN) is None


# ----------------------------------------------------------------------------------------------------
# The bound on how far walls are from an outline: worked by hand, and never less than at any point.

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
DOWN, RIGHT = (0.0, -1.0), (1.0, 0.0)


def pieces_of(
    points: list[tuple[float, float]],
    first: tuple[float, float],
    last: tuple[float, float],
    bare: bool = False,
) -> FacetPieces:
    return FacetPieces(np.array([points]), np.array([first]), np.array([last]), np.array([bare]))


def needed(pieces: FacetPieces, outline: EdgeRings, target: float) -> tuple[float, bool]:
    middles = outline.start + outline.direction * outline.length[:, None] / 2
    return distance_bound(pieces, outline, cKDTree(middles), np.arange(len(middles)), target, 0.0)


def test_a_wall_on_an_edge_needs_nothing() -> None:
    found, good = needed(pieces_of([(1, 0), (9, 0), (5, 0)], DOWN, DOWN), EdgeRings.of([SQUARE]), 0.1)
    assert good
    assert found == pytest.approx(0.0, abs=1e-12)


def test_a_wall_beside_an_edge_needs_its_distance() -> None:
    found, good = needed(pieces_of([(1, -0.05), (9, 0.03), (5, 0)], DOWN, DOWN), EdgeRings.of([SQUARE]), 0.1)
    assert good
    assert found == pytest.approx(0.05)


def test_a_wall_that_is_turned_needs_a_fourth_of_the_sine_of_the_edge() -> None:
    turn = 0.02
    normal = (math.sin(turn), -math.cos(turn))
    wall = pieces_of([(4, 0), (4.1, 0), (4, 0)], normal, normal)
    assert needed(wall, EdgeRings.of([SQUARE]), 0.1)[0] == pytest.approx(10 / 4 * math.sin(turn))
    assert not needed(wall, EdgeRings.of([SQUARE]), 0.04)[1]


def test_a_riser_in_a_long_wall_passes_for_nothing() -> None:
    riser = pieces_of([(5, 0), (5, 0.001), (5, 0)], RIGHT, RIGHT)
    found, good = needed(riser, EdgeRings.of([SQUARE]), 0.5)
    assert not good
    assert found > 0.5


def test_a_face_without_a_normal_need_only_be_near() -> None:
    level = pieces_of([(5, 0), (5, 0.25), (5.1, 0)], RIGHT, RIGHT, bare=True)
    assert needed(level, EdgeRings.of([SQUARE]), 0.3) == (pytest.approx(0.25), True)


def test_a_convex_corner_passes_for_the_normals_between_its_walls() -> None:
    corner = pieces_of([(10.1, -0.1), (10, 0)], DOWN, RIGHT)
    assert needed(corner, EdgeRings.of([SQUARE]), 0.2) == (pytest.approx(math.hypot(0.1, 0.1)), True)


def test_a_convex_corner_passes_not_where_the_outline_has_none() -> None:
    assert not needed(pieces_of([(5, 0.0), (5, 0.001)], DOWN, RIGHT), EdgeRings.of([SQUARE]), 0.5)[1]
    assert not needed(pieces_of([(10, 0), (10, 0.01)], RIGHT, (0.0, 1.0)), EdgeRings.of([SQUARE]), 0.5)[1]


def test_a_long_wall_may_be_shared_by_two_edges() -> None:
    bent = np.array([[0.0, 0.0], [5.0, -0.01], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    found, good = needed(pieces_of([(0, 0), (10, 0), (5, 0)], DOWN, DOWN), EdgeRings.of([bent]), 0.02)
    assert good
    assert 0.00999 <= found <= 0.02


def of_point(point: Floats, normal: Floats, outline: EdgeRings) -> float:
    """What a point asks of the outline's edges alone, the plain way."""
    best = np.inf
    for start, along, length, own in zip(
        outline.start, outline.direction, outline.length, outline.normal, strict=True
    ):
        share = np.clip((point - start) @ along, 0, length)
        angle = math.acos(np.clip(normal @ own, -1, 1))
        tilt = length / 4 * (math.sin(angle) if angle < math.pi / 2 else 1.0)
        best = min(best, max(float(np.linalg.norm(point - start - share * along)), tilt))
    return best


@pytest.mark.parametrize("seed", sample(range(20), range(5)))
def test_no_point_of_a_wall_needs_more_than_the_wall(seed: int) -> None:
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0, 2 * np.pi, 40))
    outline = EdgeRings.of([10 * np.column_stack([np.cos(angle), np.sin(angle)])])
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


@pytest.mark.parametrize(("subdivisions", "within"), [(2, 0.2), (3, 0.05)])
def test_a_ball_of_few_facets_is_one_within_half_of_its_shell(subdivisions, within):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=20)
    drawn_ball = Solid("ball", np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64))
    made = solid_of_revolution(drawn_ball, 0.004, within)
    assert made is not None
    inscribed = 20 - np.abs(np.einsum("ij,ij->i", mesh.triangles_center, mesh.face_normals)).min()
    assert inscribed / 2 <= made.off_mm <= within
    points = trimesh.sample.sample_surface(mesh, 20_000, seed=1)[0]
    radius = np.linalg.norm(made.vertices_mm - made.vertices_mm.mean(axis=0), axis=1)
    assert np.abs(np.linalg.norm(points, axis=1)[:, None] - [radius.min(), radius.max()]).max() <= made.off_mm
    assert solid_of_revolution(drawn_ball, 0.004, inscribed / 2 - 0.001) is None
