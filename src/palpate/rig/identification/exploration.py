"""The first grips, before there is anything to plan with: towards the table's middle, or what was felt."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.recognizer import Contact, FingerApproach, already_used
from palpate.recognizer.rays import approach_lines, offset_from_lines
from palpate.rig.reach.approaches import Reach

__all__ = ["exploring_grip", "outside_fast"]

_APART_MM = 6.0  # approaches keep this far from earlier ones of the same finger
_INWARD_MM = 6.0


def exploring_grip(reach: Reach, contacts: Sequence[Contact]) -> list[FingerApproach]:
    """For each finger the approach that passes nearest to the target.

    None that passes too near to an earlier one of that finger is taken.
    """
    target = _target(contacts)
    used = already_used(contacts, reach.approaches)
    grip = []
    for finger_index in sorted({item.finger_index for item in reach.approaches}):
        own = reach.of_finger(finger_index, reach.middle_rad)
        start, angle = approach_lines([reach.approaches[k] for k in own])
        offset = dict(zip(own, offset_from_lines(start, angle, target).tolist(), strict=True))
        taken = [offset[k] for k in own if used[k]]
        free = [k for k in own if all(abs(offset[k] - other) >= _APART_MM for other in taken)]
        if free:
            _, best = min((abs(offset[k]), k) for k in free)
            grip.append(reach.approaches[best])
    return grip


def outside_fast(approach: FingerApproach, workspace_radius_mm: float) -> FingerApproach:
    """The approach, fast as far as the tip is certainly outside of the workspace."""
    (x, y), angle = approach.start_mm, approach.direction_rad
    reach = workspace_radius_mm + approach.finger.tip_radius_mm + approach.position_bound_mm
    along = -(x * math.cos(angle) + y * math.sin(angle))
    beside = math.hypot(x, y) ** 2 - along**2
    inside = math.sqrt(max(reach**2 - beside, 0.0))
    return replace(approach, fast_mm=min(max(along - inside, 0.0), approach.travel_mm))


def _target(contacts: Sequence[Contact]) -> Floats:
    """A little inside of what was touched; the table's middle if nothing was."""
    inward = []
    for contact in contacts:
        if contact.touched:
            angle = contact.middle_normal_rad
            inward.append(
                np.array(contact.end_mm) - _INWARD_MM * np.array([math.cos(angle), math.sin(angle)])
            )
    result: Floats = np.mean(inward, axis=0) if inward else np.zeros(2)
    return result
