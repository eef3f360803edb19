"""Variations of a study: the same runs with one error halved, the part clamped, or fingers at other heights.

The part of a run and its pose are unchanged, so that each run is its own control. Identification rates are
compared by McNemar's exact test, bounds by the sign test, touches by Student's interval of paired
differences, each at the level that keeps all comparisons of a list at 95 % together (Bonferroni).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from scipy import special

from palpate.base.geometry import Floats
from palpate.base.vocabulary import ErrorSource, IdentificationVerdict, PartMotion
from palpate.config import RigFile
from palpate.config.study_result import ComparedOut, NoiseCostOut, StudyRunOut
from palpate.rig.study.simulation import Simulation, motion_of, with_motion

_SIGNIFICANCE_LEVEL = 0.05
_RELEVANT_TOUCHES = 0.5  # a difference that is worth knowing
MIN_PAIRS = 10
"""Of fewer runs that were identified both ways, neither touches nor bounds are compared."""
Pairs = tuple[tuple[StudyRunOut, StudyRunOut], ...]
Effect = Literal["identified", "touches", "bounds"]


@dataclass(frozen=True, eq=False)
class PairedRuns:
    """Runs as they are, each beside the same one varied; `both`: those that were identified both ways.

    `doubt`: chance that is left to one of several comparisons.
    """

    all: Pairs
    both: Pairs
    doubt: float

    @classmethod
    def of(cls, as_is: Sequence[StudyRunOut], varied: Sequence[StudyRunOut], comparisons: int) -> Self:
        """Pair runs, as many as there are of both."""
        pairs = tuple(zip(as_is, varied, strict=False))
        both = tuple(pair for pair in pairs if all(map(_is_identified, pair)))
        return cls(pairs, both, _SIGNIFICANCE_LEVEL / comparisons)

    @property
    def identified(self) -> tuple[int, int]:
        """Numbers of runs that were identified, as they are and varied."""
        return (
            sum(_is_identified(one) for one, _ in self.all),
            sum(_is_identified(other) for _, other in self.all),
        )

    @property
    def saved_touches(self) -> Floats:
        """Touches saved by each pair (n,), be it identified or not."""
        return np.array([one.touches - other.touches for one, other in self.all], dtype=float)

    @property
    def fewer_touches(self) -> Floats:
        """Touches that the varied run saved, by pair (b,) that was identified both ways."""
        return np.array([one.touches - other.touches for one, other in self.both], dtype=float)

    def medians(self, value: Callable[[StudyRunOut], float | None]) -> tuple[float, float] | None:
        """Medians of runs that were identified both ways; None without any."""
        found = np.array([[value(one), value(other)] for one, other in self.both], dtype=float)
        return tuple(np.median(found, axis=0).tolist()) if len(found) else None

    def fewer_interval(self) -> tuple[float, float] | None:
        """Confidence interval of the mean of `fewer_touches`; None for too few."""
        fewer = self.fewer_touches
        if len(fewer) < MIN_PAIRS:
            return None
        half = special.stdtrit(len(fewer) - 1, 1 - self.doubt / 2) * fewer.std(ddof=1) / np.sqrt(len(fewer))
        return float(fewer.mean() - half), float(fewer.mean() + half)

    def shown(self) -> tuple[Effect, ...]:
        """Signs of what differs by more than chance."""
        gained = sum(_is_identified(other) and not _is_identified(one) for one, other in self.all)
        lost = sum(_is_identified(one) and not _is_identified(other) for one, other in self.all)
        interval = self.fewer_interval()
        bounds = [(one.position_bound or 0.0, other.position_bound or 0.0) for one, other in self.both]
        narrower, wider = sum(b < a for a, b in bounds), sum(b > a for a, b in bounds)
        found: dict[Effect, bool] = {
            "identified": self._is_no_chance(gained, lost),
            "touches": interval is not None and not interval[0] <= 0 <= interval[1],
            "bounds": len(self.both) >= MIN_PAIRS and self._is_no_chance(narrower, wider),
        }
        return tuple(name for name, is_shown in found.items() if is_shown)

    def wanted(self) -> int | None:
        """Number of runs that would show a difference of half a touch; None if these do, or all are equal."""
        if self.shown() or all(_outcome(one) == _outcome(other) for one, other in self.all):
            return None
        interval = self.fewer_interval()
        if interval is None:
            times = 2 * MIN_PAIRS / max(len(self.both), 1)
        else:
            times = ((interval[1] - interval[0]) / (2 * _RELEVANT_TOUCHES)) ** 2
        return 10 * math.ceil(len(self.all) * times / 10) if times > 1 else None

    def _is_no_chance(self, one: int, other: int) -> bool:
        """Return whether two outcomes that would be equally frequent by chance are not."""
        return 2 * float(special.bdtr(min(one, other), one + other, 0.5)) < self.doubt


def _outcome(run: StudyRunOut) -> tuple[object, ...]:
    return run.verdict, run.touches, run.position_bound


def _is_identified(run: StudyRunOut) -> bool:
    return run.verdict is IdentificationVerdict.IDENTIFIED


UNVARIED = ""
"""Name of what is no variation."""
VARIATION_DIVISOR = 10
"""A tenth of the runs is repeated with each error changed, if nothing else is asked for."""


def error_variations(simulation: Simulation) -> dict[str, Simulation]:
    """Simulations by name: one for each error that can be halved, and one with parts held if they may move.

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
    """Cost of each error; what gains most identified runs first, then what saves most touches."""
    varied = {source: some for source in ErrorSource if (some := runs.get(_name(source)))}
    found = [
        NoiseCostOut(source=source, **dict(compare_runs(runs[UNVARIED], some, comparisons=len(varied))))
        for source, some in varied.items()
    ]
    return tuple(sorted(found, key=lambda item: (_answers_lost(item), -(item.fewer_touches or 0.0))))


def _answers_lost(item: ComparedOut) -> int:
    as_is, varied = item.identified
    return as_is - varied


def compare_runs(
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
