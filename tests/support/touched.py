"""Random grips of an emulated session, each touch checked against the bench's truth."""

import numpy as np
from emulated_session import EmulatedSession, shape_of
from touch_check import check_touch

from palpate.recognizer import FingerApproach
from palpate.rig.bench import connect
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of

__all__ = ["random_grip", "run_checked"]


def random_grip(session: EmulatedSession, rng: np.random.Generator) -> list[FingerApproach]:
    """One approach of each finger, most of them towards where things lie."""
    reach = reach_of(session.rig)
    grip = []
    for index in range(len(session.rig.fingers)):
        own = reach.of_finger(index)
        k = int(np.clip(rng.normal(len(own) / 2, len(own) / 8), 0, len(own) - 1))
        grip.append(reach.approaches[own[k]])
    return grip


def run_checked(session: EmulatedSession, grips: int, seed: int) -> list[Touch]:
    """Several random grips in one connection, each touch checked against the bench's truth."""
    assert session.placement is not None
    shape = shape_of(session.placement)
    rng = np.random.default_rng([seed, 77])
    centres: list[np.ndarray] = []

    def remember(stage: GripPhase) -> None:
        if stage is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    every = []
    with connect(session.bench_rig) as hand:
        for _ in range(grips):
            touches = session.grip(hand, random_grip(session, rng), remember)
            for touch in touches:
                radius = session.rig.fingers[touch.finger_index].tip.radius_mm
                check_touch(shape, touch, centres[touch.finger_index], radius)
            every += touches
    limit = session.rig.closing.max_force_n
    assert all(finger.hardest_n <= limit for finger in session.bench.fingers)
    assert not any(session.torque().values())
    return every
