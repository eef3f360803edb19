"""Mesh files: reading, checks, self-crossing, polygons of OBJ."""

import itertools
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from palpate.base.errors import InputError
from palpate.cad.mesh_checks import check_solids
from palpate.cad.mesh_files import triangulate_concave
from palpate.cad.mesh_topology import triangle_surface_of, vertex_rounding
from palpate.cad.readers import is_drawing, read_drawings, read_solids
from palpate.cad.self_crossing import find_crossings, height_fields
from support.commands.repository import cad_file

# ----------------------------------------------------------------------------------------------------
# Mesh files written by trimesh and by CAD programs, and what is left of them when they are damaged.


def volume(solid):
    return trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False).volume


@pytest.mark.parametrize(
    ("name", "units", "side_mm"),
    [
        ("20mm-xyz-cube.stl", "mm", 20.0),
        ("7_8ths_cube.stl", "mm", 40.0),
        ("angle_block.STL", "inch", 34.34),
        ("featuretype.STL", "inch", 127.0),
    ],
)
def test_files_of_cad_programs(name, units, side_mm):
    (solid,) = read_solids(cad_file(name), units, 0.05).solids
    oracle = trimesh.load_mesh(cad_file(name))
    scale = {"mm": 1.0, "inch": 25.4}[units]
    assert volume(solid) == pytest.approx(oracle.volume * scale**3, rel=1e-6)
    assert len(solid.faces) == len(oracle.faces)
    assert np.ptp(solid.vertices_mm, axis=0).max() == pytest.approx(side_mm, rel=1e-3)
    assert solid.name == Path(name).stem


def test_faces_that_lie_back_to_back_are_left_out():
    """The file has one pair, in which its hole was cut."""
    (solid,) = read_solids(cad_file("wallhole.obj"), "mm", 0.05).solids
    oracle = trimesh.load_mesh(cad_file("wallhole.obj"))
    assert len(solid.faces) == len(oracle.faces) - 2
    assert volume(solid) == pytest.approx(oracle.volume, rel=1e-9)
    assert any("2 faces" in line for line in solid.mended)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply"])
