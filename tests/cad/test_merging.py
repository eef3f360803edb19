"""Symmetric states become one; trimesh cuts the sections."""

import math

import numpy as np
import pytest
import shapely
import trimesh
from shared_files import cad_file

from palpate.cad.parts import Solid
from palpate.cad.stable_states import stable_states
from palpate.cad.state_merging import merge_states


def solid(mesh):
    return Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))


def slicer(mesh):
    """Sections by trimesh; loops inside of loops are holes."""

    def slices_of(state, heights_mm):
        resting = mesh.copy()
        resting.vertices = mesh.vertices @ state.rotation.T + state.offset_mm
        sections = []
        for height in heights_mm:
            cut = resting.section([0, 0, 1], [0, 0, height])
            region = shapely.Polygon()
            for loop in [] if cut is None else cut.discrete:
                region = region.symmetric_difference(shapely.Polygon(loop[:, :2]))
            sections.append(region.simplify(1e-9))
        return sections

    return slices_of


def run(mesh, within=0.05, **options):
    states, _ = stable_states(solid(mesh))
    found, out = merge_states(solid(mesh), states, slicer(mesh), within, **options)
    total = sum(item.state.probability for item in found) + sum(item.probability for item in out)
    assert total == pytest.approx(1.0)
    assert [item.state.name for item in found] == [f"state-{k}" for k in range(1, len(found) + 1)]
    return found, out


def counts(found):
    return [item.count for item in found]


def test_a_cube_has_one_state():
    found, out = run(trimesh.creation.box((20, 20, 20)))
    assert counts(found) == [6]
    assert found[0].state.probability == pytest.approx(1.0)
    assert found[0].apart_mm < 1e-6
    assert not out


def test_a_box_has_three():
    found, _ = run(trimesh.creation.box((30, 20, 10)))
    assert counts(found) == [2, 2, 2]


def test_triangulation_does_not_matter():
    mesh = trimesh.creation.box((20, 20, 20))
    uneven = mesh.subdivide(face_index=[0, 5, 7])
    uneven = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(uneven.vertices, uneven.faces, 9.0))
    uneven.merge_vertices()
    assert counts(run(uneven)[0]) == [6]


def test_a_nearly_symmetric_box_merges_within_the_distance_only():
    mesh = trimesh.creation.box((20, 20, 20.06))
    found, _ = run(mesh, within=0.1)
    assert counts(found) == [6]
    assert 0.02 < found[0].apart_mm <= 0.1
    found, _ = run(mesh, within=0.02)
    assert counts(found) == [4, 2]


def test_mirror_images_stay_apart():
    # A slab that is cut obliquely: upside down it is its own mirror image.
    base = np.array([(0, 0), (40, 0), (30, 15), (0, 20)], dtype=float)
    points = np.vstack([np.column_stack([base, np.full(4, z)]) for z in (0.0, 8.0)])
    found, _ = run(trimesh.convex.convex_hull(points))
    flat = [item for item in found if abs(item.state.rotation[2, 2]) > 0.99]
    assert counts(flat) == [1, 1]


def test_a_hole_through_the_middle_changes_nothing_and_a_blind_one_does():
    plate = trimesh.creation.box((30, 30, 10))
    through = trimesh.creation.annulus(5, 15, 10, sections=9)
    assert counts(run(through, within=0.01)[0])[:1] == [2]
    assert counts(run(plate, within=0.01)[0]) == [2, 4]
    # A pyramid on top: the two large faces are no longer the same.
    tip = np.vstack([plate.vertices, [(0.0, 0.0, 9.0)]])
    found, _ = run(trimesh.convex.convex_hull(tip))
    assert max(counts(found)) == 4


def test_a_cylinder_of_many_facets_stands_or_lies():
    found, out = run(trimesh.creation.cylinder(10, 30, sections=12))
    assert sorted(counts(found)) == [2, 12]
    assert not out
    lying = max(found, key=lambda item: item.count)
    assert lying.state.tipping_angle_rad == pytest.approx(math.pi / 12)


def test_a_ball_has_one_state_that_says_how_far_it_is_off():
    mesh = trimesh.creation.icosphere(3, 20)
    assert len(stable_states(solid(mesh))[0]) == 1280
    found, out = run(mesh, within=0.2)
    assert counts(found) == [1280]
    assert 0.01 < found[0].apart_mm <= 0.2
    assert not out


