"""Scenes that fingers cannot feel: the part lies outside of the workspace, or lower than the fingers.

From a placement to the commands that put it on an emulated table.
Such scenes are allowed, to try what happens on a table that seems empty.
"""

import shapely
from shapely import affinity

from palpate.config import RigFile
from palpate.rig.catalogue.finger_model import at_heights, heights_in_words
from palpate.rig.catalogue.reachability_text import workspace_words
from palpate.rig.catalogue.section_stack import region_within
from palpate.rig.emulated.scene import Placement

__all__ = ["scene_lines", "sticks_out_mm"]

_ORIGIN = shapely.Point(0, 0)
_TOLERANCE_MM = 0.01
_EMPTY = "the table will seem empty"


def scene_lines(rig: RigFile, placement: Placement) -> list[str]:
    """A line if the part that a scene puts on an emulated table cannot be touched as it should; else none."""
    name = f"scene: {placement.model.name}, {placement.state.name}"
    heights = at_heights(rig)
    met = shapely.union_all([_region(placement, at.span_mm) for at in heights])
    if met.is_empty:
        high = f"{placement.state.top_mm:.3g} mm high"
        fingers = heights_in_words(heights)
        return [f"{name} ({high}): nothing at the height of any finger, {fingers}; {_EMPTY}"]
    if shapely.distance(met, _ORIGIN) >= rig.workspace.radius_mm:
        return [f"{name}: lies outside of {workspace_words(rig)}; {_EMPTY}"]
    beyond = sticks_out_mm(rig, placement)
    if beyond > 0:
        return [f"{name}: sticks out of {workspace_words(rig)}, by {beyond:.3g} mm; fingers may start on it"]
    return []


def sticks_out_mm(rig: RigFile, placement: Placement) -> float:
    """How far the part sticks out of the workspace at the heights of fingers; 0 if it does not."""
    met = shapely.union_all([_region(placement, at.span_mm) for at in at_heights(rig)])
    if met.is_empty:
        return 0.0
    beyond = float(shapely.hausdorff_distance(met, _ORIGIN)) - rig.workspace.radius_mm
    return beyond if beyond > _TOLERANCE_MM else 0.0


def _region(placement: Placement, span_mm: tuple[float, float]) -> shapely.Geometry:
    region = region_within(placement.state, span_mm)
    turned = affinity.rotate(region, placement.theta_rad, (0, 0), use_radians=True)
    return affinity.translate(turned, placement.x_mm, placement.y_mm)
