"""Report of a study: verdicts, touches, pairs that are hard to distinguish, heights, effects of errors."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import TypeVar

import numpy as np
import shapely
from shapely import affinity

from palpate.base.errors import quantity
from palpate.base.geometry import ObjectModel, State
from palpate.base.geometry.outlines import region_of, rings_of
from palpate.base.vocabulary import PartMotion
from palpate.config.study_result import ComparedOut, HeightOut, PairStudiedOut, StateStudiedOut, StudyOut
from palpate.rig.study.variations import VARIATION_DIVISOR
from palpate.views import svg
from palpate.views.numerals import at_most, signed
from palpate.views.report.page import heading, matrix, page, paragraph, picture, section, table
from palpate.views.report.study_text import (
    SOURCE_WORDS,
    best_heights_words,
    bounds_words,
    draws_words,
    fewest_words,
    goal_words,
    hard_pairs,
    may_be_chance,
    more_runs_words,
    no_budget_words,
    placement_words,
    verdict_words,
    wrong_answers_words,
)

_WIDTH, _TEXT_SIZE = 760.0, 11.0
_ONE, _OTHER, _GREY, _LINE = "#0072b2", "#d55e00", "#5b6b78", "#c3ccd3"
_MAX_PAIRS_DRAWN, _COLUMNS = 6, 3
_ALIGNMENT_TURNS = 72


def _touches_picture(touches_of: Mapping[int, int]) -> str:
    """Histogram: runs by how many touches they took."""
    low, high = min(touches_of), max(touches_of)
    total, most = sum(touches_of.values()), max(touches_of.values())
    pitch = min((_WIDTH - 60) / (high - low + 1), 48.0)
    height, parts = 150.0, []
    for k, count in enumerate(range(low, high + 1)):
        runs = touches_of.get(count, 0)
        tall = height * runs / most
        x = 30 + k * pitch
        parts.append(svg.rectangle((x + 1, 20 + height - tall), (pitch - 2, tall), fill=_ONE))
        if runs and pitch > 24:
            share = f"{100 * runs / total:.0f} %" if runs / total >= 0.01 else "< 1 %"
            parts.append(
                svg.text(share, x + pitch / 2, 15 + height - tall, size=10, anchor="middle", fill=_GREY)
            )
        if pitch > 16 or count % 5 == 0:
            parts.append(svg.text(str(count), x + pitch / 2, 34 + height, size=_TEXT_SIZE, anchor="middle"))
    end = 30 + (high - low + 1) * pitch
    parts.append(svg.segment((30, 20 + height), (end, 20 + height), stroke=_LINE))
    parts.append(svg.text("touches", 30, 50 + height, size=_TEXT_SIZE, fill=_GREY))
    return svg.document((_WIDTH, 58 + height), *parts, title="touches that runs took")


def _pair_pictures(pairs: Sequence[PairStudiedOut], objects: Sequence[ObjectModel], height_mm: float) -> str:
    """Outlines of the hardest pairs at a height, laid on each other as well as they will go."""
    states = {(item.name, state.name): state for item in objects for state in item.states}
    drawn: dict[frozenset[tuple[str, str]], tuple[State, State]] = {}
    for pair in pairs:
        names = (pair.object, pair.state), (pair.other_object, pair.other_state)
        if len(set(names)) == 2 and all(name in states for name in names):
            drawn.setdefault(frozenset(names), (states[names[0]], states[names[1]]))
            order = tuple(drawn)
            if len(order) == _MAX_PAIRS_DRAWN:
                break
    parts, side = [], _WIDTH / _COLUMNS
    named = {id(state): f"{name[0]}, {name[1]}" for name, state in states.items()}
    for k, (one, other) in enumerate(drawn.values()):
        row, column = divmod(k, _COLUMNS)
        parts.append(_overlay(one, other, height_mm, column * side, row * (side + 30), side))
        for line, (state, colour) in enumerate(((one, _ONE), (other, _OTHER))):
            words = svg.shorten_middle(named[id(state)], _TEXT_SIZE, side - 24)
            y = row * (side + 30) + side - 4 + 15 * line
            parts.append(svg.text(words, column * side + 12, y, size=_TEXT_SIZE, fill=colour))
    height = math.ceil(len(drawn) / _COLUMNS) * (side + 30)
    return svg.document((_WIDTH, height), *parts, title="outlines of the hardest pairs")


def _overlay(one: State, other: State, height_mm: float, x: float, y: float, side: float) -> str:
    """Both outlines, fitted into a square."""
    first, second = (_region(state, height_mm) for state in (one, other))
    second = _align(first, second)
    low, high = np.array(shapely.bounds(shapely.union(first, second))).reshape(2, 2)
    scale = (side - 60) / max(*(high - low).tolist(), 1.0)
    middle = (low + high) / 2
    at = np.array([x + side / 2, y + side / 2 - 12])

    def rings(shape: shapely.Geometry) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
        return [at + (ring - middle) * scale * np.array([1, -1]) for ring in rings_of(shape)]

    return "".join(
        svg.closed_path(
            rings(shape), fill=colour, fill_opacity=0.14, fill_rule="evenodd", stroke=colour, stroke_width=1.4
        )
        for shape, colour in ((first, _ONE), (second, _OTHER))
        if not shape.is_empty
    )


def _region(state: State, height_mm: float) -> shapely.Geometry:
    """Region at a height, or the lowest section where nothing is at that height."""
    sections = state.sections_at(height_mm) or state.sections[:1]
    return region_of(polygon for section in sections for polygon in section.polygons)


def _align(first: shapely.Geometry, second: shapely.Geometry) -> shapely.Geometry:
    """The second with its centroid on that of the first, turned so that they share most."""
    to = first.centroid
    second = affinity.translate(second, to.x - second.centroid.x, to.y - second.centroid.y)
    turned = [
        affinity.rotate(second, 360 * k / _ALIGNMENT_TURNS, origin=(to.x, to.y))
        for k in range(_ALIGNMENT_TURNS)
    ]
    return turned[int(np.argmax(shapely.area(shapely.intersection(first, turned))))]


_MAX_PAIRS = 40
_MAX_MATRIX_STATES, _MAX_HEIGHTS = 16, 24
_Value = TypeVar("_Value", int, float)
_SIMULATED = {
    PartMotion.STILL: "Parts that lie still, touched by straight approaches as the rig plans them, "
    "mismeasured within the rig's bounds. What devices do beyond that, and parts that move, are not in it.",
    PartMotion.MOVING: "Parts that slide when they are pushed, as the rig file's emulation.part says, "
    "touched at the rig's speeds and forces; contacts are mismeasured within the rig's bounds. What devices "
    "do beyond that is not in it.",
}


def study_report(out: StudyOut, objects: Sequence[ObjectModel], heights_mm: Sequence[float]) -> str:
    """The page; `heights_mm`: of the rig's fingers."""
    parts = [
        heading(
            _headline(out),
            f"catalogue {out.objects}, rig {out.rig}, strategy {out.strategy.value}, seed {out.seed}, "
            f"parts {'move' if out.parts is PartMotion.MOVING else 'lie still'}",
        ),
        *(() if out.wrong else (paragraph(_sentence(wrong_answers_words(out))),)),
        _verdicts(out),
        *_accuracy(out),
        section("Touches needed", _costs(out), picture(_touches_picture(out.touches_of))),
        *_confusion(out),
        *_hardest(out, objects, heights_mm),
        *_heights(out, heights_mm),
        *_budget(out),
        _states(out),
        _simulation_section(out),
    ]
    return page(f"Study of {out.objects} on rig {out.rig}", parts)


