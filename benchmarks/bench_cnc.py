"""A part in a machine tool's vice, named and located by a ball probe: `python benchmarks/bench_cnc.py`.

The machine is grbl's own firmware, built for this computer (PALPATE_GRBL names a checkout of it), at 800
steps a mm. `examples/cnc_probe.py` drives it. A geometry kernel closes the probe's contact where a ball of
3 mm meets one of 20 outlines; the ball is 0.0175 mm beside where grbl has it, in another direction at each
search: what steps and digits add makes that the bound of 0.02 mm. Poses: turned anyhow, the middle of the
area within 10 mm of the workspace's.

The corner routine of a sender is made on the same machine for the same poses: two touches on the longest
edge of the hull that the outline lies on, one on the edge most across it. It is told the part, and its pose
to 1 mm and 2 degrees.

`--strangers`: the part in the vice is none of the file's; whatever is identified is wrong.

One line for each pose, then the table. "overlap": the deepest that the ball was in the part while it did not
search; a search at 5 mm/s ends in it, as grbl stops within what it has buffered.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from cnc_probe import Grbl, locate

import palpate
from support.commands.repository import SHARED_OUTLINES
from support.devices.grbl.grbl import SETTINGS, WHY_NOT, Machine, build
from support.oracles.shapely_touches import (
    Placed,
    equivalent_configurations,
    holding_truth,
    outlines,
    place_within,
    turned,
    unit,
)

PARTS, EACH = 20, 6  # every sixth outline, of which no two are alike
MIDDLE_MM, RADIUS_MM, AREA_MM = np.array([-210.0, -160.0]), 95.0, 10.0
Z_MM, SAFE_Z_MM, TOP_MM, BALL_MM, HEIGHT_MM = -40.0, -15.0, -30.0, 1.5, 10.0
HELD_MM, BOUND_MM = 0.0175, 0.02
ROUGH_MM, ROUGH_RAD = 1.0, math.radians(2)
_LEAST_ACROSS = 0.3  # sine between edges that give a corner


def poses(first: int, count: int) -> Iterator[tuple[int, Placed, np.random.Generator]]:
    """Each part in turn, somewhere in the workspace."""
    models = outlines(SHARED_OUTLINES)[::EACH][:PARTS]
    for number in range(first, first + count):
        rng, reach = np.random.default_rng([number, 50]), math.inf
        while reach >= RADIUS_MM:
            drawn = place_within(models[number % len(models)], rng)
            centre = shapely.get_coordinates(drawn.shape.centroid)[0]
            shift = (
                MIDDLE_MM - centre + AREA_MM * math.sqrt(rng.uniform()) * unit(rng.uniform(0, 2 * math.pi))
            )
            placed = replace(drawn, x=drawn.x + shift[0], y=drawn.y + shift[1])
            reach = shapely.hausdorff_distance(placed.shape, shapely.Point(MIDDLE_MM))
        yield number, placed, rng


def located(grbl: Grbl, machine: Machine, placed: Placed, objects: str) -> dict[str, object]:
    """What `examples/cnc_probe.py` finds."""
    tip = palpate.Finger(BALL_MM, HEIGHT_MM, shape=palpate.TipShape.BALL)
    begin_s, begin = machine.seconds, time.process_time()
    plan = locate(grbl, objects, *MIDDLE_MM.tolist(), RADIUS_MM, tip)
    holding = holding_truth(plan.planned.recognition, placed)
    row: dict[str, object] = {
        "verdict": str(plan.verdict),
        "touches": len(plan.contacts.contacts),
        "machine_s": machine.seconds - begin_s,
        "compute_s": time.process_time() - begin,
        "outside": holding is None,
        "wrong": False,
    }
    if plan.verdict == "identified":
        found = plan.hypotheses[0]
        at, bounds, state = found.configuration, found.bounds, found.state
        row["wrong"] = state.object_name != placed.model.name
        row["bound_mm"] = bounds.position_half_mm
        row["bound_deg"] = math.degrees(bounds.orientation_half_rad)
        errors = [
            (math.hypot(x - at.x_mm, y - at.y_mm), abs(theta - at.theta_rad))
            for x, y, theta in equivalent_configurations(placed, state.symmetry_order, state.origin_mm)
        ]
        row["off_mm"], off_rad = min(errors, key=lambda item: item[1])
        row["off_deg"] = math.degrees(off_rad)
    return row


def hull_edges(placed: Placed) -> list[tuple[np.ndarray, np.ndarray]]:
    """Edges of the outline (object frame) that lie on its hull, counter-clockwise, the longest first."""
    outer = shapely.geometry.polygon.orient(
        shapely.Polygon(placed.model.states[0].sections[0].polygons[0].outer)
    )
    ring = shapely.get_coordinates(outer.exterior)
    edges = [
        (a, b)
        for a, b in pairwise(ring)
        if np.all((b[0] - a[0]) * (ring[:, 1] - a[1]) - (b[1] - a[1]) * (ring[:, 0] - a[0]) >= -1e-9)
    ]
    return sorted(edges, key=lambda edge: -float(np.linalg.norm(edge[1] - edge[0])))


def cornered(grbl: Grbl, machine: Machine, placed: Placed, rng: np.random.Generator) -> dict[str, object]:
    """What the corner routine finds, told the part and about where it lies."""
    told = replace(
        placed,
        x=placed.x + rng.uniform(-ROUGH_MM, ROUGH_MM),
        y=placed.y + rng.uniform(-ROUGH_MM, ROUGH_MM),
        theta=placed.theta + rng.uniform(-ROUGH_RAD, ROUGH_RAD),
    )
    edges = hull_edges(placed)
    direction = [math.atan2(*(b - a)[::-1]) for a, b in edges]
    across = max(range(len(edges)), key=lambda k: abs(math.sin(direction[k] - direction[0])))
    if abs(math.sin(direction[across] - direction[0])) < _LEAST_ACROSS:
        return {"failed": True}
    grbl.send("G4 P0.01")
    begin_s = machine.seconds
    ends = []
    for edge, share in ((0, 0.2), (0, 0.8), (across, 0.5)):
        a, b = edges[edge]
        outward = unit(direction[edge] - math.pi / 2)
        start = told.on_table(a + share * (b - a) + (BALL_MM + 5.0) * outward)
        way = palpate.FingerApproach(
            palpate.Finger(BALL_MM, HEIGHT_MM),
            tuple(start.tolist()),
            direction[edge] + math.pi / 2 + told.theta,
            12.0,
            0.0,
        )
        contact = grbl.touch(way)
        if not contact.touched:
            return {"failed": True}
        ends.append(np.array(contact.end_mm))
    theta = math.atan2(*(ends[1] - ends[0])[::-1]) - direction[0]
    normals = [unit(direction[k] - math.pi / 2 + theta) for k in (0, across)]
    limits = [
        normal @ end - BALL_MM - normal @ turned(edges[k][0], theta)
        for normal, end, k in zip(normals, (ends[0], ends[2]), (0, across), strict=True)
    ]
    x, y = np.linalg.solve(np.array(normals), np.array(limits))
    turn = math.remainder(theta - placed.theta, 2 * math.pi)
    off = math.hypot(x - placed.x, y - placed.y)
    return {
        "failed": False,
        "off_mm": off,
        "off_deg": abs(math.degrees(turn)),
        "machine_s": machine.seconds - begin_s,
    }


def objects_file(folder: Path, without: str | None) -> str:
    """The parts' file, or all of them but one."""
    known = json.loads(SHARED_OUTLINES.read_text())
    kept = [item for item in known["objects"][::EACH][:PARTS] if item["name"] != without]
    (folder / "parts.json").write_text(json.dumps({**known, "objects": kept}))
    return str(folder / "parts.json")


