"""The dialogue of `calibrate`: announcement, requests to place references, progress, and the result."""

import math
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape

from palpate.base.errors import InputError
from palpate.calibration.finger_step import plan_placements
from palpate.calibration.measurements import Reference
from palpate.cli.terminal import StatusLine
from palpate.config import RigFile
from palpate.config.calibration_file import ReferencesFile, StageCalibration
from palpate.config.calibration_finger import ActuatorsCalibration, FingerCalibration
from palpate.config.commissioning_results import CalibratedFingerOut, CalibratedStageOut, CalibrateOut
from palpate.jobs.calibration import CalibrationAnswer, CalibrationPaths
from palpate.rig.commissioning.calibration_run import STEPS, build_references
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.views.numerals import at_most
from palpate.views.tables import table

_COLUMN_TITLES = (
    "contacts\n± mm",
    "direction\n± °",
    "base\nmm off",
    "heading\n° off",
    "tip\nmm",
    "play\n± mm",
    "skin\nN/mm",
    "taxels\nout",
)


_STEP_RANGE_S = {
    "actuators": (50.0, 65.0),
    "tactile": (115.0, 140.0),
    "fingers": (50.0, 135.0),
    "stage": (100.0, 270.0),
}
"""Least and most time that emulated rigs took: for a finger, in the third step for a finger at a placing.

Most with a touch speed of 1 mm/s and a search speed of 4 mm/s, least with 5 mm/s and none.
"""


class CalibrationProgress:
    """Says on stderr what goes on: a line for every step, a moving line for what changes all the time."""

    def __init__(self, console: Console, *, asks: bool) -> None:
        self._console = console
        # A moving line and a question would write over each other.
        self._doing = None if asks else StatusLine(console, "connecting")
        self._step = ""

    def __enter__(self) -> "CalibrationProgress":
        if self._doing is not None:
            self._doing.__enter__()
        return self

    def __exit__(self, *ended: object) -> None:
        if self._doing is not None:
            self._doing.__exit__(None, None, None)

    def tell(self, text: str) -> None:
        """Say it."""
        if self._doing is not None and text.startswith(("touch ", "press ")):
            self._doing.now(f"{self._step}, {text}")
            return
        self._step = text
        self._console.print(text if text.endswith(":") else f"  {text}", markup=False)


def announce(
    console: Console, rig: RigFile, shapes: ReferencesFile, steps: Sequence[str], places: CalibrationPaths
) -> None:
    """Say what is going to happen, before anything does."""
    disc, plate = build_references(shapes)
    placings = len(plan_placements(disc, plate, rig))
    words = {
        "actuators": f"actuators  {_slide_exercises_words(rig)}fingers press and hit a disc",
        "tactile": "tactile    fingers press a disc and a plate at many angles, as hard as 3 N",
        "fingers": f"fingers    {placings} placings of disc and plate, touched by all fingers",
        "stage": "stage      the disc beside the stage's axis, touched at several of its angles",
    }
    console.print(f"Calibrating rig {rig.name} ({len(rig.fingers)} fingers):", markup=False)
    counts = {
        "actuators": len(rig.fingers),
        "tactile": len(rig.fingers),
        "fingers": len(rig.fingers) * placings,
        "stage": len(rig.fingers),
    }
    least, most = 0.0, 0.0
    for step in STEPS:
        if step in steps:
            low, high = (counts[step] * seconds for seconds in _STEP_RANGE_S[step])
            least, most = least + low, most + high
            console.print(f"  {words[step]}; {_minutes_words(low, high)}", markup=False)
    where = "of emulated rig time" if rig.emulated else "besides the time in which you place the references"
    console.print(f"Together {_minutes_words(least, most)} {where}", markup=False)
    corners = shapes.plate.outline_mm
    console.print(
        f"References: a disc of {shapes.disc.diameter_mm:g} mm, a plate with {len(corners)} corners, "
        f"{plate.radius_mm:.1f} mm from its middle. Result: {places.calibration}",
        markup=False,
    )
    if places.record.exists():
        console.print(f"A calibration was begun before; it is taken up from {places.record}", markup=False)


def _slide_exercises_words(rig: RigFile) -> str:
    slides = any(mechanism_of(finger).push is not None for finger in rig.fingers)
    return "aims swing, slides go against their stops, " if slides else ""


def _minutes_words(least_s: float, most_s: float) -> str:
    low, high = max(round(least_s / 60), 1), max(round(most_s / 60), 1)
    return f"about {low} min" if low == high else f"{low} to {high} min"


