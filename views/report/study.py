"""Report of a study: verdicts, touches, pairs that are hard to tell apart, heights, and what errors cost."""

import math
from collections.abc import Iterator, Sequence
from importlib.metadata import version

from palpate.config.study_result import ComparedOut, StudyOut
from palpate.errors import counted
from palpate.geometry import ObjectModel
from palpate.views.report.page import heading, page, paragraph, picture, section, table
from palpate.views.study_pictures import (
    MATRIX_STATES,
    SOURCE_WORDS,
    budget_picture,
    confusion_picture,
    heights_picture,
    pair_pictures,
    states_picture,
    touches_picture,
)
from palpate.views.study_text import best_heights_words
from palpate.vocabulary import PartMotion

__all__ = ["study_report"]

_PAIRS = 40
_DOUBT = 0.05
_SIMULATED = {
    PartMotion.STILL: "Parts that lie still, touched by straight approaches as the rig plans them, "
    "mismeasured within the rig's bounds. What devices do beyond that, and parts that move, are not in it.",
    PartMotion.MOVING: "Parts that slide when they are pushed, as the rig file's emulation.part says, "
    "touched at the rig's speeds and forces; contacts are mismeasured within the rig's bounds. What devices "
    "do beyond that is not in it.",
}


def study_report(out: StudyOut, objects: Sequence[ObjectModel], heights_mm: Sequence[float]) -> str:
    """The page; `heights_mm`: of the rig's fingers."""
    title = (
        f"{counted(out.wrong, 'wrong answer', 'wrong answers')} in {out.runs} runs"
        if out.wrong
        else f"No wrong answer in {counted(out.runs, 'run', 'runs')}"
    )
    parts = [
        heading(
            title,
            f"catalogue {out.objects}, rig {out.rig}, strategy {out.strategy.value}, seed {out.seed}, "
            f"parts {'move' if out.parts is PartMotion.MOVING else 'lie still'}",
        ),
        _verdicts(out),
        section("Touches needed", _costs(out), picture(touches_picture(out.touches_of))),
        *_confusion(out),
        *_hardest(out, objects, heights_mm),
        *_heights(out, heights_mm),
        *_budget(out),
        _states(out),
        section(
            "What was simulated", paragraph(_SIMULATED[out.parts]), paragraph(f"palpate {version('palpate')}")
        ),
    ]
    return page(f"Study of {out.objects} on rig {out.rig}", parts)


def _verdicts(out: StudyOut) -> str:
    rows = [
        (item.verdict.value, str(item.runs), f"{100 * item.runs / out.runs:.1f} %") for item in out.verdicts
    ]
    rows.append(("wrong answers", str(out.wrong), f"{100 * out.wrong / out.runs:.1f} %"))
    if out.lost > out.wrong:
        rows.append(("truth not left", str(out.lost), f"{100 * out.lost / out.runs:.1f} %"))
    if out.sticking_out:
        share = f"{100 * out.sticking_out / out.runs:.1f} %"
        rows.append(("part sticking out of the workspace", str(out.sticking_out), share))
    parts = [table(("verdict", "runs", "share"), rows, numbers=("runs", "share"))]
    if not out.wrong:
        most = 100 * (1 - _DOUBT ** (1 / out.runs))
        words = f"None was wrong: with 95 % confidence, fewer than {most:.2g} % of all such runs are."
        parts.append(paragraph(words))
    return section("Verdicts", *parts)


def _costs(out: StudyOut) -> str:
    rows = [
        ("touches", f"{out.touches.mean:.2f}", f"{out.touches.median:g}", f"{out.touches.p90:g}"),
        ("grips", "", f"{out.grips[0]:g}", f"{out.grips[1]:g}"),
    ]
    if out.position_error is not None:
        rows.append(
            ("position error, mm", "", f"{out.position_error[0]:.2f}", f"{out.position_error[1]:.2f}")
        )
    if out.parts is PartMotion.MOVING:
        rows.append(("part moved by, mm", "", f"{out.moved[0]:.2f}", f"{out.moved[1]:.2f}"))
    numbers = ("mean", "median", "90 %")
    return table(("", *numbers), rows, numbers=numbers)


