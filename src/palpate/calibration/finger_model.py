"""Prior of a finger: what rig file and homing say of it before its touches are looked at.

Touches have a slide's backlash on one side always, that on which the part pushes the tip back; the zero
that is fitted is the one that belongs to that side.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.backlash import Backlash
from palpate.calibration.fitted_kinematics import ArmModel, FingerModel, SlideModel, of_one_width
from palpate.calibration.homing import StopStalls, line_through_stops
from palpate.config import ArmFingerConfig, FingerConfig, JointConfig, SlideCalibration, SlideFingerConfig
from palpate.config.calibration_finger import Actuators, ActuatorsCalibration

__all__ = [
    "SlideInContact",
    "calibrated_models",
    "certain_models",
    "finger_model",
    "nominal_models",
    "slide_in_contact",
]
__all__ += ["zero_in_file_mm"]


_CERTAIN = 1e-5  # standard deviation of what is not to be fitted: mm, rad
_LEAST = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 1e-5, 1e-6])
_LEAST_OF_ARM = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 0.002, 1e-5, 1e-5, 1e-5])
"""Standard deviations that no prior goes below, so that nothing is quite certain."""


@dataclass(frozen=True, eq=False)
class SlideInContact:
    """A slide as touches see it, its backlash taken up: distance = zero + mm_per_rad · servo.

    `covariance` (2, 2): of the zero (mm) and of the error of mm_per_rad, as a share.
    """

    zero_mm: float
    mm_per_rad: float
    covariance: Floats

    @classmethod
    def from_calibration(cls, found: SlideCalibration) -> "SlideInContact":
        """What a calibration says of a slide."""
        per_rad = found.mm_per_turn / (2 * math.pi)
        return cls(found.touch_zero_mm, per_rad, np.array(found.touch_covariance))


def slide_in_contact(
    spec: SlideFingerConfig, backlash: Backlash | None = None, stalls: StopStalls | None = None
) -> SlideInContact:
    """What is known of a slide by the rig file, its backlash and its stops, as far as they were measured."""
    described = spec.slide
    if backlash is not None and stalls is not None:
        # At the front stop the carriage is pushed back, as in a touch; at the back stop the other flank
        # bears.
        (zero, per_rad), covariance = line_through_stops(stalls, backlash, (-2.0, 0.0))
        scale = np.array([1.0, 1 / per_rad])
        return SlideInContact(float(zero), float(per_rad), covariance * np.outer(scale, scale))
    if backlash is None:
        backlash = Backlash(described.backlash_mm / 2, described.backlash_mm / math.sqrt(12))
    # The rig file's zero is at Goal Position 0, half a turn of the servo away.
    share, away = described.mm_per_turn_spread**2 / 3, described.mm_per_rad * math.pi
    variance = backlash.sigma_mm**2 + described.zero_bound_mm**2 / 3 + away**2 * share
    covariance = np.array([[variance, away * share], [away * share, share]])
    return SlideInContact(described.zero_mm + away - backlash.half_mm, described.mm_per_rad, covariance)


def nominal_models(specs: Sequence[FingerConfig]) -> list[FingerModel]:
    """Priors of all fingers by the rig file alone."""
    return of_one_width(
        [
            _arm_model(spec)
            if isinstance(spec, ArmFingerConfig)
            else finger_model(spec, slide_in_contact(spec))
            for spec in specs
        ]
    )


def calibrated_models(specs: Sequence[FingerConfig], actuators: Sequence[Actuators]) -> list[FingerModel]:
    """Priors of all fingers whose actuators have been measured."""
    found: list[FingerModel] = []
    for spec, own in zip(specs, actuators, strict=True):
        if isinstance(spec, ArmFingerConfig):
            found.append(_arm_model(spec))
        else:
            assert isinstance(own, ActuatorsCalibration)
            found.append(finger_model(spec, SlideInContact.from_calibration(own.slide)))
    return of_one_width(found)


def certain_models(specs: Sequence[FingerConfig]) -> list[FingerModel]:
    """The fingers of a calibrated rig, where they are and not elsewhere."""
    found: list[FingerModel] = []
    for spec in specs:
        if isinstance(spec, ArmFingerConfig):
            found.append(_arm_model(spec))
        else:
            per_rad = spec.slide.mm_per_rad
            zero_mm = spec.slide.zero_mm + math.pi * per_rad
            found.append(finger_model(spec, SlideInContact(zero_mm, per_rad, np.zeros((2, 2)))))
    return [model.fixed(_CERTAIN) for model in of_one_width(found)]


def finger_model(spec: SlideFingerConfig, slide: SlideInContact) -> SlideModel:
    """The prior of a slide finger: the rig file's numbers and bounds, and what is known of its slide."""
    aim_play = math.radians(spec.aim.backlash_deg)
    prior = np.array(
        [*spec.base_mm, math.radians(spec.heading_deg), spec.tip.radius_mm, slide.zero_mm, aim_play / 2, 0.0]
    )
    sigma = np.array(
        [
            spec.bounds.base_mm / 2,
            spec.bounds.base_mm / 2,
            math.radians(spec.bounds.heading_deg) / math.sqrt(3),
            spec.tip.radius_bound_mm / math.sqrt(3),
            0.0,
            aim_play / math.sqrt(12),
            0.0,
        ]
    )
    covariance = np.zeros((len(prior), len(prior)))
    covariance[np.ix_([4, 6], [4, 6])] = slide.covariance
    covariance += np.diag(np.maximum(sigma, _LEAST) ** 2)
    return SlideModel(
        spec.name,
        prior,
        covariance,
        gear_ratio=spec.aim.gear_ratio,
        aim_zero_rad=math.radians(spec.aim.zero_deg) - math.pi,
        mm_per_rad=slide.mm_per_rad,
    )


def _arm_model(spec: ArmFingerConfig) -> ArmModel:
    """The prior of an arm: the rig file's numbers and bounds. The shoulder's zero is in its heading."""
    bounds, links = spec.bounds, spec.links
    plays = [math.radians(joint.backlash_deg) for joint in (spec.shoulder, spec.elbow)]
    turned_deg = math.hypot(bounds.heading_deg, spec.shoulder.zero_bound_deg)
    prior = [*spec.base_mm, math.radians(spec.heading_deg), spec.tip.radius_mm, links.upper_mm, links.fore_mm]
    sigma = np.array(
        [
            bounds.base_mm / 2,
            bounds.base_mm / 2,
            math.radians(turned_deg) / math.sqrt(3),
            spec.tip.radius_bound_mm / math.sqrt(3),
            links.bound_mm / math.sqrt(3),
            links.bound_mm / math.sqrt(3),
            math.radians(spec.elbow.zero_bound_deg) / math.sqrt(3),
            *(play / math.sqrt(12) for play in plays),
        ]
    )
    return ArmModel(
        spec.name,
        np.array([*prior, 0.0, *(play / 2 for play in plays)]),
        np.diag(np.maximum(sigma, _LEAST_OF_ARM) ** 2),
        gear_ratio=np.array([spec.shoulder.gear_ratio, spec.elbow.gear_ratio]),
        zero_rad=np.array([_zero_rad(spec.shoulder), _zero_rad(spec.elbow)]),
    )


def _zero_rad(joint: JointConfig) -> float:
    return math.radians(joint.zero_deg) - math.pi


def zero_in_file_mm(zero_mm: float, mm_per_rad: float) -> float:
    """A zero at Goal Position 2048, as kinematics have it, at Goal Position 0, as files have it."""
    return zero_mm - mm_per_rad * math.pi
