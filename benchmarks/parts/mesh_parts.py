"""Parts as meshes, by manifold3d and trimesh, for `bench_import.py`: STL, OBJ, PLY and 3MF files in mm.

python -m venv meshes && meshes/bin/pip install manifold3d trimesh scipy networkx lxml
meshes/bin/python benchmarks/parts/mesh_parts.py FOLDER
"""

import math
import sys
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold


def mesh_of(solid):
    made = solid.to_mesh()
    return trimesh.Trimesh(np.asarray(made.vert_properties)[:, :3], np.asarray(made.tri_verts), process=False)


def polygon(count, radius):
    return CrossSection(
        [
            [
                (radius * math.cos(k * math.tau / count), radius * math.sin(k * math.tau / count))
                for k in range(count)
            ]
        ]
    )


def star(points, inner, outer):
    radii = [outer if k % 2 == 0 else inner for k in range(2 * points)]
    return CrossSection(
        [
            [
                (r * math.cos(k * math.pi / points), r * math.sin(k * math.pi / points))
                for k, r in enumerate(radii)
            ]
        ]
    )


def parts():
    """File names and meshes."""
    round_ = 96
    cylinder = Manifold.cylinder
    ring = cylinder(9, 20, 20, round_) - cylinder(9, 13, 13, round_)
    plate = Manifold.cube((46, 28, 14), True)
    holes = cylinder(30, 4, 4, 48, True)
    knob = cylinder(12, 7, 7, round_) + cylinder(14, 15, 12, round_).translate((0, 0, 11))
    solids = {
        "mf_block_two_holes.stl": plate - holes.translate((12, 0, 0)) - holes.translate((-12, 0, 0)),
        "mf_cone.stl": cylinder(26, 14, 4, round_),
        "mf_cylinder.ply": cylinder(24, 12, 12, round_),
        "mf_frustum_6.obj": cylinder(18, 16, 10, 6),
        "mf_half_ring.stl": ring - Manifold.cube((60, 60, 60), True).translate((0, 30, 0)),
        "mf_knob.3mf": knob,
        "mf_pocket.obj": plate - Manifold.cube((30, 14, 10), True).translate((0, 0, 5)),
        "mf_ring.stl": ring,
        "mf_star.ply": Manifold.extrude(star(5, 9, 22), 14),
        "mf_twisted_square.stl": Manifold.extrude(CrossSection.square((24, 24), True), 18, 12, 20),
        "mf_triangle.3mf": Manifold.extrude(polygon(3, 20), 16),
        "mf_u.stl": Manifold.cube((40, 30, 14), True)
        - Manifold.cube((20, 22, 20), True).translate((0, 8, 0)),
    }
    creation = trimesh.creation
    made = {
        "tm_annulus.stl": creation.annulus(10, 18, 16, sections=72),
        "tm_box.obj": creation.box((34, 22, 12)),
        "tm_capsule.stl": creation.capsule(22, 9, count=(48, 48)),
        "tm_cylinder_32.stl": creation.cylinder(15, 18, sections=32),
        "tm_icosphere.ply": creation.icosphere(4, 12),
        "tm_tetrahedron.stl": trimesh.Trimesh(
            [(0, 0, 0), (40, 0, 0), (12, 34, 0), (16, 12, 30)],
            [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)],
        ),
    }
    return {name: mesh_of(solid) for name, solid in solids.items()} | made


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    for name, part in parts().items():
        part.export(folder / name)
