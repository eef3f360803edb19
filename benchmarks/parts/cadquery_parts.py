"""Parts made and written as STEP files by CadQuery (Open CASCADE), for `bench_import.py`.

python -m venv cadquery && cadquery/bin/pip install cadquery
cadquery/bin/python benchmarks/parts/cadquery_parts.py FOLDER
"""

import math
import sys
from pathlib import Path

import cadquery as cq
from cadquery import exporters


def gear(teeth, radius, height):
    points = []
    for k in range(teeth):
        for part, share in ((-0.25, 0.88), (-0.15, 1.0), (0.15, 1.0), (0.25, 0.88)):
            angle = 2 * math.pi * (k + part) / teeth
            points.append((share * radius * math.cos(angle), share * radius * math.sin(angle)))
    return cq.Workplane().polyline(points).close().extrude(height)


def turned(*points):
    return cq.Workplane("XZ").polyline(points).close().revolve(360, (0, 0, 0), (0, 1, 0))


def bolt(across, head, radius, length):
    return (
        cq.Workplane().polygon(6, across).extrude(head).faces(">Z").workplane().circle(radius).extrude(length)
    )


def parts():
    """Names and parts: round ones, prisms, and what is between."""
    top = ">Z"
    plane = cq.Workplane
    return {
        "ball": plane().sphere(10),
        "block": plane().box(30, 20, 15),
        "block_fillet": plane().box(40, 25, 12).edges("|Z").fillet(4),
        "block_hole": plane().box(40, 25, 12).faces(top).workplane().hole(8),
        "bolt_m5": bolt(9.2, 3.5, 2.5, 20),
        "bolt_m8": bolt(15, 5.3, 4, 30),
        "bracket": plane().box(40, 30, 5).faces(top).workplane().center(-15, 0).rect(5, 30).extrude(25),
        "cap": plane().circle(15).extrude(14).faces("<Z").shell(-2),
        "cone": plane().add(cq.Solid.makeCone(15, 5, 30)),
        "cone_sharp": plane().add(cq.Solid.makeCone(15, 0, 30)),
        "cylinder_flat": plane().circle(15).extrude(15),
        "cylinder_tall": plane().circle(10).extrude(40),
        "dome": plane().sphere(15).intersect(plane().box(40, 40, 40).translate((0, 0, 20))),
        "flange": (
            plane()
            .circle(25)
            .extrude(6)
            .faces(top)
            .workplane()
            .circle(12)
            .extrude(15)
            .faces("<Z")
            .workplane()
            .polarArray(18, 0, 360, 4)
            .hole(5)
        ),
        "gear12": gear(12, 14, 8),
        "gear20": gear(20, 20, 10).faces(top).workplane().hole(6),
        "half_cylinder": plane().moveTo(-15, 0).threePointArc((0, 15), (15, 0)).close().extrude(25),
        "hexagonal_bar": plane().polygon(6, 20).extrude(40),
        "knob": plane()
        .circle(8)
        .extrude(10)
        .faces(top)
        .workplane()
        .circle(14)
        .extrude(12)
        .edges(top)
        .fillet(4),
        "nut_m12": plane().polygon(6, 21).circle(6).extrude(10.8),
        "oval": plane().ellipse(20, 12).extrude(15),
        "petri_dish": plane().circle(30).extrude(14).faces(top).shell(-1.5),
        "pin_chamfer": plane().circle(6).extrude(30).edges().chamfer(1),
        "pulley": turned((4, 0), (18, 0), (18, 3), (14, 7), (14, 9), (18, 13), (18, 16), (4, 16)),
        "slot": plane().slot2D(40, 16).extrude(12),
        "stepped_shaft": (
            plane()
            .circle(12)
            .extrude(12)
            .faces(top)
            .workplane()
            .circle(8)
            .extrude(14)
            .faces(top)
            .workplane()
            .circle(5)
            .extrude(10)
        ),
        "torus": plane().add(cq.Solid.makeTorus(15, 5)),
        "t_slot": plane()
        .polyline(
            [
                (-15, 0),
                (15, 0),
                (15, 6),
                (6, 6),
                (6, 16),
                (15, 16),
                (15, 20),
                (-15, 20),
                (-15, 16),
                (-6, 16),
                (-6, 6),
                (-15, 6),
            ]
        )
        .close()
        .extrude(25),
        "tube": plane().circle(11).circle(9).extrude(35),
        "vial": turned((0, 0), (2, 0.5), (5.3, 18), (5.3, 36), (6.5, 36), (6.5, 39), (0, 39)),
        "washer": plane().circle(14).circle(6).extrude(2.5),
        "washer_thick": plane().circle(20).circle(8).extrude(12),
        "wedge": cq.Workplane("XZ").polyline([(0, 0), (40, 0), (40, 20)]).close().extrude(20),
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    for name, part in parts().items():
        exporters.export(part, str(folder / f"{name}.step"))
