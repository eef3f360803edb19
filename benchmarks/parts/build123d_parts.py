"""Parts made and written as STEP files by build123d, for `bench_import.py`: round ones, prisms, and between.

python -m venv build123d && build123d/bin/pip install build123d
build123d/bin/python benchmarks/parts/build123d_parts.py FOLDER
"""

import sys
from pathlib import Path

import build123d as b


def plate(outline, thickness):
    return b.extrude(outline, thickness)


def spool():
    return b.Cylinder(16, 3) + b.Pos(0, 0, 9) * b.Cylinder(7, 15) + b.Pos(0, 0, 18) * b.Cylinder(16, 3)


def rounded(part, radius, axis=b.Axis.Z):
    return b.fillet(part.edges().filter_by(axis), radius)


def parts():
    """Names and parts."""
    grooved = b.Cylinder(9, 36) - (b.Cylinder(9, 4) - b.Cylinder(7, 4))
    return {
        "b3d_bead": b.Sphere(8) - b.Cylinder(3, 20),
        "b3d_bushing": b.Cylinder(14, 22) - b.Cylinder(9, 22),
        "b3d_capsule": b.Cylinder(8, 24) + b.Pos(0, 0, 12) * b.Sphere(8) + b.Pos(0, 0, -12) * b.Sphere(8),
        "b3d_channel": b.Box(50, 24, 24) - b.Pos(0, 0, 4) * b.Box(50, 16, 24),
        "b3d_cone_blunt": b.Cone(18, 9, 20),
        "b3d_counterbore": b.Box(36, 36, 14) - b.Cylinder(5, 14) - b.Pos(0, 0, 5) * b.Cylinder(9, 4),
        "b3d_cross": plate(b.Rectangle(44, 14) + b.Rectangle(14, 44), 13),
        "b3d_cube": b.Box(22, 22, 22),
        "b3d_d_shaft": b.Cylinder(10, 34) - b.Pos(12, 0, 0) * b.Box(10, 30, 40),
        "b3d_disc_chamfered": b.chamfer(b.Cylinder(20, 12).edges(), 2),
        "b3d_ellipsoid_slab": plate(b.Ellipse(24, 15), 11),
        "b3d_grooved_pin": grooved,
        "b3d_heart": plate(
            b.Circle(10) + b.Pos(14, 0) * b.Circle(10) + b.Pos(7, -9) * b.Rectangle(18, 18), 12
        ),
        "b3d_hemisphere_shell": (b.Sphere(18) - b.Sphere(15)) & b.Pos(0, 0, 20) * b.Box(60, 60, 40),
        "b3d_l_rounded": rounded(plate(b.Rectangle(40, 15) + b.Pos(-12.5, 15) * b.Rectangle(15, 40), 12), 3),
        "b3d_ogive": b.revolve(
            b.make_face(
                [
                    b.Line((0, 0), (10, 0)),
                    b.ThreePointArc((10, 0), (8, 16), (2, 30)),
                    b.Line((2, 30), (0, 30)),
                    b.Line((0, 30), (0, 0)),
                ]
            ).rotate(b.Axis.X, 90),
            b.Axis.Z,
        ),
        "b3d_prism_5": plate(b.RegularPolygon(15, 5), 20),
        "b3d_ring_square": b.Box(40, 40, 12) - b.Box(24, 24, 12),
        "b3d_spool": spool(),
        "b3d_tee": rounded(b.Box(46, 12, 14) + b.Pos(0, 17, 0) * b.Box(12, 24, 14), 2),
        "b3d_trapezoid": plate(b.Trapezoid(46, 24, 60), 15),
        "b3d_washer_conical": b.Cone(16, 12, 6) - b.Cylinder(6, 10),
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    for name, part in parts().items():
        b.export_step(part, str(folder / f"{name}.step"))
