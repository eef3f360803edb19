"""DXF reader: drawings as outlines of flat parts, in mm.

The file's own unit counts; one that it lacks has to be said.
"""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.base.errors import InputError
from palpate.base.files import check_file
from palpate.base.files.limits import CAD_BYTES
from palpate.base.optional_imports import needed, readable
from palpate.cad.dxf_walk import Walk
from palpate.cad.loop_assembly import JOIN_MM, Sheet, Stroke, closed_loops
from palpate.cad.part_size import GIVE_NO_UNITS, UNIT_MM
from palpate.cad.ring_nesting import parts
from palpate.cad.values import DrawingFile

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document

__all__ = ["read_dxf"]

_INSUNITS = {
    1: ("inch", 25.4),
    2: ("ft", 304.8),
    4: ("mm", 1.0),
    5: ("cm", 10.0),
    6: ("m", 1000.0),
    8: ("microinch", 25.4e-6),
    9: ("mil", 0.0254),
    10: ("yd", 914.4),
    13: ("µm", 1e-3),
    14: ("dm", 100.0),
}
"""Units of $INSUNITS that a part can be drawn in, in mm. Source: DXF reference, HEADER section."""


def read_dxf(path: Path, units: str | None, curve_mm: float, layers: Sequence[str] = ()) -> DrawingFile:
    """The parts that a drawing shows, each with its holes, from the largest on; curves within `curve_mm`.

    `units`: "mm", "inch" or "m" for a file that has none. `layers`: the ones with outlines; none named: all
    that are visible. Raises InputError for a file that is no DXF, has no or other units, or whose lines are
    no closed outlines, with coordinates in the file's own unit.
    """
    document = _opened(path)
    with readable(path, "DXF"):
        unit, unit_mm = _unit(document, units, path)
    walk = Walk(path, document, unit_mm)
    with readable(path, "DXF"):
        walk.all()
    strokes = _chosen(walk, layers, path)
    low, high = min(strokes, key=itemgetter(1)), max(strokes, key=itemgetter(1))
    if high[1] - low[1] > JOIN_MM:
        raise InputError(
            f"{path}: the drawing is not flat: {low[0].label} lies at z = {low[1] / unit_mm:.6g} {unit}, "
            f"{high[0].label} at {high[1] / unit_mm:.6g} {unit}"
        )
    sheet = Sheet(str(path), unit, (1 / unit_mm, 1 / unit_mm))
    loops = closed_loops([stroke for stroke, _ in strokes], curve_mm, sheet)
    return DrawingFile(parts(loops, path.stem, unit, sheet), walk.rest(layers))


def _opened(path: Path) -> "Document":
    ezdxf = needed("ezdxf", "cad", "reading DXF files")
    check_file(path, CAD_BYTES, "keep the outlines only")
    with readable(path, "DXF"):
        document: Document = ezdxf.readfile(path)
    return document


def _unit(document: "Document", units: str | None, path: Path) -> tuple[str, float]:
    """The unit of the file's numbers and what it is in mm: its own, or the one that is asked for."""
    code = int(document.header.get("$INSUNITS", 0))
    if code == 0:
        if units is None:
            raise InputError(f"{path}: has no units ($INSUNITS is 0): give its units: mm, inch or m")
        return units, UNIT_MM[units]
    if code not in _INSUNITS:
        raise InputError(f"{path}: has $INSUNITS {code}, a unit in which no part is drawn; save it in mm")
    unit, unit_mm = _INSUNITS[code]
    if units not in {None, unit}:
        raise InputError(f"{path}: is in {unit} ($INSUNITS is {code}), not in {units}: {GIVE_NO_UNITS}")
    return unit, unit_mm


def _chosen(walk: Walk, layers: Sequence[str], path: Path) -> list[tuple[Stroke, float]]:
    """What is drawn on the layers that are asked for, or on all."""
    found, left_out = walk.found, walk.rest()
    rest = f"; left out: {', '.join(left_out)}" if left_out else ""
    if not found and walk.on_paper and not walk.left_out:
        raise InputError(
            f"{path}: its model space is empty: what it shows is drawn in paper space ({walk.on_paper}); "
            "draw the part in model space"
        )
    if not found:
        raise InputError(f"{path}: holds no outlines; draw them on a visible layer in continuous lines{rest}")
    names = {name.casefold(): name for name in found}
    for name in layers:
        if name.casefold() not in names:
            there = ", ".join(f"'{name}'" for name in sorted(found))
            raise InputError(f"{path}: has no outlines on a visible layer '{name}', only on {there}{rest}")
    wanted = dict.fromkeys(names[name.casefold()] for name in layers) if layers else found
    return [stroke for name in wanted for stroke in found[name]]