def calibrate_out(
    answer: CalibrationAnswer, rig: RigFile, steps: Sequence[str], wall_seconds: float
) -> CalibrateOut:
    """The published result; `rig`: as its file describes it, uncalibrated."""
    file, residuals = answer.file, answer.file.residuals
    return CalibrateOut(
        rig=file.rig,
        emulated=file.emulated,
        steps=tuple(steps),
        file=str(answer.paths.calibration),
        report=str(answer.paths.report),
        coverage=file.coverage,
        fingers=tuple(_finger(found, rig, k) for k, found in enumerate(file.fingers)),
        touches=None if residuals is None else residuals.touches,
        outliers=None if residuals is None else residuals.outliers,
        stage=_stage(file.stage, rig),
        rms_mm=None if residuals is None else residuals.rms_mm,
        held_out_rms_mm=None if residuals is None else residuals.held_out_rms_mm,
        rig_seconds=answer.rig_seconds,
        wall_seconds=wall_seconds,
    )


def _stage(found: StageCalibration | None, rig: RigFile) -> CalibratedStageOut | None:
    if found is None:
        return None
    return CalibratedStageOut(
        centre_mm=found.centre_mm,
        centre_bound_mm=found.centre_bound_mm,
        moved_mm=math.dist(found.centre_mm, Stage.of(rig).centre_mm),
        backlash_deg=found.backlash_deg,
        touches=found.touches,
        rms_mm=found.rms_mm,
    )


def _finger(found: FingerCalibration, rig: RigFile, index: int) -> CalibratedFingerOut:
    spec, place, bounds = rig.fingers[index], found.place, found.bounds
    return CalibratedFingerOut(
        name=found.name,
        position_mm=None if bounds is None else bounds.position_mm,
        direction_deg=None if bounds is None else bounds.direction_deg,
        moved_mm=None if place is None else math.dist(place.base_mm, spec.base_mm),
        turned_deg=None if place is None else math.remainder(place.heading_deg - spec.heading_deg, 360),
        tip_radius_mm=None if place is None else place.tip_radius_mm,
        backlash_mm=found.actuators.slide.backlash_mm
        if isinstance(found.actuators, ActuatorsCalibration)
        else None,
        stiffness_n_per_mm=None if found.tactile is None else found.tactile.stiffness_n_per_mm,
        unusable=None if found.tactile is None else len(found.tactile.unusable),
    )


def show_calibration(out: CalibrateOut, console: Console) -> None:
    """The result for people."""
    rows = table("finger", *_COLUMN_TITLES, numbers=_COLUMN_TITLES)
    for item in out.fingers:
        rows.add_row(
            escape(item.name),
            _decimal_text(item.position_mm, 2),
            _decimal_text(item.direction_deg, 2),
            _decimal_text(item.moved_mm, 2),
            _decimal_text(item.turned_deg, 2),
            _decimal_text(item.tip_radius_mm, 2),
            _decimal_text(item.backlash_mm, 3),
            _decimal_text(item.stiffness_n_per_mm, 2),
            "–" if item.unusable is None else str(item.unusable),
        )
    console.print(rows)
    if out.rms_mm is not None:
        console.print(
            f"{out.touches} touches agree within {out.rms_mm:.3f} mm (root mean square), "
            f"{out.held_out_rms_mm:.3f} mm where they were predicted, not fitted; {out.outliers} left out. "
            f"Bounds are for {out.coverage:.1%} of contacts."
        )
    if out.stage is not None:
        stage = out.stage
        console.print(
            f"The stage turns about ({stage.centre_mm[0]:.2f}, {stage.centre_mm[1]:.2f}) mm, "
            f"± {at_most(stage.centre_bound_mm, 3)} mm, {stage.moved_mm:.2f} mm from where the rig file "
            f"says, with {stage.backlash_deg:.3f}° of play either way; {stage.touches} touches agree within "
            f"{stage.rms_mm:.3f} mm."
        )
    minutes = out.rig_seconds / 60
    console.print(
        f"{minutes:.0f} min on the {'emulated ' if out.emulated else ''}rig, {out.wall_seconds:.0f} s here"
    )
    console.print(f"calibration {out.file}, report {out.report}", markup=False)


def _decimal_text(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


class ConsoleTable:
    """Asks for each change on the table and waits for Enter."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._empty = False

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Ask for a reference near a place; raises InputError if standard input has ended."""
        x, y = about_mm
        where = "in the middle" if x == y == 0 else f"near x {x:.0f}, y {y:.0f} mm"
        turned = ", turned as you like" if reference.turns else ""
        self._ask(f"Put the {reference.name} {where}{turned}; alone, and so that it cannot slide.")
        self._empty = False

    def clear(self) -> None:
        """Ask for an empty table, once."""
        if not self._empty:
            self._ask("Clear the table: nothing may lie in the fingers' way.")
        self._empty = True

    def _ask(self, what: str) -> None:
        try:
            self._console.input(f"[bold]{escape(what)}[/bold] Then keep your hands away and press Enter. ")
        except EOFError:
            raise InputError(
                "references cannot be put on the table: standard input has ended; use a terminal"
            ) from None