def test_formats_without_units(tmp_path, kind):
    shape = trimesh.creation.cylinder(0.5, 1.0, sections=12)
    path = tmp_path / f"part.{kind[:3]}"
    shape.export(path, file_type=kind)
    (solid,) = read_solids(path, "inch", 0.05).solids
    assert volume(solid) == pytest.approx(shape.volume * 25.4**3, rel=1e-5)
    with pytest.raises(
        InputError, match=f"{kind[:3].upper()} files have no units: give their units: mm, inch or m"
    ):
        read_solids(path, None, 0.05)
    data = path.read_bytes()
    for length in (0, 3, 60, len(data) // 2, len(data) - 40):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            read_solids(path, "inch", 0.05)


def test_an_stl_in_metres(tmp_path):
    """A ring of twelve corners: area 12 / 2 · sin 30° · (20² − 10²) mm²."""
    path = tmp_path / "part.stl"
    trimesh.creation.annulus(0.01, 0.02, 0.007, sections=12).export(path)
    (solid,) = read_solids(path, "m", 0.05).solids
    assert volume(solid) == pytest.approx(900.0 * 7, rel=1e-6)
    assert np.ptp(solid.vertices_mm[:, 2]) == pytest.approx(7.0, rel=1e-6)


@pytest.mark.parametrize(("kind", "order"), [("big", ">"), ("little", "<")])
def test_a_binary_ply_of_quadrangles(tmp_path, kind, order):
    """An oblique box, in either order of bytes: 12 · 8 · 5 mm³."""
    box = [(0, 0, 0), (12, 0, 0), (12, 8, 0), (0, 8, 0), (3, 2, 5), (15, 2, 5), (15, 10, 5), (3, 10, 5)]
    faces = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    rows = np.array([(4, face) for face in faces], dtype=[("count", "u1"), ("corners", f"{order}i4", 4)])
    head = (
        f"ply\nformat binary_{kind}_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
        "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path = tmp_path / "part.ply"
    path.write_bytes(head.encode() + np.array(box, dtype=f"{order}f4").tobytes() + rows.tobytes())
    (solid,) = read_solids(path, "mm", 0.05).solids
    assert volume(solid) == pytest.approx(480.0, rel=1e-6)


def test_a_second_solid_that_is_cut_off_is_missed(tmp_path):
    text = trimesh.creation.box((9, 9, 9)).export(file_type="stl_ascii")
    path = tmp_path / "two.stl"
    path.write_text(text + text[: len(text) // 2])
    with pytest.raises(InputError, match="cut short"):
        read_solids(path, "mm", 0.05)


def test_names_in_latin_1_are_read(tmp_path):
    path = tmp_path / "part.stl"
    text = trimesh.creation.box((9, 9, 9)).export(file_type="stl_ascii")
    path.write_bytes(text.replace("solid ", "solid Gehäuse", 1).encode("latin-1"))
    assert len(read_solids(path, "mm", 0.05).solids) == 1


def test_an_obj_of_two_materials_is_one_body(tmp_path):
    lines = trimesh.creation.box((9, 9, 9)).export(file_type="obj").splitlines()
    lines.insert(-5, "usemtl red")
    path = tmp_path / "part.obj"
    path.write_text("\n".join(["mtllib none.mtl", *lines]))
    (solid,) = read_solids(path, "mm", 0.05).solids
    assert len(solid.faces) == 12


def test_an_obj_that_counts_backwards_is_the_same_solid(tmp_path):
    """Faces between vertices, each counted from where it stands, with normals and textures, too."""
    mesh = trimesh.creation.cylinder(5, 20, sections=12)
    lines = ["vn 0 0 1", "vt 0 0"]
    for count, face in enumerate(mesh.faces.tolist(), 1):
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices[face].tolist()]
        lines.append("f -3/-1/-1 -2/1/-1 " + (f"{3 * count}/1/1" if count % 2 else "-1/-1/-1"))
    path = tmp_path / "part.obj"
    path.write_text("\n".join(lines))
    (solid,) = read_solids(path, "mm", 0.05).solids
    assert volume(solid) == pytest.approx(mesh.volume)
    path.write_text("\n".join([f"{line} # face 0" if line[0] == "f" else line for line in lines]))
    assert volume(read_solids(path, "mm", 0.05).solids[0]) == pytest.approx(mesh.volume)
    path.write_text("\n".join([*lines, "f 0 1 2"]))
    with pytest.raises(InputError, match="a face has vertex 0; OBJ counts vertices from 1"):
        read_solids(path, "mm", 0.05)


def test_an_stl_may_end_its_solid_in_two_words(tmp_path):
    path = tmp_path / "part.stl"
    text = trimesh.creation.box((9, 9, 9)).export(file_type="stl_ascii")
    path.write_text(text.replace("endsolid", "end solid"))
    assert volume(read_solids(path, "mm", 0.05).solids[0]) == pytest.approx(729.0)


def test_a_3mf_file_has_units_names_and_each_shape_once(tmp_path):
    scene = trimesh.Scene()
    pin, plate = trimesh.creation.cylinder(2, 20, sections=16), trimesh.creation.box((30, 20, 3))
    scene.add_geometry(plate, geom_name="plate")
    scene.add_geometry(pin, geom_name="pin", node_name="a")
    move = trimesh.transformations.translation_matrix((0, 50, 0))
    scene.add_geometry(pin, geom_name="pin", node_name="b", transform=move)
    path = tmp_path / "set.3mf"
    scene.export(path)
    for units in (None, "mm"):
        solids = read_solids(path, units, 0.05).solids
        assert sorted((s.name.rstrip("_0123456789"), round(volume(s), 3)) for s in solids)[-1] == (
            "plate",
            1800.0,
        )
        assert volume(min(solids, key=volume)) == pytest.approx(pin.volume)
    with pytest.raises(InputError, match="millimeter, not in inch"):
        read_solids(path, "inch", 0.05)


@pytest.mark.parametrize(
    ("name", "hidden", "extra"),
    [
        ("part.stl", "trimesh", "cad"),
        ("part.step", "cascadio", "step"),
    ],
)
def test_a_missing_extra_is_named(tmp_path, monkeypatch, name, hidden, extra):
    path = tmp_path / name
    path.write_bytes(trimesh.creation.box((9, 9, 9)).export(file_type="stl"))
    monkeypatch.setitem(sys.modules, hidden, None)
    with pytest.raises(InputError, match=rf"needs {hidden}: .* -m pip install .*\[{extra}\]'"):
        read_solids(path, "mm" if name == "part.stl" else None, 0.05)


def test_what_is_read_by_whom(tmp_path):
    assert is_drawing(Path("a.DXF"))
    assert not is_drawing(Path("a.STP"))
    with pytest.raises(InputError, match=r"unknown kind of file; allowed are \.3mf, \.dxf"):
        is_drawing(Path("a.blend"))
    with pytest.raises(InputError, match="is a drawing"):
        read_solids(Path("a.svg"), None, 0.05)
    with pytest.raises(InputError, match="is a solid"):
        read_drawings(Path("a.stl"), None, 0.05)
    with pytest.raises(InputError, match="there is no such file"):
        read_solids(tmp_path / "a.stl", "mm", 0.05)


# ----------------------------------------------------------------------------------------------------
# What is the surface of a body and what is not; volumes by trimesh.


def box(extents=(10, 20, 30), at=(0, 0, 0)):
    shape = trimesh.creation.box(extents)
    shape.apply_translation(at)
    return shape


def read(*shapes, units=None, drop=()):
    both = trimesh.util.concatenate(shapes)
    return check_solids("part.stl", "part", both.vertices, np.delete(both.faces, drop, axis=0), units=units)


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


def test_fragments_beside_a_part_are_left_out_and_it_is_said():
    (part,) = read(box(), box((0.1, 0.2, 0.9), (50, 0, 0)), box((0.5, 0.5, 0.5), (0, 50, 0)))
    assert part.name == "part"
    assert volume(part) == pytest.approx(6000)
    assert part.mended == ("2 bodies were left out: smaller than 1 mm",)
    assert not any(solid.mended for solid in read(box(), box((1, 1, 1), (50, 0, 0))))
    small = refusal(box((2, 2, 4)), box((0.9, 0.9, 0.9), (50, 0, 0)), units="mm")
    assert "body 2 of 2: its largest side is 0.9 mm" in small
    assert "22.86 mm if its unit were inch" in small


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


def test_bodies_that_cross_and_are_no_bodies_are_refused_with_a_place_on_both():
    message = refusal(box((10, 10, 10)), inverted(box((10, 10, 10), (5, 5, 5))))
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


# ----------------------------------------------------------------------------------------------------
# Crossing surfaces: boxes and tetrahedra with known answers, and every edge against every face.

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])


def grid_box(lo, hi, cells, rng):
    """A box whose sides are cut into cells, each halved along a diagonal at random."""
    numbers: dict[tuple[int, ...], int] = {}
    faces = []
    for axis in range(3):
        u, w = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, 1):
            for i in range(cells[u]):
                for j in range(cells[w]):
                    ring = []
                    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        point = [0, 0, 0]
                        point[axis], point[u], point[w] = end * cells[axis], i + a, j + b
                        ring.append(numbers.setdefault(tuple(point), len(numbers)))
                    ring = ring if end else ring[::-1]
                    turn = int(rng.integers(2))
                    a, b, c, d = ring[turn:] + ring[:turn]
                    faces += [[a, b, c], [a, c, d]]
    return lo + (hi - lo) * np.array(list(numbers), dtype=float) / cells, np.array(faces)


