"""Report of a study: verdicts, touches, every state, and the pairs that are hardest to tell apart."""

from importlib.metadata import version

from palpate.config.study_result import StudyOut
from palpate.errors import counted
from palpate.views.report.page import heading, page, paragraph, picture, section, table
from palpate.views.svg import element, number, text

__all__ = ["study_report"]

_WIDTH, _ROW, _NAME, _BARS = 760.0, 18.0, 260.0, 24


def study_report(out: StudyOut) -> str:
    """The page."""
    title = (
        f"{counted(out.wrong, 'wrong answer', 'wrong answers')} in {out.runs} runs"
        if out.wrong
        else f"No wrong answer in {counted(out.runs, 'run', 'runs')}"
    )
    rows = [
        (item.verdict.value, str(item.runs), f"{100 * item.runs / out.runs:.1f} %") for item in out.verdicts
    ]
    spread = [
        ("grips", f"{out.grips[0]:g}", f"{out.grips[1]:g}"),
        ("touches", f"{out.touches.median:g}", f"{out.touches.p90:g}"),
    ]
    if out.position_error is not None:
        spread.append(("position error, mm", f"{out.position_error[0]:.2f}", f"{out.position_error[1]:.2f}"))
    states = [
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
    pairs = [
        (
            f"{item.object}, {item.state}",
            f"{item.other_object}, {item.other_state}",
            f"{item.touches:.1f}",
            str(item.runs),
            str(item.left),
        )
        for item in out.hardest
    ]
    counts, costs = ("runs", "share"), ("median", "90 %")
    state_names = ("object", "state", "runs", "identified", "touches", "90 %", "error, mm")
    pair_names = ("lay there", "still possible", "after touches", "runs", "at the end")
    parts = [
        heading(
            title, f"catalogue {out.objects}, rig {out.rig}, strategy {out.strategy.value}, seed {out.seed}"
        ),
        section("Verdicts", table(("verdict", *counts), rows, numbers=counts)),
        section("Costs", table(("", *costs), spread, numbers=costs)),
        section("Share identified", picture(_bars(out)), kind="sections"),
        section("States", table(state_names, states, numbers=state_names[2:])),
        section("Hardest to tell apart", table(pair_names, pairs, numbers=pair_names[2:])),
        *_heights(out),
        section(
            "What was simulated",
            paragraph(
                "Parts that lie still, touched by straight approaches as the rig plans them, mismeasured "
                "within the rig's bounds. What devices do beyond that, and parts that move, are not in it."
            ),
            paragraph(f"palpate {version('palpate')}"),
        ),
    ]
    return page(f"Study of {out.objects} on rig {out.rig}", parts)


def _heights(out: StudyOut) -> list[str]:
    """What would help where states are confused."""
    rows = [
        (item.a, item.b, ", ".join(f"{low:g}–{high:g} mm" for low, high in item.heights) or "no one height")
        for item in out.heights
    ]
    return (
        [section("Heights of a finger that would help", table(("one", "other", "heights"), rows))]
        if rows
        else []
    )


def _bars(out: StudyOut) -> str:
    """A bar for every state, those that are identified least often first."""
    shown, room = out.states[:_BARS], _WIDTH - _NAME - 60
    parts = []
    for k, item in enumerate(shown):
        y, share = k * _ROW, item.identified / item.runs
        parts.append(text(f"{item.object}, {item.state}"[:40], _NAME - 8, y + 13, size=11, anchor="end"))
        parts.append(element("rect", x=_NAME, y=y + 3, width=room, height=_ROW - 6, fill="#eaeef2"))
        parts.append(element("rect", x=_NAME, y=y + 3, width=room * share, height=_ROW - 6, fill="#0072b2"))
        parts.append(text(f"{100 * share:.0f} %", _NAME + room + 6, y + 13, size=11))
    height = len(shown) * _ROW + 4
    box = f"0 0 {number(_WIDTH)} {number(height)}"
    return element("svg", *parts, xmlns="http://www.w3.org/2000/svg", viewBox=box, font_family="sans-serif")
