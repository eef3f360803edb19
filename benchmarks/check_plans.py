"""Are plans that are called decisive decisive, and is planning quick?

    python benchmarks/check_plans.py --grips 1000 [--objects FILE]   # check so many decisive grips
    python benchmarks/check_plans.py --time [--objects FILE]         # the time of planning, on one core

A decisive grip must leave one class whatever it feels. Each is carried out for every hypothesis, at its own
configuration and at samples of its region, by shapely, with errors as large as they may be
(tests/support/oracles/decisive_grips.py). Ends with status 1 if one was not, or if a touch was not predicted.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import count, islice
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.config import load_rig
from palpate.recognizer import Recognition, plan_grip, recognise, used_approaches
from palpate.rig.conversion import goals_of
from palpate.rig.fingers import resolution_of
from palpate.rig.reach.approaches import reach_of
from support.oracles.decisive_grips import Finding, catalogue_of, checked, drawn, first_contacts, models_of
from support.oracles.shapely_touches import SHIPPED_OBJECTS, place

FIRM_RIG = Path(__file__).parent.parent / "examples" / "firm-rig.toml"

_CHUNK = 40
_HALF_RANGES_DEG = (10.0, 20.0, 45.0, 90.0)
_REPEATS, _RECOGNITIONS, _LIKE = 5, 8, 1.2


def some(path: Path, seed: int, samples: int, indices: tuple[int, ...]) -> list[Finding]:
    """Draw these trials and check those that are decisive."""
    found = []
    for index in indices:
        trial = drawn(path, seed, index)
        if trial is not None:
            found.append(checked(path, trial, seed, samples))
    return found


def check(path: Path, grips: int, seed: int, samples: int, workers: int) -> int:
    """Check so many decisive grips; returns how many failed."""
    findings: list[Finding] = []
    tried = 0
    with ProcessPoolExecutor(workers) as pool:
        indices = count()
        while len(findings) < grips:
            ahead = [tuple(islice(indices, _CHUNK)) for _ in range(2 * workers)]
            for part in pool.map(partial(some, path, seed, samples), ahead):
                findings += part
            tried += _CHUNK * len(ahead)
    outcomes = sum(item.outcomes for item in findings)
    hypotheses = sum(item.hypotheses for item in findings)
    print(
        f"{path.name}: {tried} first grips, {len(findings)} decisive plans for {hypotheses} hypotheses, "
        f"carried out {outcomes} times"
    )
    for item in findings:
        if item.undecided or item.unforeseen:
            print(f"  trial {item.index}: {item}")
    failed = sum(bool(item.undecided or item.unforeseen) for item in findings)
    print(f"  plans that left more than one class, or touches that were not predicted: {failed}")
    return failed


def recognitions(path: Path, hypotheses: int) -> Iterator[Recognition]:
    """Some after first grips of blunt fingers, with about so many hypotheses."""
    models = list(models_of(path).values())
    found = 0
    for seed in range(4000):
        rng = np.random.default_rng(seed)
        placed = place(models[int(rng.integers(len(models)))], rng)
        half = math.radians(float(rng.choice(_HALF_RANGES_DEG)))
        contacts = [contact for contact in first_contacts(placed, rng, half) if contact.touched]
        if len(contacts) < 2:
            continue
        answer = recognise(catalogue_of(path), contacts[: 2 + seed % 2])
        if hypotheses / _LIKE <= len(answer.hypotheses) <= hypotheses * _LIKE:
            yield answer
            found += 1
            if found == _RECOGNITIONS:
                return


def timing(path: Path) -> None:
    """Print the time of planning for 50 and 500 hypotheses, the rig's candidates included."""
    rig = load_rig(FIRM_RIG)
    for hypotheses in (50, 500):
        best, made = [], 0
        for answer in recognitions(path, hypotheses):
            times = []
            for _ in range(_REPEATS):
                begin = time.perf_counter()
                reach = reach_of(rig)
                used = used_approaches(answer.contacts, reach.approaches)
                made = len(reach.approaches)
                plan_grip(answer, reach, resolution_of(rig), goals_of(rig), used)
                times.append(1000 * (time.perf_counter() - begin))
            best.append((min(times), len(answer.hypotheses), len(answer.hypotheses.regions.cells)))
        best.sort()
        listed = ", ".join(f"{ms:.0f} ({n} in {cells} cells)" for ms, n, cells in best)
        print(f"{hypotheses} hypotheses, {made} candidates: ms {listed}")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objects", type=Path, default=SHIPPED_OBJECTS)
    parser.add_argument("--grips", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--time", action="store_true")
    options = parser.parse_args()
    if options.time:
        timing(options.objects)
        return 0
    return int(check(options.objects, options.grips, options.seed, options.samples, options.workers) > 0)


if __name__ == "__main__":
    sys.exit(main())
