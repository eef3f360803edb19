"""Study of learning from Python: how many touches, and how much of a rig's time, a tolerance costs."""

import time
from collections.abc import Callable, Sequence

from palpate.base.errors import InputError, quantity, warn_operator
from palpate.config import ObjectsFile, RigFile
from palpate.config.learning_study_result import LearningRunOut, LearningStudyOut
from palpate.jobs.files import check_arguments
from palpate.jobs.learning import check_learning
from palpate.rig.catalogue.reachability import felt_objects, finding_lines
from palpate.rig.learning.learning_search import LearningSearch, learning_reach
from palpate.rig.study.learning_simulation import LearningSimulation, learnable_objects, tolerance_costs
from palpate.rig.study.simulation import placement_radius_mm
from palpate.rig.workers import in_processes

_MAX_RUNS = 100_000
_MAX_STATES_SHOWN = 5


@check_arguments
def study_learning(  # noqa: PLR0913  # the command's options, all but one optional
    rig: RigFile,
    objects: ObjectsFile,
    *,
    height_mm: float,
    tolerance_mm: float = 2.0,
    max_seconds: float = 900.0,
    runs: int = 10,
    seed: int = 0,
    workers: int | None = None,
    name: str = "the catalogue",
    progress: Callable[[str], None] = lambda _: None,
) -> LearningStudyOut:
    """Simulate how a rig learns parts of a catalogue as if nobody had drawn them, on all cores.

    Each run draws a state whose section is one piece at the fingers' heights, and where it lies, by `seed`
    and its number; touches are mismeasured within the rig's bounds. `height_mm`, `tolerance_mm` and
    `max_seconds` are those of `Rig.learn`. `workers`: so many processes at once, None: as there are cores.
    `name`: of the file of objects, in messages. Raises InputError for a rig on which nothing can be learned,
    as `Rig.learn` does, and for a catalogue of which it can learn nothing.
    """
    if not 1 <= runs <= _MAX_RUNS:
        raise InputError(f"{runs} runs: it must be from 1 to {_MAX_RUNS}")
    if workers is not None and workers < 1:
        raise InputError(f"{workers} workers: it must be at least 1")
    if seed < 0:
        raise InputError(f"seed is {seed}; it must be a whole number from 0")
    check_learning(rig, height_mm, tolerance_mm, max_seconds)
    begin, reach = time.perf_counter(), learning_reach(rig)
    search = LearningSearch(rig, reach, height_mm, tolerance_mm)
    for line in finding_lines(rig, objects.objects, name):
        warn_operator(line)
    felt = ObjectsFile(felt_objects(rig, objects.objects))
    learnable, others = learnable_objects(felt, search.fingers)
    if not learnable.objects:
        raise InputError(f'{name}: rig "{rig.name}" can learn nothing in it: {_left_out_words(others)}')
    if others:
        warn_operator(f"{name}: {_left_out_words(others)}; left out")
    simulation = LearningSimulation(rig, reach, learnable, height_mm, tolerance_mm, max_seconds, seed)
    done: dict[int, LearningRunOut] = {}
    progress(f"runs: 0 of {runs}")
    for number, run in in_processes(simulation.run, [(number,) for number in range(runs)], workers):
        done[number] = run
        progress(f"runs: {len(done)} of {runs}")
    found = tuple(done[number] for number in range(runs))
    return LearningStudyOut(
        objects=name,
        rig=rig.name,
        height=height_mm,
        goal=tolerance_mm,
        max_seconds=max_seconds,
        placed_within=placement_radius_mm(rig),
        seed=seed,
        outside=sum(not run.inside_bounds for run in found),
        costs=tolerance_costs(found, tolerance_mm),
        runs=found,
        seconds=time.perf_counter() - begin,
    )


def _left_out_words(names: Sequence[str]) -> str:
    """Say which states cannot be learned, and why."""
    more = len(names) - _MAX_STATES_SHOWN
    rest = f" and {quantity(more, 'more state', 'more states')}" if more > 0 else ""
    shown = "; ".join(names[:_MAX_STATES_SHOWN])
    return f"{shown}{rest}: not one piece at the fingers' heights, or not known there"
