"""Report of a calibration: one HTML page with a row per quantity, a column per finger, and pictures.

It needs nothing else: no scripts, nothing fetched.
"""

import importlib
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import numpy as np

from palpate.base.file_io import write_text
from palpate.base.geometry import Bools
from palpate.base.optional_imports import install_command
from palpate.config.calibration_file import CalibrationFile, StageCalibration
from palpate.config.calibration_finger import (
    ActuatorsCalibration,
    ArmActuatorsCalibration,
    ArmPlaceCalibration,
    ContactBounds,
    FingerCalibration,
    Overshoot,
    PlaceCalibration,
    PlaceInHandFrame,
    RotaryCalibration,
    StopsCalibration,
    TactileCalibration,
)
from palpate.views.numerals import at_most, decimal
from palpate.views.report.page import embedded_picture, heading, page, paragraph, section, subheading, table

Part = TypeVar("Part")

_NONE = "–"
_MAX_DECIMALS = 5

Row = tuple[str, list[str]]


@dataclass(frozen=True)
class RowGroup:
    """Rows of a table that belong together: a label, and one text per finger."""

    title: str
    rows: list[Row]


def plus_minus(value: float, sigma: float) -> str:
    """Value ± deviation with two digits of the deviation, rounded up; the value with as many decimals."""
    decimals = _decimals(sigma)
    return f"{decimal(value, decimals)} ± {at_most(sigma, decimals)}"


def finger_tables(file: CalibrationFile) -> list[RowGroup]:
    """The results for each finger; groups of rows that no finger has are left out."""
    fingers = file.fingers
    groups = [
        _group("Residuals of touches", _RESIDUALS, [_residuals(file, finger) for finger in fingers]),
        _group("Place in the hand frame, ± standard deviation", _PLACE, [f.place for f in fingers]),
        _group(
            "Slides in that fit", _SLIDE_PLACE, _parts_of_type(PlaceCalibration, [f.place for f in fingers])
        ),
        _group(
            "Links in that fit, ± standard deviation",
            _ARM_PLACE,
            _parts_of_type(ArmPlaceCalibration, [f.place for f in fingers]),
        ),
        _group(
            "Servos, ± standard deviation",
            _ACTUATORS,
            _parts_of_type(ActuatorsCalibration, [f.actuators for f in fingers]),
        ),
        _group(
            "Joints, ± standard deviation",
            _JOINTS,
            _parts_of_type(ArmActuatorsCalibration, [f.actuators for f in fingers]),
        ),
        _group("Array and skin", _TACTILE, [f.tactile for f in fingers]),
        _group("Bounds on contacts", _BOUNDS, [f.bounds for f in fingers]),
    ]
    return [group for group in groups if group is not None]


def residuals_mm(file: CalibrationFile, finger: str) -> tuple[list[float], list[float]]:
    """Residuals of a finger's fitted and of its held-out touches, without outliers."""
    touches = [] if file.residuals is None else file.residuals.touches_seen
    used = [touch for touch in touches if touch.finger == finger and not touch.outlier]
    fitted = [touch.residual_mm for touch in used if not touch.held_out]
    return fitted, [touch.residual_mm for touch in used if touch.held_out]


def never_pressed(tactile: TactileCalibration) -> Bools:
    """Taxels (rows, columns) that no press has reached: their gain is 1, with the widest bound of all."""
    gain, bound = np.array(tactile.gain), np.array(tactile.gain_bound)
    result: Bools = (gain == 1.0) & (bound == bound.max())
    for taxel in tactile.unusable:
        result[taxel.row, taxel.col] = False
    return result


def summary(file: CalibrationFile) -> list[tuple[str, str]]:
    """The overall result, in the order of interest: names and values."""
    rows = [
        ("Rig", file.rig + (" (emulated devices)" if file.emulated else "")),
        ("Made", f"{file.made:%Y-%m-%d %H:%M} UTC, palpate {file.palpate}"),
        ("References", ", ".join(reference.name for reference in file.references) or "none"),
        ("Coverage of bounds", f"{100 * file.coverage:g} % of contacts"),
    ]
    found = file.residuals
    if found is not None:
        rows.append(
            (
                "Fitted touches",
                f"{found.touches}, rms {found.rms_mm:.3f} mm, largest {found.largest_mm:.3f} mm",
            )
        )
        if found.held_out:
            off = _errors_words(found.held_out_rms_mm, found.held_out_largest_mm)
            rows.append(("Held-out touches", f"{found.held_out}, {off}"))
        rows.append(("Outliers, left out", str(found.outliers)))
        if found.degrees_of_freedom:
            share = found.chi_square / found.degrees_of_freedom
            rows.append(("χ² by degree of freedom", f"{share:.2f} ({found.degrees_of_freedom} degrees)"))
    if file.stage is not None:
        rows += _stage(file.stage)
    worst = [finger.bounds.position_mm for finger in file.fingers if finger.bounds is not None]
    if worst:
        rows.append(("Worst bound on a position", f"± {at_most(max(worst), 3)} mm"))
    return rows


