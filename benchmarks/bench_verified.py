"""Is what is called verified true? Run with `python benchmarks/bench_verified.py`.

Seeded grips on shipped parts and shared outlines, exact ones and some with a tolerance, are recognised,
and each verified configuration is judged by tests/support/oracles/judge.py (shapely). One row for each
value of a setting: grips, hypotheses, how many of them are verified, what the judge has against these, and
how often the hypothesis that holds the truth is verified. What is refused is printed with `--only INDEX`,
which repeats it. With `--tries`, so many random configurations in the cells of every unverified hypothesis
are polished: how often that finds what the search did not. Ends with status 1 if anything was refused.
"""

import argparse
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.recognizer import Recognition
from palpate.recognizer.numpy_witnesses import polish
from palpate.recognizer.verification import Poses
from support.commands.repository import SHARED_OUTLINES
from support.oracles.judge import Scene, asked, drawn, refused
from support.oracles.shapely_touches import holding_truth

_PROGRESS_S = 20.0


@dataclass
class Row:
    """Counts under one value of a setting."""

    grips: int = 0
    hypotheses: int = 0
    verified: int = 0
    refused: int = 0
    truth_verified: int = 0


def keys(scene: Scene) -> list[str]:
    """The rows under which a scene counts."""
    family = "shipped" if scene.family == "memo" else "outlines"
    return [
        "all",
        f"{family}, {'exact' if not scene.tolerance_mm else f'tolerance {scene.tolerance_mm:g} mm'}",
        f"{scene.touches} touches",
        f"tip {scene.radius_mm:g} mm",
        f"position bound {scene.bound_mm:g} mm",
        f"normals ±{scene.normals_deg:g}°",
    ]


def found_by_chance(answer: Recognition, tries: int, rng: np.random.Generator) -> list[bool]:
    """For each unverified hypothesis, whether some of so many random places leads to a configuration."""
    regions, constraints = answer.hypotheses.regions, answer.hypotheses.constraints
    cells = regions.cells
    found = []
    for row in np.flatnonzero(~regions.verified):
        cell = rng.integers(regions.first[row], regions.first[row + 1], tries)
        share = rng.dirichlet(np.full(cells.polygon.shape[1], 0.5), tries)
        place = np.einsum("kv,kvj->kj", share, cells.polygon[cell])
        poses = Poses(cells.state[cell], rng.uniform(cells.lo[cell], cells.hi[cell]), place)
        region = np.full(tries, row)
        found.append(bool(polish(constraints, cells, regions.first, region, cell, poses)[1].any()))
    return found


def main() -> None:
    """Run the grips and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--configurations", type=int, default=100_000, help="verified ones to be judged")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, metavar="INDEX", help="index of the first grip")
    parser.add_argument("--only", type=int, metavar="INDEX", help="repeat one grip")
    parser.add_argument("--tries", type=int, default=0, help="random places for unverified hypotheses")
    options = parser.parse_args()
    families = ("memo", "parts") if SHARED_OUTLINES.exists() else ("memo",)
    rng = np.random.default_rng(options.seed)
    table: dict[str, Row] = defaultdict(Row)
    chance: list[bool] = []
    begin = shown = time.perf_counter()
    index = options.first if options.only is None else options.only
    while table["all"].verified < options.configurations:
        scene = drawn(options.seed, index, families)
        answer = asked(scene)
        against = refused(scene, answer)
        for line in against:
            print(f"REFUSED --only {index}: {line}", flush=True)
        if options.tries:
            chance += found_by_chance(answer, options.tries, rng)
        holding = holding_truth(answer, scene.placed)
        for key in keys(scene):
            row = table[key]
            row.grips += 1
            row.hypotheses += len(answer.hypotheses)
            row.verified += int(answer.hypotheses.verified.sum())
            row.refused += len(against)
            row.truth_verified += holding is not None and holding.verified
        index += 1
        now = time.perf_counter()
        if options.only is not None or now - begin > options.seconds:
            break
        if now - shown > _PROGRESS_S:
            shown = now
            print(f"\r{table['all']} ", end="", file=sys.stderr, flush=True)
    print(f"\n{'':<34} grips  hypotheses  verified   share  refused  truth's verified")
    for key in sorted(table):
        row = table[key]
        print(
            f"{key:<34} {row.grips:>5}  {row.hypotheses:>10}  {row.verified:>8}  "
            f"{row.verified / max(row.hypotheses, 1):>6.1%}  {row.refused:>7}  "
            f"{row.truth_verified / max(row.grips, 1):>16.2%}"
        )
    if chance:
        print(f"of {len(chance)} unverified hypotheses {sum(chance)} have a configuration found by chance")
    sys.exit(bool(table["all"].refused))


if __name__ == "__main__":
    main()
