"""A study's result in words: sentences for its page, and lines for a terminal."""

import math
from collections import defaultdict
from collections.abc import Sequence

from palpate.base.errors import quantity
from palpate.base.vocabulary import ErrorSource, IdentificationVerdict, PartMotion
from palpate.config.learning_study_result import LearningRunOut, LearningStudyOut, ToleranceCostOut
from palpate.config.study_result import (
    AccuracyOut,
    BestHeightsOut,
    ComparedOut,
    NoiseCostOut,
    PairStudiedOut,
    StudyOut,
    TouchesOut,
)
from palpate.rig.study.variations import VARIATION_DIVISOR
from palpate.views.numerals import at_most, signed

_ERROR_PROBABILITY = 0.05
_MAX_HEIGHT_SETS = 3
_NOT_COMPARED = "were compared: at none are sections of all parts known"
SOURCE_WORDS = {
    ErrorSource.POSITION: "half the bound of contacts",
    ErrorSource.NORMAL: "half the range of normals",
    ErrorSource.TOLERANCE: "half the tolerance of parts",
    ErrorSource.REACH: "half the aims of fingers",
    ErrorSource.MOTION: "part held firmly",
}
"""What is changed for each source of error."""


def bounds_words(position_mm: float, orientation_rad: float) -> str:
    """Half widths of both."""
    return f"± {at_most(position_mm)} mm, ± {at_most(math.degrees(orientation_rad))}°"


def placement_words(out: StudyOut) -> str:
    """Say where parts are put."""
    return f"within {out.placed_within:g} mm of the middle of the workspace"


def draws_words(out: StudyOut) -> str:
    """Say how states are drawn, as the end of a sentence."""
    if not out.by_probability:
        return "objects and their states are drawn evenly"
    some = quantity(out.by_probability, "object", "objects")
    return f"objects are drawn evenly, states of {some} by their probabilities"


def wrong_answers_words(out: StudyOut) -> str:
    """Say how many answers were wrong, or may be after so many runs of which none was."""
    if out.wrong:
        return f"{quantity(out.wrong, 'wrong answer', 'wrong answers')} in {out.runs} runs"
    most = 100 * (1 - _ERROR_PROBABILITY ** (1 / out.runs))
    runs = quantity(out.runs, "run", "runs")
    return f"no wrong answer in {runs} (fewer than {at_most(most, 1)} % with 95 % confidence)"


def verdict_words(out: StudyOut, verdict: IdentificationVerdict) -> str:
    """Say what came of runs that ended so, beyond their number; empty if there is no more to say."""
    match verdict:
        case IdentificationVerdict.INDISTINGUISHABLE:
            return _twins_words(out)
        case IdentificationVerdict.UNRESOLVED:
            return _unresolved_words(out)
        case _:
            return ""


def _twins_words(out: StudyOut) -> str:
    named = [
        f"{' ~ '.join(item.states) if len(item.states) > 1 else f'places of {item.states[0]}'} ({item.runs})"
        for item in out.twins
    ]
    more = f"; {len(named) - _MAX_HEIGHT_SETS} more" if len(named) > _MAX_HEIGHT_SETS else ""
    return f"no touch within reach tells apart {'; '.join(named[:_MAX_HEIGHT_SETS])}{more}" if named else ""


def _unresolved_words(out: StudyOut) -> str:
    states = sorted((item for item in out.states if item.unresolved), key=lambda item: -item.unresolved)
    named = [f"{item.object}, {item.state} ({item.unresolved})" for item in states]
    more = f"; {len(named) - _MAX_HEIGHT_SETS} more" if len(named) > _MAX_HEIGHT_SETS else ""
    unresolved = sum(item.unresolved for item in out.states)
    some = "" if out.stopped == unresolved else f"{out.stopped} of them "
    stopped = f"{some}stopped at max_grips ({out.max_grips}): " if out.stopped else ""
    return f"{stopped}{'; '.join(named[:_MAX_HEIGHT_SETS])}{more}"


def fewest_words(touches: TouchesOut) -> str:
    """Say how many touches any strategy needs, beside those that were made."""
    return (
        f"identified runs took {touches.taken:.1f}; any strategy needs {touches.fewest:.1f} to single out "
        "and to place the part, before anything confirms it"
    )


