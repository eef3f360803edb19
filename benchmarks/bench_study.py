"""Studies: how many simulated runs an hour, and how well they foretell runs on emulated devices.

    python benchmarks/bench_study.py throughput             # runs an hour on all cores, shared outlines
    python benchmarks/bench_study.py predictions --keep FOLDER [--emulated 500] [--each 20]

`throughput` counts runs of parts that lie still and that move, by processor time: with the start of processes
and their loading of the catalogue, without its preparation.

`predictions` identifies parts on emulated devices, with wires, frames, servos and their errors, and simulates
for each of these runs some of a study in which the same part lies on the same rig's table: then the two
differ by what devices do and by chance alone. What is in FOLDER is not done again.

With `--write` the tables go into docs/study.md.
"""

import argparse
import json
import os
import resource
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from performance_page import PAGE, machine, markdown_table, update

import palpate
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, Strategy
from palpate.config import ObjectsFile, RigFile
from palpate.config.study_result import StudyRunOut
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.conversion import finger_of
from palpate.rig.study.campaign import RunsFile, carry_out_runs, simulate_here, split_into_chunks
from palpate.rig.study.simulation import Simulation, draw_placement, with_motion
from palpate.rig.study.variations import UNVARIED
from support.commands.repository import SHARED_OUTLINES

_TARGETS = {PartMotion.STILL: 20_000, PartMotion.MOVING: 2_000}
_DRAWS = 10_000
Numbers = np.ndarray[tuple[int, ...], np.dtype[Any]]


@dataclass(frozen=True)
class Ended:
    """How a run ended: its truth, the verdict, what was left beside the truth, and whether it was wrong."""

    truth: tuple[str, str]
    verdict: str
    touches: int
    others: frozenset[tuple[str, str]]
    inside_bounds: bool

    @property
    def identified(self) -> bool:
        """One state, and it is the right one."""
        return self.verdict == IdentificationVerdict.IDENTIFIED.value and self.inside_bounds

    @property
    def wrong(self) -> bool:
        """An answer without the truth."""
        named = (IdentificationVerdict.IDENTIFIED.value, IdentificationVerdict.INDISTINGUISHABLE.value)
        return self.verdict in named and not self.inside_bounds


_MEANS: dict[str, Callable[[Ended], float]] = {
    "identified, %": lambda run: 100.0 * run.identified,
    "others left at the end, %": lambda run: 100.0 * bool(run.others),
    "wrong answers, %": lambda run: 100.0 * run.wrong,
    "touches, mean": lambda run: float(run.touches),
}


def throughput(objects: ObjectsFile, rig: RigFile, counts: dict[PartMotion, int]) -> str:
    """Runs an hour on all cores, with parts of either kind."""
    rows = []
    for motion, number in counts.items():
        simulation = Simulation(*with_motion(rig, objects, motion), Strategy.PLANNED, 1)
        prepare_catalogue(simulation.objects.objects, map(finger_of, rig.fingers))
        begin = _processor_s()
        runs = _simulated(simulation, number)
        processor_s = _processor_s() - begin
        rows.append(
            (
                f"parts {'move' if motion is PartMotion.MOVING else 'lie still'}",
                str(number),
                f"{np.mean([run.touches for run in runs]):.1f}",
                f"{1000 * processor_s / number:.0f} ms",
                f"{3600 * number * (os.cpu_count() or 1) / processor_s:,.0f}",
                f"{_TARGETS[motion]:,}",
            )
        )
    head = ("", "runs", "touches a run", "processor time a run", "runs an hour", "palpate's goal")
    where = f"{machine()}, {os.cpu_count()} cores; {len(objects.objects)} parts, rig {rig.name}."
    return f"{where} Runs an hour: if nothing else uses the cores.\n\n{markdown_table(head, rows)}"


