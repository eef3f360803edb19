"""Models of a rig's fingers: `MODELS` is the only place in calibration that lists the kinds of finger."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.calibration.arm_model import ArmModel
from palpate.calibration.finger_model import FingerModel
from palpate.calibration.slide_model import SlideModel
from palpate.config import ArmFingerConfig, FingerConfig, SlideFingerConfig
from palpate.config.calibration_finger import Actuators, FingerCalibration

MODELS: dict[type, type[FingerModel]] = {SlideFingerConfig: SlideModel, ArmFingerConfig: ArmModel}
"""Model of each kind of finger, by the model of its table in the rig file."""

_CERTAIN_SIGMA = 1e-5  # standard deviation of what is not to be fitted: mm, rad


def _model_of(spec: FingerConfig) -> type[FingerModel]:
    if type(spec) not in MODELS:
        raise InputError(f"finger {spec.name}: palpate does not calibrate fingers of its type yet")
    return MODELS[type(spec)]


def nominal_model(spec: FingerConfig) -> FingerModel:
    """Prior of a finger by the rig file alone."""
    return _model_of(spec).nominal(spec)


def nominal_models(specs: Sequence[FingerConfig]) -> list[FingerModel]:
    """Priors of all fingers by the rig file alone."""
    return _pad_to_one_width([nominal_model(spec) for spec in specs])


def calibrated_models(specs: Sequence[FingerConfig], actuators: Sequence[Actuators]) -> list[FingerModel]:
    """Priors of all fingers whose actuators have been measured."""
    pairs = zip(specs, actuators, strict=True)
    return _pad_to_one_width([_model_of(spec).from_actuators(spec, own) for spec, own in pairs])


def certain_models(specs: Sequence[FingerConfig]) -> list[FingerModel]:
    """Fingers of a calibrated rig, where they are and not elsewhere."""
    models = _pad_to_one_width([_model_of(spec).certain(spec) for spec in specs])
    return [model.fix(_CERTAIN_SIGMA) for model in models]


def _pad_to_one_width(models: Sequence[FingerModel]) -> list[FingerModel]:
    """Models with as many values each as the one that has most."""
    columns = max(len(model.prior) for model in models)
    return [model.widen(columns) for model in models]


_MIN_SIGMA = 1e-6  # of what a calibration takes for certain: mm, rad, a share


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
        """Fingers by a calibration file; `specs`: the rig's fingers; each finger's errors for themselves.

        All must have places and actuators.
        """
        models = certain_models(specs)
        values = np.array([model.prior for model in models])
        columns = values.shape[1]
        covariance = _MIN_SIGMA**2 * np.eye(values.size)
        for index, (model, found) in enumerate(zip(models, calibrated, strict=True)):
            assert found.place is not None
            assert found.actuators is not None
            own = index * columns + np.array(model.place_columns)
            covariance[np.ix_(own, own)] += np.array(found.place.covariance)
            for column, (value, sigma) in model.known_values(found.actuators).items():
                at = index * columns + column
                values[index, column] = value
                covariance[at, at] += sigma**2
        return cls(models, values, covariance)
