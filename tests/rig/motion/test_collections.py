"""Garbage collections while fingers may move: they do not look through everything that palpate holds."""

import gc

from emulated_session import small_session

from palpate.rig.bench import connect


def test_what_is_there_before_fingers_move_is_not_looked_through_while_they_do() -> None:
    held = len(gc.get_objects())
    with connect(small_session().bench_rig) as hand:
        hand.prepare()
        assert len(gc.get_objects()) < held / 20, "a full collection looks at these"
    assert len(gc.get_objects()) > held / 2
    assert gc.get_freeze_count() == 0
