"""Study from Python: how well a rig tells a catalogue apart, by simulated identifications."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from palpate.api.arguments import checked
from palpate.api.files import PathLike
from palpate.config import ObjectsFile, RigFile
from palpate.config.study_result import ConfusionOut, HeightsOut, StudyOut
from palpate.errors import InputError
from palpate.rig.catalogue.finger_model import rig_fingers
from palpate.rig.catalogue.heights import check_known
from palpate.rig.catalogue.preparation import prepared_catalogue
from palpate.rig.catalogue.section_stack import state_sections
from palpate.rig.catalogue.separating_heights import separating_heights
from palpate.rig.catalogue.twins import find_twins
from palpate.rig.conversion import finger_of
from palpate.rig.study.campaign import RunsFile, carry_out
from palpate.rig.study.simulation import Simulation, held_still
from palpate.rig.study.summary import study_out
from palpate.vocabulary import Strategy

__all__ = ["study"]

MOST_RUNS = 1_000_000
_PAIRS_LOOKED_AT = 40


@checked
def study(
    rig: RigFile,
    objects: ObjectsFile,
    *,
    runs: int = 1000,
    seed: int = 0,
    strategy: Strategy = Strategy.PLANNED,
    keep: PathLike | None = None,
    name: str = "the catalogue",
    progress: Callable[[str], None] = lambda _: None,
) -> StudyOut:
    """Simulate identifications of parts of a catalogue that lie still, on all cores.

    Touches are worked out by shapely and mismeasured within the rig's bounds; each run draws a state and
    where it lies, by `seed` and its number. `keep`: a file of runs (JSON Lines), by which a study that was
    ended goes on. Raises InputError for a catalogue that the rig cannot identify, or a file of another study.
    """
    if not 1 <= runs <= MOST_RUNS:
        raise InputError(f"{runs} runs: it must be from 1 to {MOST_RUNS}")
    check_known(objects.objects, rig.fingers)
    begin = time.perf_counter()
    still_rig, still_objects = held_still(rig, objects)
    simulation = Simulation(still_rig, still_objects, strategy, seed)
    # Kept, it is there for the processes that carry out runs.
    prepared_catalogue(still_objects.objects, map(finger_of, still_rig.fingers), progress)
    with TemporaryDirectory() as folder:
        path = Path(folder, "runs.jsonl") if keep is None else Path(keep)
        found = carry_out(simulation, runs, RunsFile(path, simulation, version("palpate")), progress)
    return study_out(
        found,
        objects=name,
        rig=rig.name,
        strategy=strategy,
        seed=seed,
        seconds=time.perf_counter() - begin,
        heights=partial(_heights, rig, objects),
    )


def _heights(rig: RigFile, objects: ObjectsFile, confusion: Sequence[ConfusionOut]) -> tuple[HeightsOut, ...]:
    """For the states that were confused most often, as `check_objects` finds them."""
    names = {frozenset((item.a, item.b)): item for item in confusion[:_PAIRS_LOOKED_AT]}
    if not names:
        return ()
    found = []
    for pair in find_twins(state_sections(objects), rig_fingers(rig)):
        item = names.get(frozenset((pair.first.state.name, pair.second.state.name)))
        if item is not None:
            found.append(HeightsOut(a=item.a, b=item.b, heights=separating_heights(pair).heights_mm))
    return tuple(found)
