"""Summary of a study: verdicts, touches, states that are hard to identify, pairs hard to tell apart."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from palpate.base.vocabulary import IdentificationVerdict, PartMotion, Strategy
from palpate.config import RigFile
from palpate.config.study_result import (
    AccuracyOut,
    BestHeightsOut,
    ConfusionOut,
    HeightOut,
    NoiseCostOut,
    PairStudiedOut,
    SeparatingStudiedOut,
    StateStudiedOut,
    StudyOut,
    StudyRunOut,
    TouchesOut,
    TwinsOut,
    VerdictCountOut,
)

_MAX_PAIRS = 200
_MAX_WRONG_RUNS = 20


def is_wrong(run: StudyRunOut) -> bool:
    """Return whether a run gave an answer that the truth is not in."""
    return run.verdict.is_answer and not run.inside_bounds


@dataclass(frozen=True)
class StudyGoals:
    """A rig file's goals, half widths in mm and rad, and its limit of grips."""

    goal_mm: float
    goal_rad: float
    max_grips: int

    @classmethod
    def of(cls, rig: RigFile) -> Self:
        """Goals of `[search]`."""
        limits = rig.search
        return cls(limits.goal_position_mm, math.radians(limits.goal_orientation_deg), limits.max_grips)


@dataclass(frozen=True)
class StudyDraws:
    """Draws of runs: `shares` of them by object and state, and parts within `within_mm` of the middle.

    `by_probability`: of so many objects, states by their probabilities.
    """

    within_mm: float
    shares: Mapping[tuple[str, str], float]
    by_probability: int = 0


@dataclass(frozen=True)
class StudyAdvice:
    """Advice of a study beside its runs: where fingers would help, and what errors cost."""

    separating: tuple[SeparatingStudiedOut, ...] = ()
    heights: tuple[HeightOut, ...] = ()
    best_heights: BestHeightsOut | None = None
    noise_budget: tuple[NoiseCostOut, ...] = ()


@dataclass(frozen=True)
class StudySetting:
    """Setting of all runs of a study; `objects`, `rig`: their names."""

    objects: str
    rig: str
    strategy: Strategy
    seed: int
    parts: PartMotion = PartMotion.STILL


def study_out(
    runs: Sequence[StudyRunOut],
    setting: StudySetting,
    *,
    seconds: float = 0.0,
    limits: StudyGoals | None = None,
    drawn: StudyDraws | None = None,
    advice: StudyAdvice | None = None,
) -> StudyOut:
    """The summary. There is at least one run.

    Without `limits` nothing is said of goals; without `drawn` states that were drawn are all there are.
    """
    wrong = [run for run in runs if is_wrong(run)]
    errors = [run.position_error for run in runs if run.position_error is not None and run.inside_bounds]
    identified = [run for run in runs if _is_identified(run)]
    true_errors = [run.position_error for run in identified if run.position_error is not None]
    grip_s = [run.grip_seconds for run in runs if run.grip_seconds is not None]
    advice = advice or StudyAdvice()
    return StudyOut(
        objects=setting.objects,
        rig=setting.rig,
        strategy=setting.strategy,
        seed=setting.seed,
        parts=setting.parts,
        runs=len(runs),
        wrong=len(wrong),
        lost=sum(not run.inside_bounds for run in runs),
        sticking_out=sum(run.sticks_out for run in runs),
        verdicts=tuple(
            VerdictCountOut(verdict=verdict, runs=count)
            for verdict, count in Counter(run.verdict for run in runs).most_common()
        ),
        seconds=seconds,
        grips=_spread(run.grips for run in runs),
        touches=_touches(runs),
        touches_of=dict(sorted(Counter(run.touches for run in runs).items())),
        moved=_spread(run.moved for run in runs),
        position_error=_spread(errors) if errors else None,
        states=(states := _states(runs, limits, drawn.shares if drawn else {})),
        states_in_catalogue=len(drawn.shares if drawn else states),
        confusion=confusion_of(runs),
        hardest=_pairs(runs),
        separating=advice.separating,
        heights=advice.heights,
        best_heights=advice.best_heights,
        noise_budget=advice.noise_budget,
        wrong_runs=tuple(wrong[:_MAX_WRONG_RUNS]),
        placed_within=drawn and drawn.within_mm,
        by_probability=drawn.by_probability if drawn else 0,
        goal=limits and (limits.goal_mm, limits.goal_rad),
        max_grips=limits and limits.max_grips,
        stopped=sum(
            run.verdict is IdentificationVerdict.UNRESOLVED and run.grips >= limits.max_grips for run in runs
        )
        if limits
        else 0,
        grips_max=max(run.grips for run in runs),
        accuracy=_accuracy(identified, limits),
        true_error=(*_spread(true_errors), max(true_errors)) if true_errors else None,
        twins=_twins(runs),
        grip_seconds=_spread(grip_s) if grip_s else None,
    )


def _is_identified(run: StudyRunOut) -> bool:
    return run.verdict is IdentificationVerdict.IDENTIFIED


