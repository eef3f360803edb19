"""Sections of resting solids, slices and silhouettes."""

import itertools
import pickle

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial.transform import Rotation

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Polygon
from palpate.base.geometry.plane import signed_area
from palpate.cad.parts import CrossSection, Solid, StableState
from palpate.cad.resting_surface import (
    RestingSurface,
    regions_of,
    resting_surface_of,
    silhouette,
    slice_surface,
)
from palpate.cad.section_bounds import material_bound_mm
from palpate.cad.sections import SectionsError, sections_of
from support.benches.parts import ELL, prism
from support.campaign.sampling import sample
from support.commands.repository import cad_file

# ----------------------------------------------------------------------------------------------------
# Cross sections against trimesh's own sections at random heights: regions, edges and normals.

UPRIGHT = np.eye(3)


def solid_of(mesh: trimesh.Trimesh, off_mm: float = 0.0) -> Solid:
    return Solid("part", np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64), off_mm)


def resting(solid: Solid, rotation: Floats = UPRIGHT) -> StableState:
    lowest = (solid.vertices_mm @ rotation.T)[:, 2].min()
    return StableState("a", rotation, np.array([0.0, 0.0, -lowest]), 1.0, 0.5, np.zeros((3, 2)))


def turned(seed: int) -> Floats:
    return Rotation.random(random_state=seed).as_matrix()


def twisted_prism(outline: Floats, height: float, twist_rad: float = 0.0, levels: int = 2) -> trimesh.Trimesh:
    """Walls of two triangles between levels, turned by a twist in all; convex outlines only."""
    rings = []
    for share in np.linspace(0, 1, levels):
        c, s = np.cos(twist_rad * share), np.sin(twist_rad * share)
        rings.append(np.column_stack([outline @ [[c, s], [-s, c]], np.full(len(outline), height * share)]))
    n = len(outline)
    faces = [[0, k + 1, k] for k in range(1, n - 1)]
    top = (levels - 1) * n
    faces += [[top, top + k, top + k + 1] for k in range(1, n - 1)]
    for level, k in itertools.product(range(levels - 1), range(n)):
        a, b = level * n + k, level * n + (k + 1) % n
        faces += [[a, b, b + n], [a, b + n, a + n]]
    return trimesh.Trimesh(np.vstack(rings), faces, process=False)


def polygon(sides: int, radius: float) -> Floats:
    angle = 2 * np.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def edges_and_vertices(section: CrossSection) -> tuple[Floats, Floats, Floats, Floats]:
    """Starts, ends (n, 2), normal angles (n,) and those of the edges before (n,), the plain way."""
    rows = []
    for region in section.polygons:
        for ring in (region.outer, *region.holes):
            for k in range(len(ring)):
                p, a, b = ring[k - 1], ring[k], ring[(k + 1) % len(ring)]
                rows.append([*a, *b, *(np.arctan2(-(q - o)[0], (q - o)[1]) for o, q in ((a, b), (p, a)))])
    table = np.array(rows)
    return table[:, :2], table[:, 2:4], table[:, 4], table[:, 5]


def worst_excess(section: CrossSection, points: Floats, normals: Floats) -> float:
    """How far beyond `off_mm` true edge points (n, 2) with normals (n,) rad are from what passes for them."""
    start, end, heading, before = edges_and_vertices(section)
    leg = end - start
    length = np.hypot(*leg.T)
    tilt = np.where(4 * section.off_mm < length, np.arcsin(np.minimum(4 * section.off_mm / length, 1)), np.pi)
    share = np.clip(np.einsum("nkc,kc->nk", points[:, None] - start, leg) / length**2, 0, 1)
    to_edge = np.linalg.norm(points[:, None] - start - share[:, :, None] * leg, axis=2)
    turn = np.abs(np.angle(np.exp(1j * (normals[:, None] - heading))))
    to_edge[turn > tilt + 1e-6] = np.inf
    to_vertex = np.linalg.norm(points[:, None] - start, axis=2)
    bend = np.angle(np.exp(1j * (heading - before)))
    tilt_before = np.array([tilt[np.argmin(np.linalg.norm(end - s, axis=1))] for s in start])
    after = np.angle(np.exp(1j * (normals[:, None] - before)))
    to_vertex[(after < -tilt_before - 1e-6) | (after > bend + tilt + 1e-6)] = np.inf
    return float(np.minimum(to_edge.min(axis=1), to_vertex.min(axis=1)).max()) - section.off_mm