def _stage(found: StageCalibration) -> list[tuple[str, str]]:
    """The turning stage's rows."""
    (x, y), (own_x, own_y) = found.centre_mm, found.centre_sigma_mm
    share = found.chi_square / max(found.degrees_of_freedom, 1)
    return [
        ("Axis of the stage, x, ± standard deviation", f"{plus_minus(x, own_x)} mm"),
        ("Axis of the stage, y", f"{plus_minus(y, own_y)} mm"),
        ("Axis of the stage, bound", f"± {at_most(found.centre_bound_mm, 3)} mm"),
        ("Play of the stage, either way", f"{plus_minus(found.backlash_deg, found.backlash_sigma_deg)}°"),
        (
            "Touches at stage angles",
            f"{found.touches} at {found.stops} stops, rms {found.rms_mm:.3f} mm, χ² by degree of freedom "
            f"{share:.2f}, {found.outliers} left out",
        ),
    ]


@dataclass(frozen=True)
class _FingerResiduals:
    """Residuals (mm) of one finger's touches, its outliers, and its bound on positions, if there is one."""

    fitted: list[float]
    held_out: list[float]
    outliers: int
    bound_mm: float | None


def _residuals(file: CalibrationFile, finger: FingerCalibration) -> _FingerResiduals | None:
    touches = [] if file.residuals is None else file.residuals.touches_seen
    mine = [touch for touch in touches if touch.finger == finger.name]
    outliers = sum(touch.outlier for touch in mine)
    bound = None if finger.bounds is None else finger.bounds.position_mm
    return _FingerResiduals(*residuals_mm(file, finger.name), outliers, bound) if mine else None


def _largest(residuals: _FingerResiduals) -> str:
    used = np.abs(residuals.fitted + residuals.held_out)
    return _errors_words(math.sqrt(np.mean(used**2)), used.max()) if len(used) else _NONE


def _beyond_bound_words(residuals: _FingerResiduals) -> str:
    if residuals.bound_mm is None:
        return _NONE
    used = np.abs(residuals.fitted + residuals.held_out)
    return str(int((used > residuals.bound_mm).sum()) or "none")


def _unusable(tactile: TactileCalibration) -> str:
    counts = Counter(taxel.what for taxel in tactile.unusable)
    return ", ".join(f"{count} {what}" for what, count in sorted(counts.items())) or "none"


def _force_drift(tactile: TactileCalibration) -> str:
    found = tactile.force_drift_n_per_s
    return "not known" if found is None else f"{1000 * found:.3g} mN/s"


def _gains(tactile: TactileCalibration) -> str:
    """Range of the measured gains and the median of their bounds."""
    measured = ~never_pressed(tactile)
    for taxel in tactile.unusable:
        measured[taxel.row, taxel.col] = False
    if not measured.any():
        return _NONE
    gain, bound = (np.array(values)[measured] for values in (tactile.gain, tactile.gain_bound))
    return f"{gain.min():.2f} to {gain.max():.2f}, median bound ± {_percent(float(np.median(bound)))}"


def _errors_words(rms_mm: float, largest_mm: float) -> str:
    return f"rms {rms_mm:.3f} mm, largest {largest_mm:.3f} mm"


def _group(
    title: str, rows: Sequence[tuple[str, Callable[[Part], str]]], parts: Sequence[Part | None]
) -> RowGroup | None:
    if all(part is None for part in parts):
        return None
    shown = [(label, [_NONE if part is None else words(part) for part in parts]) for label, words in rows]
    return RowGroup(title, shown)


def _decimals(sigma: float) -> int:
    if sigma <= 0:
        return 3
    return min(_MAX_DECIMALS, max(0, 1 - math.floor(math.log10(sigma))))


def _percent(share: float) -> str:
    return f"{at_most(100 * share, 1)} %"


def _parts_of_type(kind: type[Part], parts: Sequence[object]) -> list[Part | None]:
    """Parts of fingers of one type; None for those of others."""
    return [part if isinstance(part, kind) else None for part in parts]


def _latency(stops: StopsCalibration) -> str:
    return f"{1000 * stops.latency_s:.1f} ms, {at_most(1000 * stops.latency_bound_s, 1)} ms"


def _overshoots(rows: Sequence[Overshoot]) -> str:
    return (
        "; ".join(f"{at_most(row.bound_mm, 2)} mm at {row.speed_mm_s:g} mm/s" for row in rows) or "not tried"
    )


def _travel(actuators: ActuatorsCalibration) -> str:
    slide = actuators.slide
    return plus_minus(slide.mm_per_turn, slide.mm_per_turn_sigma) + " mm" if slide.homed else "as described"


