"""Is what a touch claims true of the bench? For tests that know where the part and the tip really are."""

import math

import numpy as np
import shapely
from emulated_session import angle_in

from palpate.drivers.tactile.patches import PatchFlag
from palpate.rig.motion.touch import Touch

SEVERAL = frozenset({PatchFlag.WIDE, PatchFlag.SEVERAL_PATCHES})


def check_touch(shape: shapely.Polygon, touch: Touch, centre: np.ndarray, radius: float) -> None:
    """Compare one touch with the true section and the true centre of the tip while it was measured."""
    contact = touch.contact
    way = shapely.LineString([contact.start_mm, contact.end_mm])
    assert way.distance(shape) >= radius - contact.path_bound_mm
    if not contact.touched:
        return
    assert touch.patch is not None
    tip = shapely.Point(centre)
    nearest = shape.boundary.interpolate(shape.boundary.project(tip))
    outward = np.array([tip.x - nearest.x, tip.y - nearest.y])
    if shape.contains(tip):
        outward = -outward
    just_touching = np.array([nearest.x, nearest.y]) + radius * outward / np.hypot(*outward)
    # A tip in a notch touches twice; then the nearer edge need not be the one that was measured.
    alone = shapely.Point(just_touching).distance(shape) > radius - 1e-6 and not touch.patch.flags & SEVERAL
    if alone:
        assert math.dist(contact.end_mm, just_touching) <= contact.position_bound_mm
        if contact.normal is not None:
            angle = math.atan2(outward[1], outward[0])
            assert angle_in(angle, contact.normal.lo_rad, contact.normal.hi_rad)
        return
    where = shapely.Point(contact.end_mm).buffer(contact.position_bound_mm)
    near = shape.buffer(radius, quad_segs=128).boundary.intersection(where)
    assert not near.is_empty
    if contact.normal is not None:
        found = []
        for point in shapely.get_coordinates(shapely.segmentize(near, 0.02)):
            foot = shape.boundary.interpolate(shape.boundary.project(shapely.Point(point)))
            found.append(math.atan2(point[1] - foot.y, point[0] - foot.x))
        assert any(angle_in(angle, contact.normal.lo_rad, contact.normal.hi_rad) for angle in found)
