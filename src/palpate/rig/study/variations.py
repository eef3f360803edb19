"""Variations of a study: the same runs with one error halved, the part held, or fingers at other heights.

Part and place of a run stay what they are, so that differences are of the variation.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from palpate.base.vocabulary import ErrorSource, PartMotion
from palpate.config import RigFile
from palpate.config.study_result import ComparedOut, NoiseCostOut, StudyRunOut
from palpate.rig.study.paired_runs import PairedRuns
from palpate.rig.study.simulation import Simulation, motion_of, with_motion

__all__ = ["AS_IT_IS", "at_heights", "compared", "heights_name", "noise_budget", "without_errors"]

AS_IT_IS = ""
"""Name of what is no variation."""


def without_errors(simulation: Simulation) -> dict[str, Simulation]:
    """By name, a simulation for each error that can be halved, and one with parts held if they may move.

    None for tolerances of 0.
    """
    has_tolerance = any(item.tolerance_mm for item in simulation.objects.objects)
    moves = motion_of(simulation.rig) is PartMotion.MOVING
    left_out = {
        *(() if has_tolerance else (ErrorSource.TOLERANCE,)),
        *(() if moves else (ErrorSource.MOTION,)),
    }
    return {_name(item): _without(simulation, item) for item in ErrorSource if item not in left_out}


def _without(simulation: Simulation, source: ErrorSource) -> Simulation:
    if source is not ErrorSource.MOTION:
        return replace(simulation, halved=source)
    rig, objects = with_motion(simulation.rig, simulation.objects, PartMotion.STILL)
    return replace(simulation, rig=rig, objects=objects)


def _name(source: ErrorSource) -> str:
    return "held" if source is ErrorSource.MOTION else f"half {source.value}"


def at_heights(rig: RigFile, heights_mm: Sequence[float]) -> RigFile:
    """The rig with its fingers at some heights, in turn."""
    fingers = [
        finger.model_copy(update={"height_mm": heights_mm[k % len(heights_mm)]})
        for k, finger in enumerate(rig.fingers)
    ]
    return rig.model_copy(update={"fingers": fingers})


def heights_name(heights_mm: Sequence[float]) -> str:
    """Name of the variation with fingers there."""
    return "heights " + " ".join(f"{height:g}" for height in heights_mm)


def noise_budget(runs: Mapping[str, Sequence[StudyRunOut]]) -> tuple[NoiseCostOut, ...]:
    """What each error costs; what gains most identified runs first, then what saves most touches."""
    varied = {source: some for source in ErrorSource if (some := runs.get(_name(source)))}
    found = [
        NoiseCostOut(source=source, **dict(compared(runs[AS_IT_IS], some, comparisons=len(varied))))
        for source, some in varied.items()
    ]
    return tuple(sorted(found, key=lambda item: (_lost(item), -(item.fewer_touches or 0.0))))


def _lost(item: ComparedOut) -> int:
    as_is, varied = item.identified
    return as_is - varied


def compared(
    as_is: Sequence[StudyRunOut], varied: Sequence[StudyRunOut], *, comparisons: int = 1
) -> ComparedOut:
    """A variation beside the same runs as they are, one of so many `comparisons`."""
    runs = PairedRuns.of(as_is, varied, comparisons)
    saved = runs.saved_touches
    return ComparedOut(
        runs=len(runs.all),
        touches=(_mean(one.touches for one, _ in runs.all), _mean(other.touches for _, other in runs.all)),
        saved_touches=float(saved.mean()),
        standard_error=float(saved.std(ddof=1) / np.sqrt(len(saved))) if len(saved) > 1 else 0.0,
        identified=runs.identified,
        position_bound=runs.medians(lambda run: run.position_bound),
        orientation_bound=runs.medians(lambda run: run.orientation_bound),
        pairs=len(runs.both),
        fewer_touches=float(runs.fewer_touches.mean()) if runs.both else None,
        fewer_interval=runs.fewer_interval(),
        shown=runs.shown(),
        runs_wanted=runs.wanted(),
    )


def _mean(values: Iterable[int]) -> float:
    return float(np.mean(list(values)))
