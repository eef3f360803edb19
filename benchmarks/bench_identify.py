"""Emulated runs to a verdict over a whole catalogue, with the emulator's truth hidden until the end.

    python benchmarks/bench_identify.py                         # six shipped models × 20 seeds
    python benchmarks/bench_identify.py --objects FILE --runs N # N seeds, the object drawn by the seed

Prints a row for each object (or for all drawn runs) and ends with exit code 1 if any run was wrong:
something else identified, or the truth outside the bounds of the answer. Seeds are fixed, so the table is
repeatable but for the seconds. Sensor noise, gain spread, play and placement are those of the rig's
`[emulation]` table.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.config import ObjectsFile, load_objects, load_rig, shipped_objects, shipped_rig
from palpate.recognizer import Catalogue
from palpate.rig.bench import connect, place, set_up
from palpate.rig.convert import models_of
from palpate.rig.identify import Outcome, identify
from palpate.rig.scene import draw_placement
from palpate.rig.truth import compare


@dataclass(frozen=True)
class Run:
    """What one run came to. Errors are None where the right object is not among the answers."""

    name: str
    seed: int
    outcome: str
    named: bool
    inside: bool
    position_error_mm: float | None
    orientation_error_rad: float | None
    grips: int
    touches: int
    hardest_n: float
    rig_s: float
    wall_s: float

    @property
    def right(self) -> bool:
        """Identified rightly, or rightly called indistinguishable from something; truth inside the bounds."""
        answered = self.outcome in (Outcome.IDENTIFIED.value, Outcome.INDISTINGUISHABLE.value)
        return answered and self.named and self.inside

    @property
    def wrong(self) -> bool:
        """A false statement: the worst that can happen."""
        if self.outcome == Outcome.UNRESOLVED.value:
            return not self.named
        return not (self.named and self.inside)


def run(source: Path | None, name: str | None, seed: int) -> Run:
    """One run: on `name`, or on whatever the seed draws from the catalogue."""
    begin = time.perf_counter()
    rig = load_rig(shipped_rig())
    objects = load_objects(source or shipped_objects())
    catalogue = Catalogue(models_of(objects))
    if name is None:
        placement = place(rig, objects, None, seed)
    else:
        alone = ObjectsFile(tuple(model for model in objects.objects if model.name == name))
        radius = rig.emulation.placement_radius_mm if rig.emulation else 0.0
        placement = draw_placement(alone, radius, np.random.default_rng([seed, 0]))
    bench = set_up(rig, placement, seed)
    with connect(bench) as hand:
        hand.prepare()
        result = identify(hand, catalogue)
    assert placement is not None, "the shipped rig is emulated"
    assert bench.mock is not None, "the shipped rig is emulated"
    found = compare(placement, result.recognition.hypotheses if result.recognition else ())
    return Run(
        placement.model.name,
        seed,
        result.outcome.value,
        found.hypothesis is not None,
        found.inside_bounds,
        found.position_error_mm,
        found.orientation_error_rad,
        len(result.grips),
        result.touches,
        max(finger.hardest_n for finger in bench.mock.rig.bench.fingers),
        bench.clock.now(),
        time.perf_counter() - begin,
    )


def table(title: str, runs: Iterable[Run]) -> str:
    """One row: how often right, and how well."""
    every = list(runs)
    errors = [item.position_error_mm for item in every if item.position_error_mm is not None]
    turns = [item.orientation_error_rad for item in every if item.orientation_error_rad is not None]
    count = {item.value: sum(i.outcome == item.value for i in every) for item in Outcome}
    cells = [
        f"{title:<12}{len(every):>5}{sum(i.right for i in every):>6}{sum(i.wrong for i in every):>6}",
        *(f"{count[item.value]:>7}" for item in Outcome),
        f"{np.median(errors):>7.2f}{max(errors):>6.2f}",
        f"{math.degrees(np.median(turns)):>6.2f}{math.degrees(max(turns)):>6.2f}",
        f"{np.mean([i.touches for i in every]):>6.1f}{max(i.touches for i in every):>4}",
        f"{max(i.hardest_n for i in every):>6.1f}",
        f"{np.median([i.rig_s for i in every]):>7.0f}{np.median([i.wall_s for i in every]):>7.1f}",
    ]
    return "".join(cells)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--objects", type=Path, help="objects file; without it, the shipped models, each in turn"
    )
    parser.add_argument("--runs", type=int, default=20, help="seeds (for each shipped model)")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.runs)
    if options.objects is None:
        names = [model.name for model in load_objects(shipped_objects()).objects]
        jobs = [(None, name, seed) for name in names for seed in seeds]
    else:
        jobs = [(options.objects, None, seed) for seed in seeds]
    print(
        "object       runs right wrong ident. indist unkn. unres. mm med   max ° med   max  touches"
        " max N  rig s wall s"
    )
    with ProcessPoolExecutor(options.workers) as pool:
        runs = list(pool.map(run, *zip(*jobs, strict=True)))
    if options.objects is None:
        for name in names:
            print(table(name, [item for item in runs if item.name == name]))
    print(table("all", runs))
    for item in runs:
        if not item.right:
            print(f"not right: {item}")
    return int(any(item.wrong for item in runs))


if __name__ == "__main__":
    sys.exit(main())
