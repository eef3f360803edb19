"""Polygons of OBJ files: concave ones as triangles, judged by shapely's areas and trimesh's volumes."""

import itertools
import math

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.cad.mesh_files import triangulate_concave
from palpate.cad.readers import read_solids

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
    (solid,) = read_solids(path, "mm", 0.05)
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