def crossed(vertices, faces):
    return len(find_crossings(triangle_surface_of(vertices, faces, vertex_rounding(vertices))).pairs)


def test_boxes_on_a_grid():
    """Edges, corners and diagonals fall onto each other in every way; touching along them is allowed."""
    rng = np.random.default_rng(1)
    seen = {True: 0, False: 0}
    for trial in range(160):
        lo = rng.integers(0, 4, (2, 3)).astype(float)
        hi = lo + rng.integers(1, 4, (2, 3))
        cells = rng.integers(1, 4, (2, 3))
        (v0, f0), (v1, f1) = (grid_box(lo[k], hi[k], cells[k], rng) for k in (0, 1))
        vertices, faces = np.vstack([v0, v1]), np.vstack([f0, f1 + len(v0)])
        if trial % 2:
            vertices = Rotation.random(rng=rng).apply(vertices) * rng.uniform(1, 100) + rng.uniform(
                -10, 10, 3
            )
        if trial % 4 == 3:
            vertices = vertices.astype(np.float32).astype(float)
        common = np.minimum(hi[0], hi[1]) - np.maximum(lo[0], lo[1])
        nested = any((lo[a] < lo[b]).all() and (hi[a] > hi[b]).all() for a, b in ((0, 1), (1, 0)))
        # Faces that lie on each other overlap too.
        expected = bool(
            ((common > 0).all() and not nested) or ((common >= 0).all() and (common == 0).sum() == 1)
        )
        assert (crossed(vertices, faces) > 0) == expected, (trial, lo, hi, cells)
        seen[expected] += 1
    assert min(seen.values()) > 30


