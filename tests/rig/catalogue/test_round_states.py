"""Polygons as they are written; round states: sections and drawings."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from shapely import affinity

from palpate.base.geometry import Floats, Polygon
from palpate.cad.parts import Drawing
from palpate.config.objects_tables import CircleText, StateText
from palpate.rig.catalogue.cad_import import ImportedObject, ImportOptions, import_file
from palpate.rig.catalogue.import_states import polygons_text
from palpate.rig.catalogue.round_outlines import round_drawing
from support.benches.parts import prism
from support.campaign.sampling import sample

pytestmark = pytest.mark.usefixtures("read_here")

# ----------------------------------------------------------------------------------------------------
# Polygons as they are written: what can be read again, and nothing else that a tip could reach is lost.


def slit(width: float, at: float) -> Floats:
    """A hole of that width, 2 mm long."""
    return np.array([[at, 0.0], [at, 2.0], [at + width, 2.0], [at + width, 0.0]])


def test_holes_that_enclose_no_area_are_not_written() -> None:
    outer = np.array([[-5.0, -5.0], [9.0, -5.0], [9.0, 5.0], [-5.0, 5.0]])
    wide, thin = slit(0.01, 1.0), slit(2e-7, 3.0)
    (written,) = polygons_text([Polygon(outer, (wide, thin))])
    assert written.holes == [[tuple(point) for point in wide.tolist()]]
    (solid,) = polygons_text([Polygon(outer, (thin, thin[:3]))])
    assert not solid.holes


# ----------------------------------------------------------------------------------------------------
# Round states of imported solids: circles where the surface is round, judged by trimesh's own sections.


def without_facets(mesh: trimesh.Trimesh, height: float, *, others: bool = False) -> trimesh.Trimesh:
    """A mesh without its level facets at a height, or without all others."""
    level = (np.abs(mesh.triangles[..., 2] - height) < 1e-9).all(axis=1)
    mesh.update_faces(level if others else ~level)
    return mesh


def imported(mesh: trimesh.Trimesh, folder: Path, **options: object) -> ImportedObject:
    path = folder / "part.stl"
    mesh.export(path)
    (item,) = import_file(path, ImportOptions(units="mm", as_is=True, **options)).objects
    return item


def circles(state: StateText) -> list[CircleText]:
    found = [ring for part in state.sections for p in part.polygons for ring in (p.outer, *p.holes)]
    return [ring for ring in found if isinstance(ring, CircleText)] if found else []


def is_round(state: StateText) -> bool:
    return len(circles(state)) == sum(1 + len(p.holes) for part in state.sections for p in part.polygons)


def drawn(state: StateText, height: float) -> shapely.Geometry:
    """What the imported state has at a height, in 800 sides a circle."""
    shapes = []
    for part in state.sections:
        if part.z[0] <= height <= part.z[1]:
            for polygon in part.polygons:
                outer, *holes = (
                    shapely.Point(ring.circle.centre).buffer(ring.circle.radius, quad_segs=200)
                    for ring in (polygon.outer, *polygon.holes)
                )
                shapes.append(outer.difference(shapely.union_all(holes)))
    return shapely.union_all(shapes)


def true_section(mesh: trimesh.Trimesh, item: ImportedObject, number: int, height: float) -> shapely.Geometry:
    """The mesh's section at a height of one of its states, by trimesh."""
    frame = item.result.states[number].frame
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.rotation, frame.offset
    resting = mesh.copy().apply_transform(matrix)
    path = resting.section(plane_origin=[0, 0, height], plane_normal=[0, 0, 1])
    result = shapely.Polygon()
    for ring in sorted((shapely.Polygon(line[:, :2]) for line in path.discrete), key=lambda p: -p.area):
        result = result.symmetric_difference(ring)
    return result


def profile(seed: int) -> np.ndarray:
    rng = np.random.default_rng([12, seed])
    heights = np.cumsum(rng.uniform(2.0, 8.0, 4))
    radii = rng.uniform(6.0, 20.0, 5)
    return np.array([[0.0, 0.0], [radii[0], 0.0], *zip(radii[1:], heights, strict=True), [0.0, heights[-1]]])


