"""The report of a calibration: one HTML file with numbers and pictures that needs nothing else.

The end of the calibration's way: the calibration file in, a page for people out. No scripts, nothing fetched.
"""

import math
from pathlib import Path

import numpy as np

from palpate.config.calibration_file import CalibrationFile
from palpate.config.calibration_finger import FingerCalibration, TactileCalibration
from palpate.files.writing import write_text
from palpate.views.calibration.histogram import draw_histograms
from palpate.views.calibration.numbers import Section, finger_sections, summary
from palpate.views.calibration.residual_map import draw_map
from palpate.views.calibration.taxel_map import draw_taxels
from palpate.views.calibration.values import MEASURED, NEVER_PRESSED, Mark, MarkMap, Spread, TaxelMap
from palpate.views.scene.style import CARD, INK, MUTED, PAPER, RULE
from palpate.views.scene.values import FingerBase
from palpate.views.svg import escape

__all__ = ["report_html", "write_report"]

_STYLE = f"""
:root {{ color-scheme: light; }}
body {{ margin: 0 auto; max-width: 1060px; padding: 28px; background: {PAPER}; color: {INK};
  font: 15px/1.45 sans-serif; }}
h1 {{ font-size: 26px; margin: 0 0 14px; }}
h2 {{ font-size: 19px; margin: 40px 0 10px; }}
h3 {{ font-size: 15px; margin: 22px 0 8px; }}
p {{ max-width: 46em; margin: 8px 0 14px; color: {MUTED}; }}
svg {{ display: block; width: 100%; height: auto; }}
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
    """The report as one HTML page. Deterministic: equal files give equal text."""
    title = escape(f"Calibration of {file.rig}")
    body = [
        f"<h1>{title}</h1>",
        _summary(file),
        *_residuals(file),
        *_fingers(file),
        *_taxels(file),
        _devices(file),
    ]
    head = f'<meta charset="utf-8"><title>{title}</title><style>\n{_STYLE}\n</style>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n'
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _summary(file: CalibrationFile) -> str:
    rows = "".join(f"<tr>{_row_head(name)}<td>{escape(value)}</td></tr>" for name, value in summary(file))
    return f"<table>{rows}</table>"


def _residuals(file: CalibrationFile) -> list[str]:
    found = file.residuals
    if found is None or not found.touches_seen:
        return []
    return [
        "<h2>Residual map</h2>",
        "<p>Tip centres in plan view, where the fit says that they were, and how far each touch of a "
        "reference is off it. Residuals that all point one way in one place speak of something that the fit "
        "does not know.</p>",
        draw_map(_marks(file)),
        "<h2>Residuals against the bounds</h2>",
        "<p>The bound on positions has to hold for every later contact, anywhere in the workspace, and not "
        "only for those touches.</p>",
        draw_histograms(tuple(_spread(file, finger) for finger in file.fingers)),
    ]


def _fingers(file: CalibrationFile) -> list[str]:
    sections = finger_sections(file.fingers)
    if not sections:
        return []
    names = "".join(f'<th scope="col">{escape(finger.name)}</th>' for finger in file.fingers)
    groups = "".join(_group(section, len(file.fingers)) for section in sections)
    return ["<h2>Fingers</h2>", f"<table><thead><tr><td></td>{names}</tr></thead>{groups}</table>"]


def _group(section: Section, columns: int) -> str:
    head = f'<tr><th scope="rowgroup" colspan="{columns + 1}">{escape(section.title)}</th></tr>'
    rows = [
        f"<tr>{_row_head(name)}{''.join(f'<td>{escape(value)}</td>' for value in values)}</tr>"
        for name, values in section.rows
    ]
    return f"<tbody>{head}{''.join(rows)}</tbody>"


def _row_head(name: str) -> str:
    return f'<th scope="row">{escape(name)}</th>'


def _taxels(file: CalibrationFile) -> list[str]:
    known = [(finger.name, finger.tactile) for finger in file.fingers if finger.tactile is not None]
    if not known:
        return []
    shown = ["<h2>Taxels</h2>"]
    for name, tactile in known:
        shown += [f"<h3>{escape(name)}</h3>", draw_taxels(_taxel_map(name, tactile))]
    return shown


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


def _marks(file: CalibrationFile) -> MarkMap:
    names = tuple(finger.name for finger in file.fingers)
    seen = () if file.residuals is None else file.residuals.touches_seen
    return MarkMap(
        names,
        tuple(FingerBase(f.name, f.place.base_mm) for f in file.fingers if f.place is not None),
        tuple(
            Mark(
                finger=names.index(touch.finger),
                placing=touch.placing,
                at_mm=(touch.x_mm, touch.y_mm),
                normal_rad=math.radians(touch.normal_deg),
                residual_mm=touch.residual_mm,
                held_out=touch.held_out,
                outlier=touch.outlier,
            )
            for touch in seen
        ),
    )


def _spread(file: CalibrationFile, finger: FingerCalibration) -> Spread:
    seen = () if file.residuals is None else file.residuals.touches_seen
    mine = [touch for touch in seen if touch.finger == finger.name]
    used = [touch for touch in mine if not touch.outlier]
    return Spread(
        finger.name,
        np.array([touch.residual_mm for touch in used if not touch.held_out]),
        np.array([touch.residual_mm for touch in used if touch.held_out]),
        len(mine) - len(used),
        None if finger.bounds is None else finger.bounds.position_mm,
    )


def _taxel_map(name: str, tactile: TactileCalibration) -> TaxelMap:
    """Gains as a picture's values; what was never pressed has the gain 1 and the widest bound of all."""
    gain, bound = np.array(tactile.gain), np.array(tactile.gain_bound)
    kinds = np.where((gain == 1.0) & (bound == bound.max()), NEVER_PRESSED, MEASURED).tolist()
    for taxel in tactile.unusable:
        kinds[taxel.row][taxel.col] = taxel.what
    return TaxelMap(name, gain, bound, tuple(tuple(row) for row in kinds))
