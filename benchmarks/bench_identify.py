"""Emulated runs to a verdict over a whole catalogue, with the emulator's truth hidden until the end.

    python benchmarks/bench_identify.py                         # six shipped models × 20 seeds
    python benchmarks/bench_identify.py --objects FILE --runs N # N seeds, the object drawn by the seed
    … --strategy planned --strategy random --strategy rotate    # the memo's strategies beside one another
    … --outside FILE                                            # what lies there is not in the catalogue
    … --push MM                                                 # it is pushed so far after the first grip

Prints how the runs ended, how near the answers were, and the touches beyond the first grip beside the least
that any strategy would need. Ends with exit code 1 if any run was wrong: something else identified, the truth
outside the bounds of the answer, or called indistinguishable from something that a reachable approach tells
from it. Seeds are fixed, so the table is repeatable but for the seconds. Sensor noise, gain spread, play and
placement are those of the rig's `[emulation]` table.
"""

import argparse
import math
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.vocabulary import IdentificationVerdict, Strategy
from palpate.config import ObjectsFile, load_objects, load_rig, shipped_objects
from palpate.recognizer import Approach, Catalogue, Grip, Recognition, near_equal, used_approaches
from palpate.rig.bench import BenchRig, connect, set_up
from palpate.rig.conversion import goals_of
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, draw_placement, outline_at
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.events import Event, Observers, PlanEvent, RecognitionEvent, TouchEvent
from palpate.rig.identification.identify import identify
from palpate.rig.identification.outcome import Identification
from palpate.rig.reach.approaches import reach_of
from support.oracles.plans import as_predicted
from support.oracles.shapely_touches import outward_normal, placed_as, stop, unit

FIRM_RIG = Path(__file__).parent.parent / "examples" / "firm-rig.toml"


@dataclass(frozen=True)
class Job:
    """One run: `name` lies there, or whatever the seed draws from `outside` or else from `objects`."""

    objects: Path | None
    name: str | None
    seed: int
    strategy: str
    outside: Path | None
    push_mm: float


@dataclass(frozen=True)
class Run:
    """What one run came to. Errors are None where the right object is not among the answers.

    `beyond`: touches beyond the first grip; `least`: touches that any strategy needs to tell apart what the
    first grip leaves, if every perceptible outcome of each were as likely. `separable`: it was called
    indistinguishable from something that an approach not taken tells from it.
    """

    job: Job
    name: str
    outcome: str
    known: bool
    named: bool
    inside: bool
    separable: bool
    position_error_mm: float | None
    orientation_error_rad: float | None
    touches: int
    beyond: int
    least: int
    moved: bool
    unforeseen: int
    hardest_n: float
    rig_s: float
    wall_s: float
    processor_s: float

    @property
    def answered(self) -> bool:
        """Whether the run claims to know what lies there."""
        return self.outcome in (
            IdentificationVerdict.IDENTIFIED.value,
            IdentificationVerdict.INDISTINGUISHABLE.value,
        )

    @property
    def right(self) -> bool:
        """Identified rightly, or rightly called indistinguishable or unknown; truth inside the bounds."""
        if not self.known:
            return self.outcome == IdentificationVerdict.UNKNOWN.value
        return self.answered and self.named and self.inside and not self.separable

    @property
    def wrong(self) -> bool:
        """A false statement: the worst that can happen."""
        if self.answered:
            return not self.right
        return self.known and self.outcome == IdentificationVerdict.UNKNOWN.value and not self.job.push_mm


