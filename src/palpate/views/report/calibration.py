"""Report of a calibration: one HTML file with numbers and pictures that needs nothing else.

From a calibration file to a page for people. No scripts, nothing fetched.
"""

import importlib
from pathlib import Path
from types import ModuleType

from palpate.base.file_io import write_text
from palpate.base.optional_imports import install_command
from palpate.config.calibration_file import CalibrationFile
from palpate.views.report.calibration_numbers import finger_tables, summary
from palpate.views.report.page import embedded_picture, heading, page, paragraph, section, subheading, table


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
        *([paragraph(no_plots)] if plots is None else _residuals(file, plots)),
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


def _residuals(file: CalibrationFile, plots: ModuleType) -> list[str]:
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
