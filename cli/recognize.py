"""`palpate recognize`: from a file of contacts to hypotheses, without a rig."""

import math
from pathlib import Path

import typer

from palpate.api.answers import RecognitionAnswer
from palpate.api.recognition import recognise
from palpate.errors import counted
from palpate.files.writing import write_text
from palpate.recognizer import Hypothesis
from palpate.recognizer.explanation import ObjectExplanation
from palpate.recognizer.memo_statistics import MemoCounts, memo_counts
from palpate.views.explanation import ContactRecord, explanation_lines, why_lines
from palpate.vocabulary import RecognitionVerdict

__all__ = ["run_recognize"]

_SHOWN = 12


def run_recognize(
    *,
    objects: Path,
    contacts: Path,
    json: bool,
    picture: Path | None,
    max_spurious: int = 0,
    asked: str | None = None,
    statistics: bool = False,
) -> int:
    """Recognise, explain, print, draw; returns the exit code (1 if there is not one answer).

    `asked` names an object, or "object/state", of which to say whether and why it was ruled out. `statistics`
    asks for the counts of the memo's tables.
    """
    answer = recognise(objects, contacts, max_spurious=max_spurious)
    because = None if asked is None else answer.why(asked)
    memo = memo_counts(answer.catalogue, answer.contacts.contacts) if statistics else None
    if picture is not None:
        write_text(picture, answer.picture())
    if json:
        typer.echo(answer.to_json(because, memo))
    else:
        _print(answer)
        _print_why(because, answer.contacts)
        for line in () if memo is None else _memo_lines(memo):
            typer.echo(line)
    return 0 if answer.verdict is RecognitionVerdict.UNIQUE else 1


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


def _print(answer: RecognitionAnswer) -> None:
    recognition, explanation, contacts = answer.recognition, answer.explanation(), answer.contacts
    count = len(recognition.hypotheses)
    touched = sum(contact.touched for contact in recognition.contacts)
    missed = len(recognition.contacts) - touched
    found = counted(count, "hypothesis", "hypotheses")
    typer.echo(f"{recognition.verdict.value}: {found} after {touched} contacts and {missed} misses")
    for line in () if explanation is None else explanation_lines(explanation, contacts):
        typer.echo(f"  {line}")
    for item in recognition.hypotheses[:_SHOWN]:
        spurious = f"  without {contacts.listed(item.null_contacts)}" if item.null_contacts else ""
        typer.echo(f"  {hypothesis_line(item)}{spurious}")
    if count > _SHOWN:
        typer.echo(f"  and {count - _SHOWN} more; --json lists them all")
    typer.echo(f"{1000 * answer.seconds:.1f} ms")


def _print_why(because: ObjectExplanation | None, record: ContactRecord) -> None:
    if because is None:
        return
    for line in why_lines(because, record):
        typer.echo(line)
    for item in because.hypotheses[:_SHOWN]:
        typer.echo(f"  {hypothesis_line(item)}")


def hypothesis_line(item: Hypothesis) -> str:
    """A hypothesis in one line: name, state, weight, configuration with the half-widths of its bounds."""
    at, bounds = item.configuration, item.bounds
    unsure = "" if item.verified else "  (no witness found)"
    slides = ""
    if item.slide is not None:
        lo, hi = item.slide.extent_mm
        slides = f"  slides {hi - lo:.1f} mm along {math.degrees(item.slide.direction_rad):.0f}°"
    return (
        f"{item.state.object_name}, {item.state.state.name}  {100 * item.weight:5.1f} %  "
        f"x {at.x_mm:.2f} ± {_half(bounds.x_mm):.2f} mm  y {at.y_mm:.2f} ± {_half(bounds.y_mm):.2f} mm  "
        f"θ {math.degrees(at.theta_rad):.2f} ± {math.degrees(_half(bounds.theta_rad)):.2f}°{slides}{unsure}"
    )


def _half(interval: tuple[float, float]) -> float:
    return (interval[1] - interval[0]) / 2