def _homed_zero(actuators: ActuatorsCalibration) -> str:
    slide = actuators.slide
    return plus_minus(slide.zero_mm, slide.zero_sigma_mm) + " mm" if slide.homed else "as described"


def _directions(actuators: ActuatorsCalibration) -> str:
    confirmed = (actuators.slide.direction_confirmed, actuators.aim.direction_confirmed)
    return {(True, True): "as described", (False, False): "not confirmed"}.get(
        confirmed, "aim not confirmed" if confirmed[0] else "slide not confirmed"
    )


def _joint_directions(actuators: ArmActuatorsCalibration) -> str:
    confirmed = (actuators.shoulder.direction_confirmed, actuators.elbow.direction_confirmed)
    return {(True, True): "as described", (False, False): "not confirmed"}.get(
        confirmed, "elbow not confirmed" if confirmed[0] else "shoulder not confirmed"
    )


def _play(joint: RotaryCalibration) -> str:
    return plus_minus(joint.backlash_deg, joint.backlash_sigma_deg) + "°"


def _saturation(tactile: TactileCalibration) -> str:
    return "not seen" if tactile.saturates_n is None else f"{tactile.saturates_n:.2f} N"


def _parts(parts: dict[str, float], unit: str) -> str:
    return ", ".join(f"{name} {at_most(value, 3)}{unit}" for name, value in parts.items())


_RESIDUALS: tuple[tuple[str, Callable[[_FingerResiduals], str]], ...] = (
    ("touches", lambda r: f"{len(r.fitted)} fitted, {len(r.held_out)} held out"),
    ("residual", _largest),
    ("beyond the bound on positions", _beyond_bound_words),
    ("outliers, left out", lambda r: str(r.outliers)),
)

_PLACE: tuple[tuple[str, Callable[[PlaceInHandFrame], str]], ...] = (
    ("base x", lambda p: plus_minus(p.base_mm[0], p.base_sigma_mm[0]) + " mm"),
    ("base y", lambda p: plus_minus(p.base_mm[1], p.base_sigma_mm[1]) + " mm"),
    ("heading", lambda p: plus_minus(p.heading_deg, p.heading_sigma_deg) + "°"),
    ("tip radius", lambda p: plus_minus(p.tip_radius_mm, p.tip_radius_sigma_mm) + " mm"),
    ("array heading", lambda p: plus_minus(p.array_heading_deg, p.array_heading_sigma_deg) + "°"),
)

_SLIDE_PLACE: tuple[tuple[str, Callable[[PlaceCalibration], str]], ...] = (
    (
        "distance at Goal Position 0, in touch",
        lambda p: plus_minus(p.zero_mm, math.sqrt(p.covariance[4][4])) + " mm",
    ),
    ("travel per turn", lambda p: f"{p.mm_per_turn:.3f} mm"),
)

_ARM_PLACE: tuple[tuple[str, Callable[[ArmPlaceCalibration], str]], ...] = (
    ("upper link", lambda p: plus_minus(p.upper_mm, p.upper_sigma_mm) + " mm"),
    ("second link", lambda p: plus_minus(p.fore_mm, p.fore_sigma_mm) + " mm"),
    ("elbow's zero", lambda p: plus_minus(p.elbow_zero_deg, p.elbow_zero_sigma_deg) + "°"),
)

_JOINTS: tuple[tuple[str, Callable[[ArmActuatorsCalibration], str]], ...] = (
    ("directions", _joint_directions),
    ("play of the shoulder, either way", lambda a: _play(a.shoulder)),
    ("play of the elbow, either way", lambda a: _play(a.elbow)),
    ("friction, shoulder and elbow", lambda a: f"{a.shoulder.friction_a:.3f} A, {a.elbow.friction_a:.3f} A"),
    ("latency, mean and bound", lambda a: _latency(a.stops)),
    ("overshoot, bound", lambda a: _overshoots(a.stops.overshoots)),
)

_ACTUATORS: tuple[tuple[str, Callable[[ActuatorsCalibration], str]], ...] = (
    ("directions", _directions),
    ("travel per turn, by the stops", _travel),
    ("distance at Goal Position 0, by the stops", _homed_zero),
    (
        "play of the slide, either way",
        lambda a: plus_minus(a.slide.backlash_mm, a.slide.backlash_sigma_mm) + " mm",
    ),
    ("play of the aim, either way", lambda a: plus_minus(a.aim.backlash_deg, a.aim.backlash_sigma_deg) + "°"),
    ("friction, slide and aim", lambda a: f"{a.slide.friction_a:.3f} A, {a.aim.friction_a:.3f} A"),
    ("latency, mean and bound", lambda a: _latency(a.slide)),
    ("overshoot, bound", lambda a: _overshoots(a.slide.overshoots)),
)

