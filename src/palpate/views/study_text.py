"""A study's result for a terminal."""

from collections.abc import Sequence

from palpate.base.errors import counted
from palpate.base.vocabulary import PartMotion
from palpate.config.study_result import PairStudiedOut, StudyOut
from palpate.views.study_words import (
    SOURCE_WORDS,
    VARIED_SHARE,
    accuracy_words,
    best_heights_words,
    comparison_words,
    drawn_words,
    goal_words,
    more_runs_words,
    no_budget_words,
    pairs_lasting,
    placed_words,
    verdict_words,
    wrong_words,
)

__all__ = ["study_lines"]

_SHOWN = 8


def study_lines(out: StudyOut, heights_mm: Sequence[float]) -> list[str]:
    """Verdicts, accuracy and costs first, then the hardest states and pairs; fingers are at `heights_mm`."""
    lines = [*_verdict_lines(out), *_accuracy_lines(out), *_cost_lines(out)]
    hard = [state for state in out.states if state.identified < state.runs][:_SHOWN]
    if hard:
        lines += ["", "identified least often"]
        for state in hard:
            share = f"{state.identified} of {state.runs}"
            words = f"{state.object}, {state.state}: {share}, {state.touches[0]:g} touches in the median"
            lines.append(f"  {words}")
    lines += _pair_lines(pairs_lasting(out.hardest))
    return lines + _heights_lines(out, heights_mm) + _budget_lines(out)


def _heights_lines(out: StudyOut, heights_mm: Sequence[float]) -> list[str]:
    best = out.best_heights
    if best is None:
        return []
    lines = ["", best_heights_words(best, heights_mm, others=bool(out.heights))]
    if best.compared is not None:
        runs = counted(best.compared.runs, "run", "runs")
        lines.append(f"  the first {runs} again with fingers there: {comparison_words(best.compared)}")
    return lines


def _verdict_lines(out: StudyOut) -> list[str]:
    moving = ", parts that move" if out.parts is PartMotion.MOVING else ""
    lines = [f"{counted(out.runs, 'run', 'runs')}, rig {out.rig}, {_states_words(out)}{moving}:"]
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
        lines.append(wrong_words(out))
    if out.placed_within is not None:
        lines.append(f"parts lie {placed_words(out)}; {drawn_words(out)}")
    return lines


def _states_words(out: StudyOut) -> str:
    """How many states were drawn, and of how many where that is not all."""
    drawn, all_states = len(out.states), out.states_in_catalogue
    if drawn == all_states:
        return counted(drawn, "state", "states")
    return f"{drawn} of {counted(all_states, 'state', 'states')} drawn"


def _accuracy_lines(out: StudyOut) -> list[str]:
    lines = []
    if out.accuracy is not None and out.goal is not None:
        lines = [
            "",
            f"identified: {accuracy_words(out.accuracy)}",
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
        f"grips {grips[0]:g} in the median, in 90 % of runs at most {grips[1]:g}, {out.grips_max} at worst",
    ]
    if out.grip_seconds is not None:
        median, p90 = out.grip_seconds
        lines.append(f"rig time in grips {median:.0f} s in the median, in 90 % of runs at most {p90:.0f} s")
    return lines


def _budget_lines(out: StudyOut) -> list[str]:
    costs = out.noise_budget
    if not costs:
        return ["", no_budget_words(out)] if out.runs < VARIED_SHARE else []
    width = max(len(SOURCE_WORDS[item.source]) for item in costs)
    head = f"the first {counted(costs[0].runs, 'run', 'runs')} again, with one thing changed"
    lines = [
        "",
        head,
        *(f"  {SOURCE_WORDS[item.source]:{width}s}  {comparison_words(item)}" for item in costs),
    ]
    more = more_runs_words(costs, out.runs)
    return [*lines, f"  ({more})"] if more else lines


def _pair_lines(pairs: Sequence[PairStudiedOut]) -> list[str]:
    if not pairs:
        return []
    return ["", "hardest to tell apart", *(f"  {_pair_words(pair)}" for pair in pairs[:_SHOWN])]


def _pair_words(pair: PairStudiedOut) -> str:
    """Both, and what came of it."""
    end = f", at the end of {counted(pair.left, 'run', 'runs')}" if pair.left else ""
    return (
        f"{pair.object}, {pair.state} ~ {pair.other_object}, {pair.other_state}: still possible after "
        f"{pair.touches:.1f} touches in {counted(pair.runs, 'run', 'runs')}{end}"
    )
