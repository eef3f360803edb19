"""What is the surface of a body and what is not; volumes by trimesh."""

import numpy as np
import pytest
import trimesh

from palpate.base.errors import InputError
from palpate.cad.mesh_checks import check_solids


def box(extents=(10, 20, 30), at=(0, 0, 0)):
    shape = trimesh.creation.box(extents)
    shape.apply_translation(at)
    return shape


def read(*shapes, units=None, drop=()):
    both = trimesh.util.concatenate(shapes)
    return check_solids("part.stl", "part", both.vertices, np.delete(both.faces, drop, axis=0), units=units)


def volume(solid):
    return trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False).volume


def refusal(*shapes, **options):
    with pytest.raises(InputError) as caught:
        read(*shapes, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def inverted(shape):
    shape.invert()
    return shape


def test_bodies_that_do_not_touch_are_solids_of_their_own():
    solids = read(box(), box((5, 5, 5), (50, 0, 0)))
    assert [solid.name for solid in solids] == ["part-1", "part-2"]
    assert [volume(solid) for solid in solids] == pytest.approx([6000, 125])
    assert all(len(np.unique(solid.faces)) == len(solid.vertices_mm) == 8 for solid in solids)


def test_repeated_and_nearly_equal_corners_are_one_vertex_and_the_move_is_told():
    shape = box()
    rng = np.random.default_rng(0)
    corners = shape.triangles.reshape(-1, 3) + rng.uniform(-1e-6, 1e-6, (36, 3))
    (solid,) = check_solids("part.stl", "part", corners, np.arange(36).reshape(-1, 3))
    assert len(solid.vertices_mm) == 8
    assert 0 < solid.off_mm < 1e-5
    assert volume(solid) == pytest.approx(6000, rel=1e-5)


def test_a_solid_that_is_inside_out_is_turned():
    (solid,) = read(inverted(box()))
    assert volume(solid) == pytest.approx(6000)


@pytest.mark.parametrize("all_inverted", [False, True])
def test_a_shell_within_is_a_void_and_a_body_in_the_void_is_its_own(all_inverted):
    shapes = [box((30, 30, 30)), inverted(box((20, 20, 20))), box((5, 5, 5))]
    solids = read(*(inverted(shape) if all_inverted else shape for shape in shapes))
    assert [volume(solid) for solid in solids] == pytest.approx([27000 - 8000, 125])


def test_a_shell_within_that_faces_the_same_way_is_refused():
    assert "lies inside another" in refusal(box((30, 30, 30)), box((5, 5, 5)))


def test_a_missing_face_names_one_edge_and_counts_the_others():
    message = refusal(box(), drop=[0])
    assert message.startswith("part.stl: is not watertight: the edge from (")
    assert "belongs to 1 face (and 2 more edges)" in message


def test_an_edge_of_four_faces_is_refused():
    assert "belongs to 4 faces" in refusal(box((10, 10, 10)), box((10, 10, 10), (10, 10, 0)))


def test_a_face_that_is_turned_over_is_refused():
    shape = box()
    faces = shape.faces.copy()
    faces[3] = faces[3][::-1]
    with pytest.raises(InputError, match="one face is turned over"):
        check_solids("part.stl", "part", shape.vertices, faces)


def test_bodies_that_overlap_are_refused_with_a_place_on_both():
    message = refusal(box((10, 10, 10)), box((10, 10, 10), (5, 5, 5)))
    place = np.array([float(x) for x in message.split("at (")[1].split(")")[0].split(",")])
    assert np.abs(place).max() == pytest.approx(5)
    assert np.abs(place - 5).max() == pytest.approx(5)


@pytest.mark.parametrize(
    ("scale", "units", "said"),
    [
        (1000, "m", "its largest side is 30000 mm; it must be from 1 mm to 1000 mm (it would be 30 mm if"),
        (0.01, "mm", "0.3 mm; it must be from 1 mm to 1000 mm (it would be 7.62 mm if its unit were inch"),
        (100, None, "3000 mm; it must be from 1 mm to 1000 mm"),
    ],
)
def test_sizes_out_of_range_are_refused_with_the_unit_that_would_fit(scale, units, said):
    shape = box()
    shape.apply_scale(scale)
    message = refusal(shape, units=units)
    assert said in message
    assert units is not None or "its unit" not in message


def test_numbers_that_are_none_are_refused():
    shape = box()
    vertices = np.array(shape.vertices)
    vertices[2, 1] = np.nan
    with pytest.raises(InputError, match=r"nan.*must be finite"):
        check_solids("part.stl", "part", vertices, shape.faces)


def test_a_sheet_of_two_sides_encloses_nothing_or_overlaps():
    with pytest.raises(InputError, match=r"overlap|no volume"):
        check_solids(
            "p", "p", np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0.0]]), np.array([[0, 1, 2], [0, 2, 1]])
        )


def test_no_faces_are_refused():
    with pytest.raises(InputError, match="has no faces"):
        check_solids("p", "p", np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))
