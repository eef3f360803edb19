"""Prior of a slide finger: what rig file and homing say of it before its touches are looked at.

Touches have the slide's backlash on one side always, that on which the part pushes the tip back; the zero
that is fitted is the one that belongs to that side.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.calibration.backlash import Backlash
from palpate.calibration.finger_fit import COLUMNS, FingerModel
from palpate.calibration.homing import StopStalls, line_through_stops
from palpate.config import SlideCalibration, SlideFingerConfig
from palpate.geometry import Floats

__all__ = ["SlideInContact", "finger_model", "slide_in_contact", "zero_in_file_mm"]


_LEAST = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 1e-5, 1e-6])
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


def finger_model(spec: SlideFingerConfig, slide: SlideInContact) -> FingerModel:
    """The prior of a finger: the rig file's numbers and bounds, and what is known of its slide."""
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
    covariance = np.zeros((COLUMNS, COLUMNS))
    covariance[np.ix_([4, 6], [4, 6])] = slide.covariance
    covariance += np.diag(np.maximum(sigma, _LEAST) ** 2)
    return FingerModel(
        spec.name,
        spec.aim.gear_ratio,
        math.radians(spec.aim.zero_deg) - math.pi,
        slide.mm_per_rad,
        prior,
        covariance,
    )


def zero_in_file_mm(zero_mm: float, mm_per_rad: float) -> float:
    """A zero at Goal Position 2048, as kinematics have it, at Goal Position 0, as files have it."""
    return zero_mm - mm_per_rad * math.pi