def true_section(mesh: trimesh.Trimesh, height: float) -> tuple[Floats, Floats, shapely.Geometry]:
    """Points on the true edges, their normals, and the region."""
    lines, faces = trimesh.intersections.mesh_plane(mesh, [0, 0, 1], [0, 0, height], return_faces=True)
    lines = lines[:, :, :2]
    normal = mesh.face_normals[faces]
    share = np.array([0.001, 0.25, 0.5, 0.75, 0.999])
    points = lines[:, :1] + share[:, None] * (lines[:, 1:] - lines[:, :1])
    cut = mesh.section([0, 0, 1], [0, 0, height])
    region = shapely.Polygon()
    for ring in cut.discrete:
        region = region.symmetric_difference(shapely.Polygon(ring[:, :2]))
    angle = np.arctan2(normal[:, 1], normal[:, 0])
    return points.reshape(-1, 2), angle.repeat(len(share)), region


def region_of(section: CrossSection) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(r.outer, r.holes) for r in section.polygons])


def check(mesh: trimesh.Trimesh, rotation: Floats, tolerance: float, count: int) -> None:
    """Find the cross sections of a part, and compare `count` of them with it at random heights."""
    solid = solid_of(mesh)
    state = resting(solid, rotation)
    found = sections_of(solid, state, tolerance, most=3000)
    moved = trimesh.Trimesh(solid.vertices_mm @ rotation.T + state.offset_mm, solid.faces, process=False)
    top = moved.vertices[:, 2].max()
    assert found[0].z_mm[0] == 0.0
    assert found[-1].z_mm[1] == pytest.approx(top, abs=1e-3)
    assert all(a.z_mm[1] == b.z_mm[0] for a, b in itertools.pairwise(found))
    random = np.random.default_rng(3)
    for number in random.permutation(len(found))[:count]:
        section = found[number]
        assert section.off_mm <= tolerance * (1 + 1e-9)
        low, high = section.z_mm
        for share in (random.uniform(0, 0.1), random.uniform(), random.uniform(0.9, 1)):
            height = low + share * (high - low)
            points, normals, region = true_section(moved, height)
            assert worst_excess(section, points, normals) < 1e-6, (number, height)
            grown = section.off_mm * 1.002 + 2e-6
            model = region_of(section)
            assert region.difference(model.buffer(grown, quad_segs=32)).area < 1e-9, (number, height)
            assert model.difference(region.buffer(grown, quad_segs=32)).area < 1e-9, (number, height)


@pytest.mark.parametrize(
    ("mesh", "rotation", "tolerance"),
    [
        (trimesh.creation.box((8, 12, 4)), turned(1), 0.4),
        (trimesh.creation.cone(6, 8, sections=32), UPRIGHT, 0.2),
        (trimesh.creation.cone(6, 8, sections=32), turned(4), 0.5),
        (trimesh.creation.icosphere(3, radius=8), UPRIGHT, 0.4),
        (trimesh.creation.annulus(4, 9, 12, sections=40), turned(6), 0.8),
        (trimesh.creation.torus(12, 4, 30, 16), UPRIGHT, 0.5),
        (twisted_prism(polygon(4, 12.0), 20.0, 1.0, 9), UPRIGHT, 0.8),
        (twisted_prism(polygon(6, 12.0) * [1, 0.1], 20.0, 0.5, 7), UPRIGHT, 0.6),
    ],
    ids=["box", "cone", "cone-tilted", "ball", "tube", "torus", "screw", "blade"],
)
def test_sections_say_the_truth(mesh: trimesh.Trimesh, rotation: Floats, tolerance: float) -> None:
    check(mesh, rotation, tolerance, 8)


def test_upright_walls_make_one_exact_section() -> None:
    outline = polygon(6, 12.0)
    (section,) = sections_of(*part_of(twisted_prism(outline, 20.0, levels=30)), 0.05)
    assert section.z_mm == (0.0, 20.0)
    assert section.off_mm < 1e-6
    (region,) = section.polygons
    assert len(region.outer) == 6
    assert not region.holes
    assert shapely.Polygon(region.outer).symmetric_difference(shapely.Polygon(outline)).area < 1e-6


def part_of(mesh: trimesh.Trimesh, off_mm: float = 0.0) -> tuple[Solid, StableState]:
    solid = solid_of(mesh, off_mm)
    return solid, resting(solid)


