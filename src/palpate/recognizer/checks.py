"""Validation of object models that were made without a file: clear errors instead of obscure geometry.

Models from files have been checked already, with messages that name the place in the file.
"""

import math

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, ObjectModel, Polygon, Section
from palpate.recognizer.contact import LARGEST_MM

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
    low, high = section.z_mm
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"{place}: the heights of a cross section must be finite")
    if low > high:
        raise InputError(f"{place}: a cross section must run upwards, not from {low:g} to {high:g} mm")
    if not section.polygons:
        raise InputError(f"{place}: a cross section has no polygon: at least one is needed")
    for polygon in section.polygons:
        _check_polygon(polygon, place)


def _check_polygon(polygon: Polygon, place: str) -> None:
    for ring in polygon.rings:
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
