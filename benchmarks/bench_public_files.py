"""Public CAD files, each imported by itself, judged by Open CASCADE, trimesh and shapely.

    python -m venv judge && judge/bin/pip install cadquery shapely trimesh scipy networkx lxml
    python benchmarks/draw_public_files.py take benchmarks/public-files.csv --from CLONES --into FILES
    judge/bin/python benchmarks/bench_public_files.py FILES --palpate .venv/bin/palpate --out public.jsonl

The judges say of each file which solids it holds: for STEP valid and closed ones of Open CASCADE, for meshes
watertight bodies of trimesh; and of each imported object which of these it is, by where it lies. Then as in
`bench_import.py`: sections against the tolerance, probabilities of states against trimesh's. Numbers of
files without units are taken for metres if they are all below 1. Of assemblies some objects are judged. A
line of JSON for each file; what is there already is not run again, so that a judge that crashed can be begun
anew; `--skip` names its file. The table at the end counts, by format, files that hold a solid of 10 to
300 mm, and what became of them.
"""

import argparse
import json
import random
import statistics
from collections import Counter, defaultdict
from pathlib import Path

import cadquery as cq
import numpy as np
import trimesh
from bench_import import imported, judged, off_trimesh, transform_of

_LEAST_MM, _MOST_MM = 10.0, 300.0
_LAID_MM = 0.15  # of the centre of mass and the height of an object's solid
_CHORD_MM, _CHORD_RAD = 0.02, 0.2
_UNITLESS = (".stl", ".obj", ".ply")
_DRAWINGS = (".dxf", ".svg")
_MOST_OBJECTS, _MOST_STATES = 2, 3  # of a file, of an object, that are judged: drawn
_QUANTILES = (0.5, 0.9, 1.0)


def solids_of(path, scale):
    """Each closed solid of a file: Open CASCADE's, or None; and a mesh of it, in mm."""
    if path.suffix == ".step":
        whole = cq.importers.importStep(str(path))
        found = [solid for item in whole.vals() for solid in item.Solids() if solid.isValid()]
        return [(solid, mesh_of(solid)) for solid in found]
    loaded = trimesh.load(path, force="mesh")
    loaded.apply_scale(scale)
    loaded.merge_vertices()
    bodies = list(loaded.split(only_watertight=True))
    # A void is a body of its own to trimesh: the whole is a candidate, too.
    return [(None, body) for body in ([loaded, *bodies] if len(bodies) > 1 else bodies)]


def mesh_of(solid, fine=1.0):
    points, faces = solid.tessellate(_CHORD_MM / fine, _CHORD_RAD / fine)
    return trimesh.Trimesh([(p.x, p.y, p.z) for p in points], faces)


def is_of_interest(mesh):
    return _LEAST_MM <= float(mesh.extents.max()) <= _MOST_MM


def laid_solid(solids, shown):
    """The solid that an object is, by how it lies in its first state; None: there is none such."""
    state = shown["states"][0]
    transform = transform_of(state["frame"])
    best, least = None, _LAID_MM
    for exact, mesh in solids:
        points = trimesh.transform_points(mesh.vertices, transform)
        centre = trimesh.transform_points([mesh.center_mass], transform)[0]
        off = max(*np.abs(centre[:2]), abs(points[:, 2].min()), abs(np.ptp(points[:, 2]) - state["height"]))
        if off < least:
            best, least = (exact, mesh), off
    return best


def judged_object(solids, shown, table, rng):
    """What the judges say of an object."""
    found = laid_solid(solids, shown)
    if found is None:
        return {"name": shown["name"], "unmatched": True}
    exact, mesh = found
    transforms = [transform_of(state["frame"]) for state in shown["states"]]
    tolerance = max(table["tolerance"], 1e-4)
    pairs = list(zip(table["states"], transforms, strict=True))
    some = rng.sample(pairs, min(_MOST_STATES, len(pairs)))
    shares = [judged_state(exact, mesh, state, transform, tolerance, rng) for state, transform in some]
    worst, area = (max(each) for each in zip(*shares, strict=True))
    return {
        "name": shown["name"],
        "states": len(shown["states"]),
        "lost": sum(item["probability"] for item in shown["left_out"]),
        "tolerance": table["tolerance"],
        "off": worst,
        "area": area,
        "poses": off_trimesh(mesh.copy(), transforms, shown),
    }


def judged_state(exact, mesh, state, transform, tolerance, rng):
    """Shares of the tolerance by the exact solid; by a fine mesh of it where Open CASCADE loses edges."""
    found = judged(exact, mesh, state, transform, tolerance, rng)
    if exact is None or max(found) <= 1:
        return found
    return judged(None, mesh_of(exact, fine=4.0), state, transform, tolerance, rng)