def _confusion(out: StudyOut) -> Iterator[str]:
    parts = [paragraph("No run ended with another state than the true one still possible.")]
    if out.confusion:
        words = "Percent of the runs with the row's part that ended with the column's still possible."
        parts = [paragraph(words), picture(confusion_picture(out.confusion))]
        count = len({name for item in out.confusion for name in (item.a, item.b)})
        if count > MATRIX_STATES:
            words = f"{MATRIX_STATES} of {count} states are shown, those with the largest shares."
            parts.append(paragraph(words))
    if any(item.identified < item.runs for item in out.states):
        parts.append(
            paragraph(
                "A run that ends with several places of the true state alone has not identified it either, "
                "and is not in here."
            )
        )
    yield section("Confusion", *parts, kind="sections")


def _hardest(out: StudyOut, objects: Sequence[ObjectModel], heights_mm: Sequence[float]) -> Iterator[str]:
    if not out.hardest:
        return
    names = ("lay there", "still possible", "after touches", "runs", "at the end")
    rows = [
        (
            f"{item.object}, {item.state}",
            f"{item.other_object}, {item.other_state}",
            f"{item.touches:.1f}",
            str(item.runs),
            str(item.left),
        )
        for item in out.hardest[:_PAIRS]
    ]
    yield section(
        "Hardest to tell apart",
        paragraph(f"Outlines at {min(heights_mm):g} mm, laid on each other."),
        picture(pair_pictures(out.hardest, objects, min(heights_mm))),
        table(names, rows, numbers=names[2:]),
        kind="sections",
    )


def _heights(out: StudyOut, heights_mm: Sequence[float]) -> Iterator[str]:
    if out.best_heights is None or not out.heights:
        return
    words = best_heights_words(out.best_heights, heights_mm)
    parts = [paragraph(f"{words[:1].upper()}{words[1:]}.")]
    if out.best_heights.compared is not None:
        parts.append(_compared([("there", out.best_heights.compared)]))
    if len(out.heights) > 1:
        parts.append(picture(heights_picture(out.heights, heights_mm, out.best_heights.heights)))
    rows = [
        (item.a, item.b, ", ".join(f"{low:g}–{high:g} mm" for low, high in item.heights) or "no one height")
        for item in out.separating
    ]
    if rows:
        parts.append(table(("confused", "with", "a finger would tell them apart at"), rows))
    yield section("Heights of fingers", *parts)


def _budget(out: StudyOut) -> Iterator[str]:
    if not out.noise_budget:
        return
    runs = out.noise_budget[0].runs
    words = (
        f"The first {counted(runs, 'run', 'runs')} again, with half of one error, or with the middle half of "
        "the aims only: what better measurement would save, and what less reach would cost. Lines are two "
        "standard errors long, either way."
    )
    rows = [(f"half the {SOURCE_WORDS[item.source.value]}", item) for item in out.noise_budget]
    yield section(
        "What errors cost", paragraph(words), picture(budget_picture(out.noise_budget)), _compared(rows)
    )


def _compared(rows: Sequence[tuple[str, ComparedOut]]) -> str:
    """Values as they are and as they become."""
    names = ("touches", "saved", "± s.e.", "identified", "position ± mm", "orientation ± °")
    return table(
        ("", *names),
        [
            (
                words,
                _change(item.touches, "{:.2f}"),
                f"{item.saved_touches:+.2f}".replace("-", "−"),
                f"{item.standard_error:.2f}",
                _change(item.identified, "{:d}"),
                _change(item.position_bound, "{:.2f}"),
                _change(item.orientation_bound, "{:.2f}", 180 / math.pi),
            )
            for words, item in rows
        ],
        numbers=names,
    )


def _change(values: tuple[float, float] | None, form: str, scale: float = 1) -> str:
    return "" if values is None else " → ".join(form.format(scale * value) for value in values)


def _states(out: StudyOut) -> str:
    names = ("object", "state", "runs", "identified", "touches", "90 %", "error, mm")
    rows = [
        (
            item.object,
            item.state,
            str(item.runs),
            f"{100 * item.identified / item.runs:.0f} %",
            f"{item.touches[0]:g}",
            f"{item.touches[1]:g}",
            "" if item.position_error is None else f"{item.position_error:.2f}",
        )
        for item in out.states
    ]
    hard = [item for item in out.states if item.identified < item.runs]
    shown = (
        [paragraph("Share identified, of those that were not always."), picture(states_picture(hard))]
        if hard
        else []
    )
    return section("States", *shown, table(names, rows, numbers=names[2:]), kind="sections")