class Watch:
    """Follows a run: what the first grip left, whether touches came out as predicted; pushes the part."""

    def __init__(self, bench: BenchRig, placement: Placement, job: Job) -> None:
        self.placement = placement
        self.after_first: Recognition | None = None
        self.unforeseen = 0
        self._bench, self._job = bench, job
        self._plan: Grip | None = None

    def __call__(self, event: Event) -> None:
        """Compare touches with their prediction, push the part once, keep the first recognition."""
        match event:
            case PlanEvent():
                self._plan = event.plan
            case TouchEvent():
                self._touched(event)
            case RecognitionEvent() if self.after_first is None:
                self.after_first = event.recognition

    def _touched(self, event: TouchEvent) -> None:
        if self._plan is not None and not self._job.push_mm:
            self.unforeseen += sum(
                not any(as_predicted(touch.contact, item) for item in self._plan.predictions.of_approach(row))
                for row, touch in enumerate(event.touches)
            )
        self._plan = None
        if event.grip == 1 and self._job.push_mm:
            self._push()

    def _push(self) -> None:
        bearing = np.random.default_rng([self._job.seed, 7]).uniform(0, 2 * math.pi)
        self.placement = replace(
            self.placement,
            x_mm=self.placement.x_mm + self._job.push_mm * math.cos(bearing),
            y_mm=self.placement.y_mm + self._job.push_mm * math.sin(bearing),
        )
        assert self._bench.mock is not None, "the rig is emulated"
        for finger in self._bench.mock.rig.bench.fingers:
            finger.put([outline_at(self.placement, finger.truth.height_mm)])


def run(job: Job) -> Run:
    """One run on emulated devices."""
    begin, begin_processor = time.perf_counter(), time.process_time()
    rig = load_rig(FIRM_RIG)
    objects = load_objects(job.objects or shipped_objects())
    catalogue = Catalogue(objects.objects)
    placement = _placement(job, objects, rig.emulation.placement_radius_mm if rig.emulation else 0.0)
    bench = set_up(rig, [placement], job.seed)
    watch = Watch(bench, placement, job)
    with connect(bench) as hand:
        hand.prepare()
        result = identify(
            hand, catalogue, Observers(record=watch), strategy=Strategy(job.strategy), seed=job.seed
        )
    assert bench.mock is not None, "the rig is emulated"
    left = result.recognition.hypotheses if result.recognition else ()
    found = compare_answer(watch.placement, left)
    return Run(
        job,
        placement.model.name,
        result.outcome.value,
        job.outside is None,
        found.named,
        found.inside_bounds,
        result.outcome is IdentificationVerdict.INDISTINGUISHABLE and found.named and _separable(result),
        found.position_error_mm,
        found.orientation_error_rad,
        result.touches,
        result.touches - len(result.grips[0]),
        _least_touches(watch.after_first),
        bool(result.moved_before),
        watch.unforeseen,
        max(finger.hardest_n for finger in bench.mock.rig.bench.fingers),
        bench.clock.now(),
        time.perf_counter() - begin,
        time.process_time() - begin_processor,
    )


def _placement(job: Job, objects: ObjectsFile, radius_mm: float) -> Placement:
    drawn_from = objects if job.outside is None else load_objects(job.outside)
    if job.name is not None:
        drawn_from = ObjectsFile(tuple(model for model in drawn_from.objects if model.name == job.name))
    return draw_placement(drawn_from, radius_mm, np.random.default_rng([job.seed, 0]))


def _least_touches(recognition: Recognition | None) -> int:
    """Touches needed if each told apart as many hypotheses as it has perceptible outcomes: log to that base.

    Outcomes of one touch: a miss, or a stop anywhere across the parts, at any normal that faces the finger.
    """
    if recognition is None or len(recognition.hypotheses) < 2:
        return 0
    resolution = resolution_of(load_rig(FIRM_RIG))
    boxes = [item.bounds for item in recognition.hypotheses]
    across = max(max(item.state.state.sections[0].polygons[0].outer.max(axis=0)
                     - item.state.state.sections[0].polygons[0].outer.min(axis=0))
                 for item in recognition.hypotheses)  # fmt: skip
    spread = max(b.x_mm[1] for b in boxes) - min(b.x_mm[0] for b in boxes)
    stops = math.ceil((float(across) + spread) / resolution.distance_mm)
    normals = math.ceil(math.pi / (2 * resolution.normal_half_rad))
    return math.ceil(math.log(len(boxes)) / math.log(1 + stops * normals))


