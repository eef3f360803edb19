"""Tests of motion in free air: fingers arrive, and measure no force. The table is clear."""

import pytest

from palpate.config import RigFile
from palpate.drivers.dynamixel import MoveEnd
from palpate.rig.motion.finger_movers import ARRIVED_MM
from palpate.rig.motion.guarded_approach import move_along_lines, move_tips, read_positions
from palpate.rig.motion.hand import Hand
from palpate.testing.hardware.bench import AirMover, AirPaths, Note, return_fingers, start_approaches


@pytest.mark.moves("each finger turns to both ends of its range, goes 25 mm in and back; the table is clear")
def test_a_finger_goes_where_it_is_sent(ways: AirPaths, hand: Hand, note: Note) -> None:
    """Both servos arrive within their tolerances: along the way and beside it."""
    for finger_ways in ways:
        worst_mm = worst_beside_mm = 0.0
        for way in (finger_ways[0], finger_ways[-1]):
            (run,) = start_approaches(hand, [way])
            move_along_lines(hand, {run: way.travel_mm})
            read_positions(hand, [run])
            worst_mm = max(worst_mm, abs(run.travel_mm - way.travel_mm))
            worst_beside_mm = max(worst_beside_mm, run.cross_track_error_mm)
            bound_mm = way.position_bound_mm
            return_fingers(hand, [run])
            assert abs(run.travel_mm) < ARRIVED_MM, way.finger
            assert worst_mm < ARRIVED_MM, way.finger
            assert worst_beside_mm < bound_mm, way.finger
        name = hand.fingers[finger_ways[0].finger_index].name
        note(f"{name}_off_mm", worst_mm)
        note(f"{name}_beside_mm", worst_beside_mm)


@pytest.mark.moves("each finger goes 25 mm in and back at approach and search speed; the table is clear")
def test_a_finger_feels_nothing_in_the_air(ways: AirPaths, rig: RigFile, hand: Hand, note: Note) -> None:
    """No contact where nothing is: motion and cables do not press on its array."""
    note("contact_force_n", rig.closing.contact_force_n)
    for _, way, _ in ways:
        (run,) = start_approaches(hand, [way])
        hand.tare()
        hand.arm()  # a busy computer may have been silent while it worked on the zero
        for speed_mm_s in (rig.closing.approach_speed_mm_s, rig.closing.search_mm_s):
            mover = AirMover(hand, run, speed_mm_s)
            ends = move_tips(hand, [mover])
            note(f"{run.finger.name}_felt_at_{speed_mm_s:g}_mm_s_n", mover.largest_n)
            assert ends == {run: MoveEnd.REACHED}, "a contact where nothing is"
            move_along_lines(hand, {run: 0.0})
        hand.stop_arrays()
        return_fingers(hand, [run])
