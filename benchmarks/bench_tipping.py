"""Do parts that are said to slide really not tip? Random blocks, pushed on MuJoCo's table.

Run with `python benchmarks/bench_tipping.py --runs 1000` (needs the extra `physics`). Blocks,
height of fingers, friction, mass and pushes are drawn by tests/support/oracles/pushed_stack.py from the
seed and the run's number. Prints by how much those leaned that were said to slide, and what became
of the others. Ends with status 1 if one that was said to slide leaned too far.
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.vocabulary import PushResponse
from palpate.rig.identification.pushing_mechanics import MAX_TABLE_FRICTION, stability_of
from support.oracles.pushed_stack import drawn_pushes, drawn_stack, state_of, worst_lean_rad

_MOST_DEG = 0.5


def tried(seed: int, number: int) -> tuple[PushResponse, float, float, float]:
    """What was said, margin over height, friction, and the largest lean in degrees."""
    rng = np.random.default_rng([seed, number])
    blocks = drawn_stack(rng)
    height = float(rng.uniform(4, min(30.0, blocks[-1].z[1] - 1)))
    friction = float(rng.uniform(0.1, MAX_TABLE_FRICTION))
    mass = float(np.exp(rng.uniform(np.log(0.03), np.log(1.0))))
    found = stability_of(state_of(blocks), 0.0, [(height, height)])
    lean = worst_lean_rad(blocks, mass, friction, drawn_pushes(rng, blocks, height))
    return found.response, found.margin_mm / height, friction, math.degrees(lean)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.perf_counter()
    rows = [tried(options.seed, number) for number in range(options.runs)]
    slides = np.array([row[3] for row in rows if row[0] is PushResponse.SLIDES])
    others = [row for row in rows if row[0] is not PushResponse.SLIDES]
    over = np.array([row[3] for row in others if row[2] > row[1]])
    under = np.array([row[3] for row in others if row[2] <= row[1]])
    print(f"{len(rows)} runs in {time.perf_counter() - begin:.0f} s; lean in degrees: median, 99 %, most")
    for words, leans in (
        ("said to slide", slides),
        ("may tip, friction below margin/height", under),
        ("may tip, friction above", over),
    ):
        if len(leans):
            figures = ", ".join(f"{value:.3f}" for value in np.quantile(leans, [0.5, 0.99, 1.0]))
            print(
                f"  {words}: {len(leans)} runs, {figures}; {(leans > _MOST_DEG).sum()} above {_MOST_DEG:g}°"
            )
    wrong = [
        number for number, row in enumerate(rows) if row[0] is PushResponse.SLIDES and row[3] > _MOST_DEG
    ]
    for number in wrong:
        _, ratio, friction, lean = rows[number]
        print(f"  run {number}: margin/height {ratio:.2f}, friction {friction:.2f}, leaned by {lean:.2f}°")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
