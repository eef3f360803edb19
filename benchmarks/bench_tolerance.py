"""What tolerances and fine outlines cost: run with `python benchmarks/bench_tolerance.py`.

Touches are simulated by shapely on the nominal outlines, tip radius 5 mm, position bound 0.3 mm, normals
±10°. One row for each catalogue, tolerance, normal tolerance (`-` where none is stated) and number of
contacts: edges of one kind of finger in the whole catalogue, processor time for preparing it, median and
longest processor time of one `recognise`, median number of hypotheses and mean extent of their bounds in x
and y, how often the truth was among them, and the most memory. Every row is a process of its own.
"""

import argparse
import math
import multiprocessing
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, recognise
from support.commands.repository import SHARED_OUTLINES
from support.oracles.shapely_touches import flat, grip, holding_truth, outlines, place

TOLERANCES_MM = (0.0, 0.02, 0.05, 0.1, 0.2)
HALF_RANGE_RAD = math.radians(10)


def fine(count: int, sides: int) -> list[ObjectModel]:
    """Wavy rounds of 35 to 45 mm radius in `sides` edges each, no two alike."""
    rng = np.random.default_rng(sides)
    angle = 2 * np.pi * np.arange(sides) / sides
    found = []
    for k in range(count):
        waves = sum(
            rng.normal(0, 0.15 / n) * np.cos(n * angle + rng.uniform(0, 2 * np.pi)) for n in range(1, 6)
        )
        radius = rng.uniform(35, 45) * (1 + np.clip(waves, -0.5, 0.5))
        found.append(flat(f"wavy {k}", np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])))
    return found


def models_of(name: str) -> list[ObjectModel]:
    """The catalogue of a row: `fine COUNT SIDES`, or `shared COUNT` of the shared outlines."""
    kind, *numbers = name.split()
    if kind == "fine":
        return fine(*map(int, numbers))
    return outlines(SHARED_OUTLINES)[: int(numbers[0])]


def row(name: str, tolerance: float, normal_deg: float | None, fingers: int, grips: int) -> str:
    """One row of the table."""
    nominal = models_of(name)
    stated = None if normal_deg is None else math.radians(normal_deg)
    catalogue = Catalogue(
        [replace(model, tolerance_mm=tolerance, normal_bound_rad=stated) for model in nominal]
    )
    rng = np.random.default_rng(fingers)
    scenes = []
    while len(scenes) < grips:
        placed = place(nominal[int(rng.integers(len(nominal)))], rng)
        contacts = grip(placed, rng, fingers=fingers, half_range=HALF_RANGE_RAD)
        if all(contact.touched for contact in contacts):
            scenes.append((placed, contacts))
    begin = time.process_time()
    finger = scenes[0][1][0].finger
    edges = catalogue.edges(finger)
    catalogue.boundary(finger)
    prepared = time.process_time() - begin
    seconds, left, wide, kept, refused = [], [], [], 0, 0
    for placed, contacts in scenes:
        begin = time.process_time()
        try:
            found = recognise(catalogue, contacts)
            left.append(len(found.hypotheses))
        except InputError:
            refused += 1
            continue
        finally:
            seconds.append(time.process_time() - begin)
        wide.append(np.mean((found.hypotheses.hi - found.hypotheses.lo)[:, :2]))
        kept += holding_truth(found, placed) is not None
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"{name:<13} {tolerance:>5g} {'-' if normal_deg is None else normal_deg!s:>4} {fingers:>2} "
        f"{len(edges.state):>6} {prepared:>6.2f} s {1e3 * np.median(seconds):>8.0f} ms "
        f"{1e3 * max(seconds):>8.0f} ms {np.median(left or [0]):>6.0f} {np.mean(wide or [0]):>7.2f} mm  "
        f"{kept}/{grips - refused} refused {refused} {memory:>6.0f} MB"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=8, help="grips per row")
    parser.add_argument(
        "--catalogues", nargs="*", default=["shared 20", "shared 100", "fine 10 200", "fine 10 1000"]
    )
    parser.add_argument("--contacts", nargs="*", type=int, default=[3])
    parser.add_argument("--tolerances", nargs="*", type=float, default=TOLERANCES_MM)
    parser.add_argument("--normal-tolerances", nargs="*", type=float, default=[5.0], help="deg, beside none")
    given = parser.parse_args()
    start = multiprocessing.get_context("spawn")
    for name in given.catalogues:
        for fingers in given.contacts:
            for tolerance in given.tolerances:
                for stated in (None, *(given.normal_tolerances if tolerance else ())):
                    with start.Pool(1) as pool:
                        print(pool.apply(row, (name, tolerance, stated, fingers, given.grips)), flush=True)


if __name__ == "__main__":
    main()