def _headline(out: StudyOut) -> str:
    """Wrong answers, if there are any; else how many are identified, what stays alike, the worst bounds."""
    if out.wrong:
        return wrong_answers_words(out)
    identified = sum(item.identified for item in out.states)
    parts = [f"{100 * identified / out.runs:.0f} % of {quantity(out.runs, 'run', 'runs')} identified"]
    if out.accuracy is not None:
        worst = bounds_words(out.accuracy.position[-1], out.accuracy.orientation[-1])
        parts.append(f"known to {worst} at worst")
    if out.twins:
        parts.append(f"{quantity(len(out.twins), 'set', 'sets')} of states no touch tells apart")
    return "; ".join(parts)


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def _verdicts(out: StudyOut) -> str:
    def row(name: str, runs: int, words: str = "") -> tuple[str, ...]:
        return name, str(runs), f"{100 * runs / out.runs:.1f} %", words

    rows = [row(item.verdict.value, item.runs, verdict_words(out, item.verdict)) for item in out.verdicts]
    rows.append(row("wrong answers", out.wrong))
    if out.lost > out.wrong:
        rows.append(row("true part ruled out", out.lost))
    if out.sticking_out:
        rows.append(row("part sticking out of the workspace", out.sticking_out))
    return section("Verdicts", table(("verdict", "runs", "share", ""), rows, numbers=("runs", "share")))


