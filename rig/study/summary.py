"""Summary of a study: verdicts, touches, states that are hard to identify, pairs hard to tell apart."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.config.study_result import (
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
    VerdictCountOut,
)
from palpate.vocabulary import IdentificationVerdict, PartMotion, Strategy

__all__ = ["Advice", "confusion_of", "is_wrong", "study_out"]

_PAIRS = 200
_WRONG_SHOWN = 20
_NAMED = (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)


def is_wrong(run: StudyRunOut) -> bool:
    """Whether a run gave an answer that the truth is not in."""
    return run.verdict in _NAMED and not run.inside_bounds


@dataclass(frozen=True)
class Advice:
    """What a study says beside its runs: where fingers would help, and what errors cost."""

    separating: tuple[SeparatingStudiedOut, ...] = ()
    heights: tuple[HeightOut, ...] = ()
    best_heights: BestHeightsOut | None = None
    noise_budget: tuple[NoiseCostOut, ...] = ()


def study_out(
    runs: Sequence[StudyRunOut],
    *,
    objects: str,
    rig: str,
    strategy: Strategy,
    seed: int,
    parts: PartMotion = PartMotion.STILL,
    seconds: float = 0.0,
    states_in_catalogue: int | None = None,
    advice: Advice | None = None,
) -> StudyOut:
    """The summary; `objects`, `rig`: their names. There is at least one run.

    `states_in_catalogue`: from which states were drawn, None: those that were drawn are all.
    """
    wrong = [run for run in runs if is_wrong(run)]
    errors = [run.position_error for run in runs if run.position_error is not None and run.inside_bounds]
    advice = advice or Advice()
    return StudyOut(
        objects=objects,
        rig=rig,
        strategy=strategy,
        seed=seed,
        parts=parts,
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
        states=(states := _states(runs)),
        states_in_catalogue=len(states) if states_in_catalogue is None else states_in_catalogue,
        confusion=confusion_of(runs),
        hardest=_pairs(runs),
        separating=advice.separating,
        heights=advice.heights,
        best_heights=advice.best_heights,
        noise_budget=advice.noise_budget,
        wrong_runs=tuple(wrong[:_WRONG_SHOWN]),
    )


def _touches(runs: Sequence[StudyRunOut]) -> TouchesOut:
    found = np.array([run.touches for run in runs])
    median, p90 = _spread(found)
    return TouchesOut(mean=float(found.mean()), median=median, p90=p90, max=int(found.max()))


def confusion_of(runs: Sequence[StudyRunOut]) -> tuple[ConfusionOut, ...]:
    """Which states were still possible at the end beside the true one; the largest shares first."""
    total: Counter[str] = Counter()
    left: Counter[tuple[str, str]] = Counter()
    for run in runs:
        truth = f"{run.object}, {run.state}"
        total[truth] += 1
        others = (f"{name}, {state}" for name, state in run.left)
        left.update((truth, other) for other in others if other != truth)
    found = [ConfusionOut(a=a, b=b, share=count / total[a]) for (a, b), count in left.items()]
    return tuple(sorted(found, key=lambda item: (-item.share, item.a, item.b)))


def _states(runs: Sequence[StudyRunOut]) -> tuple[StateStudiedOut, ...]:
    """Those that are identified least often first."""
    by_state: dict[tuple[str, str], list[StudyRunOut]] = defaultdict(list)
    for run in runs:
        by_state[run.object, run.state].append(run)
    found = [_state(name, some) for name, some in by_state.items()]
    return tuple(sorted(found, key=lambda item: (item.identified / item.runs, -item.touches[0], item.object)))


def _state(name: tuple[str, str], runs: Sequence[StudyRunOut]) -> StateStudiedOut:
    identified = [run for run in runs if run.verdict is IdentificationVerdict.IDENTIFIED]
    errors = [run.position_error for run in identified if run.position_error is not None]
    return StateStudiedOut(
        object=name[0],
        state=name[1],
        runs=len(runs),
        identified=len(identified),
        touches=_spread(run.touches for run in runs),
        position_error=float(np.median(errors)) if errors else None,
    )


def _pairs(runs: Sequence[StudyRunOut]) -> tuple[PairStudiedOut, ...]:
    """First those that were left at the end most often, then those that lasted longest."""
    lasted: dict[tuple[str, str, str, str], list[int]] = defaultdict(list)
    left: Counter[tuple[str, str, str, str]] = Counter()
    for run in runs:
        truth = run.object, run.state
        for rival in run.rivals:
            lasted[(*truth, rival.object, rival.state)].append(rival.touches)
        left.update((*truth, *other) for other in run.left if other != truth)
    found = [
        PairStudiedOut(
            object=pair[0],
            state=pair[1],
            other_object=pair[2],
            other_state=pair[3],
            runs=len(touches),
            touches=float(np.mean(touches)),
            left=left[pair],
        )
        for pair, touches in lasted.items()
    ]
    return tuple(sorted(found, key=lambda item: (-item.left, -item.touches, -item.runs))[:_PAIRS])


def _spread(values: Iterable[float]) -> tuple[float, float]:
    """Median and 90th percentile."""
    found = np.array(list(values), dtype=float)
    return float(np.median(found)), float(np.percentile(found, 90))