def test_tetrahedra_cross_unless_a_plane_separates_them_or_one_holds_the_other():
    rng = np.random.default_rng(2)
    seen = {True: 0, False: 0}
    for trial in range(150):
        a, b = rng.normal(size=(2, 4, 3))
        b = (b + rng.normal(size=3) * rng.uniform(0, 1.5)) * rng.uniform(0.2, 1)
        rows = np.vstack(
            [np.column_stack([-a, np.ones((4, 2))]), np.column_stack([b, -np.ones(4), np.ones(4)])]
        )
        margin = -linprog([0, 0, 0, 0, -1], rows, np.zeros(8), bounds=[(-1, 1)] * 3 + [(None, None)] * 2).fun
        held = any(
            (np.linalg.solve(np.vstack([outer.T, np.ones(4)]), np.vstack([inner.T, np.ones(4)])) > 0).all()
            for outer, inner in ((a, b), (b, a))
        )
        faces = [TETRAHEDRON if np.linalg.det(t[1:] - t[0]) < 0 else TETRAHEDRON[:, ::-1] for t in (a, b)]
        expected = margin < 1e-9 and not held
        assert (crossed(np.vstack([a, b]), np.vstack([faces[0], faces[1] + 4])) > 0) == expected, trial
        seen[expected] += 1
    assert min(seen.values()) > 30


def pierced_pairs(vertices, faces):
    """Pairs of faces of which an edge of one goes through the other: all edges against all faces."""
    found = set()
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    for index, face in enumerate(faces):
        for start, end in zip(face, np.roll(face, -1), strict=True):
            p, q = vertices[start], vertices[end]
            at_p, at_q = ((p - a) * normal).sum(axis=1), ((q - a) * normal).sum(axis=1)
            through = (at_p * at_q < 0) & ~np.isin(faces, [start, end]).any(axis=1)
            x = p + np.where(through, at_p / np.where(through, at_p - at_q, 1), 0)[:, None] * (q - p)
            for s, e in ((a, b), (b, c), (c, a)):
                through &= (np.cross(e - s, x - s) * normal).sum(axis=1) > 0
            found |= {tuple(sorted((index, int(other)))) for other in np.flatnonzero(through)}
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_crumpled_sphere_crosses_itself_where_edges_pierce_faces(seed):
    rng = np.random.default_rng(seed)
    sphere = trimesh.creation.icosphere(subdivisions=2)
    vertices = np.asarray(sphere.vertices) + rng.normal(scale=0.12, size=(len(sphere.vertices), 3))
    faces = np.asarray(sphere.faces)
    surface = triangle_surface_of(vertices, faces, vertex_rounding(vertices))
    found = {tuple(sorted(pair)) for pair in find_crossings(surface).pairs.tolist()}
    assert found
    assert found == pierced_pairs(vertices, faces)


@pytest.mark.parametrize(
    "shape",
    [
        trimesh.creation.icosphere(subdivisions=4),
        trimesh.creation.torus(20, 5, 40, 30),
        trimesh.creation.cylinder(10, 50, sections=400),
        trimesh.creation.cone(10, 50, sections=200),
    ],
)
def test_good_surfaces_do_not_cross_themselves_in_any_position(shape):
    shape.merge_vertices()
    faces = np.asarray(shape.faces)
    turn = Rotation.random(rng=np.random.default_rng(3))
    for vertices in (np.asarray(shape.vertices), turn.apply(shape.vertices).astype(np.float32).astype(float)):
        assert crossed(vertices, faces) == 0
        assert (
            height_fields(triangle_surface_of(vertices, faces, vertex_rounding(vertices))) >= 0
        ).mean() > 0.9


def test_a_face_folded_onto_its_neighbour_overlaps_it():
    """A flat box whose lid is not there: its walls have no height."""
    vertices = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [3, 3, 0.0]])
    assert crossed(vertices, TETRAHEDRON) >= 3


# ----------------------------------------------------------------------------------------------------
# Polygons of OBJ files: concave ones as triangles, judged by shapely's areas and trimesh's volumes.

HEIGHT_MM = 7.0
L_OUTLINE = [(0, 0), (30, 0), (30, 10), (10, 10), (10, 30), (0, 30)]
L_AREA_MM2 = 500.0
FRAME = [(0, 0), (0, 20), (20, 20), (20, 0), (0, 0), (5, 5), (15, 5), (15, 15), (5, 15), (5, 5)]
"""A keyhole polygon: a square with a square hole, joined by a slit that is walked twice."""


