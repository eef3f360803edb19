"""A patch that an array may have felt straight ahead, for tests that look at some of its fields only."""

from dataclasses import replace
from typing import Any

from palpate.drivers.tactile.patches import ContactPatch

__all__ = ["felt_patch"]

_AHEAD = ContactPatch(
    angle_rad=0.0,
    angle_half_range_rad=0.1,
    centroid_rad=0.0,
    centroid_bound_rad=0.1,
    position_mm=(5.0, 0.0, 8.0),
    position_bound_mm=(0.1, 0.1, 0.1),
    height_mm=8.0,
    height_bound_mm=0.1,
    force_n=0.4,
    force_bound_n=0.04,
    extent_rad=0.3,
    area_mm2=6.0,
    flags=frozenset(),
)


def felt_patch(**changes: Any) -> ContactPatch:
    """That patch with some of its fields (see `ContactPatch`) changed."""
    return replace(_AHEAD, **changes)
