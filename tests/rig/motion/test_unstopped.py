"""Fingers that nobody stops press no harder than `palpate check` says: the bus is cut when one touches."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from emulated_session import emulated_session
from firm_rig import firm_rig
from quick_rig import small, small_objects
from sampling import sample

from palpate.base.errors import DeviceError, SafetyStop
from palpate.config import RigFile
from palpate.rig.contact_peak import unstopped_peak_n


def drawn_rig(rng: np.random.Generator) -> RigFile:
    """The small firm rig with other speeds, force limits and tips."""
    data = tomllib.loads(small(firm_rig()))
    speed = float(rng.uniform(5.0, 60.0))
    tip = {
        "stiffness_n_per_mm": float(rng.uniform(1.0, 12.0)),
        "stiffness_spread": float(rng.uniform(0.0, 0.3)),
    }
    data["closing"] |= {"approach_speed_mm_s": speed, "touch_speed_mm_s": min(speed, 5.0)}
    data["closing"] |= {"max_force_n": float(rng.uniform(8.0, 14.0))}
    friction = {"friction": [0.3, 1.2], "rest_friction": [1.0, 2.0], "cable_n": [-1.0, 1.0]}
    data["emulation"] |= {"stiffness_spread": tip["stiffness_spread"], "mechanics": friction}
    for finger in data["fingers"]:
        finger["tip"] |= tip
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(60), range(3)))
def test_a_finger_whose_bus_is_cut_presses_within_its_bound(seed: int, tmp_path: Path) -> None:
    rig = drawn_rig(np.random.default_rng([11, seed]))
    session = emulated_session(seed=seed, rig=rig, objects=small_objects())
    bus = session.cables[rig.bus.port]

    def cut_at_a_touch() -> None:
        bus.cut = bus.cut or any(finger.hardest_n > 0 for finger in session.bench.fingers)

    session.clock.on_tick = cut_at_a_touch
    with pytest.raises((DeviceError, SafetyStop)):
        session.run_grip(tmp_path, session.middle())
    assert bus.cut
    session.rest(2.0)
    hardest = max(finger.hardest_n for finger in session.bench.fingers)
    assert 0.1 < hardest <= unstopped_peak_n(rig)
