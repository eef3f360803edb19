"""Identify with a planner of one's own: python own_planner.py [RIG.toml [OBJECTS.json]]"""

import sys
from collections.abc import Sequence

import palpate

Approaches = Sequence[palpate.FingerApproach]


def touch_middle(known: palpate.RigRecognition, rig: palpate.GripPlanner) -> Approaches | None:
    """One finger after the other through the likeliest middle, once palpate's planner has found the part."""
    if not known.hypotheses:
        return rig.plan(known)
    if known.verdict == "identified" or len(known.grips) == 8:
        return None
    place, finger = known.hypotheses[0].configuration, len(known.grips) % len(rig.file.fingers)
    ways = [way for way in rig.approaches if way.finger_index == finger]
    return [min(ways, key=lambda way: way.aside_mm(place.x_mm, place.y_mm))]


print(palpate.open_rig(*sys.argv[1:2], seed=7).identify(*sys.argv[2:3], strategy=touch_middle).text())
