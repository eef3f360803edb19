"""A study's result for a terminal."""

import math
from collections.abc import Sequence

from palpate.config.study_result import BestHeightsOut, ComparedOut, NoiseCostOut, PairStudiedOut, StudyOut
from palpate.errors import counted
from palpate.vocabulary import PartMotion

__all__ = ["best_heights_words", "pair_words", "study_lines"]

_SHOWN = 8


def study_lines(out: StudyOut, heights_mm: Sequence[float]) -> list[str]:
    """Verdicts and costs first, then the states and pairs that are hardest; fingers are at `heights_mm`."""
    lines = [
        f"{counted(out.runs, 'run', 'runs')}, rig {out.rig}, {_states_words(out)}"
        f"{', parts that move' if out.parts is PartMotion.MOVING else ''}:"
    ]
    lines += [
        f"  {item.verdict.value:18s} {item.runs:6d}  {100 * item.runs / out.runs:5.1f} %"
        for item in out.verdicts
    ]
    lines.append(f"  {'wrong answers':18s} {out.wrong:6d}")
    if out.lost > out.wrong:
        lines.append(f"  {'truth not left':18s} {out.lost:6d}")
    if out.sticking_out:
        words = "of the workspace: answers are for parts inside"
        lines.append(f"  {'parts sticking out':18s} {out.sticking_out:6d}  {words}")
    touches, grips = out.touches, out.grips
    lines.append(
        f"touches {touches.mean:.1f} on average, in 90 % of runs up to {touches.p90:g}; "
        f"grips {grips[0]:g} in the median, up to {grips[1]:g}"
    )
    if out.position_error is not None:
        lines.append(
            f"position error {out.position_error[0]:.2f} mm, in 90 % up to {out.position_error[1]:.2f} mm"
        )
    hard = [state for state in out.states if state.identified < state.runs][:_SHOWN]
    if hard:
        lines += ["", "identified least often"]
        for state in hard:
            share = f"{state.identified} of {state.runs}"
            lines.append(f"  {state.object}, {state.state}: {share}, {state.touches[0]:g} touches")
    lines += _pair_lines(out.hardest)
    if out.best_heights is not None:
        lines += ["", best_heights_words(out.best_heights, heights_mm)]
    return lines + _budget_lines(out.noise_budget)


def _states_words(out: StudyOut) -> str:
    """How many states were drawn, and of how many where that is not all."""
    drawn, all_states = len(out.states), out.states_in_catalogue
    if drawn == all_states:
        return counted(drawn, "state", "states")
    return f"{drawn} of {counted(all_states, 'state', 'states')} drawn"


def best_heights_words(best: BestHeightsOut, heights_mm: Sequence[float]) -> str:
    """Where fingers should be."""
    now = ", ".join(f"{height:g}" for height in sorted(set(heights_mm)))
    alike = (
        counted(best.alike_now, "pair of states is", "pairs of states are")
        if best.alike_now
        else "no pair is"
    )
    if best.alike >= best.alike_now:
        there = f"fingers at {now} mm: {alike} alike there"
        return f"{there}, and no other heights would do better" if best.alike_now else there
    wanted = ", ".join(f"{height:g}" for height in best.heights)
    words = f"fingers at {now} mm: {alike} alike there; at {wanted} mm, {best.alike or 'none'}"
    return words if best.compared is None else f"{words}: {_compared_words(best.compared)}"


def _compared_words(item: ComparedOut) -> str:
    """What runs there came to, beside the same ones as it is."""
    now, there = item.identified
    saved = f"{abs(item.saved_touches):.1f} touches {'fewer' if item.saved_touches > 0 else 'more'}"
    return f"of {counted(item.runs, 'run', 'runs')} {there} identified there, {now} as it is, with {saved}"


def _budget_lines(costs: Sequence[NoiseCostOut]) -> list[str]:
    if not costs:
        return []
    head = f"half of an error saves, in {counted(costs[0].runs, 'run', 'runs')}"
    return ["", head, *(f"  {_budget_words(item)}" for item in costs)]


def _budget_words(item: NoiseCostOut) -> str:
    saved = f"{item.saved_touches:+.2f}".replace("-", "−")
    words = f"{item.source.value:10s} {saved} ± {item.standard_error:.2f} touches"
    if item.position_bound is None or item.orientation_bound is None:
        return words
    (now, then), (turn, then_turn) = item.position_bound, item.orientation_bound
    turns = f"± {math.degrees(turn):.2f}° → {math.degrees(then_turn):.2f}°"
    return f"{words}, bounds ± {now:.2f} → {then:.2f} mm, {turns}"


def _pair_lines(pairs: Sequence[PairStudiedOut]) -> list[str]:
    if not pairs:
        return []
    return ["", "hardest to tell apart", *(f"  {pair_words(pair)}" for pair in pairs[:_SHOWN])]


def pair_words(pair: PairStudiedOut) -> str:
    """Both, and what came of it."""
    end = f", at the end of {counted(pair.left, 'run', 'runs')}" if pair.left else ""
    return (
        f"{pair.object}, {pair.state} ~ {pair.other_object}, {pair.other_state}: still possible after "
        f"{pair.touches:.1f} touches in {counted(pair.runs, 'run', 'runs')}{end}"
    )