def test_steps_end_sections_exactly() -> None:
    mesh = prism_of_profile([(0, 0), (20, 0), (20, 5), (16, 5), (16, 10), (8, 10), (8, 15), (0, 15)], 12.0)
    found = sections_of(*part_of(mesh), 0.05)
    assert [section.z_mm for section in found] == [(0.0, 5.0), (5.0, 10.0), (10.0, 15.0)]
    assert [region_of(section).area for section in found] == pytest.approx([240.0, 192.0, 96.0])
    assert max(section.off_mm for section in found) < 1e-6


def prism_of_profile(profile: list[tuple[float, float]], width: float) -> trimesh.Trimesh:
    """A profile (x, z), extruded along y."""
    n = len(profile)
    shape = shapely.constrained_delaunay_triangles(shapely.Polygon(profile))
    number = {point: k for k, point in enumerate(profile)}
    faces = []
    for triangle in shape.geoms:
        a, b, c = (number[point] for point in shapely.geometry.polygon.orient(triangle).exterior.coords[:3])
        faces += [[a, b, c], [c + n, b + n, a + n]]
    for k in range(n):
        a, b = k, (k + 1) % n
        faces += [[b, a, a + n], [b, a + n, b + n]]
    points = [[x, 0.0, z] for x, z in profile] + [[x, width, z] for x, z in profile]
    return trimesh.Trimesh(points, faces, process=False)


def test_a_cone_has_no_more_sections_than_its_width_asks_for() -> None:
    mesh = trimesh.creation.cone(10, 20, sections=200)
    found = sections_of(*part_of(mesh), 0.1)
    assert 10 / 0.2 <= len(found) <= 1.3 * 10 / 0.2 + 2


def test_round_walls_are_simplified_within_the_tolerance() -> None:
    (section,) = sections_of(*part_of(trimesh.creation.cylinder(30, 20, sections=1000)), 0.05)
    assert 40 < len(section.polygons[0].outer) < 70
    assert 0.01 < section.off_mm <= 0.05


def test_what_the_surface_is_off_counts() -> None:
    (section,) = sections_of(*part_of(trimesh.creation.box((5, 6, 7)), 0.02), 0.05)
    assert section.off_mm == pytest.approx(0.02, abs=1e-6)
    with pytest.raises(InputError, match=r"off by 0.02 mm already; give a tolerance greater"):
        sections_of(*part_of(trimesh.creation.box((5, 6, 7)), 0.02), 0.02)


def test_beside_a_level_face_what_the_surface_is_off_counts_in_the_thinnest_slab() -> None:
    solid, state = part_of(trimesh.creation.cone(10, 20, sections=50), 0.05)
    surface = resting_surface_of(solid, state)
    assert surface.around(0.0, 0.5) == (0.0, 0.6)
    assert surface.around(0.0, 0.0008) == pytest.approx((0.0, 0.1008))
    assert surface.around(0.0008, 0.5) == pytest.approx((0.0, 0.6))


@pytest.mark.parametrize(
    ("sides", "tolerance"), sample([(64, 0.3), (128, 0.1), (301, 0.05)], [(64, 0.3), (128, 0.1)])
)
def test_a_lying_cylinder_of_chords_is_as_wide_as_the_true_one(sides: int, tolerance: float) -> None:
    """Near its top and bottom a wall that is off by little in space is off by much at a height."""
    radius = 10.0
    sagitta = radius * (1 - np.cos(np.pi / sides))
    lying = Rotation.from_euler("xz", [np.pi / 2, 0.3]).as_matrix()
    mesh = twisted_prism(polygon(sides, radius), 30.0)
    solid = solid_of(mesh, sagitta)
    # One of its sides is down.
    side = Rotation.from_euler("z", np.pi / 2 - np.pi / sides).as_matrix()
    found = sections_of(solid, resting(solid, lying @ side), tolerance)
    assert found[-1].z_mm[1] - found[0].z_mm[0] > 1.8 * radius
    for section in found:
        middle = shapely.minimum_rotated_rectangle(region_of(section))
        width = min(sides_of(middle))
        for height in np.linspace(*section.z_mm, 7):
            true = 2 * np.sqrt(max(height * (2 * radius - height), 0.0))
            assert abs(width - true) / 2 <= section.off_mm


def sides_of(rectangle: shapely.Geometry) -> list[float]:
    corners = shapely.get_coordinates(rectangle)
    return [float(np.hypot(*leg)) for leg in np.diff(corners, axis=0)]