def prism(outline, axes=(0, 1, 2), token="{0}"):
    """An OBJ file of a prism whose two caps are one polygon each."""
    places = [tuple(p) for p in outline]
    corners = list(dict.fromkeys(places))
    n = len(corners)
    lines = []
    for z in (0.0, HEIGHT_MM):
        for x, y in corners:
            xyz = (x, y, z)
            lines.append("v " + " ".join(repr(float(xyz[a])) for a in axes))
    cap = [corners.index(p) for p in places]
    faces = [[n + c for c in cap], cap[::-1]]
    sides = list(zip(cap, cap[1:] + cap[:1], strict=True))
    slits = [(a, b) for a, b in sides if (b, a) in sides]
    faces += [[a, b, n + b, n + a] for a, b in sides if (a, b) not in slits and a != b]
    lines += ["f " + " ".join(token.format(c + 1) for c in face) for face in faces]
    return "\n".join(lines).encode() + b"\n"


def volume_mm3(data, tmp_path):
    path = tmp_path / "part.obj"
    path.write_bytes(data)
    (solid,) = read_solids(path, "mm", 0.05).solids
    mesh = trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False)
    assert mesh.is_watertight
    return mesh.volume


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("axes", list(itertools.permutations(range(3))))
def test_a_concave_cap_is_read_whatever_its_first_corner_and_its_plane(tmp_path, first, axes):
    outline = L_OUTLINE[first:] + L_OUTLINE[:first]
    assert volume_mm3(prism(outline, axes), tmp_path) == pytest.approx(L_AREA_MM2 * HEIGHT_MM)


def test_a_hole_on_a_slit_stays_a_hole(tmp_path):
    assert volume_mm3(prism(FRAME), tmp_path) == pytest.approx(300 * HEIGHT_MM)


def test_corners_with_texture_and_normals_are_read(tmp_path):
    data = prism(L_OUTLINE[3:] + L_OUTLINE[:3], token="{0}/1/1")
    data = b"vt 0 0\nvn 0 0 1\n" + data.replace(b"\n", b"\r\n")
    assert volume_mm3(data, tmp_path) == pytest.approx(L_AREA_MM2 * HEIGHT_MM)


def test_an_outline_that_crosses_itself_stays_refused(tmp_path):
    with pytest.raises(InputError, match="itself"):
        volume_mm3(prism([(0, 0), (20, 20), (20, 0), (0, 20)]), tmp_path)


@pytest.mark.parametrize(
    "data",
    [
        trimesh.creation.box((9, 9, 9)).export(file_type="obj").encode(),
        prism([(0, 0), (9, 0), (9, 9), (0, 9)]),
        prism(L_OUTLINE).replace(b"f 7 8 9", b"f 77 8 9").replace(b"f 6 5 4", b"f -6 x 4"),
        b"v 0 0 zero\n" + prism(L_OUTLINE),
    ],
    ids=["triangles", "convex polygons", "corners that are not there", "a number that is none"],
)
def test_what_needs_no_cut_or_cannot_be_cut_is_left_to_trimesh(data):
    assert triangulate_concave(data) is data


@given(st.lists(st.floats(2.0, 40.0), min_size=4, max_size=12), st.floats(0.0, 2 * math.pi))
def test_triangles_cover_the_polygon_and_turn_with_it(radii, tilt):
    angles = np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    flat = np.array(radii)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    u, v = np.array([math.cos(tilt), math.sin(tilt), 0.3]), np.array([-math.sin(tilt), math.cos(tilt), 2.0])
    points = flat @ np.array([u, v])
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    text += "f " + " ".join(str(i + 1) for i in range(len(radii))) + "\n"
    lines = triangulate_concave(text.encode()).decode().split("\n")
    faces = [[int(token) - 1 for token in line.split()[1:]] for line in lines if line.startswith("f ")]
    if len(faces) == 1:  # convex
        hull = shapely.Polygon(flat).convex_hull
        assert hull.area == pytest.approx(shapely.Polygon(flat).area, rel=1e-6)
        return
    triangles = [shapely.Polygon(flat[face]) for face in faces]
    assert all(len(face) == 3 for face in faces)
    assert all(shapely.is_ccw(triangle.exterior) for triangle in triangles)
    assert shapely.union_all(triangles).area == pytest.approx(shapely.Polygon(flat).area)
    assert sum(triangle.area for triangle in triangles) == pytest.approx(shapely.Polygon(flat).area)