def _accuracy_words(item: AccuracyOut) -> str:
    """Say what answers guarantee: median, 90 % and the worst."""
    median, p90, worst = (
        bounds_words(mm, rad) for mm, rad in zip(item.position, item.orientation, strict=True)
    )
    return f"known to {median} in the median; {p90} in 90 %; {worst} at worst"


def goal_words(item: AccuracyOut, goal: tuple[float, float]) -> str:
    """Say how many are placed as finely as is asked."""
    asked = f"± {goal[0]:g} mm, ± {math.degrees(goal[1]):.4g}°"
    return f"placed within the goal ({asked}): {item.within_goal} of {item.runs}"


def hard_pairs(pairs: Sequence[PairStudiedOut]) -> list[PairStudiedOut]:
    """Both directions of each pair as one, without pairs that the second grip told apart in every run."""
    both: dict[frozenset[tuple[str, str]], list[PairStudiedOut]] = defaultdict(list)
    for pair in pairs:
        both[frozenset(((pair.object, pair.state), (pair.other_object, pair.other_state)))].append(pair)
    found = [_merge_directions(some) for some in both.values()]
    lasting = (pair for pair in found if pair.left or pair.grips > 1)
    return sorted(lasting, key=lambda item: (-item.left, -item.touches, -item.runs))


def _merge_directions(pairs: Sequence[PairStudiedOut]) -> PairStudiedOut:
    runs = sum(pair.runs for pair in pairs)
    return pairs[0].model_copy(
        update={
            "runs": runs,
            "left": sum(pair.left for pair in pairs),
            "touches": sum(pair.touches * pair.runs for pair in pairs) / runs,
            "grips": sum(pair.grips * pair.runs for pair in pairs) / runs,
        }
    )


def best_heights_words(best: BestHeightsOut, heights_mm: Sequence[float], *, others: bool = True) -> str:
    """Say where fingers should be; `others`: whether there were other heights to compare."""
    fingers = f"fingers at {_heights_text(heights_mm)}"
    if not best.alike_now:
        return f"{fingers} distinguish all pairs of states"
    now = quantity(best.alike_now, "pair of states is", "pairs of states are")
    words = f"{fingers}: {now} never, or perhaps not, distinguished"
    if best.alike >= best.alike_now:
        return f"{words}; no other heights {'would do better' if others else _NOT_COMPARED}"
    return f"{words}; {best.alike or 'none'} with fingers at {_heights_text(best.heights)}"


def _heights_text(heights_mm: Sequence[float]) -> str:
    return f"{', '.join(f'{height:g}' for height in sorted(set(heights_mm)))} mm"


def _comparison_words(item: ComparedOut) -> str:
    """Say what a change gains in the same runs, and what of it may be chance."""
    if not item.shown:
        runs = quantity(item.runs, "run", "runs")
        return f"the same in {runs}" if _is_unchanged(item) else f"no effect can be shown with {runs}"
    gained = item.identified[1] - item.identified[0]
    change = signed(gained, "d") if gained else "as many"
    parts = [f"{change} of {item.runs} identified{_chance_words(item, 'identified')}"]
    if item.fewer_touches is not None and item.fewer_interval is not None:
        kind = "fewer" if item.fewer_touches >= 0 else "more"
        parts.append(f"{abs(item.fewer_touches):.1f} touches {kind}{_chance_words(item, 'touches')}")
        parts.append(_bounds_change(item))
    else:
        parts.append(f"only {item.pairs} identified both ways")
    return ", ".join(parts)


def _is_unchanged(item: ComparedOut) -> bool:
    place = item.position_bound
    same_touches = item.saved_touches == 0 == item.standard_error
    return same_touches and item.identified[0] == item.identified[1] and (not place or place[0] == place[1])


def may_be_chance(item: ComparedOut, what: str) -> bool:
    """True if there is a difference of identified runs, touches or bounds that is not shown."""
    place = item.position_bound
    differs = {
        "identified": item.identified[0] != item.identified[1],
        "touches": bool(item.fewer_touches),
        "bounds": place is not None and place[0] != place[1],
    }
    return differs[what] and what not in item.shown


