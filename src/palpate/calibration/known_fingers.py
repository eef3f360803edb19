"""Fingers as a calibration knows them: their values in the hand frame, and what these may be off by."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.finger_model import certain_models
from palpate.calibration.fitted_kinematics import (
    AIM_PLAY,
    ELBOW_PLAY,
    SCALE,
    SHOULDER_PLAY,
    ArmModel,
    FingerModel,
)
from palpate.calibration.frame_alignment import ARM_PLACE, PLACE
from palpate.config import FingerConfig
from palpate.config.calibration_finger import ActuatorsCalibration, ArmActuatorsCalibration, FingerCalibration

__all__ = ["KnownFingers"]

_LEAST_SIGMA = 1e-6  # of what a calibration takes for certain: mm, rad, a share


@dataclass(frozen=True, eq=False)
class KnownFingers:
    """Values (fingers, k) of calibrated fingers in the hand frame, and the covariance of all of them.

    `covariance`: (fingers · k, fingers · k).
    """

    models: Sequence[FingerModel]
    values: Floats
    covariance: Floats

    @classmethod
    def from_calibration(cls, specs: Sequence[FingerConfig], calibrated: Sequence[FingerCalibration]) -> Self:
        """By a calibration file, of which `specs` are the rig's fingers; each finger's errors for themselves.

        All must have places and actuators.
        """
        models = certain_models(specs)
        values = np.array([model.prior for model in models])
        columns = values.shape[1]
        covariance = _LEAST_SIGMA**2 * np.eye(values.size)
        for index, (model, found) in enumerate(zip(models, calibrated, strict=True)):
            assert found.place is not None
            own = index * columns + np.array(ARM_PLACE if isinstance(model, ArmModel) else PLACE)
            covariance[np.ix_(own, own)] += np.array(found.place.covariance)
            for column, (value, sigma) in _moving(found).items():
                at = index * columns + column
                values[index, column] = value
                covariance[at, at] += sigma**2
        return cls(models, values, covariance)


def _moving(found: FingerCalibration) -> dict[int, tuple[float, float]]:
    """Plays, and the error of a slide's travel, with their deviations, by columns of the values."""
    if isinstance(found.actuators, ArmActuatorsCalibration):
        joints = {SHOULDER_PLAY: found.actuators.shoulder, ELBOW_PLAY: found.actuators.elbow}
    else:
        assert isinstance(found.actuators, ActuatorsCalibration)
        joints = {AIM_PLAY: found.actuators.aim}
    moving = {
        column: (math.radians(joint.backlash_deg), math.radians(joint.backlash_sigma_deg))
        for column, joint in joints.items()
    }
    if isinstance(found.actuators, ActuatorsCalibration):
        slide = found.actuators.slide
        moving[SCALE] = 0.0, slide.mm_per_turn_sigma / abs(slide.mm_per_turn)
    return moving
