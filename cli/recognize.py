"""`palpate recognize`: from a file of contacts to hypotheses, without a rig."""

import math
import time
from pathlib import Path

import typer

from palpate.config import load_contacts, load_objects
from palpate.config.results import to_json
from palpate.files.writing import write_text
from palpate.recognizer import Catalogue, Hypothesis, Recognition, recognise
from palpate.recognizer.explanation import Why, why
from palpate.recognizer.statistics import MemoCounts, memo_counts
from palpate.rig.catalogue.heights import check_known, fingers_of
from palpate.rig.conversion import grips_of
from palpate.views.explanation import (
    Explanation,
    Felt,
    explain,
    explanation_lines,
    explanation_out,
    state_named,
    why_lines,
    why_out,
)
from palpate.views.recognition import recognition_out, recognition_picture
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
    objects_file = load_objects(objects)
    felt = Felt(grips_of(load_contacts(contacts)))
    check_known(objects_file.objects, fingers_of(felt.contacts))
    catalogue = Catalogue(objects_file.objects)
    named = None if asked is None else state_named(catalogue, asked)
    begin = time.perf_counter()
    recognition = recognise(catalogue, felt.contacts, max_spurious)
    seconds = time.perf_counter() - begin
    explanation = (
        explain(catalogue, felt, max_spurious) if recognition.verdict is RecognitionVerdict.NONE else None
    )
    because = None if named is None else why(catalogue, felt.contacts, *named)
    memo = memo_counts(catalogue, felt.contacts) if statistics else None
    if picture is not None:
        write_text(picture, recognition_picture(recognition, f"{contacts.name} in {objects.name}"))
    if json:
        result = recognition_out(recognition, seconds, memo)
        more = {
            "explanation": explanation and explanation_out(explanation, felt),
            "why": because and why_out(because, felt),
        }
        typer.echo(to_json(result.model_copy(update=more)))
    else:
        _print(recognition, seconds, felt, explanation)
        _print_why(because, felt)
        for line in () if memo is None else _memo_lines(memo):
            typer.echo(line)
    return 0 if recognition.verdict is RecognitionVerdict.UNIQUE else 1


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


def _print(recognition: Recognition, seconds: float, felt: Felt, explanation: Explanation | None) -> None:
    count = len(recognition.hypotheses)
    found = "1 hypothesis" if count == 1 else f"{count} hypotheses"
    touched = sum(contact.touched for contact in recognition.contacts)
    missed = len(recognition.contacts) - touched
    typer.echo(f"{recognition.verdict.value}: {found} after {touched} contacts and {missed} misses")
    for line in () if explanation is None else explanation_lines(explanation, felt):
        typer.echo(f"  {line}")
    for item in recognition.hypotheses[:_SHOWN]:
        spurious = f"  without {felt.listed(item.null_contacts)}" if item.null_contacts else ""
        typer.echo(f"  {hypothesis_line(item)}{spurious}")
    if count > _SHOWN:
        typer.echo(f"  and {count - _SHOWN} more; --json lists them all")
    typer.echo(f"{1000 * seconds:.1f} ms")


def _print_why(because: Why | None, felt: Felt) -> None:
    if because is None:
        return
    for line in why_lines(because, felt):
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