def _accuracy(out: StudyOut) -> Iterator[str]:
    if out.accuracy is None or out.goal is None:
        return
    rows = [
        ("guaranteed position, ± mm", *(at_most(value) for value in out.accuracy.position)),
        (
            "guaranteed orientation, ± °",
            *(at_most(math.degrees(value)) for value in out.accuracy.orientation),
        ),
    ]
    if out.true_error is not None:
        rows.append(("true error of position, mm", *(f"{value:.2f}" for value in out.true_error)))
    numbers = ("median", "90 %", "worst")
    yield section(
        "Accuracy",
        table(("", *numbers), rows, numbers=numbers),
        paragraph(_sentence(goal_words(out.accuracy, out.goal))),
        paragraph(
            f"Of the {quantity(out.accuracy.runs, 'run', 'runs')} that identified a part. Guaranteed is what "
            "answers give as bounds; the true error is known to the simulator only."
        ),
    )


def _costs(out: StudyOut) -> str:
    touches = out.touches
    rows: list[tuple[str, ...]] = [
        ("touches", f"{touches.mean:.2f}", f"{touches.median:g}", f"{touches.p90:g}", str(touches.max)),
        ("grips", "", f"{out.grips[0]:g}", f"{out.grips[1]:g}", str(out.grips_max)),
    ]
    if out.grip_seconds is not None:
        rows.append(("rig time in grips, s", "", *(f"{value:.0f}" for value in out.grip_seconds), ""))
    if out.parts is PartMotion.MOVING:
        rows.append(("part moved by, mm", "", *(f"{value:.2f}" for value in out.moved), ""))
    numbers = ("mean", "median", "90 %", "worst")
    found = table(("", *numbers), rows, numbers=numbers)
    return found if touches.fewest is None else found + paragraph(_sentence(fewest_words(touches)))


def _confusion(out: StudyOut) -> Iterator[str]:
    names = list(dict.fromkeys(name for item in out.confusion for name in (item.a, item.b)))
    parts = [paragraph("No run ended with another state than the true one still possible.")]
    if names:
        shares = {(item.a, item.b): item.share for item in out.confusion}
        words = "Percent of the runs with the row's part that ended with the column's part still possible."
        parts = [paragraph(words), matrix(names[:_MAX_MATRIX_STATES], shares)]
    if len(names) > _MAX_MATRIX_STATES:
        words = f"{_MAX_MATRIX_STATES} of {len(names)} states are shown, those with the largest shares."
        parts.append(paragraph(words))
    if any(item.identified < item.runs for item in out.states):
        parts.append(
            paragraph(
                "Runs in which only the true state is left, but in several places, are not identified; "
                "they are not shown here."
            )
        )
    yield section("Confusion", *parts)


def _hardest(out: StudyOut, objects: Sequence[ObjectModel], heights_mm: Sequence[float]) -> Iterator[str]:
    pairs = hard_pairs(out.hardest)
    if not pairs:
        return
    names = ("one", "other", "still possible after touches", "in runs", "at the end of")
    rows = [
        (
            f"{item.object}, {item.state}",
            f"{item.other_object}, {item.other_state}",
            f"{item.touches:.1f}",
            str(item.runs),
            str(item.left),
        )
        for item in pairs[:_MAX_PAIRS]
    ]
    yield section(
        "Hardest to tell apart",
        paragraph(
            "One lay on the table, the other was still possible. Outlines, laid on each other, at "
            f"{min(heights_mm):g} mm."
        ),
        picture(_pair_pictures(pairs, objects, min(heights_mm))),
        table(names, rows, numbers=names[2:]),
        kind="sections",
    )


def _heights(out: StudyOut, heights_mm: Sequence[float]) -> Iterator[str]:
    if out.best_heights is None:
        return
    parts = [paragraph(_sentence(best_heights_words(out.best_heights, heights_mm, others=bool(out.heights))))]
    if out.best_heights.compared is not None:
        parts.append(_comparison_table([("fingers at these heights", out.best_heights.compared)]))
    if len(out.heights) > 1:
        parts.append(_heights_table(out.heights, heights_mm, out.best_heights.heights))
    rows = [
        (item.a, item.b, ", ".join(f"{low:g}–{high:g} mm" for low, high in item.heights) or "none known")
        for item in out.separating
    ]
    if rows:
        parts.append(table(("confused", "with", "a finger would tell them apart at"), rows))
    yield section("Heights of fingers", *parts)