def scale_of(path):
    """Millimetres of the unit of a file without units, and its name."""
    if path.suffix not in _UNITLESS:
        return 1.0, None
    return (1000.0, "m") if trimesh.load(path, force="mesh").extents.max() < 1 else (1.0, "mm")


def row_of(palpate, path, folder):
    """What became of a file, what it cost, and what the judges say."""
    target = folder / f"{path.name}.objects.json"
    target.unlink(missing_ok=True)
    scale, unit = scale_of(path)
    more = ["--thickness", "10"] if path.suffix in _DRAWINGS else []
    units = ["--units", unit] if unit else []
    printed, complaint, cost = imported(palpate, path, target, [*units, *more])
    if not target.exists() and path.suffix in _DRAWINGS:  # those that state no unit
        printed, complaint, cost = imported(palpate, path, target, ["--units", "mm", *more])
    row = {"file": path.name, "format": path.suffix[1:], "cost": cost, "came": target.exists()}
    if path.suffix in _DRAWINGS:
        return row | {"complaint": complaint[-400:]}
    solids = solids_of(path, scale)
    row["solids"] = sum(is_of_interest(mesh) for _, mesh in solids)
    if not row["came"]:
        return row | {"complaint": " ".join(complaint.split())[-400:]}
    result = json.loads(printed)
    rng = random.Random(path.name)
    tables = json.loads(target.read_text())["objects"]
    pairs = list(zip(result["objects"], tables, strict=True))
    some = rng.sample(pairs, min(_MOST_OBJECTS, len(pairs)))
    row["objects"] = [judged_object(solids, shown, table, rng) for shown, table in some]
    row["imported"] = len(pairs)
    row["refused"] = [line for item in result["files"] for line in item["refused"]]
    return row


def print_tables(rows):
    """By format: what came in, and what it cost; then whatever a judge has against an object."""
    by_format = defaultdict(list)
    for row in rows:
        by_format[row["format"]].append(row)
    print(
        "| format | files | with a solid of 10–300 mm | of these came in | all that came in | wall s | MB |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, some in sorted(by_format.items()):
        sized = [row for row in some if row.get("solids")]
        came = sum(row["came"] for row in sized)
        spent = [
            ", ".join(f"{np.quantile([row['cost'][k] for row in some], q):.1f}" for q in _QUANTILES)
            for k in (0, 2)
        ]
        print(
            f"| {name} | {len(some)} | {len(sized)} | {came} | {sum(row['came'] for row in some)} | "
            f"{spent[0]} | {spent[1]} |"
        )
    objects = [(row["file"], item) for row in rows for item in row.get("objects", ())]
    known = [item for _, item in objects if "off" in item]
    poses = [float(item["poses"]) for item in known if item["poses"] != "–"]
    print(f"\n{len(objects)} objects, {len(objects) - len(known)} are no solid of the judges'")
    if known:
        off, area = ([item[key] for item in known] for key in ("off", "area"))
        print(
            f"off by {statistics.median(off):.2f} of the tolerance in the median, {max(off):.2f} at most, "
            f"areas {max(area):.2f}; "
            f"{len(poses)} probabilities of poses off by {max(poses, default=0):.4f} at most"
        )
    for file, item in objects:
        if item.get("unmatched") or max(item.get("off", 0), item.get("area", 0)) > 1:
            print("  to look at:", file, item)
    for row in rows:
        if not row["came"]:
            print("  refused:", row["file"], row.get("solids", "drawing"), row["complaint"][-200:])
    print(Counter(row["came"] for row in rows))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--palpate", default="palpate")
    parser.add_argument("--out", type=Path, default=Path("public.jsonl"))
    parser.add_argument("--only", default="", help="files whose names contain this")
    parser.add_argument("--skip", nargs="*", default=[], help="files whose judges crash")
    asked = parser.parse_args()
    folder = asked.out.with_suffix("")
    folder.mkdir(exist_ok=True)
    there = asked.out.read_text().splitlines() if asked.out.exists() else []
    rows = {row["file"]: row for row in map(json.loads, there)}
    with asked.out.open("a") as log:
        for path in sorted(asked.folder.iterdir()):
            if path.name not in (*rows, *asked.skip) and asked.only in path.name:
                row = rows[path.name] = row_of(asked.palpate, path, folder)
                print(json.dumps(row), file=log, flush=True)
    print_tables([rows[name] for name in sorted(rows)])


if __name__ == "__main__":
    main()