@pytest.mark.parametrize("seed", sample(range(3), [0]))
def test_turned_parts_stand_as_circles_within_their_tolerance(seed: int, tmp_path: Path) -> None:
    mesh = trimesh.creation.revolve(profile(seed), sections=[40, 64, 128][seed % 3])
    item = imported(mesh, tmp_path)
    standing = [number for number, state in enumerate(item.text.states) if is_round(state)]
    assert standing
    rng = np.random.default_rng(seed)
    for number in standing:
        state = item.text.states[number]
        assert state.normal_bound is not None
        assert state.normal_bound >= np.pi / 128 - 1e-6
        for height in rng.uniform(0.01, state.height - 0.01, 8):
            true = true_section(mesh, item, number, height)
            off = shapely.hausdorff_distance(drawn(state, height).boundary, true.boundary, densify=0.05)
            assert off <= item.text.tolerance + 1e-3  # of the circle's own facets


def test_a_tube_is_two_circles(tmp_path: Path) -> None:
    mesh = trimesh.creation.revolve(
        np.array([[6.0, 0.0], [14.0, 0.0], [14.0, 20.0], [6.0, 20.0], [6.0, 0.0]]), sections=64
    )
    item = imported(mesh, tmp_path)
    (state,) = [state for state in item.text.states if is_round(state)]
    assert [ring.circle.centre for ring in circles(state)] == [(0.0, 0.0)] * 2
    assert [ring.circle.radius for ring in circles(state)] == pytest.approx([14.0, 6.0], abs=0.01)


@pytest.mark.parametrize("kind", ["oval", "hexagon", "off the axis"])
def test_what_is_not_round_stays_a_polygon(kind: str, tmp_path: Path) -> None:
    mesh = trimesh.creation.cylinder(radius=12.0, height=20.0, sections=6 if kind == "hexagon" else 64)
    if kind == "oval":
        mesh.apply_scale([1.02, 1.0, 1.0])
    if kind == "off the axis":
        top = mesh.vertices[:, 2] > 0
        mesh.vertices[top] += [0.5, 0.0, 0.0]
    assert not any(is_round(state) for state in imported(mesh, tmp_path).text.states)


def test_a_ring_that_leans_a_little_is_divided_into_circles(tmp_path: Path) -> None:
    """A cone's sections differ with height: as many circles as the tolerance needs."""
    cone = trimesh.creation.revolve(
        np.array([[0.0, 0.0], [15.0, 0.0], [5.0, 30.0], [0.0, 30.0]]), sections=64
    )
    item = imported(cone, tmp_path, heights_mm=(10.0,))
    standing = [state for state in item.text.states if is_round(state)]
    assert standing
    for state in standing:
        radii = [ring.circle.radius for ring in circles(state)]
        assert len(set(radii)) == len(radii) > 1


def test_normals_of_what_is_made_otherwise_than_drawn_are_not_bounded(tmp_path: Path) -> None:
    mesh = trimesh.creation.cylinder(radius=12.0, height=20.0, sections=64)
    (drawn_so,), (made_so,) = (imported(mesh, tmp_path, deviation_mm=off).text.states for off in (0.0, 0.05))
    assert is_round(made_so)
    assert drawn_so.normal_bound == pytest.approx(np.pi / 64, abs=1e-5)
    assert made_so.normal_bound is None


def test_a_bolt_is_round_where_fingers_meet_its_shank(tmp_path: Path) -> None:
    """Whatever its head is: a hexagon below has no part in what is known at 10 mm."""
    turns = np.arange(6) * np.pi / 3
    head = shapely.Polygon(8 * np.column_stack([np.cos(turns), np.sin(turns)]))
    shank = shapely.Point(0, 0).buffer(4, quad_segs=16)
    # The head's top is a ring, so that both together are one closed surface.
    bolt = trimesh.util.concatenate(
        [
            without_facets(prism(head, 5.0), 5.0),
            without_facets(prism(head - shank, 5.0), 5.0, others=True),
            without_facets(prism(shank, 25.0).apply_translation([0, 0, 5.0]), 5.0),
        ]
    )
    bolt.merge_vertices()
    assert bolt.is_volume
    item = imported(bolt, tmp_path, heights_mm=(2.0, 10.0))
    assert not is_round(item.text.states[0])
    item = imported(bolt, tmp_path, heights_mm=(10.0,))
    assert is_round(item.text.states[0])
    assert [ring.circle.radius for ring in circles(item.text.states[0])] == [pytest.approx(4.0, abs=0.01)]