def campaign(first: int, count: int, folder: Path, *, strangers: bool) -> None:
    """Print a line a pose, and the table."""
    machine = Machine(build(folder), BALL_MM, top_mm=TOP_MM)
    grbl = Grbl(machine.port, Z_MM, SAFE_Z_MM)
    grbl.send(*SETTINGS)
    ours, theirs = [], []
    for number, placed, rng in poses(first, count):
        grbl.send("G4 P0.01")  # answered when the machine stands
        machine.part = placed.shape
        machine.draw_error = lambda rng=rng: tuple((HELD_MM * unit(rng.uniform(0, 2 * math.pi))).tolist())
        objects = objects_file(folder, placed.model.name if strangers else None)
        ours.append(located(grbl, machine, placed, objects))
        theirs.append(cornered(grbl, machine, placed, rng))
        print(number, placed.model.name, json.dumps([ours[-1], theirs[-1]]), flush=True)
    machine.close()
    print(table(ours, theirs, machine.overlap_mm))


def table(ours: list[dict], theirs: list[dict], overlap_mm: float) -> str:
    """The figures of a campaign."""

    def of(rows: list[dict], key: str) -> np.ndarray:
        return np.array([row[key] for row in rows if key in row])

    def spread(rows: list[dict], key: str, digits: int) -> str:
        values = of(rows, key)
        if not len(values):
            return "none"
        return f"{np.median(values):.{digits}f}, at most {values.max():.{digits}f}"

    verdicts = [row["verdict"] for row in ours]
    lines = [
        f"poses: {len(ours)}; "
        + ", ".join(f"{name} {verdicts.count(name)}" for name in sorted(set(verdicts))),
        f"wrong: {sum(of(ours, 'wrong'))}; truth outside of its bounds: {sum(of(ours, 'outside'))}",
        f"touches: {np.mean(of(ours, 'touches')):.1f}, at most {max(of(ours, 'touches'))}",
        f"overlap: {overlap_mm:.3f} mm",
        *(f"ours, {key}: {spread(ours, key, 4)}" for key in ("bound_mm", "off_mm", "bound_deg", "off_deg")),
        *(f"ours, {key}: {spread(ours, key, 1)}" for key in ("machine_s", "compute_s")),
        f"corner routine: {sum(of(theirs, 'failed'))} without a corner, or not met",
        *(f"corner routine, {key}: {spread(theirs, key, 4)}" for key in ("off_mm", "off_deg")),
        f"corner routine, machine_s: {spread(theirs, 'machine_s', 1)}",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--strangers", action="store_true", help="the part in the vice is not in the file")
    asked = parser.parse_args()
    if WHY_NOT:
        sys.exit(WHY_NOT)
    with TemporaryDirectory() as made:
        campaign(asked.first, asked.count, Path(made), strangers=asked.strangers)
