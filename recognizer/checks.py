"""What object models must be before the recogniser takes them up: for whoever uses it without files.

Files are checked when they are read, with their own places and names; here is the last gate before geometry
that would fail obscurely, or never end.
"""

import math

import numpy as np
import shapely

from palpate.errors import InputError
from palpate.recognizer.arrays import Floats
from palpate.recognizer.contact import LARGEST_MM
from palpate.recognizer.model import ObjectModel, Polygon, Section

__all__ = ["check_model"]

_SMALLEST_MM2, _THINNEST_MM = 1e-9, 2e-7


def check_model(item: ObjectModel) -> None:
    """Raise InputError, naming the object and the place, unless everything about it is in order."""
    if not (math.isfinite(item.tolerance_mm) and 0 <= item.tolerance_mm <= LARGEST_MM):
        raise InputError(
            f"object {item.name}: the tolerance must be from 0 to {LARGEST_MM:g} mm, "
            f"not {item.tolerance_mm:g}"
        )
    if not item.states:
        raise InputError(f"object {item.name} has no state: at least one is needed")
    for state in item.states:
        place = f"object {item.name}, state {state.name}"
        if not state.sections:
            raise InputError(f"{place} has no cross section: at least one is needed")
        for section in state.sections:
            _check_section(section, place)


def _check_section(section: Section, place: str) -> None:
    if not (math.isfinite(section.z_lo_mm) and math.isfinite(section.z_hi_mm)):
        raise InputError(f"{place}: the heights of a cross section must be finite")
    if section.z_lo_mm > section.z_hi_mm:
        raise InputError(
            f"{place}: a cross section must run upwards, "
            f"not from {section.z_lo_mm:g} to {section.z_hi_mm:g} mm"
        )
    if not section.polygons:
        raise InputError(f"{place}: a cross section has no polygon: at least one is needed")
    for polygon in section.polygons:
        _check_polygon(polygon, place)


def _check_polygon(polygon: Polygon, place: str) -> None:
    for ring in (polygon.outer, *polygon.holes):
        _check_ring(ring, place)
    shape = shapely.Polygon(polygon.outer, polygon.holes)
    if not shape.is_valid:
        raise InputError(f"{place}: an outline is no simple polygon: {shapely.is_valid_reason(shape)}")
    if shape.area < max(_SMALLEST_MM2, _THINNEST_MM * shape.length):
        raise InputError(f"{place}: an outline encloses no area")


def _check_ring(ring: Floats, place: str) -> None:
    if ring.ndim != 2 or ring.shape[1] != 2 or len(np.unique(ring, axis=0)) < 3:
        raise InputError(f"{place}: an outline needs at least three different points (x, y)")
    if not np.all(np.isfinite(ring)) or float(np.abs(ring).max()) > LARGEST_MM:
        raise InputError(f"{place}: coordinates must be finite and within ±{LARGEST_MM:g} mm")
