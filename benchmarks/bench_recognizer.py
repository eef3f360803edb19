"""How long `recognise` takes, and how much it leaves: run with `python benchmarks/bench_recognizer.py`.

Touches are simulated by shapely with seeded noise inside the declared bounds. One row for each catalogue,
number of contacts and width of the normal range: median and 90th percentile of the time for one call, median
number of hypotheses, share of hypotheses with a verified configuration, and the share of time in each stage.
"""

import argparse
import cProfile
import math
import pstats
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from shapely_bench import SHARED_OUTLINES, SHIPPED_OBJECTS, grip, holding_truth, outlines, place

from palpate.recognizer import Catalogue, Contact, recognise

STAGES = {
    "tree": ("first_level", "next_level"),
    "regions": ("build_cells",),
    "hypotheses": ("hypotheses_of",),
}


def scenes(
    path: Path, fingers: int, half_range: float | None, count: int
) -> list[tuple[object, list[Contact]]]:
    """Grips on random objects of a file, each touching with all of its fingers."""
    rng = np.random.default_rng(fingers)
    models = outlines(path)
    found: list[tuple[object, list[Contact]]] = []
    while len(found) < count:
        placed = place(models[int(rng.integers(len(models)))], rng)
        contacts = grip(placed, rng, fingers=fingers, half_range=half_range)
        if all(contact.touched for contact in contacts):
            found.append((placed, contacts))
    return found


def stage_shares(catalogue: Catalogue, grips: Sequence[list[Contact]]) -> str:
    """Share of the time of `recognise` that each stage takes; the rest is free paths."""
    profile = cProfile.Profile()
    profile.enable()
    for contacts in grips:
        recognise(catalogue, contacts)
    profile.disable()
    spent = {name: 0.0 for names in STAGES.values() for name in (*names, "recognise")}
    for (_, _, name), (_, _, _, cumulative, _) in pstats.Stats(profile).stats.items():
        if name in spent:
            spent[name] += cumulative
    whole = spent["recognise"] or 1.0
    shares = {stage: sum(spent[name] for name in names) / whole for stage, names in STAGES.items()}
    shares["paths"] = max(0.0, 1.0 - sum(shares.values()))
    return " ".join(f"{stage} {share:3.0%}" for stage, share in shares.items())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=12, help="grips per row")
    count = parser.parse_args().grips
    print("position bound 0.3 mm, tip radius 5 mm")
    print("catalogue  contacts  normals    median     90 %  hypotheses  verified  truth  stages")
    for label, path in (("memo's 6", SHIPPED_OBJECTS), ("129 parts", SHARED_OUTLINES)):
        if not path.exists():
            print(f"{label}: skipped, its file is not beside the repository")
            continue
        catalogue = Catalogue(outlines(path))
        for fingers, degrees in ((2, 10), (3, 10), (3, None), (4, 10), (6, 10)):
            half_range = None if degrees is None else math.radians(degrees)
            seconds, left, verified, kept = [], [], [], 0
            chosen = scenes(path, fingers, half_range, count)
            recognise(catalogue, chosen[0][1])  # grown outlines and distance ranges are made on first use
            for placed, contacts in chosen:
                begin = time.perf_counter()
                found = recognise(catalogue, contacts)
                seconds.append(time.perf_counter() - begin)
                left.append(len(found.hypotheses))
                verified += [item.verified for item in found.hypotheses]
                kept += holding_truth(found, placed) is not None
            normals = "unknown" if degrees is None else f"±{degrees}°"
            stages = stage_shares(catalogue, [contacts for _, contacts in chosen[:4]])
            print(
                f"{label:<10} {fingers:>8}  {normals:<7} {1e3 * np.median(seconds):>7.0f} ms "
                f"{1e3 * np.percentile(seconds, 90):>5.0f} ms  {np.median(left):>10.0f}  "
                f"{np.mean(verified):>8.1%}  {kept}/{count}  {stages}",
                flush=True,
            )


if __name__ == "__main__":
    main()
