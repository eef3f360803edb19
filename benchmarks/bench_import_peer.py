"""CAD import beside trimesh: run with `python benchmarks/bench_import_peer.py`.

The question to both: how can this part lie on a table, how probably, and what are its sections at the
fingers' heights? trimesh answers with `load`, `compute_stable_poses` and `section_multiplane`, as its
documentation has them. palpate's import also merges states that look alike, finds symmetries, simplifies
sections within a tolerance that it proves, and refuses unsound files. Processor time, child processes
included. `--write` puts the table into docs/performance.md.
"""

import argparse
import resource
import statistics
import sys
import tempfile
from collections.abc import Callable
from functools import reduce
from importlib import metadata
from pathlib import Path

import numpy as np
import shapely
import trimesh
from performance_page import markdown_table, milliseconds, update, versions_line

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.errors import InputError
from palpate.rig.catalogue.cad_import import ImportOptions, import_file
from support.benches.parts import ELL, WEDGE, mesh_file, prism

HEIGHTS_MM = (5.0, 10.0, 15.0)
LEAST_PROBABILITY = 0.01
HEAD = ("part", "triangles", "palpate", "trimesh", "times trimesh's", "states: palpate", "trimesh")


def parts() -> dict[str, trimesh.Trimesh]:
    """Solids that anyone can make again."""
    star = [((30 if k % 2 else 18) * np.exp(1j * np.pi * k / 12)) for k in range(24)]
    washer = shapely.Point(0, 0).buffer(25, quad_segs=24) - shapely.Point(0, 0).buffer(9, quad_segs=24)
    return {
        "angle profile": prism(ELL, 40),
        "wedge": prism(WEDGE, 25),
        "star, 12 points": prism(shapely.Polygon([(z.real, z.imag) for z in star]), 20),
        "washer, 96 facets": prism(washer, 18),
        "frustum, 64 facets": trimesh.convex.convex_hull(frustum()),
        "sphere-capped rod": trimesh.creation.capsule(height=60, radius=12, count=(16, 16)),
    }


def frustum() -> np.ndarray:
    """Points (128, 3) of a truncated cone."""
    turns = 2 * np.pi * np.arange(64) / 64
    rings = [(25 - 10 * z / 40, z) for z in (0.0, 40.0)]
    return np.concatenate(
        [np.column_stack([r * np.cos(turns), r * np.sin(turns), np.full(64, z)]) for r, z in rings]
    )


def with_trimesh(path: Path) -> int:
    """The number of stable poses whose sections were cut."""
    mesh = trimesh.load(path, force="mesh")
    poses, probable = mesh.compute_stable_poses(sigma=0, n_samples=1, threshold=LEAST_PROBABILITY)
    for pose in poses:
        laid = mesh.copy()
        laid.apply_transform(pose)
        for path_2d in laid.section_multiplane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], HEIGHTS_MM):
            if path_2d is not None:
                reduce(shapely.symmetric_difference, path_2d.polygons_closed)
    return len(probable)


def with_palpate(path: Path) -> int:
    """The number of states."""
    found = import_file(path, ImportOptions(units="mm", heights_mm=HEIGHTS_MM, accept_loss=True))
    return sum(len(item.text.states or ()) for item in found.objects)


def processor_s(answer: Callable[[Path], int], path: Path, repeats: int) -> tuple[float, int]:
    """Median processor time of a call, and what it returned."""

    def spent() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in used)

    times, count = [], 0
    for _ in range(repeats):
        begin = spent()
        count = answer(path)
        times.append(spent() - begin)
    return statistics.median(times), count


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="put the table into docs/performance.md")
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, mesh in parts().items():
            path = mesh_file(mesh, Path(folder, "part.stl"))
            theirs, poses = processor_s(with_trimesh, path, given.repeats)
            try:
                ours, states = processor_s(with_palpate, path, given.repeats)
                told = [milliseconds(ours), milliseconds(theirs), f"{ours / theirs:.1f}", str(states)]
            except InputError as error:
                told = [f"refused: {error}", milliseconds(theirs), "–", "–"]
            rows.append([name, f"{len(mesh.faces):,}", *told, str(poses)])
            print(rows[-1], file=sys.stderr, flush=True)
    versions = {name: metadata.version(name) for name in ("palpate", "trimesh", "numpy", "shapely")}
    whole = f"{versions_line(versions)}\n\n{markdown_table(HEAD, rows)}"
    print(whole)
    if given.write:
        update("import", whole)


if __name__ == "__main__":
    main()
