"""The truth in the frame that a calibrated hand speaks of, which is not quite the emulated table's."""

import math
from dataclasses import replace

import numpy as np
import pytest
from repository import EXAMPLES

from palpate.calibration.frame_alignment import BasePose, align_to_nominal
from palpate.config import RigFile, load_objects, load_rig, shipped_objects
from palpate.config.calibration_overlay import frame_offset_bound_mm
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.drivers.kinematics import Turn
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.ground_truth import in_hand_frame
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


def test_a_stage_turns_about_where_its_centre_bound_allows_in_the_calibrations_frame() -> None:
    """Points of the ring, by the drawing's centre and by the true one, in the frame of the calibration."""
    data = FRESH.model_dump(mode="json", exclude_unset=True)
    rng, widest = np.random.default_rng(6), 0.0
    for seed in range(40):
        centre = tuple(rng.uniform(-8.0, 8.0, 2).tolist())
        stage = {"centre_mm": centre, "dxl_id": 1, "model": "XM430-W350", "gear_ratio": 5.0}
        stage |= {"range_deg": [-30.0, 30.0], "backlash_deg": 0.0, "zero_deg": 180.0, "bound_deg": 0.0}
        rig = RigFile.model_validate(data | {"stage": stage})
        assert rig.stage is not None
        truths = slides(seed)
        drawn = [BasePose(item.base_mm, math.radians(item.heading_deg)) for item in rig.fingers]
        frame = align_to_nominal(drawn, [BasePose(item.base_mm, item.heading_rad) for item in truths])
        bound = frame_offset_bound_mm(rig, rig.stage.centre_mm)
        true_centre = frame.point_mm(rig.stage.centre_mm)
        assert math.dist(true_centre, rig.stage.centre_mm) <= bound
        angle = float(rng.uniform(-0.52, 0.52))
        point = tuple(rng.uniform(-60.0, 60.0, 2).tolist())
        believed = Turn(rig.stage.centre_mm, angle, 0.0, bound)
        off = math.dist(believed.point_mm(point), Turn(true_centre, angle).point_mm(point))
        assert off <= believed.position_bound_mm(point) + 1e-9
        widest = max(widest, off)
    assert widest > 0.3, "more than such rigs' contacts are bounded by"