_TACTILE: tuple[tuple[str, Callable[[TactileCalibration], str]], ...] = (
    ("stiffness", lambda t: f"{t.stiffness_n_per_mm:.2f} N/mm, bound ± {_percent(t.stiffness_bound)}"),
    ("relative gain of taxels", _gains),
    ("unusable taxels", _unusable),
    ("taxels never pressed", lambda t: str(int(never_pressed(t).sum()))),
    ("noise of a taxel", lambda t: f"{t.noise_counts:.2f} counts"),
    ("drift, bound", lambda t: f"{t.drift_counts_per_s:.3g} counts/s"),
    ("drift of three columns together, bound", _force_drift),
    ("crosstalk", lambda t: f"{_percent(t.crosstalk)}, bound ± {_percent(t.crosstalk_bound)}"),
    ("least contact force", lambda t: f"{at_most(t.least_contact_force_n, 3)} N"),
    ("a taxel saturates at", _saturation),
    ("array heading, by presses", lambda t: plus_minus(t.phase_deg, t.phase_sigma_deg) + "°"),
    ("presses", lambda t: f"{t.presses}, {_percent(t.residual_share)} unexplained"),
)

_BOUNDS: tuple[tuple[str, Callable[[ContactBounds], str]], ...] = (
    ("position", lambda b: f"± {at_most(b.position_mm, 3)} mm"),
    ("position is made of", lambda b: _parts(b.parts_mm.model_dump(), " mm")),
    ("direction of the array", lambda b: f"± {at_most(b.direction_deg, 2)}°"),
    ("direction is made of", lambda b: _parts(b.normal_parts_deg.model_dump(), "°")),
)


def write_report(path: Path, file: CalibrationFile) -> None:
    """Write the report to `path`; raises InputError if the place cannot be written."""
    write_text(path, report_html(file))


def report_html(file: CalibrationFile) -> str:
    """The report as one HTML page. Deterministic: equal files give equal text.

    Without matplotlib it has all numbers, and one line that says how to get the pictures.
    """
    title, plots = f"Calibration of {file.rig}", _plots()
    no_plots = f"No pictures: matplotlib is not installed ({install_command('plots')})."
    parts = [
        heading(title, f"{file.made:%Y-%m-%d %H:%M} UTC"),
        table(("", ""), summary(file)),
        *([paragraph(no_plots)] if plots is None else _residual_sections(file, plots)),
        *_fingers(file),
        *([] if plots is None else _taxels(file, plots)),
        _devices(file),
    ]
    return page(title, parts)


def _plots() -> ModuleType | None:
    """The pictures' module; None if matplotlib is not installed."""
    try:
        return importlib.import_module("palpate.views.report.calibration_plots")
    except ModuleNotFoundError as missing:
        if missing.name is None or missing.name.partition(".")[0] != "matplotlib":
            raise
        return None


def _residual_sections(file: CalibrationFile, plots: ModuleType) -> list[str]:
    if file.residuals is None or not file.residuals.touches_seen:
        return []
    return [
        section(
            "Residual map",
            paragraph(
                "Fitted tip centres in plan view, with the residual of each touch of a reference. Residuals "
                "that all point one way in one place show an effect that the model does not have."
            ),
            embedded_picture("Map of the touches with their residuals", plots.svg(plots.residual_map, file)),
        ),
        section(
            "Residuals against the bounds",
            paragraph(
                "The bound on positions has to hold for every later contact, anywhere in the workspace, and "
                "not only for those touches."
            ),
            embedded_picture("Histograms of residuals by finger", plots.svg(plots.residual_histograms, file)),
        ),
    ]


def _fingers(file: CalibrationFile) -> list[str]:
    names = [finger.name for finger in file.fingers]
    tables = [
        part
        for group in finger_tables(file)
        for part in (subheading(group.title), table(("", *names), [(name, *row) for name, row in group.rows]))
    ]
    return [section("Fingers", *tables)] if tables else []


def _taxels(file: CalibrationFile, plots: ModuleType) -> list[str]:
    shown = [
        part
        for finger in file.fingers
        if finger.tactile is not None
        for part in (
            subheading(finger.name),
            embedded_picture(
                f"Gains of the taxels of {finger.name}", plots.svg(plots.taxel_gains, finger.tactile)
            ),
        )
    ]
    intro = paragraph("Arrays are shown unrolled and seen from outside, the tip's lower end below.")
    return [section("Taxels", intro, *shown)] if shown else []


def _devices(file: CalibrationFile) -> str:
    rows = [(item.port, item.kind, item.id, item.model, item.firmware) for item in file.devices]
    return section(
        "Devices",
        paragraph(
            "The calibration holds for these devices and for the rig file with this geometry: "
            f"{file.geometry_sha256[:16]}…"
        ),
        table(("port", "kind", "ID", "model", "firmware"), rows),
    )