def test_only_the_heights_asked_for() -> None:
    part = part_of(trimesh.creation.cone(10, 20, sections=50))
    found = sections_of(*part, 0.2, [(18.0, 30.0), (-1.0, 1.0), (0.5, 2.0)])
    ends = {section.z_mm[0] for section in found} ^ {section.z_mm[1] for section in found}
    assert sorted(ends) == pytest.approx([0.0, 2.0, 18.0, 20.0])
    with pytest.raises(InputError, match=r"no given height is on the part, which is 20 mm high"):
        sections_of(*part, 0.2, [(25.0, 30.0)])


def test_too_many_sections_are_refused_with_the_height() -> None:
    part = part_of(trimesh.creation.cone(10, 20, sections=50))
    with pytest.raises(InputError, match=r"part, a: more than 10 .* at height \d+\.\d+ mm; give heights"):
        sections_of(*part, 0.1, most=10)


def test_a_slit_without_width_is_no_material_and_no_harm() -> None:
    """A fin so thin that the exact section is asked, whose outline goes back and forth on itself."""
    surface = surface_from(prism(shapely.Polygon([(0, 0), (20, 0), (20, 2)]), 10.0), UPRIGHT)
    walls = surface.within(4.0, 5.0)
    fin = np.array([(0.0, 0.0), (20.0, 0.0), (20.0, 2.0)])
    slit = np.vstack([fin[:1], [(0.3, 0.0), (0.2, 0.0)], fin[1:]])

    def bound(exact: Floats) -> float | None:
        return material_bound_mm(
            [Polygon(fin)], lambda: [Polygon(exact)], surface, walls, (4.0, 5.0), 0.05, 0.06
        )

    assert bound(slit) == bound(fin) == 0.06
    assert bound(fin + np.array([1.0, 0.0])) is None


def test_a_state_without_any_section_says_why() -> None:
    solid, state = part_of(trimesh.creation.cone(10, 20, sections=50), 0.05)
    with pytest.raises(
        SectionsError, match=r"^part, a: no section .* leans .* off by 0.05 mm; give a greater"
    ) as told:
        sections_of(solid, state, 0.06, [(2.0, 3.0)])
    again = pickle.loads(pickle.dumps(told.value))
    assert (str(again), again.reason) == (str(told.value), told.value.reason)


def test_a_printed_cube_with_letters() -> None:
    check(trimesh.load(cad_file("20mm-xyz-cube.stl")), UPRIGHT, 0.3, 6)


# ----------------------------------------------------------------------------------------------------
# Slices of closed surfaces against trimesh, and at the heights where slicing is delicate.

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])


def surface_from(mesh: trimesh.Trimesh, rotation: Floats) -> RestingSurface:
    solid = Solid("part", np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64))
    lowest = (solid.vertices_mm @ rotation.T)[:, 2].min()
    state = StableState("a", rotation, np.array([0.0, 0.0, -lowest]), 1.0, 0.5, np.zeros((3, 2)))
    return resting_surface_of(solid, state)


def area(regions: tuple[Polygon, ...]) -> float:
    return sum(signed_area(r.outer) + sum(signed_area(h) for h in r.holes) for r in regions)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.annulus(4, 9, 12, sections=30),
        trimesh.creation.icosphere(2, radius=7),
        trimesh.creation.torus(12, 4, 30, 20),
    ],
    ids=["tube", "ball", "torus"],
)
def test_areas_are_those_of_trimesh(mesh: trimesh.Trimesh, seed: int) -> None:
    rotation = Rotation.random(random_state=seed).as_matrix()
    surface = surface_from(mesh, rotation)
    moved = trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False)
    for height in np.random.default_rng(seed).uniform(0.01, 0.99, 6) * surface.top_mm:
        regions = regions_of([ring.points for ring in slice_surface(surface, height)])
        lines = trimesh.intersections.mesh_plane(moved, [0, 0, 1], [0, 0, height], return_faces=True)
        (start, end), normal = lines[0][:, :, :2].swapaxes(0, 1), moved.face_normals[lines[1]]
        # Gauss: the area is half the flux of the position through the edges.
        outward = normal[:, :2] / np.hypot(*normal[:, :2].T)[:, None]
        flux = np.sum((start + end) / 2 * outward, axis=1) @ np.hypot(*(end - start).T) / 2
        assert area(regions) == pytest.approx(flux, rel=1e-9)
        assert all(signed_area(r.outer) > 0 and all(signed_area(h) < 0 for h in r.holes) for r in regions)