def _processor_s() -> float:
    """Of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _simulated(simulation: Simulation, count: int) -> list[StudyRunOut]:
    with TemporaryDirectory() as folder:
        file = RunsFile(Path(folder, "runs.jsonl"), simulation)
        return carry_out_runs({UNVARIED: (simulation, count)}, file, lambda _: None)[UNVARIED]


def simulated_like(emulated: Sequence[Ended], simulation: Simulation, each: int, keep: Path) -> list[Ended]:
    """The first runs of a study that have the parts of the emulated ones, `each` of every part."""
    file = RunsFile(keep, simulation)
    done = {run.number: run for run in file.runs}
    numbers = _numbers({run.truth for run in emulated}, simulation, each)
    missing = [number for number in numbers if number not in done]
    for runs in simulate_here(split_into_chunks(UNVARIED, simulation, missing, file.study, 1)):
        file.add(runs)
        done |= {run.number: run for run in runs}
    return [read_simulated(done[number]) for number in numbers]


def _numbers(parts: set[tuple[str, str]], simulation: Simulation, each: int) -> list[int]:
    """Of runs with these parts, as their numbers draw them."""
    found = []
    left = dict.fromkeys(parts, each)
    for number in count():
        if not any(left.values()):
            return found
        rng = np.random.default_rng([simulation.seed, number])
        workspace_mm = simulation.rig.workspace.radius_mm
        placement = draw_placement(simulation.objects, simulation.within_mm, rng, workspace_mm)
        truth = placement.model.name, placement.state.name
        if left.get(truth):
            left[truth] -= 1
            found.append(number)
    return found


def emulated_run(rig: Path | None, objects: Path | None, seed: int, folder: Path) -> None:
    """One run on emulated devices; its answer is a file of the folder."""
    place = folder / f"seed-{seed}.json"
    if place.exists():
        return
    with palpate.open_rig(rig, seed=seed) as opened:
        answer = opened.identify(objects, warn=lambda _: None, notice=lambda _: None)
    place.write_text(answer.to_json())


def read_emulated(place: Path) -> Ended:
    """How an emulated run ended, from its answer."""
    told = json.loads(place.read_text())
    truth = (told["truth"]["object"], told["truth"]["state"])
    answers = {(item["object"], item["state"]) for item in told["alternatives"]}
    if told["object"] is not None:
        answers.add((told["object"], told["state"]))
    inside = bool(told["truth"]["inside_bounds"])
    return Ended(truth, told["verdict"], told["touches"], frozenset(answers - {truth}), inside)


def read_simulated(run: StudyRunOut) -> Ended:
    """How a simulated run ended."""
    truth = (run.object, run.state)
    return Ended(truth, run.verdict.value, run.touches, frozenset(run.left) - {truth}, run.inside_bounds)


def compared(emulated: Sequence[Ended], simulated: Sequence[Ended]) -> str:
    """Both beside each other, the study's runs weighted by the parts that the emulated ones had."""
    drawn = _alike(emulated, simulated)
    rows = []
    for words, value in _MEANS.items():
        seen, expected = (np.array([value(run) for run in runs]) for runs in (emulated, simulated))
        rows.append(_cells(words, seen.mean(), expected[drawn].mean(axis=1)))
    seen, expected = (np.array([run.touches for run in runs]) for runs in (emulated, simulated))
    for share in (50, 90):
        words = f"touches, {share} % of runs"
        rows.append(_cells(words, np.percentile(seen, share), np.percentile(expected[drawn], share, axis=1)))
    left = [(run.truth, other) for run in emulated for other in run.others]
    known = {(run.truth, other) for run in simulated for other in run.others}
    parts = len({run.truth for run in emulated})
    lines = [
        f"{len(emulated)} emulated runs with {parts} parts of the catalogue, {len(simulated)} simulated.",
        "",
        markdown_table(("", "emulated", "study", "95 % of as many simulated runs", "p"), rows),
        "",
        f"Confusions of the emulated runs (truth, other): {len(left)}; of these, "
        f"{sum(pair in known for pair in left)} are among the study's.",
    ]
    return "\n".join([*lines, *(f"  {one} ~ {other}" for one, other in left if (one, other) not in known)])


def _alike(emulated: Sequence[Ended], simulated: Sequence[Ended]) -> Numbers:
    """Runs (draws, emulated) of the study with the parts of the emulated ones: what they may come to."""
    rng = np.random.default_rng(0)
    rows = defaultdict(list)
    for row, run in enumerate(simulated):
        rows[run.truth].append(row)
    return np.column_stack([rng.choice(rows[run.truth], _DRAWS) for run in emulated])


def _cells(words: str, seen: float, expected: Numbers) -> tuple[str, ...]:
    """Seen, expected, where 95 % of equal campaigns would be, and in how many it is as far off or farther."""
    low, high = np.percentile(expected, [2.5, 97.5])
    p = min(1.0, 2 * min(np.mean(expected <= seen), np.mean(expected >= seen)))
    chance = f"{p:.2f}" if p >= 0.01 else "< 0.01"
    return words, f"{seen:.2f}", f"{expected.mean():.2f}", f"{low:.2f} to {high:.2f}", chance


def predictions(
    objects: Path | None, rig: Path | None, keep: Path, seeds: int, each: int, workers: int
) -> str:
    """The table of a study beside emulated runs."""
    keep.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:
        list(
            pool.map(emulated_run, *zip(*((rig, objects, seed, keep) for seed in range(seeds)), strict=True))
        )
    opened = palpate.open_rig(rig).file
    simulation = Simulation(opened, palpate.load_objects(objects), Strategy.PLANNED, 1)
    emulated = [read_emulated(keep / f"seed-{seed}.json") for seed in range(seeds)]
    return compared(emulated, simulated_like(emulated, simulation, each, keep / "study.jsonl"))


def main() -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["throughput", "predictions"])
    parser.add_argument(
        "--objects", type=Path, default=SHARED_OUTLINES, help="the shared outlines if left out"
    )
    parser.add_argument("--rig", type=Path, help="rig file; the shipped bench if left out")
    parser.add_argument("--still", type=int, default=2000, help="throughput: runs of parts that lie still")
    parser.add_argument("--moving", type=int, default=500, help="throughput: runs of parts that move")
    parser.add_argument("--keep", type=Path, help="predictions: folder for the runs")
    parser.add_argument("--emulated", type=int, default=500, help="predictions: runs on emulated devices")
    parser.add_argument("--each", type=int, default=20, help="predictions: simulated runs of every part")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--write", action="store_true", help="into docs/study.md")
    asked = parser.parse_args()
    if asked.what == "throughput":
        rig = palpate.open_rig(asked.rig).file
        counts = {PartMotion.STILL: asked.still, PartMotion.MOVING: asked.moving}
        text = throughput(palpate.load_objects(asked.objects), rig, counts)
    elif asked.keep is None:
        parser.error("predictions: --keep FOLDER is needed")
    else:
        text = predictions(asked.objects, asked.rig, asked.keep, asked.emulated, asked.each, asked.workers)
    print(text)
    if asked.write:
        update(f"study {asked.what}", text, PAGE.with_name("study.md"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