# ----------------------------------------------------------------------------------------------------
# Round drawings: which are taken for circles, and how far they may be from these.

ALLOWED_MM = 0.1
LARGEST_TURN_RAD = 0.3  # more, and a rough outline has any normal: no circle stands for it


def disc(radius, centre=(0.0, 0.0), corners=200, phase=0.0):
    angle = phase + np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + centre


def largest_turn_rad(rings):
    """By how much an edge's normal is off the radial direction at one of its ends, at most."""
    worst = 0.0
    for ring in rings:
        about = ring - ring.mean(axis=0)
        leg = np.roll(about, -1, axis=0) - about
        for end in (about, about + leg):
            cos = np.abs(np.sum(leg * end, axis=1)) / np.hypot(*leg.T) / np.hypot(*end.T)
            worst = max(worst, float(np.arcsin(np.minimum(cos, 1.0)).max()))
    return worst


@given(
    st.floats(2.0, 200.0),
    st.lists(st.floats(0.1, 0.9), max_size=2, unique=True),
    st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    st.integers(10, 400),
    st.floats(0.0, 6.3),
    st.floats(0.0, 0.02),
)
def test_outlines_are_within_the_bound_of_the_circles(radius, shares, centre, corners, phase, rough):
    wobble = 1 + rough * np.cos(5 * np.arange(corners))[:, None] / radius
    rings = [(disc(radius * k, corners=corners, phase=phase) * wobble) + centre for k in (1.0, *shares)]
    found = round_drawing(
        Drawing("disc", Polygon(rings[0], tuple(ring[::-1] for ring in rings[1:]))), ALLOWED_MM
    )
    if found is None:
        sagitta = radius * (1 - math.cos(math.pi / corners))
        assert sagitta + rough > ALLOWED_MM / 2 or largest_turn_rad(rings) > LARGEST_TURN_RAD
        return
    assert found.off_mm <= ALLOWED_MM
    axis = shapely.Point(found.centre_mm)
    for ring, about in zip(rings, found.radii_mm, strict=True):
        outline = shapely.LinearRing(ring)
        assert axis.distance(outline) >= about - found.off_mm - 1e-9
        assert axis.hausdorff_distance(outline) <= about + found.off_mm + 1e-9


@pytest.mark.parametrize(
    "region",
    [
        Polygon(disc(1.0, corners=8)),
        Polygon(disc(30.0), (disc(5.0, (0.3, 0.0))[::-1],)),
        Polygon(disc(30.0) * [1.0, 1.01]),
        Polygon(disc(30.0)[:150]),
        Polygon(disc(30.0), (disc(5.0, (20.0, 0.0))[::-1],)),
        Polygon(disc(30.0), (disc(3.0, (10.0, 0.0))[::-1], disc(3.0, (-10.0, 0.0))[::-1])),
    ],
    ids=["octagon", "eccentric", "ellipse", "most of a disc", "bore beside the middle", "two bores"],
)
def test_what_is_nearly_round_is_not_round(region):
    assert round_drawing(Drawing("part", region), ALLOWED_MM) is None


def test_a_fine_star_of_the_size_of_the_tolerance_is_no_circle():
    spikes = disc(2.0) * np.where(np.arange(200) % 2, 0.97, 1.0)[:, None]
    assert shapely.Point(0, 0).hausdorff_distance(shapely.LinearRing(spikes)) == pytest.approx(2.0)
    assert round_drawing(Drawing("star", Polygon(spikes)), ALLOWED_MM) is None


def test_a_circle_is_known_by_its_outer_outline():
    one = round_drawing(Drawing("one", Polygon(disc(30.0, (5, 5)))), ALLOWED_MM)
    moved = affinity.translate(shapely.Polygon(disc(30.0, (5, 5))), 0.05).exterior.coords
    near = round_drawing(Drawing("near", Polygon(np.array(moved)[:-1])), ALLOWED_MM)
    small = round_drawing(Drawing("small", Polygon(disc(29.0, (5, 5)))), ALLOWED_MM)
    assert None not in (one, near, small)
    assert one.is_near(near, 0.2)
    assert not one.is_near(small, 0.2)
    assert one.bounds_mm == pytest.approx((-25, -25, 35, 35), abs=0.01)