def test_the_number_of_states_is_bounded_and_the_rest_is_said():
    points = np.random.default_rng(1).normal(size=(30, 3)) * [20, 15, 10]
    mesh = trimesh.convex.convex_hull(points)
    every, _ = run(mesh)
    found, out = run(mesh, most=3)
    assert len(found) == 3
    assert len(every) > 4
    assert [item.reason.split(":")[0] for item in out] == [
        f"{len(every) - 3} states beyond the 3 most probable"
    ]
    assert out[0].probability == pytest.approx(sum(item.state.probability for item in every[3:]))


def test_what_is_improbable_is_judged_after_merging():
    mesh = trimesh.creation.cylinder(10, 30, sections=12)
    found, out = run(mesh, least_probability=0.05)
    assert sorted(counts(found)) == [2, 12]
    found, out = run(trimesh.creation.box((30, 20, 10)), least_probability=0.2)
    assert counts(found) == [2, 2]
    assert [item.reason for item in out] == ["improbable: 11 %"]


def _blocks(cuts, solid_cells):
    """The surface of those cells of a grid, the same in x, y and z, that are solid."""
    n = len(cuts) - 1
    cells = np.zeros((n + 2,) * 3, dtype=bool)
    cells[1:-1, 1:-1, 1:-1] = solid_cells
    quads = []
    for axis in range(3):
        behind = np.roll(cells, 1, axis=axis)
        for index in np.argwhere(cells != behind):
            u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
            ring = [index, index + u, index + u + v, index + v]
            quads.append(ring[::-1] if cells[tuple(index)] else ring)
    corners = np.array(quads) - 1
    triangles = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    points, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return trimesh.Trimesh(cuts[points], faces.reshape(-1, 3), process=False)


def test_an_engraving_between_the_sections_keeps_states_apart():
    cuts = np.r_[0.0, 0.2, np.linspace(1.1, 18.9, 16), 19.8, 20.0] - 10.0
    plain = np.ones((19, 19, 19), dtype=bool)
    engraved = plain.copy()
    engraved[6, 0, 11] = False  # 0.2 mm deep
    whole, mesh = _blocks(cuts, plain), _blocks(cuts, engraved)
    assert whole.is_watertight
    assert mesh.is_watertight
    assert counts(run(whole)[0]) == [6]
    states, _ = stable_states(solid(mesh))
    seen = {}

    def slices_of(state, heights_mm):
        seen[state.name] = slicer(mesh)(state, heights_mm)
        return seen[state.name]

    found, _ = merge_states(solid(mesh), states, slices_of, 0.05)
    full = [name for name, sections in seen.items() if all(abs(item.area - 400) < 1e-6 for item in sections)]
    assert len(full) == 4, "seen by their sections alone, four states are those of a plain cube"
    assert counts(found) == [1] * 6


def test_a_cube_with_letters_has_six_states():
    mesh = trimesh.load_mesh(cad_file("20mm-xyz-cube.stl"))
    mesh.merge_vertices()
    assert counts(run(mesh)[0]) == [1] * 6


def test_a_prism_of_64_sides_stands_or_lies():
    found, out = run(trimesh.creation.cylinder(10, 30, sections=64), within=0.01)
    assert sorted(counts(found)) == [2, 64]
    assert max(item.apart_mm for item in found) < 1e-4
    assert not out


@pytest.mark.parametrize("again", [(6, 18, 7), (12, 0, 7), (12, 18, 11)])
def test_sections_that_allow_four_motions_are_tried_with_all(again):
    # Sections are squares; dents between them, alike by half a turn, tell which turn is right.
    cuts = np.r_[0.0, 0.2, np.linspace(1.1, 18.9, 16), 19.8, 20.0] - 10.0
    cells = np.ones((19, 19, 19), dtype=bool)
    cells[6, 0, 11] = cells[again] = False
    found, _ = run(_blocks(cuts, cells))
    assert sorted(counts(found)) == [1, 1, 2, 2]


def test_a_limit_of_proofs_is_said():
    found, out = run(trimesh.creation.box((30, 20, 10)), effort=0)
    assert counts(found) == [1] * 6
    reason = "not compared, it would take too long: 3 states may be as others are"
    assert [(item.reason, item.probability) for item in out] == [(reason, 0.0)]
