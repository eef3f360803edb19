"""Identifications on the emulated bench without arrays: as drawn, at the declared bounds, and beyond them.

    python benchmarks/bench_without_arrays.py [--runs 20] [--first 100]

Each seed is a part of the shipped catalogue, held, and a bench of another hidden truth. Outcomes are verdicts
that hold the truth; "fault": an error, torque off; "wrong": an answer that does not hold the truth.
A line for each fault goes to stderr.
"""

import argparse
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import palpate

RIG = Path(__file__).parents[1] / "examples" / "current-rig.toml"
AT_BOUNDS = {
    "friction": [1.39, 1.4],
    "rest_friction": [1.19, 1.2],
    "cogging": [0.29, 0.3],
    "torque_loss": [0.09, 0.1],
}
CASES: Mapping[str, Mapping[str, Any]] = {
    "friction within its bounds": {},
    "friction, cogging and warmth at their bounds": AT_BOUNDS,
    "friction up to 1.5 times its bound": {"friction": [1.4, 1.9], "cogging": [0.3, 0.6]},
}


class Run(NamedTuple):
    """Outcome of a run; half widths of the bounds (mm, degrees), peak as sensed, rig time (s)."""

    kind: str
    position_mm: float = math.nan
    turn_deg: float = math.nan
    peak_n: float = math.nan
    rig_s: float = math.nan
    touches: int = 0


def run(seed: int, mechanics: Mapping[str, Any]) -> Run:
    """Identify the part that the seed draws."""
    try:
        with palpate.open_rig(RIG, seed=seed).with_(emulation={"mechanics": mechanics}) as rig:
            found = rig.identify().result
    except palpate.PalpateError as error:
        print(seed, error, file=sys.stderr, flush=True)
        return Run("fault")
    truth = found.truth
    assert truth is not None
    right = truth.named and truth.inside_bounds
    kind = found.verdict.value if right else "not resolved" if found.configuration is None else "wrong"
    bounds = found.bounds
    if bounds is None:
        return Run(kind)
    x, y, turn = ((high - low) / 2 for low, high in (bounds.x, bounds.y, bounds.theta))
    peak = max(touch.peak_force_n for touch in found.touch_records)
    return Run(kind, max(x, y), math.degrees(turn), peak, found.rig_seconds, found.touches)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    asked = parser.parse_args()
    print("| friction | runs | outcomes | bounds, median | touches | peak as sensed, N | rig time, s |")
    print("|---|---|---|---|---|---|---|")
    for name, mechanics in CASES.items():
        runs = [run(seed, mechanics) for seed in range(asked.first, asked.first + asked.runs)]
        kinds = ", ".join(
            f"{sum(one.kind == kind for one in runs)} {kind}" for kind in sorted({r.kind for r in runs})
        )
        done = [one for one in runs if not math.isnan(one.rig_s)]
        cells = ("–",) * 4
        if done:
            place, turn = (median(getattr(one, key) for one in done) for key in ("position_mm", "turn_deg"))
            cells = (
                f"± {place:.1f} mm, ± {turn:.1f}°",
                f"{median(one.touches for one in done):g}",
                f"{max(one.peak_n for one in done):.1f}",
                f"{median(one.rig_s for one in done):.0f}",
            )
        print(f"| {name} | {len(runs)} | {kinds} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