def _chance_words(item: ComparedOut, what: str) -> str:
    return " (may be chance)" if may_be_chance(item, what) else ""


def _bounds_change(item: ComparedOut) -> str:
    assert item.position_bound is not None
    assert item.orientation_bound is not None
    (now, then), (turn, turn_then) = item.position_bound, item.orientation_bound
    turned, turned_then = (at_most(math.degrees(value)) for value in (turn, turn_then))
    words = f"± {at_most(now)} → {at_most(then)} mm, ± {turned}° → {turned_then}°"
    return f"{words}{_chance_words(item, 'bounds')}"


def more_runs_words(costs: Sequence[NoiseCostOut], runs: int) -> str:
    """Say with which option effects would be shown that are not; empty where all are."""
    wanted = max((item.runs_wanted or 0 for item in costs), default=0)
    if not wanted:
        return ""
    option = f"--budget {wanted}" if wanted <= runs else f"--runs {wanted} --budget {wanted}"
    return f"with {option} a difference of half a touch would show"


def no_budget_words(out: StudyOut) -> str:
    """Why errors are not compared."""
    runs = quantity(out.runs, "run", "runs")
    return f"what errors cost is not compared: a tenth of {runs} is none; --budget N repeats N of them"


_MAX_ROWS = 8


def study_lines(out: StudyOut, heights_mm: Sequence[float]) -> list[str]:
    """Verdicts, accuracy and costs first, then the hardest states and pairs; fingers are at `heights_mm`."""
    lines = [*_verdict_lines(out), *_accuracy_lines(out), *_cost_lines(out)]
    hard = [state for state in out.states if state.identified < state.runs][:_MAX_ROWS]
    if hard:
        lines += ["", "identified least often"]
        for state in hard:
            share = f"{state.identified} of {state.runs}"
            words = f"{state.object}, {state.state}: {share}, {state.touches[0]:g} touches in the median"
            lines.append(f"  {words}")
    lines += _pair_lines(hard_pairs(out.hardest))
    return lines + _heights_lines(out, heights_mm) + _budget_lines(out)


def _heights_lines(out: StudyOut, heights_mm: Sequence[float]) -> list[str]:
    best = out.best_heights
    if best is None:
        return []
    lines = ["", best_heights_words(best, heights_mm, others=bool(out.heights))]
    if best.compared is not None:
        runs = quantity(best.compared.runs, "run", "runs")
        lines.append(f"  the first {runs} again with fingers there: {_comparison_words(best.compared)}")
    return lines


def _verdict_lines(out: StudyOut) -> list[str]:
    moving = ", parts that move" if out.parts is PartMotion.MOVING else ""
    lines = [f"{quantity(out.runs, 'run', 'runs')}, rig {out.rig}, {_states_words(out)}{moving}:"]
    for item in out.verdicts:
        lines.append(f"  {item.verdict.value:20s} {item.runs:6d}  {100 * item.runs / out.runs:5.1f} %")
        if words := verdict_words(out, item.verdict):
            lines.append(f"    {words}")
    lines.append(f"  {'wrong answers':20s} {out.wrong:6d}")
    if out.lost > out.wrong:
        lines.append(f"  {'true part ruled out':20s} {out.lost:6d}")
    if out.sticking_out:
        words = "of the workspace: answers are for parts inside"
        lines.append(f"  {'parts sticking out':20s} {out.sticking_out:6d}  {words}")
    if not out.wrong:
        lines.append(wrong_answers_words(out))
    if out.placed_within is not None:
        lines.append(f"parts lie {placement_words(out)}; {draws_words(out)}")
    return lines


def _states_words(out: StudyOut) -> str:
    """Say how many states were drawn, and of how many where that is not all."""
    drawn, all_states = len(out.states), out.states_in_catalogue
    if drawn == all_states:
        return quantity(drawn, "state", "states")
    return f"{drawn} of {quantity(all_states, 'state', 'states')} drawn"


def _accuracy_lines(out: StudyOut) -> list[str]:
    lines = []
    if out.accuracy is not None and out.goal is not None:
        lines = [
            "",
            f"identified: {_accuracy_words(out.accuracy)}",
            f"  {goal_words(out.accuracy, out.goal)}",
        ]
    if out.true_error is not None:
        median, p90, worst = out.true_error
        words = f"{median:.2f} mm in the median, at most {p90:.2f} mm in 90 %, {worst:.2f} mm at worst"
        lines.append(f"  true error, which only the simulator knows: {words}")
    return lines


