"""Study from Python: how well a rig tells a catalogue apart, by simulated identifications."""

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from palpate.api.arguments import checked
from palpate.api.files import PathLike
from palpate.config import ObjectsFile, RigFile
from palpate.config.study_result import StudyOut
from palpate.errors import InputError
from palpate.rig.catalogue.heights import check_known
from palpate.rig.study.campaign import RunsFile, carry_out
from palpate.rig.study.simulation import Simulation, held_still
from palpate.rig.study.summary import study_out
from palpate.vocabulary import Strategy

__all__ = ["study"]

MOST_RUNS = 1_000_000


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
    still_rig, still_objects = held_still(rig, objects)
    simulation = Simulation(still_rig, still_objects, strategy, seed)
    with TemporaryDirectory() as folder:
        path = Path(folder, "runs.jsonl") if keep is None else Path(keep)
        found = carry_out(simulation, runs, RunsFile(path, simulation, version("palpate")), progress)
    return study_out(found, objects=name, rig=rig.name, strategy=strategy, seed=seed)
