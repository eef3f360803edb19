"""Fingers move outside of the workspace, where nothing is: they arrive, and feel nothing."""

import math

import pytest

from palpate.config import RigFile
from palpate.drivers.dynamixel.guarded import End
from palpate.rig.motion.finger_movers import ARRIVED_MM
from palpate.rig.motion.guarded_approach import go_to, look, move_tips
from palpate.rig.motion.hand import Hand
from palpate.testing.hardware.conftest import Note
from palpate.testing.hardware.ways import AirMover, Ways, aimed, back

_PASSES = 2


@pytest.mark.moves("each finger turns to both ends of its range, goes up to the workspace and back")
def test_a_finger_goes_where_it_is_sent(ways: Ways, hand: Hand, note: Note) -> None:
    """Both servos arrive within their tolerances: along the way and beside it."""
    for finger_ways in ways:
        worst_mm = worst_beside_mm = 0.0
        for way in (finger_ways[0], finger_ways[-1]):
            (run,) = aimed(hand, [way])
            go_to(hand, {run: way.travel_mm})
            look(hand, [run])
            worst_mm = max(worst_mm, abs(run.travel_mm - way.travel_mm))
            worst_beside_mm = max(worst_beside_mm, run.cross_track_error_mm)
            bound_mm = way.position_bound_mm
            back(hand, [run])
            assert abs(run.travel_mm) < ARRIVED_MM, way.finger
            assert worst_mm < ARRIVED_MM, way.finger
            assert worst_beside_mm < bound_mm, way.finger
        name = hand.fingers[finger_ways[0].finger_index].name
        note(f"{name}_off_mm", worst_mm)
        note(f"{name}_beside_mm", worst_beside_mm)


@pytest.mark.moves("all fingers at once go up to the workspace and back, at approach and search speed")
def test_fingers_feel_nothing_in_the_air(ways: Ways, rig: RigFile, hand: Hand, note: Note) -> None:
    """No contact on ways where nothing is; motion and cables do not press on the arrays."""
    runs = aimed(hand, [way for _, way, _ in ways])
    hand.tare()
    largest_n = dict.fromkeys((run.finger.name for run in runs), -math.inf)
    for speed_mm_s in _PASSES * (rig.closing.approach_speed_mm_s, rig.closing.search_mm_s):
        movers = [AirMover(hand, run, speed_mm_s, runs) for run in runs]
        ends = move_tips(hand, movers)
        for mover in movers:
            name = mover.run.finger.name
            largest_n[name] = max(largest_n[name], mover.largest_n)
        assert ends == dict.fromkeys(runs, End.REACHED), "a contact where nothing is"
        go_to(hand, dict.fromkeys(runs, 0.0))
    hand.stop_arrays()
    back(hand, runs)
    note("contact_force_n", rig.closing.contact_force_n)
    for name, force_n in largest_n.items():
        note(f"{name}_felt_n", force_n)