def _separable(result: Identification) -> bool:
    """Whether an approach that was not taken would stop at perceptibly different places: by shapely alone."""
    assert result.recognition is not None, "only called with an answer"
    rig = load_rig(FIRM_RIG)
    candidates = reach_of(rig).approaches
    used = used_approaches(result.recognition.contacts, candidates)
    placed = [placed_as(item) for item in result.recognition.hypotheses]
    heights = {item.finger.height_mm for item in candidates}
    shapes = {height: [item.shape_at(height) for item in placed] for height in heights}
    limit = resolution_of(rig).distance_mm
    wanted = np.triu(~near_equal(result.recognition.hypotheses, goals_of(rig)))  # the others are one answer
    for k in np.flatnonzero(~used):
        approach = candidates[k]
        felt = [_felt(shape, approach) for shape in shapes[approach.finger.height_mm]]
        hits = [item for item in felt if item is not None]
        if len(hits) == len(felt):
            travel, facing = map(np.array, zip(*hits, strict=True))
            apart = np.abs(travel[:, None] - travel) * facing.min()
            if (apart[wanted] > limit).any():
                return True
    return False


def _felt(shape: shapely.Geometry, approach: Approach) -> tuple[float, float] | None:
    """Travel to the stop, and how squarely the surface is met; None for a miss."""
    start, direction = np.asarray(approach.start_mm), approach.direction_rad
    travel = stop(shape, start, direction, approach.finger.tip_radius_mm, approach.travel_mm)
    if math.isinf(travel):
        return None
    normal = outward_normal(shape, start + travel * unit(direction))
    return travel, abs(math.cos(normal - direction))


_HEAD = (
    "                     runs right wrong ident. indist unkn. unres.  mm med   max ° med   max"
    "  beyond first: mean  90%  max least  max N  rig s wall s"
)


def table(title: str, runs: Iterable[Run]) -> str:
    """One row: how often right, how well, and after how many touches."""
    every = list(runs)
    errors = [item.position_error_mm for item in every if item.position_error_mm is not None] or [math.nan]
    turns = [item.orientation_error_rad for item in every if item.orientation_error_rad is not None]
    turns = turns or [math.nan]
    count = {item.value: sum(i.outcome == item.value for i in every) for item in IdentificationVerdict}
    beyond = [item.beyond for item in every]
    cells = [
        f"{title:<20}{len(every):>5}{sum(i.right for i in every):>6}{sum(i.wrong for i in every):>6}",
        *(f"{count[item.value]:>7}" for item in IdentificationVerdict),
        f"{np.median(errors):>8.2f}{max(errors):>6.2f}",
        f"{math.degrees(np.median(turns)):>6.2f}{math.degrees(max(turns)):>6.2f}",
        f"{np.mean(beyond):>20.2f}{np.percentile(beyond, 90):>5.0f}{max(beyond):>5}",
        f"{np.mean([i.least for i in every]):>6.2f}",
        f"{max(i.hardest_n for i in every):>7.1f}",
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
    parser.add_argument("--strategy", action="append", choices=[item.value for item in Strategy])
    parser.add_argument("--outside", type=Path, help="objects file with what lies on the table")
    parser.add_argument("--push", type=float, default=0.0, metavar="MM")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.runs)
    names = [None]
    if options.objects is None and options.outside is None:
        names = [model.name for model in load_objects(shipped_objects()).objects]
    wrong = False
    print(_HEAD)
    with ProcessPoolExecutor(options.workers) as pool:
        for strategy in options.strategy or [Strategy.PLANNED.value]:
            jobs = [
                Job(options.objects, name, seed, strategy, options.outside, options.push)
                for name in names
                for seed in seeds
            ]
            runs = list(pool.map(run, jobs))
            for name in names if len(names) > 1 else []:
                print(table(f"{strategy} {name}", [item for item in runs if item.name == name]))
            print(table(f"{strategy}, all", runs), flush=True)
            if options.push:
                print(f"  noticed that it moved: {sum(item.moved for item in runs)} of {len(runs)}")
            print(f"  touches that no hypothesis had predicted: {sum(item.unforeseen for item in runs)}")
            cost, most = [item.processor_s for item in runs], max(runs, key=lambda item: item.processor_s)
            print(
                f"  processor s: median {np.median(cost):.1f}, 90 % {np.percentile(cost, 90):.1f}, "
                f"most {most.processor_s:.1f} ({most.name}, seed {most.job.seed})"
            )
            for item in runs:
                if not item.right:
                    print(f"  not right: {item}", flush=True)
            wrong |= any(item.wrong for item in runs)
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
