"""A study's result for a terminal."""

from collections.abc import Sequence

from palpate.config.study_result import PairStudiedOut, StudyOut
from palpate.errors import counted

__all__ = ["pair_words", "study_lines"]

_SHOWN = 8


def study_lines(out: StudyOut) -> list[str]:
    """Verdicts and costs first, then the states and pairs that are hardest."""
    lines = [
        f"{counted(out.runs, 'run', 'runs')}, rig {out.rig}, {counted(len(out.states), 'state', 'states')}:"
    ]
    lines += [
        f"  {item.verdict.value:18s} {item.runs:6d}  {100 * item.runs / out.runs:5.1f} %"
        for item in out.verdicts
    ]
    lines.append(f"  {'wrong answers':18s} {out.wrong:6d}")
    if out.lost > out.wrong:
        lines.append(f"  {'truth not left':18s} {out.lost:6d}")
    touches, grips = out.touches, out.grips
    lines.append(
        f"touches {touches.median:g}, in 90 % of runs up to {touches.p90:g}; grips {grips[0]:g}, {grips[1]:g}"
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
    return lines + _pair_lines(out.hardest)


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
