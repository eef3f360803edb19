"""The truth in the frame that a calibrated hand speaks of, which is not quite the emulated table's."""

import math
from dataclasses import replace

import numpy as np
import pytest
from repository import EXAMPLES

from palpate.config import load_objects, load_rig, shipped_objects
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.emulated.calibrated_truth import in_hand_frame
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.scene import Placement, draw_placement

FRESH = load_rig(EXAMPLES / "fresh-rig.toml")
PLACEMENT = draw_placement(load_objects(shipped_objects()), 20.0, np.random.default_rng(4))


def slides(seed: int) -> list[FingerTruth]:
    fingers = emulate(FRESH, None, seed).bench.fingers
    return [finger.truth for finger in fingers if isinstance(finger.truth, FingerTruth)]


def moved(point: tuple[float, float], angle: float, shift: tuple[float, float]) -> tuple[float, float]:
    at = complex(*point) * complex(math.cos(angle), math.sin(angle)) + complex(*shift)
    return at.real, at.imag


def test_a_hand_that_stands_as_drawn_but_elsewhere_takes_the_part_along() -> None:
    """All fingers turned and shifted as one, and the part with them: the hand sees no difference."""
    angle, shift = 0.04, (2.0, -1.5)
    truths = [
        replace(
            truth,
            base_mm=moved(spec.base_mm, angle, shift),
            heading_rad=math.radians(spec.heading_deg) + angle,
        )
        for spec, truth in zip(FRESH.fingers, slides(0), strict=True)
    ]
    x, y = moved((PLACEMENT.x_mm, PLACEMENT.y_mm), angle, shift)
    elsewhere = replace(PLACEMENT, x_mm=x, y_mm=y, theta_rad=PLACEMENT.theta_rad + angle)
    assert pose(in_hand_frame(elsewhere, FRESH, truths)) == pytest.approx(pose(PLACEMENT))


def test_a_drawn_hand_sees_the_part_elsewhere_by_what_its_fingers_are_off() -> None:
    for seed in range(3):
        truths = slides(seed)
        there = in_hand_frame(PLACEMENT, FRESH, truths)
        # The middle of the bases goes to the middle of the drawn ones; the part is as far from it as it was.
        drawn = np.mean([finger.base_mm for finger in FRESH.fingers], axis=0)
        built = np.mean([truth.base_mm for truth in truths], axis=0)
        before = math.dist((PLACEMENT.x_mm, PLACEMENT.y_mm), built)
        assert math.dist((there.x_mm, there.y_mm), drawn) == pytest.approx(before)
        assert 0 < abs(there.theta_rad - PLACEMENT.theta_rad) < math.radians(3.0)
        assert (there.model, there.state) == (PLACEMENT.model, PLACEMENT.state)


def pose(placement: Placement) -> tuple[float, float, float]:
    return placement.x_mm, placement.y_mm, placement.theta_rad