def _cost_lines(out: StudyOut) -> list[str]:
    touches, grips = out.touches, out.grips
    lines = [
        f"touches {touches.mean:.1f} on average, in 90 % of runs at most {touches.p90:g}, "
        f"{touches.max} at worst",
        *([] if touches.fewest is None else [f"  {fewest_words(touches)}"]),
        f"grips {grips[0]:g} in the median, in 90 % of runs at most {grips[1]:g}, {out.grips_max} at worst",
    ]
    if out.grip_seconds is not None:
        median, p90 = out.grip_seconds
        lines.append(f"rig time in grips {median:.0f} s in the median, in 90 % of runs at most {p90:.0f} s")
    return lines


def _budget_lines(out: StudyOut) -> list[str]:
    costs = out.noise_budget
    if not costs:
        return ["", no_budget_words(out)] if out.runs < VARIATION_DIVISOR else []
    width = max(len(SOURCE_WORDS[item.source]) for item in costs)
    head = f"the first {quantity(costs[0].runs, 'run', 'runs')} again, with one thing changed"
    lines = [
        "",
        head,
        *(f"  {SOURCE_WORDS[item.source]:{width}s}  {_comparison_words(item)}" for item in costs),
    ]
    more = more_runs_words(costs, out.runs)
    return [*lines, f"  ({more})"] if more else lines


def _pair_lines(pairs: Sequence[PairStudiedOut]) -> list[str]:
    if not pairs:
        return []
    return ["", "hardest to tell apart", *(f"  {_pair_words(pair)}" for pair in pairs[:_MAX_ROWS])]


def _pair_words(pair: PairStudiedOut) -> str:
    """Both, and what came of it."""
    end = f", at the end of {quantity(pair.left, 'run', 'runs')}" if pair.left else ""
    return (
        f"{pair.object}, {pair.state} ~ {pair.other_object}, {pair.other_state}: still possible after "
        f"{pair.touches:.1f} touches in {quantity(pair.runs, 'run', 'runs')}{end}"
    )


def learning_study_lines(out: LearningStudyOut) -> list[str]:
    """Cost of each tolerance, states that were not learned as finely as asked for, and false bounds."""
    runs = quantity(len(out.runs), "run", "runs")
    return [
        f"{runs}, rig {out.rig}, parts {out.height:g} mm high, {out.max_seconds:g} s for each at most:",
        "  tolerance   reached by      touches     rig time",
        *(_cost_line(item, len(out.runs)) for item in out.costs),
        *_coarse_lines(out.runs),
        f"{quantity(out.outside, 'truth', 'truths')} outside bounds in {runs}"
        if out.outside
        else f"no truth outside its bounds in {runs}",
        f"parts lie within {out.placed_within:g} mm of the middle of the workspace",
    ]


def _cost_line(item: ToleranceCostOut, runs: int) -> str:
    share = f"{item.runs} of {runs}"
    touches = "-" if item.touches is None else f"{item.touches:g}"
    seconds = "-" if item.rig_seconds is None else f"{item.rig_seconds:.0f} s"
    return f"  {item.tolerance:6g} mm   {share:>10}   {touches:>10}   {seconds:>10}"


def _coarse_lines(runs: Sequence[LearningRunOut]) -> list[str]:
    """Lines on the states that missed the goal, the most frequent first."""
    missed: dict[tuple[str, str], list[LearningRunOut]] = defaultdict(list)
    for run in runs:
        if not run.goal_met:
            missed[run.object, run.state].append(run)
    if not missed:
        return []
    lines = ["not as fine as asked for"]
    for (name, state), some in sorted(missed.items(), key=lambda item: -len(item[1]))[:_MAX_ROWS]:
        known = [run.tolerance for run in some if run.tolerance is not None]
        best = f"at best {at_most(min(known))} mm" if known else "never closed"
        lines.append(f"  {name}, {state}: {quantity(len(some), 'run', 'runs')}, {best}")
    return lines
