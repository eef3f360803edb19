"""Study from Python: how well a rig tells a catalogue apart, by simulated identifications."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from palpate.base.errors import InputError, warn_operator
from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import PartMotion, Strategy
from palpate.config import ObjectsFile, RigFile
from palpate.config.study_result import (
    BestHeightsOut,
    ConfusionOut,
    HeightOut,
    SeparatingStudiedOut,
    StudyOut,
    StudyRunOut,
)
from palpate.jobs.files import PathLike, check_arguments, select_known
from palpate.jobs.recognition import parse_strategy
from palpate.rig.catalogue.finger_model import RigFingers, rig_fingers
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.catalogue.reachability import felt_objects, finding_lines
from palpate.rig.catalogue.section_stack import StateSections, state_sections
from palpate.rig.catalogue.separating_heights import BestHeights, best_heights, separating_heights
from palpate.rig.catalogue.twins import find_twins
from palpate.rig.conversion import finger_of
from palpate.rig.identification.accuracy import check_accuracy
from palpate.rig.study.campaign import Executor, RunsFile, carry_out_runs, cluster_executor, simulate_here
from palpate.rig.study.simulation import Simulation, has_probabilities, motion_of, state_shares, with_motion
from palpate.rig.study.summary import (
    StudyAdvice,
    StudyDraws,
    StudyGoals,
    StudySetting,
    confusion_of,
    study_out,
)
from palpate.rig.study.variations import (
    UNVARIED,
    VARIATION_DIVISOR,
    at_heights,
    compare_runs,
    error_variations,
    heights_name,
    noise_budget,
)

_MAX_RUNS = 1_000_000
_MAX_PAIRS = 40
_MAX_VARIATION_RUNS = 200


@check_arguments
def study(  # noqa: PLR0913  # the command's options, all optional
    rig: RigFile,
    objects: ObjectsFile,
    *,
    runs: int = 1000,
    seed: int = 0,
    strategy: Strategy | str = Strategy.PLANNED,
    parts: PartMotion | str | None = None,
    placed_within_mm: float | None = None,
    budget: int | None = None,
    keep: PathLike | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    name: str = "the catalogue",
    rig_name: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> StudyOut:
    """Simulate identifications of parts of a catalogue, on all cores or a cluster.

    Each run draws a state that the rig can feel and where it lies, by `seed` and its number; touches are
    mismeasured within the rig's bounds. `parts`: "moving" or "still", None: as the rig file's
    `[emulation.part]` says.
    `placed_within_mm`: how far from the middle of the workspace parts' centres of area lie, None: as
    `placement_radius_mm` says, or 0.16 of the workspace's radius. `budget`: so many runs are done again with
    each error halved and with parts held, None: a tenth of them. `keep`: a file of runs (JSON Lines), by
    which a study that was ended goes on. `scheduler`: address of a dask scheduler. `workers`: so many
    processes at once, None: as there are cores. `name`, `rig_name`: of the files of objects and rig, in
    messages.
    Raises InputError for a catalogue that the rig cannot identify, a rig of which too little is known, as
    `Rig.identify` does, or a file of another study.
    """
    if not 1 <= runs <= _MAX_RUNS:
        raise InputError(f"{runs} runs: it must be from 1 to {_MAX_RUNS}")
    if workers is not None and workers < 1:
        raise InputError(f"{workers} workers: it must be at least 1")
    if workers is not None and scheduler is not None:
        raise InputError("workers are of this computer, and a scheduler has its own: give one of the two")
    check_accuracy(rig, rig_name)
    varied = min(runs // VARIATION_DIVISOR, _MAX_VARIATION_RUNS) if budget is None else min(budget, runs)
    objects, _ = select_known(objects, rig.fingers, name, warn_operator)
    begin = time.perf_counter()
    motion, chosen = motion_of(rig) if parts is None else _parse_motion(parts), parse_strategy(strategy)
    _check_placed(placed_within_mm, rig.workspace.radius_mm)
    states, fingers = state_sections(objects), rig_fingers(rig)
    for line in finding_lines(rig, objects.objects, name):
        warn_operator(line)
    # Parts that it cannot feel tell nothing of how well the rig tells apart what it feels.
    objects = replace(objects, objects=felt_objects(rig, objects.objects))
    simulation = Simulation(
        *with_motion(rig, objects, motion), chosen, seed, placed_within_mm=placed_within_mm
    )
    with _runs_file(keep) as path, _executor(scheduler, keep, workers) as execute:
        file = RunsFile(path, simulation)
        # Kept, it is there for the processes that carry out runs.
        prepare_catalogue(simulation.objects.objects, map(finger_of, rig.fingers), progress, workers=workers)
        progress("comparing heights")
        heights = best_heights(states, fingers)
        simulations = _simulations(simulation, runs, varied, heights)
        found = carry_out_runs(simulations, file, progress, execute)
    return study_out(
        found[UNVARIED],
        StudySetting(name, rig.name, chosen, seed, motion),
        limits=StudyGoals.of(rig),
        drawn=StudyDraws(
            simulation.within_mm, state_shares(objects), sum(map(_is_by_probability, objects.objects))
        ),
        seconds=time.perf_counter() - begin,
        advice=StudyAdvice(
            _separating(states, fingers, confusion_of(found[UNVARIED])),
            tuple(
                HeightOut(range=item.range_mm, alike=item.alike, unmet=item.unmet) for item in heights.ranges
            ),
            _best_heights_out(heights, found),
            noise_budget(found),
        ),
    )


def _check_placed(within_mm: float | None, radius_mm: float) -> None:
    if within_mm is not None and not 0 <= within_mm < radius_mm:
        raise InputError(
            f"parts placed within {within_mm:g} mm of the middle: it must be from 0 to below the workspace's "
            f"radius, {radius_mm:g} mm"
        )


def _is_by_probability(model: ObjectModel) -> bool:
    return len(model.states) > 1 and has_probabilities(model)


def _parse_motion(name: PartMotion | str) -> PartMotion:
    if name not in list(PartMotion):
        raise InputError(f'parts is "{name}"; allowed: {", ".join(PartMotion)}')
    return PartMotion(name)


def _simulations(
    simulation: Simulation, runs: int, varied: int, heights: BestHeights
) -> dict[str, tuple[Simulation, int]]:
    """Simulations, as it is and with each variation, and how many runs each."""
    simulations = {UNVARIED: (simulation, runs)}
    if varied:
        simulations |= {key: (item, varied) for key, item in error_variations(simulation).items()}
        if heights.alike < heights.alike_now:
            moved = replace(simulation, rig=at_heights(simulation.rig, heights.chosen_mm))
            simulations[heights_name(heights.chosen_mm)] = (moved, varied)
    return simulations


def _executor(
    scheduler: str | None, keep: PathLike | None, workers: int | None
) -> AbstractContextManager[Executor]:
    if scheduler is None:
        return nullcontext(partial(simulate_here, workers=workers))
    return cluster_executor(scheduler, None if keep is None else str(keep))


@contextmanager
def _runs_file(keep: PathLike | None) -> Iterator[Path]:
    with TemporaryDirectory() as folder:
        yield Path(folder, "runs.jsonl") if keep is None else Path(keep)


def _best_heights_out(
    heights: BestHeights, found: Mapping[str, Sequence[StudyRunOut]]
) -> BestHeightsOut | None:
    if not heights.chosen_mm:
        return None
    there = found.get(heights_name(heights.chosen_mm))
    return BestHeightsOut(
        heights=heights.chosen_mm,
        alike=heights.alike,
        alike_now=heights.alike_now,
        compared=compare_runs(found[UNVARIED], there) if there else None,
    )


def _separating(
    states: Sequence[StateSections], fingers: RigFingers, confusion: Sequence[ConfusionOut]
) -> tuple[SeparatingStudiedOut, ...]:
    """Separating heights of the states that were confused most often, as `check_objects` finds them."""
    names = {frozenset((item.a, item.b)): item for item in confusion[:_MAX_PAIRS]}
    if not names:
        return ()
    found = []
    for pair in find_twins(states, fingers):
        item = names.get(frozenset((pair.first.state.name, pair.second.state.name)))
        if item is not None:
            found.append(
                SeparatingStudiedOut(a=item.a, b=item.b, heights=separating_heights(pair).heights_mm)
            )
    return tuple(found)
