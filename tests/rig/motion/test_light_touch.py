"""A light touch: fast through free space, slow where the part may be, off it at once, as hard as stated."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emulated_session import EmulatedSession, emulated_session
from firm_rig import firm_rig
from repository import EXAMPLES

from palpate.config import RigFile, load_rig
from palpate.rig.bench import connect
from palpate.rig.contact_peak import expected_peak_n
from palpate.rig.motion.load_meter import TouchStage
from palpate.rig.motion.touch import Touch

STIFFER = 1.2
"""A tip may be so much stiffer than the rig file says, and its array read so much more."""


def light(rig: RigFile, **changes: float) -> RigFile:
    changes = {"search_speed_mm_s": 5.0, "touch_speed_mm_s": 2.0, "contact_force_n": 0.1} | changes
    return rig.model_copy(update={"closing": rig.closing.model_copy(update=changes)})


def gripped(session: EmulatedSession, fast_mm: float) -> tuple[list[Touch], float]:
    """All fingers through the middle, fast for so long; and how long that took."""
    grip = [replace(item, fast_mm=fast_mm) for item in session.middle()]
    with connect(session.bench_rig) as hand:
        begun = session.clock.now()
        touches = session.grip(hand, grip)
        return touches, session.clock.now() - begun


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(firm_rig(), id="slides"),
        pytest.param(EXAMPLES / "two-link-rig.toml", id="arms", marks=pytest.mark.campaign),
    ],
)
def test_a_finger_is_slow_where_it_may_meet_the_part(path: Path) -> None:
    rig = light(load_rig(path))
    sessions = [emulated_session(seed=7, rig=rig) for _ in range(2)]
    slow, slow_s = gripped(sessions[0], 0.0)
    way = min(float(np.hypot(*np.subtract(t.contact.end_mm, t.contact.start_mm))) for t in slow)
    fast, fast_s = gripped(sessions[1], way - 10.0)
    assert fast_s < 0.9 * slow_s
    for session, touches in zip(sessions, (slow, fast), strict=True):
        hardest = max(expected_peak_n(rig, speed) for speed in (5.0, 2.0))
        assert max(finger.hardest_n for finger in session.bench.fingers) < STIFFER * hardest + 0.05
        assert any(touch.contact.touched for touch in touches)
    for one, other in zip(slow, fast, strict=True):
        assert one.contact.touched == other.contact.touched
        apart = np.hypot(*np.subtract(one.contact.end_mm, other.contact.end_mm))
        assert apart < one.contact.position_bound_mm + other.contact.position_bound_mm


def test_every_touch_says_what_it_loaded_the_part_with() -> None:
    session = emulated_session(seed=7, rig=light(load_rig(firm_rig())))
    touches, _ = gripped(session, 0.0)
    for touch, finger in zip(touches, session.bench.fingers, strict=True):
        assert [load.stage for load in touch.loads] == [TouchStage.QUICK, TouchStage.SLOW]
        peak = max(load.peak_force_n for load in touch.loads)
        assert peak == pytest.approx(finger.hardest_n, rel=0.25)
        assert all(0.0 < load.travel_mm < 0.3 for load in touch.loads)


def test_a_finger_that_has_touched_does_not_press_while_others_are_under_way() -> None:
    """The finger whose way is longest comes seconds later: until then the others have left the part."""
    session = emulated_session(seed=7, rig=light(load_rig(firm_rig())))
    grip = [replace(item, fast_mm=60.0 * (index > 0)) for index, item in enumerate(session.middle())]
    pressed = [0.0] * len(grip)
    last = [session.clock.now()]

    def look() -> None:
        now = session.clock.now()
        for index, finger in enumerate(session.bench.fingers):
            pressed[index] += (now - last[0]) * (finger.press is not None)
        last[0] = now

    session.clock.on_tick = look
    with connect(session.bench_rig) as hand:
        session.grip(hand, grip)
    assert max(pressed[1:]) < 2.0


def test_the_expected_peak_grows_with_speed_and_threshold() -> None:
    rig = load_rig(firm_rig())
    peaks = [expected_peak_n(light(rig, contact_force_n=force), 5.0) for force in (0.05, 0.1, 0.3)]
    assert peaks == sorted(peaks)
    assert expected_peak_n(rig, 20.0) == pytest.approx(2.85, abs=0.01)  # as docs/rig-file.md has it
    assert expected_peak_n(light(rig), 5.0) == pytest.approx(0.34, abs=0.01)


def test_a_miss_says_nothing_of_the_way_from_where_something_was_felt() -> None:
    """A finger that ends its way pressing on the part, with less than counts as a contact."""
    rig = light(load_rig(firm_rig()), contact_force_n=2.0)
    found, _ = gripped(emulated_session(seed=7, rig=light(load_rig(firm_rig()))), 0.0)
    session = emulated_session(seed=7, rig=rig)
    ways = [math.dist(touch.contact.start_mm, touch.contact.end_mm) for touch in found]
    grip = [replace(item, travel_mm=way + 0.3) for item, way in zip(session.middle(), ways, strict=True)]
    with connect(session.bench_rig) as hand:
        missed = session.grip(hand, grip)
    assert max(finger.hardest_n for finger in session.bench.fingers) > 0.3
    for touch, way in zip(missed, ways, strict=True):
        assert not touch.contact.touched
        assert way - 1.0 < math.dist(touch.contact.start_mm, touch.contact.end_mm) < way + 0.05
