"""The result of a recognition in words: hypotheses, why there is none, and the memo's counts."""

import math
from collections.abc import Iterator

from palpate.base.errors import counted
from palpate.recognizer import Hypothesis, Recognition
from palpate.recognizer.explanation import ObjectExplanation
from palpate.recognizer.memo_statistics import MemoCounts
from palpate.views.explanation import ContactRecord, Explanation, explanation_lines, why_lines

__all__ = ["recognition_lines"]

_SHOWN = 12


def recognition_lines(
    recognition: Recognition,
    record: ContactRecord,
    explanation: Explanation | None,
    because: ObjectExplanation | None,
    memo: MemoCounts | None,
    seconds: float,
) -> Iterator[str]:
    """The result for a person; `because`: of the object asked for, `memo`: counts as in the memo's tables."""
    touched = sum(contact.touched for contact in recognition.contacts)
    missed = len(recognition.contacts) - touched
    found = counted(len(recognition.hypotheses), "hypothesis", "hypotheses")
    yield f"{recognition.verdict.value}: {found} after {touched} contacts and {missed} misses"
    for line in () if explanation is None else explanation_lines(explanation, record):
        yield f"  {line}"
    for item in recognition.hypotheses[:_SHOWN]:
        spurious = f"  without {record.listed(item.null_contacts)}" if item.null_contacts else ""
        yield f"  {_hypothesis_line(item)}{spurious}"
    if len(recognition.hypotheses) > _SHOWN:
        yield f"  and {len(recognition.hypotheses) - _SHOWN} more; --json lists them all"
    yield from _unfinished_lines(recognition, record)
    yield f"{1000 * seconds:.1f} ms"
    if because is not None:
        yield from why_lines(because, record)
        for item in because.hypotheses[:_SHOWN]:
            yield f"  {_hypothesis_line(item)}"
    if memo is not None:
        yield from _memo_lines(memo)


def _unfinished_lines(recognition: Recognition, record: ContactRecord) -> Iterator[str]:
    """What the work budget did not suffice for; nothing if it did."""
    unpaired = recognition.unpaired_contacts
    parts = [f"not paired with edges: {record.listed(unpaired)}"] if unpaired else []
    parts += ["cells are coarse"] if recognition.has_coarse_cells else []
    if parts:
        units = recognition.budget.units
        yield f"  budget of {units} units spent: {'; '.join(parts)}; more of it may leave less"


def _memo_lines(memo: MemoCounts) -> list[str]:
    """The memo's Tables I and II for this search, a column for each test at each level."""
    depth = len(memo.levels) + 2
    lines = ["Interpretations left (the memo's Tables I and II):"]
    for order, tests, counts in (
        ("distance first", "DA", memo.distance_first),
        ("angle first", "AD", memo.angle_first),
    ):
        names = ["1", *(f"{level}{test}" for level in range(2, depth) for test in ("", *tests)), "M"]
        wide = [max(len(name), len(f"{count:,}")) for name, count in zip(names, counts, strict=True)]
        lines.append(
            f"  {order:<15}" + "  ".join(f"{name:>{w}}" for name, w in zip(names, wide, strict=True))
        )
        lines.append(" " * 17 + "  ".join(f"{count:>{w},}" for count, w in zip(counts, wide, strict=True)))
    return lines


def _hypothesis_line(item: Hypothesis) -> str:
    """A hypothesis in one line: name, state, weight, configuration with the half-widths of its bounds."""
    at, bounds = item.configuration, item.bounds
    unsure = "" if item.verified else "  (no witness found)"
    half = math.degrees(_half(bounds.theta_rad))
    turned = (
        f"θ {math.degrees(at.theta_rad):.2f} ± {half:.2f}°" if item.state.symmetry_order else "θ any (round)"
    )
    slides = ""
    if item.slide is not None:
        lo, hi = item.slide.extent_mm
        slides = f"  slides {hi - lo:.1f} mm along {math.degrees(item.slide.direction_rad):.0f}°"
    return (
        f"{item.state.object_name}, {item.state.state.name}  {100 * item.weight:5.1f} %  "
        f"x {at.x_mm:.2f} ± {_half(bounds.x_mm):.2f} mm  y {at.y_mm:.2f} ± {_half(bounds.y_mm):.2f} mm  "
        f"{turned}{slides}{unsure}"
    )


def _half(interval: tuple[float, float]) -> float:
    return (interval[1] - interval[0]) / 2
