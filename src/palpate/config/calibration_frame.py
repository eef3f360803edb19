"""How far the frame of a calibration may be from the drawing's: what that leaves open of a stage's centre.

A calibration speaks of the frame in which bases and headings are nearest to the rig file's (ADR 0018). The
centre of a stage that was not measured is where the drawing has it, but in the drawing's frame.
"""

import math

from palpate.config.rig_file import RigFile

__all__ = ["frame_offset_bound_mm"]


def frame_offset_bound_mm(rig: RigFile, point_mm: tuple[float, float]) -> float:
    """How far a point of the drawing may be off in a calibration's frame, by the bounds of all bases (mm).

    The frame is turned by no more than headings, or bases as seen from their middle, may be off: it is fitted
    to both by least squares. Its middle is off by the mean of the bases' bounds at most.
    """
    count = len(rig.fingers)
    bounds = [finger.bounds.base_mm for finger in rig.fingers]
    middle = [sum(finger.base_mm[k] for finger in rig.fingers) / count for k in (0, 1)]
    levers = [math.dist(finger.base_mm, middle) for finger in rig.fingers]
    square = math.fsum(lever**2 for lever in levers)
    aside = math.fsum(lever * bound for lever, bound in zip(levers, bounds, strict=True))
    turned = math.asin(min(aside / square, 1.0)) if square > 0 else 0.0
    turned = max(turned, *(math.radians(finger.bounds.heading_deg) for finger in rig.fingers))
    return math.fsum(bounds) / count + 2 * math.sin(turned / 2) * math.dist(point_mm, middle)
