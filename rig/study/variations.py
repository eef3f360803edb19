"""Variations of a study: the same runs with one error halved, or with fingers at other heights.

Part, place and draws of a run stay what they are, so that differences are of the variation.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from palpate.config import RigFile
from palpate.config.study_result import ComparedOut, NoiseCostOut, StudyRunOut
from palpate.rig.study.simulation import Simulation
from palpate.vocabulary import ErrorSource, IdentificationVerdict

__all__ = ["AS_IT_IS", "at_heights", "compared", "halved", "heights_name", "noise_budget"]

AS_IT_IS = ""
"""Name of what is no variation."""


def halved(simulation: Simulation) -> dict[str, Simulation]:
    """A simulation for each error that can be halved, by name; none for tolerances of 0."""
    has_tolerance = any(item.tolerance_mm for item in simulation.objects.objects)
    sources = [item for item in ErrorSource if item is not ErrorSource.TOLERANCE or has_tolerance]
    return {_half(source): replace(simulation, halved=source) for source in sources}


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
    """What each error costs; the most touches first."""
    found = [
        NoiseCostOut(source=source, **dict(compared(runs[AS_IT_IS], runs[_half(source)])))
        for source in ErrorSource
        if runs.get(_half(source))
    ]
    return tuple(sorted(found, key=lambda item: -item.saved_touches))


def compared(as_is: Sequence[StudyRunOut], varied: Sequence[StudyRunOut]) -> ComparedOut:
    """A variation beside the same runs as they are."""
    pairs = list(zip(as_is, varied, strict=False))
    saved = np.array([one.touches - other.touches for one, other in pairs], dtype=float)
    both = [pair for pair in pairs if all(map(_is_identified, pair))]

    def medians(value: Callable[[StudyRunOut], float | None]) -> tuple[float, float] | None:
        found = np.array([[value(one), value(other)] for one, other in both], dtype=float)
        return tuple(np.median(found, axis=0).tolist()) if len(found) else None

    return ComparedOut(
        runs=len(pairs),
        touches=(_mean(one.touches for one, _ in pairs), _mean(other.touches for _, other in pairs)),
        saved_touches=float(saved.mean()),
        standard_error=float(saved.std(ddof=1) / math.sqrt(len(saved))) if len(saved) > 1 else 0.0,
        identified=(
            sum(_is_identified(one) for one, _ in pairs),
            sum(_is_identified(one) for _, one in pairs),
        ),
        position_bound=medians(lambda run: run.position_bound),
        orientation_bound=medians(lambda run: run.orientation_bound),
    )


def _half(source: ErrorSource) -> str:
    return f"half {source.value}"


def _is_identified(run: StudyRunOut) -> bool:
    return run.verdict is IdentificationVerdict.IDENTIFIED


def _mean(values: Iterable[int]) -> float:
    return float(np.mean(list(values)))