def _accuracy(identified: Sequence[StudyRunOut], limits: StudyGoals | None) -> AccuracyOut | None:
    """Accuracy that answers of identified runs guarantee; None without goals, or any run."""
    bounds = [
        (run.position_bound, run.orientation_bound)
        for run in identified
        if run.position_bound is not None and run.orientation_bound is not None
    ]
    if not bounds or limits is None:
        return None
    position, orientation = zip(*bounds, strict=True)
    return AccuracyOut(
        runs=len(bounds),
        position=(*_spread(position), max(position)),
        orientation=(*_spread(orientation), max(orientation)),
        within_goal=sum(mm <= limits.goal_mm and rad <= limits.goal_rad for mm, rad in bounds),
    )


def _twins(runs: Sequence[StudyRunOut]) -> tuple[TwinsOut, ...]:
    """Twins left at the end of runs of which no touch within reach tells more; the most frequent first."""
    left = Counter(run.left for run in runs if run.verdict is IdentificationVerdict.INDISTINGUISHABLE)
    return tuple(
        TwinsOut(states=tuple(f"{name}, {state}" for name, state in states), runs=count)
        for states, count in sorted(left.items(), key=lambda item: (-item[1], item[0]))
    )


def _touches(runs: Sequence[StudyRunOut]) -> TouchesOut:
    found = np.array([run.touches for run in runs])
    median, p90 = _spread(found)
    both = [(run.fewest, run.touches) for run in runs if _is_identified(run) and run.fewest is not None]
    fewest, taken = np.mean(both, axis=0).tolist() if both else (None, None)
    return TouchesOut(
        mean=float(found.mean()), median=median, p90=p90, max=int(found.max()), fewest=fewest, taken=taken
    )


def confusion_of(runs: Sequence[StudyRunOut]) -> tuple[ConfusionOut, ...]:
    """States that were still possible at the end beside the true one; the largest shares first."""
    total: Counter[str] = Counter()
    left: Counter[tuple[str, str]] = Counter()
    for run in runs:
        truth = f"{run.object}, {run.state}"
        total[truth] += 1
        others = (f"{name}, {state}" for name, state in run.left)
        left.update((truth, other) for other in others if other != truth)
    found = [ConfusionOut(a=a, b=b, share=count / total[a]) for (a, b), count in left.items()]
    return tuple(sorted(found, key=lambda item: (-item.share, item.a, item.b)))


def _states(
    runs: Sequence[StudyRunOut], limits: StudyGoals | None, shares: Mapping[tuple[str, str], float]
) -> tuple[StateStudiedOut, ...]:
    """States, those that are identified least often first."""
    by_state: dict[tuple[str, str], list[StudyRunOut]] = defaultdict(list)
    for run in runs:
        by_state[run.object, run.state].append(run)
    found = [_state(name, some, limits, shares.get(name)) for name, some in by_state.items()]
    return tuple(sorted(found, key=lambda item: (item.identified / item.runs, -item.touches[0], item.object)))


def _state(
    name: tuple[str, str], runs: Sequence[StudyRunOut], limits: StudyGoals | None, drawn: float | None
) -> StateStudiedOut:
    identified = [run for run in runs if _is_identified(run)]
    ended = Counter(run.verdict for run in runs)
    errors = [run.position_error for run in identified if run.position_error is not None]
    return StateStudiedOut(
        object=name[0],
        state=name[1],
        runs=len(runs),
        identified=len(identified),
        touches=_spread(run.touches for run in runs),
        position_error=float(np.median(errors)) if errors else None,
        indistinguishable=ended[IdentificationVerdict.INDISTINGUISHABLE],
        unresolved=ended[IdentificationVerdict.UNRESOLVED],
        accuracy=_accuracy(identified, limits),
        drawn=drawn,
    )


def _pairs(runs: Sequence[StudyRunOut]) -> tuple[PairStudiedOut, ...]:
    """First those that were left at the end most often, then those that lasted longest."""
    lasted: dict[tuple[str, str, str, str], list[tuple[int, int]]] = defaultdict(list)
    left: Counter[tuple[str, str, str, str]] = Counter()
    for run in runs:
        truth = run.object, run.state
        for rival in run.rivals:
            lasted[(*truth, rival.object, rival.state)].append((rival.touches, rival.grips))
        left.update((*truth, *other) for other in run.left if other != truth)
    found = [
        PairStudiedOut(
            object=pair[0],
            state=pair[1],
            other_object=pair[2],
            other_state=pair[3],
            runs=len(some),
            touches=float(np.mean([touches for touches, _ in some])),
            left=left[pair],
            grips=float(np.mean([grips for _, grips in some])),
        )
        for pair, some in lasted.items()
    ]
    return tuple(sorted(found, key=lambda item: (-item.left, -item.touches, -item.runs))[:_MAX_PAIRS])


def _spread(values: Iterable[float]) -> tuple[float, float]:
    """Median, and the smallest value that 90 % of all do not exceed."""
    found = np.array(list(values), dtype=float)
    return float(np.median(found)), float(np.sort(found)[math.ceil(9 * len(found) / 10) - 1])