def _heights_table(heights: Sequence[HeightOut], now_mm: Sequence[float], best_mm: Sequence[float]) -> str:
    """Pairs of states that fingers at each range of height do not tell apart, the highest range first."""
    names = ("height, mm", "not distinguished", "states not met", "fingers")
    rows = [
        (
            f"{low:.1f} to {high:.1f}",
            str(item.alike),
            str(item.unmet),
            ", ".join(word for word, at in (("now", now_mm), ("best", best_mm)) if _is_within(item, at)),
        )
        for item in heights[:_MAX_HEIGHTS][::-1]
        for low, high in [item.range]
    ]
    return table(names, rows, numbers=names[:3])


def _is_within(item: HeightOut, places_mm: Sequence[float]) -> bool:
    return any(item.range[0] <= place < item.range[1] for place in places_mm)


def _budget(out: StudyOut) -> Iterator[str]:
    costs = out.noise_budget
    if not costs:
        if out.runs < VARIATION_DIVISOR:
            yield section("What errors cost", paragraph(_sentence(no_budget_words(out))))
        return
    more = more_runs_words(costs, out.runs)
    yield section(
        "What errors cost",
        paragraph(
            f"The first {quantity(costs[0].runs, 'run', 'runs')} again with one thing changed: the same "
            "parts at the same places. Touches and bounds are of runs that were identified both ways. What "
            "is marked ? may be chance, the rest is not, with 95 % confidence for all lines together."
        ),
        _comparison_table([(SOURCE_WORDS[item.source], item) for item in costs]),
        *((paragraph(_sentence(more)),) if more else ()),
    )


def _comparison_table(rows: Sequence[tuple[str, ComparedOut]]) -> str:
    """Values as they are and as they become."""
    names = ("runs", "identified", "both ways", "touches fewer", "position ± mm", "orientation ± °")
    return table(
        ("", *names),
        [
            (
                words,
                str(item.runs),
                _change(item.identified, str) + _chance(item, "identified"),
                str(item.pairs),
                _fewer_touches_words(item),
                _change(item.position_bound, at_most) + _chance(item, "bounds"),
                _change(item.orientation_bound, _degrees) + _chance(item, "bounds"),
            )
            for words, item in rows
        ],
        numbers=names,
    )


def _fewer_touches_words(item: ComparedOut) -> str:
    if item.fewer_touches is None or item.fewer_interval is None:
        return "too few"
    low, high = (signed(value, ".1f") for value in item.fewer_interval)
    return f"{signed(item.fewer_touches, '.1f')} ({low} to {high}){_chance(item, 'touches')}"


def _chance(item: ComparedOut, what: str) -> str:
    return " ?" if may_be_chance(item, what) else ""


def _change(values: tuple[_Value, _Value] | None, words: Callable[[_Value], str]) -> str:
    return "" if values is None else " → ".join(map(words, values))


def _degrees(value: float) -> str:
    return at_most(math.degrees(value))


def _states(out: StudyOut) -> str:
    names = (
        "runs",
        "identified",
        "indistinguishable",
        "unresolved",
        "touches",
        "90 %",
        "± mm",
        "± °",
        "in goal",
    )
    rows = [
        (
            f"{item.object}, {item.state}",
            str(item.runs),
            f"{100 * item.identified / item.runs:.0f} %",
            str(item.indistinguishable),
            str(item.unresolved),
            f"{item.touches[0]:g}",
            f"{item.touches[1]:g}",
            *_state_accuracy(item),
        )
        for item in out.states
    ]
    words = (
        "Touches: median and 90 %. Bounds: the worst of identified runs; in goal: how many of these are "
        "placed within the rig file's goals."
    )
    return section("States", table(("state", *names), rows, numbers=names), paragraph(words))


def _state_accuracy(item: StateStudiedOut) -> tuple[str, str, str]:
    found = item.accuracy
    if found is None:
        return "", "", ""
    return (
        at_most(found.position[-1]),
        at_most(math.degrees(found.orientation[-1])),
        f"{found.within_goal} of {found.runs}",
    )


def _simulation_section(out: StudyOut) -> str:
    parts = [paragraph(_SIMULATED[out.parts])]
    if out.placed_within is not None:
        parts.append(paragraph(f"Parts lie {placement_words(out)}; {draws_words(out)}."))
    return section("What was simulated", *parts, paragraph(f"palpate {version('palpate')}"))