def test_a_plane_through_vertices_is_no_special_case() -> None:
    surface = surface_from(trimesh.creation.icosphere(2, radius=7), np.eye(3))
    for height in np.unique(surface.vertices_mm[:, 2])[1:-1]:
        (region,) = regions_of(
            [r.points for r in slice_surface(surface, height) if abs(signed_area(r.points)) > 1e-9]
        )
        (above,) = regions_of([r.points for r in slice_surface(surface, height + 1e-9)])
        assert signed_area(region.outer) == pytest.approx(signed_area(above.outer), abs=1e-6)


def test_every_edge_lies_on_its_facet() -> None:
    surface = surface_from(trimesh.creation.box((3, 4, 5)), Rotation.random(random_state=2).as_matrix())
    (ring,) = slice_surface(surface, surface.top_mm / 2)
    leg = np.roll(ring.points, -1, axis=0) - ring.points
    outward = np.column_stack([leg[:, 1], -leg[:, 0]]) / np.hypot(*leg.T)[:, None]
    np.testing.assert_allclose(outward, surface.normal[ring.facet], atol=1e-9)


def test_holes_belong_to_the_smallest_polygon_around_them() -> None:
    island = SQUARE / 8 + 1.75
    regions = regions_of([SQUARE, (SQUARE / 2 + 1)[::-1], island, (island / 2 + 1)[::-1] + 0.0, SQUARE + 9])
    assert [len(region.holes) for region in regions] == [1, 1, 0]
    assert area(regions) == pytest.approx(16 - 4 + 0.25 - 0.0625 + 16)


def test_a_hole_outside_of_the_material_is_refused() -> None:
    with pytest.raises(InputError, match=r"a hole at \(11, 11\) lies outside"):
        regions_of([SQUARE, (SQUARE + 9)[::-1]])


def test_an_open_surface_is_refused() -> None:
    mesh = trimesh.creation.box((3, 4, 5))
    mesh.faces = mesh.faces[1:]
    with pytest.raises(InputError, match="not closed"):
        surface_from(mesh, np.eye(3))


def test_faces_that_are_level_but_for_rounding_are_made_level() -> None:
    mesh = trimesh.creation.box((30, 40, 50))
    surface = surface_from(mesh, Rotation.from_rotvec([1e-8, 2e-8, 0]).as_matrix())
    assert surface.level.sum() == 4
    assert surface.top_mm == pytest.approx(50, abs=1e-3)


# ----------------------------------------------------------------------------------------------------
# Silhouettes of resting solids, beside hulls of points and outlines that prisms have.


def resting_mesh(mesh, rotation):
    vertices = np.asarray(mesh.vertices, dtype=float)
    offset = np.array([0.0, 0.0, -(vertices @ rotation[2]).min()])
    state = StableState("a", rotation, offset, 1.0, 0.5, np.zeros((3, 2)))
    return (
        Solid("part", vertices, np.asarray(mesh.faces, dtype=np.int64)),
        state,
        vertices @ rotation.T + offset,
    )


def area_of_rings(rings):
    whole = shapely.Polygon()
    for ring in rings:
        whole = whole.symmetric_difference(shapely.Polygon(ring))
    return whole


@pytest.mark.parametrize("seed", range(5))
def test_of_a_convex_solid_it_is_the_hull_of_its_points(seed):
    rng = np.random.default_rng(seed)
    mesh = trimesh.convex.convex_hull(rng.normal(size=(400, 3)) * [30, 12, 8])
    solid, state, points = resting_mesh(mesh, Rotation.random(random_state=seed).as_matrix())
    wide, deep = np.ptp(points[:, :2], axis=0)
    hull = shapely.MultiPoint(points[:, [0, 2]] if wide >= deep else points[:, [1, 2]]).convex_hull
    seen = area_of_rings(silhouette(solid, state))
    size = max(np.ptp(points, axis=0))
    assert shapely.hausdorff_distance(seen, hull) < 0.015 * size
    assert seen.bounds[1] == pytest.approx(0.0, abs=0.01 * size)


def test_an_angle_profile_shows_its_legs_and_a_tube_its_hole():
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # the outline is seen from the side
    solid, state, _ = resting_mesh(prism(ELL, 20.0), upright)
    seen = area_of_rings(silhouette(solid, state))
    assert shapely.hausdorff_distance(seen, shapely.affinity.translate(ELL, 0, 0)) < 1.0
    ring = shapely.Point(0, 0).buffer(12).difference(shapely.Point(0, 0).buffer(8))
    solid, state, _ = resting_mesh(prism(ring, 20.0), upright)
    rings = silhouette(solid, state)
    assert len(rings) == 2
    assert area_of_rings(rings).area == pytest.approx(ring.area, rel=0.05)
