"""Presses and touches of fingers that stick, give way and have their play taken up: what is made of them."""

import math
from typing import Any

import numpy as np
import pytest
from repository import EXAMPLES
from simulated_prober import SimulatedProber, SimulatedRig

from palpate.calibration.finger_fit import touch_loads
from palpate.calibration.idle_statistics import analyse_idle
from palpate.calibration.measurements import Probe, TouchMeasurement
from palpate.calibration.press_levels import PressAtBearing, average_levels
from palpate.calibration.press_model import fit_presses
from palpate.calibration.reference import ReferenceDisc
from palpate.config import RigFile, SlideFingerConfig, load_rig

FRICTION = 0.4
DISC = ReferenceDisc("disc", 25.0)


def loaded_rig(**finger: Any) -> RigFile:
    """The fresh rig, without dead taxels, with forces that act on fingers, and that declares them."""
    data = load_rig(EXAMPLES / "fresh-rig.toml").model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {
        "dead_taxels": 0,
        "deflection_mm_per_n": 0.1,
        "play_holds_n": [0.1, 0.3],
        "part": {"engine": "still", "tip_friction": FRICTION},
    }
    for spec in data["fingers"]:
        spec["tip"] |= {"max_friction": 0.6}
        spec["aim"] |= {"backlash_holds_n": 0.0} | finger
        spec["bounds"] |= {"deflection_mm_per_n": 0.1, "deflection_deg_per_n": 0.03}
    return RigFile.model_validate(data)


def pressed(rig: RigFile, seed: int) -> tuple[SimulatedRig, list[PressAtBearing]]:
    """Presses of the first finger on a disc near the middle, at the bearings at which it really meets it."""
    world = SimulatedRig(rig, seed)
    prober = SimulatedProber(world, rig)
    prober.put(DISC, (0.0, 0.0))
    found = []
    for number, item in enumerate(prober.approaches):
        if item.finger != 0 or number % 2:
            continue
        bearing = prober.bearing_rad(number)
        if bearing is None or abs(bearing) > math.radians(47):
            continue
        (press,) = prober.press([Probe(number, item.length_mm, int(np.sign(bearing)))], 0)
        found.append(PressAtBearing(press, bearing, math.radians(0.3), 1 / DISC.radius_mm))
    return world, found


def test_friction_and_softness_are_told_from_gains() -> None:
    rig = loaded_rig()
    world, presses = pressed(rig, 4)
    assert len(presses) >= 7
    spec, truth, taxels = rig.fingers[0], world.truth(0), world.fingers[0].array.taxels
    assert isinstance(spec, SlideFingerConfig)
    description = world.fingers[0].array.description
    idle = analyse_idle(SimulatedProber(world, rig).idle(2.0)[:1], description.max_count)
    full = description.max_count - 0.5 - idle.zero_counts
    levels = average_levels(presses, idle.live, full, idle.noise_counts)
    rows = np.full(description.cols, description.rows)
    found = fit_presses(
        presses, levels, levels.counts.mean(axis=1), rows, idle.noise_counts, description, spec
    )
    assert found.friction == pytest.approx(FRICTION, rel=0.08)
    assert truth.aim_yield is not None
    reach = math.dist(truth.base_mm, (0.0, 0.0)) - 30.0
    softness = truth.aim_yield.rad_per_nmm * reach**2 * truth.stiffness_n_per_mm
    assert abs(found.softness - softness) < 3 * found.softness_sigma < 0.15
    well = found.gain_log_sigma < 0.03
    assert well.sum() >= 8
    off = np.log(found.gain / taxels.gain.mean(axis=0))[well]
    assert np.abs(off).max() < 0.06
    assert (np.abs(off) < 4 * found.gain_log_sigma[well]).all()


def touch(bearing_deg: float, way: int = 1) -> TouchMeasurement:
    return TouchMeasurement("f1", 0, (0.0, 0.0), way, math.radians(bearing_deg), 0.05, 0.5, 0.05)


def test_loads_of_touches_by_their_rule() -> None:
    specs = [spec for spec in loaded_rig().fingers if isinstance(spec, SlideFingerConfig)]
    loads = touch_loads([touch(0.0), touch(45.0), touch(-45.0), touch(5.0)], specs)
    assert loads.side.tolist() == [0, 1, -1, 1]
    assert loads.pushes.tolist() == [[True, False]] * 4
    # Half of what is declared, and of the push what friction leaves: a third where it sticks, 0.4 at 45°.
    small = math.sin(math.radians(5)) ** 2
    assert loads.give_mm == pytest.approx(0.1 * 0.5 * np.array([0, 0.5 * 0.35, 0.5 * 0.35, small / 3]))
    # It slips at 45°, and sticks at 5°.
    slipping = 0.6 * 0.5 / (2 / 3 * 3.0) / 5.0
    assert loads.sheared_rad[1:3] == pytest.approx(np.full(2, slipping / 2))
    assert loads.sheared_rad[3] == pytest.approx(math.tan(math.radians(5)) * 0.5 / 3.0 / 5.0 / 2)
    assert loads.sheared_rad[0] == 0
    held = [replaced(spec) for spec in specs]
    assert not touch_loads([touch(45.0)], held).pushes.any()


def replaced(spec: SlideFingerConfig) -> SlideFingerConfig:
    """The same, with play that no force takes up."""
    return spec.model_copy(update={"aim": spec.aim.model_copy(update={"backlash_holds_n": None})})
