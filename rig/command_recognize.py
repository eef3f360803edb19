"""`palpate recognize`: from a file of contacts to hypotheses, without a rig."""

import math
import time
from pathlib import Path

import typer

from palpate.config import load_contacts, load_objects
from palpate.config.results import to_json
from palpate.recognizer import Catalogue, Hypothesis, Recognition, Verdict, recognise
from palpate.rig.convert import contacts_of, models_of
from palpate.rig.files import write_text
from palpate.rig.report import recognition_out, recognition_picture

__all__ = ["run_recognize"]

_SHOWN = 12


def run_recognize(*, objects: Path, contacts: Path, json: bool, picture: Path | None) -> int:
    """Recognise, print, draw; returns the exit code (1 if there is not one answer)."""
    catalogue = Catalogue(models_of(load_objects(objects)))
    felt = contacts_of(load_contacts(contacts))
    begin = time.perf_counter()
    recognition = recognise(catalogue, felt)
    seconds = time.perf_counter() - begin
    if picture is not None:
        write_text(picture, recognition_picture(recognition, f"{contacts.name} in {objects.name}"))
    if json:
        typer.echo(to_json(recognition_out(recognition, seconds)))
    else:
        _print(recognition, seconds)
    return 0 if recognition.verdict is Verdict.UNIQUE else 1


def _print(recognition: Recognition, seconds: float) -> None:
    count = len(recognition.hypotheses)
    found = "1 hypothesis" if count == 1 else f"{count} hypotheses"
    touched = sum(contact.touched for contact in recognition.contacts)
    missed = len(recognition.contacts) - touched
    typer.echo(f"{recognition.verdict.value}: {found} after {touched} contacts and {missed} misses")
    for item in recognition.hypotheses[:_SHOWN]:
        typer.echo(f"  {hypothesis_line(item)}")
    if count > _SHOWN:
        typer.echo(f"  and {count - _SHOWN} more; --json lists them all")
    typer.echo(f"{1000 * seconds:.1f} ms")


def hypothesis_line(item: Hypothesis) -> str:
    """A hypothesis in one line: name, state, weight, configuration with the half-widths of its bounds."""
    at, bounds = item.configuration, item.bounds
    unsure = "" if item.verified else "  (no witness found)"
    return (
        f"{item.state.object_name}, {item.state.state.name}  {100 * item.weight:5.1f} %  "
        f"x {at.x_mm:.2f} ± {_half(bounds.x_mm):.2f} mm  y {at.y_mm:.2f} ± {_half(bounds.y_mm):.2f} mm  "
        f"θ {math.degrees(at.theta_rad):.2f} ± {math.degrees(_half(bounds.theta_rad)):.2f}°{unsure}"
    )


def _half(interval: tuple[float, float]) -> float:
    return (interval[1] - interval[0]) / 2
