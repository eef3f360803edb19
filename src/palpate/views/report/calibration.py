"""Report of a calibration: one HTML file with numbers and pictures that needs nothing else.

From a calibration file to a page for people. No scripts, nothing fetched.
"""

import importlib
from base64 import b64encode
from pathlib import Path
from types import ModuleType

from palpate.base.file_io import write_text
from palpate.base.optional_imports import install_command
from palpate.config.calibration_file import CalibrationFile
from palpate.views.report.calibration_numbers import RowGroup, finger_tables, summary
from palpate.views.svg import CARD, INK, MUTED, PAPER, RULE, escape

_STYLE = f"""
:root {{ color-scheme: light; }}
body {{ margin: 0 auto; max-width: 1060px; padding: 28px; background: {PAPER}; color: {INK};
  font: 15px/1.45 sans-serif; }}
h1 {{ font-size: 26px; margin: 0 0 14px; }}
h2 {{ font-size: 19px; margin: 40px 0 10px; }}
h3 {{ font-size: 15px; margin: 22px 0 8px; }}
p {{ max-width: 46em; margin: 8px 0 14px; color: {MUTED}; }}
img {{ display: block; width: 100%; height: auto; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ text-align: left; vertical-align: top; padding: 4px 22px 4px 0; border-bottom: 1px solid {RULE};
  font-weight: normal; }}
th[scope=row] {{ color: {MUTED}; white-space: nowrap; }}
th[scope=col] {{ font-weight: bold; overflow-wrap: anywhere; }}
th[scope=rowgroup] {{ font-weight: bold; padding-top: 16px; background: {CARD}; }}
""".strip()


def write_report(path: Path, file: CalibrationFile) -> None:
    """Write the report to `path`; raises InputError if the place cannot be written."""
    write_text(path, report_html(file))


def report_html(file: CalibrationFile) -> str:
    """The report as one HTML page. Deterministic: equal files give equal text.

    Without matplotlib it has all numbers, and one line that says how to get the pictures.
    """
    title, plots = escape(f"Calibration of {file.rig}"), _plots()
    body = [f"<h1>{title}</h1>", _summary(file)]
    body += [_no_plots()] if plots is None else _residuals(file, plots)
    body += _fingers(file)
    body += [] if plots is None else _taxels(file, plots)
    body.append(_devices(file))
    head = f'<meta charset="utf-8"><title>{title}</title><style>\n{_STYLE}\n</style>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n'
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _summary(file: CalibrationFile) -> str:
    rows = "".join(f"<tr>{_row_head(name)}<td>{escape(value)}</td></tr>" for name, value in summary(file))
    return f"<table>{rows}</table>"


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
        "<h2>Residual map</h2>",
        "<p>Fitted tip centres in plan view, with the residual of each touch of a reference. Residuals that "
        "all point one way in one place show an effect that the model does not have.</p>",
        _image("Map of the touches with their residuals", plots.svg(plots.residual_map, file)),
        "<h2>Residuals against the bounds</h2>",
        "<p>The bound on positions has to hold for every later contact, anywhere in the workspace, and not "
        "only for those touches.</p>",
        _image("Histograms of residuals by finger", plots.svg(plots.residual_histograms, file)),
    ]


def _image(words: str, svg: str) -> str:
    """A picture inside the page, its ids apart from those of other pictures."""
    return f'<img alt="{escape(words)}" src="data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"/>'


def _fingers(file: CalibrationFile) -> list[str]:
    groups = finger_tables(file)
    if not groups:
        return []
    names = "".join(f'<th scope="col">{escape(finger.name)}</th>' for finger in file.fingers)
    rows = "".join(_group(group, len(file.fingers)) for group in groups)
    return ["<h2>Fingers</h2>", f"<table><thead><tr><td></td>{names}</tr></thead>{rows}</table>"]


def _group(group: RowGroup, columns: int) -> str:
    head = f'<tr><th scope="rowgroup" colspan="{columns + 1}">{escape(group.title)}</th></tr>'
    rows = [
        f"<tr>{_row_head(name)}{''.join(f'<td>{escape(value)}</td>' for value in values)}</tr>"
        for name, values in group.rows
    ]
    return f"<tbody>{head}{''.join(rows)}</tbody>"


def _row_head(name: str) -> str:
    return f'<th scope="row">{escape(name)}</th>'


def _taxels(file: CalibrationFile, plots: ModuleType) -> list[str]:
    shown = []
    for finger in file.fingers:
        if finger.tactile is not None:
            picture = _image(
                f"Gains of the taxels of {finger.name}", plots.svg(plots.taxel_gains, finger.tactile)
            )
            shown += [f"<h3>{escape(finger.name)}</h3>", picture]
    intro = (
        "<h2>Taxels</h2><p>Arrays are shown unrolled and seen from outside, the tip's lower end below.</p>"
    )
    return [intro, *shown] if shown else []


def _devices(file: CalibrationFile) -> str:
    titles = ("port", "kind", "ID", "model", "firmware")
    head = "".join(f'<th scope="col">{title}</th>' for title in titles)
    rows = "".join(
        "<tr>"
        + "".join(f"<td>{escape(value)}</td>" for value in (d.port, d.kind, d.id, d.model, d.firmware))
        + "</tr>"
        for d in file.devices
    )
    return (
        "<h2>Devices</h2><p>The calibration holds for these devices and for the rig file with this geometry: "
        f"{escape(file.geometry_sha256[:16])}…</p><table><thead><tr>{head}</tr></thead>{rows}</table>"
    )


def _no_plots() -> str:
    return f"<p>No pictures: matplotlib is not installed ({escape(install_command('plots'))}).</p>"
