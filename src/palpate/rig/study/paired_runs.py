"""Paired runs: what a variation changes in the same runs of a study, and whether that may be chance.

Each run is its own control: the same part at the same place. Shares identified are compared by McNemar's
exact test, bounds by the sign test, touches by Student's interval of paired differences, each at the level
that keeps all comparisons of a list at 95 % together (Bonferroni).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from scipy import special

from palpate.base.geometry import Floats
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config.study_result import StudyRunOut

__all__ = ["LEAST_PAIRS", "PairedRuns"]

_DOUBT = 0.05
_WORTH_TOUCHES = 0.5  # a difference that is worth knowing
LEAST_PAIRS = 10
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
        """As many as there are of both."""
        pairs = tuple(zip(as_is, varied, strict=False))
        both = tuple(pair for pair in pairs if all(map(_is_identified, pair)))
        return cls(pairs, both, _DOUBT / comparisons)

    @property
    def identified(self) -> tuple[int, int]:
        """How many were identified, as they are and varied."""
        return (
            sum(_is_identified(one) for one, _ in self.all),
            sum(_is_identified(other) for _, other in self.all),
        )

    @property
    def saved_touches(self) -> Floats:
        """Of each pair (n,), whether identified or not."""
        return np.array([one.touches - other.touches for one, other in self.all], dtype=float)

    @property
    def fewer_touches(self) -> Floats:
        """Of each pair (b,) that was identified both ways: how many the varied run saved."""
        return np.array([one.touches - other.touches for one, other in self.both], dtype=float)

    def medians(self, value: Callable[[StudyRunOut], float | None]) -> tuple[float, float] | None:
        """Of runs that were identified both ways; None without any."""
        found = np.array([[value(one), value(other)] for one, other in self.both], dtype=float)
        return tuple(np.median(found, axis=0).tolist()) if len(found) else None

    def fewer_interval(self) -> tuple[float, float] | None:
        """Confidence interval of the mean of `fewer_touches`; None for too few."""
        fewer = self.fewer_touches
        if len(fewer) < LEAST_PAIRS:
            return None
        half = special.stdtrit(len(fewer) - 1, 1 - self.doubt / 2) * fewer.std(ddof=1) / np.sqrt(len(fewer))
        return float(fewer.mean() - half), float(fewer.mean() + half)

    def shown(self) -> tuple[Effect, ...]:
        """What differs by more than chance."""
        gained = sum(_is_identified(other) and not _is_identified(one) for one, other in self.all)
        lost = sum(_is_identified(one) and not _is_identified(other) for one, other in self.all)
        interval = self.fewer_interval()
        bounds = [(one.position_bound or 0.0, other.position_bound or 0.0) for one, other in self.both]
        narrower, wider = sum(b < a for a, b in bounds), sum(b > a for a, b in bounds)
        found: dict[Effect, bool] = {
            "identified": self._is_no_chance(gained, lost),
            "touches": interval is not None and not interval[0] <= 0 <= interval[1],
            "bounds": len(self.both) >= LEAST_PAIRS and self._is_no_chance(narrower, wider),
        }
        return tuple(name for name, is_shown in found.items() if is_shown)

    def wanted(self) -> int | None:
        """How many runs would show a difference of half a touch; None if these show any, or all are equal."""
        if self.shown() or all(_ended(one) == _ended(other) for one, other in self.all):
            return None
        interval = self.fewer_interval()
        if interval is None:
            times = 2 * LEAST_PAIRS / max(len(self.both), 1)
        else:
            times = ((interval[1] - interval[0]) / (2 * _WORTH_TOUCHES)) ** 2
        return 10 * math.ceil(len(self.all) * times / 10) if times > 1 else None

    def _is_no_chance(self, one: int, other: int) -> bool:
        """Whether two outcomes that would be equally frequent by chance are not."""
        return 2 * float(special.bdtr(min(one, other), one + other, 0.5)) < self.doubt


def _ended(run: StudyRunOut) -> tuple[object, ...]:
    return run.verdict, run.touches, run.position_bound


def _is_identified(run: StudyRunOut) -> bool:
    return run.verdict is IdentificationVerdict.IDENTIFIED
