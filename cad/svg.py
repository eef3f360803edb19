"""SVG drawings as outlines of flat parts, in mm. One of the readers; what it finds goes to `chains`.

What counts is geometry: paths, rectangles, circles, ellipses, polygons, polylines and lines, wherever they are
painted; neither fill rule nor clipping changes it. What is not displayed, or has neither fill nor stroke, and
text and images are left out. y points down in SVG and up here. Source: SVG 2, https://www.w3.org/TR/SVG2/
"""

import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from palpate.cad.chains import Sheet, Stroke, closed_loops
from palpate.cad.curves import Arc, Curve, line, mapped
from palpate.cad.nesting import parts
from palpate.cad.size import UNIT_MM
from palpate.cad.values import Drawing, Floats
from palpate.errors import InputError

if TYPE_CHECKING:
    from svgelements import Shape

__all__ = ["read_svg"]

_LENGTH = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(mm|cm|in|pt|pc|px|Q|)\s*")
_UNITS_MM = {
    "mm": 1.0,
    "cm": 10.0,
    "in": 25.4,
    "pt": 25.4 / 72,
    "pc": 25.4 / 6,
    "px": 25.4 / 96,
    "Q": 0.25,
}
"""Absolute units, in mm. Source: CSS Values and Units 4, section 6.2."""
_NEVER_PAINTED = ("clipPath", "mask", "marker", "pattern", "symbol")
"""Elements whose content is painted, if at all, only where others refer to it."""


def read_svg(path: Path, units: str | None, curve_mm: float) -> tuple[Drawing, ...]:
    """The parts that a drawing shows, each with its holes, from the largest on; curves within `curve_mm`.

    `units`: "mm", "inch" or "m" for a file whose width and height have no unit; one of its user units (of
    its viewBox) is so much. Raises InputError for a file that is no SVG, has no or other units, or whose lines
    are no closed outlines, with coordinates in mm from the top left, y downwards.
    """
    root = _parsed(path)
    page = _page(root, units, path)
    strokes = list(_strokes(root, page, path))
    if not strokes:
        raise InputError(f"{path}: holds no outlines; draw them as paths or shapes with a stroke or fill")
    sheet = Sheet(str(path), "mm from the top left", (1.0, -1.0))
    return parts(closed_loops(strokes, curve_mm, sheet), path.stem, units, sheet)


@dataclass(frozen=True)
class _Page:
    """The page in user units, and what one of them is in mm."""

    width: float
    height: float
    user_mm: float


def _parsed(path: Path) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, ElementTree.ParseError, ValueError, LookupError) as problem:
        raise InputError(f"{path}: is no readable SVG file ({problem}); save it as SVG anew") from None
    if _local(root) != "svg":
        raise InputError(f"{path}: is XML but no SVG: its outermost element is <{_local(root)}>, not <svg>")
    return root


def _local(element: ElementTree.Element) -> str:
    """The name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _page(root: ElementTree.Element, units: str | None, path: Path) -> _Page:
    """Source: SVG 2, sections 8.2 (viewBox) and 8.9 (units)."""
    sides = [_side(root.get(name), name, path) for name in ("width", "height")]
    box = root.get("viewBox")
    view = [float(number) for number in re.findall(r"[^\s,]+", box)] if box and _numbers(box) else None
    if box and (view is None or len(view) != 4 or min(view[2:]) <= 0):
        raise InputError(f"{path}: its viewBox is '{box}'; needed are four numbers, x y width height")
    extent = view[2:] if view else [1.0 if side is None else side[0] for side in sides]
    absolute = [
        _UNITS_MM[unit] * (number / size if view else 1.0)
        for (number, unit), size in zip((side or (0.0, "") for side in sides), extent, strict=True)
        if unit
    ]
    if not absolute:
        if units is None:
            raise InputError(f"{path}: has no units: add --units mm, inch or m for what its user units are")
        return _Page(*extent, UNIT_MM[units])
    named = next(unit for _, unit in (side or (0.0, "") for side in sides) if unit)
    if units not in {None, {"in": "inch"}.get(named, named)}:
        raise InputError(f"{path}: is in {named} (its width and height), not in {units}: leave --units out")
    fit = (root.get("preserveAspectRatio") or "").split()
    if "none" in fit and max(absolute) > min(absolute) * (1 + 1e-6):
        raise InputError(f"{path}: stretches its viewBox differently in width and height; save it unstretched")
    return _Page(*extent, max(absolute) if "slice" in fit else min(absolute))
