"""What a closing claims is true of the bench: places, normals, free ways, forces, distances of fingers."""

import math

import numpy as np
import pytest
from emulated_session import EmulatedSession, emulated_session, small_session
from sampling import sample
from shared_files import SHARED_OUTLINES, needs_shared_outlines
from touched import run_checked

from palpate.base.geometry.plane import distance_range
from palpate.config import ObjectsFile, load_objects, shipped_objects
from palpate.rig.bench import connect


def gaps_mm(session: EmulatedSession) -> list[float]:
    """True free space between every two fingers, as discs swept from base to tip."""
    ends = [(np.array([f.truth.base_mm]), np.array([f.centre_mm]), f.truth) for f in session.bench.fingers]
    gaps = []
    for i, (base, tip, one) in enumerate(ends):
        for other_base, other_tip, other in ends[:i]:
            apart, _ = distance_range(base, tip, other_base, other_tip)
            gaps.append(float(apart[0]) - one.tip_radius_mm - other.tip_radius_mm)
    return gaps


@pytest.mark.parametrize("number", sample([2, 3], [2]))
def test_every_touch_is_within_its_bounds(number: int) -> None:
    """Each shipped object at a drawn place, gripped at random."""
    objects = load_objects(shipped_objects())
    one = ObjectsFile((objects.objects[number],))
    touches = run_checked(emulated_session(seed=100 + number, objects=one), 2, number)
    assert sum(touch.contact.touched for touch in touches) >= 3


@pytest.mark.slow
@needs_shared_outlines
@pytest.mark.parametrize("seed", sample(range(2), []))
def test_every_touch_on_real_parts_is_within_its_bounds(seed: int) -> None:
    touches = run_checked(emulated_session(seed=seed, objects=load_objects(SHARED_OUTLINES)), 2, seed)
    assert touches


def test_an_empty_table_is_missed_and_fingers_stay_apart() -> None:
    session = small_session(empty=True)
    closest = [math.inf]
    session.clock.on_tick = lambda: closest.append(min(closest.pop(), *gaps_mm(session)))
    with connect(session.bench_rig) as hand:
        touches = session.grip(hand, session.middle())
    assert [touch.contact.touched for touch in touches] == [False] * 3
    assert all(touch.patch is None for touch in touches)
    assert session.rig.closing.clearance_mm - 2.0 <= closest[0] <= session.rig.closing.clearance_mm + 2.0
    for touch in touches:
        short = np.hypot(*touch.contact.end_mm)
        assert 5.0 < short < 20.0, "they stopped on their ways, short of the middle"


def test_fingers_wait_outside_the_workspace_between_grips() -> None:
    session = small_session(seed=3)
    with connect(session.bench_rig) as hand:
        session.grip(hand, session.middle())
        for finger in session.bench.fingers:
            outside = session.rig.workspace.radius_mm + finger.truth.tip_radius_mm
            assert np.hypot(*finger.centre_mm) >= outside - 1.5
        assert all(session.torque().values())
    assert not any(session.torque().values())
