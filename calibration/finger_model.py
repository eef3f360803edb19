"""What is known of a slide finger before its touches are looked at: from rig file and homing to a prior.

Between the configuration and `finger_fit`. Touches have the slide's play on one side always, that on which
the part pushes the tip back; the zero that is fitted is the one that belongs to that side.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.calibration.finger_fit import COLUMNS, FingerModel
from palpate.calibration.play import Backlash
from palpate.config import SlideFingerConfig
from palpate.config.calibration_finger import SlideCalibration
from palpate.drivers.finger import TICK_RAD
from palpate.geometry import Floats

__all__ = [
    "Homed",
    "SlideInContact",
    "finger_model",
    "mm_per_rad_of",
    "touching",
    "touching_of",
    "zero_in_file_mm",
]


_LEAST = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 1e-5, 1e-6])
"""Standard deviations that no prior goes below, so that nothing is quite certain."""


@dataclass(frozen=True)
class Homed:
    """Where a slide's servo (rad) stalled against its stops, in the mean, and its play.

    `sigma_rad`: standard deviation of either mean. `stops_mm`: as the rig file has them.
    """

    back_rad: float
    front_rad: float
    sigma_rad: float
    stops_mm: tuple[float, float]
    play: Backlash


@dataclass(frozen=True, eq=False)
class SlideInContact:
    """A slide as touches see it, its play taken up: distance = zero + mm_per_rad · servo.

    `covariance` (2, 2): of the zero (mm) and of the error of mm_per_rad, as a share.
    """

    zero_mm: float
    mm_per_rad: float
    covariance: Floats


def touching(spec: SlideFingerConfig, play: Backlash | None, homed: Homed | None) -> SlideInContact:
    """What is known of a slide by the rig file, its play and its stops, as far as they were measured."""
    if homed is not None:
        return _from_stops(homed)
    per_rad = mm_per_rad_of(spec)
    half, sigma = _half_mm(spec, play)
    # The rig file's zero is at Goal Position 0, half a turn of the servo away.
    share, away = spec.slide.mm_per_turn_spread**2 / 3, per_rad * math.pi
    zero = sigma**2 + spec.slide.zero_bound_mm**2 / 3 + away**2 * share
    covariance = np.array([[zero, away * share], [away * share, share]])
    return SlideInContact(spec.slide.zero_mm + away - half, per_rad, covariance)


def touching_of(found: SlideCalibration) -> SlideInContact:
    """What a calibration says of a slide."""
    per_rad = found.mm_per_turn / (2 * math.pi)
    return SlideInContact(found.touch_zero_mm, per_rad, np.array(found.touch_covariance))


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


def mm_per_rad_of(spec: SlideFingerConfig) -> float:
    """The slide's travel per rad of its servo, as described."""
    return spec.slide.mm_per_turn / (2 * math.pi)


def zero_in_file_mm(zero_mm: float, mm_per_rad: float) -> float:
    """A zero at Goal Position 2048, as kinematics have it, at Goal Position 0, as files have it."""
    return zero_mm - mm_per_rad * math.pi


def _half_mm(spec: SlideFingerConfig, play: Backlash | None) -> tuple[float, float]:
    """Half play and its standard deviation: measured, or anything that the rig file allows."""
    if play is not None:
        return play.half_mm, play.sigma_mm
    return spec.slide.backlash_mm / 2, spec.slide.backlash_mm / math.sqrt(12)


def _from_stops(homed: Homed) -> SlideInContact:
    """The touching side by the stops.

    At the front stop the carriage is pushed back, as in a touch; at the back stop it is on the other flank,
    a whole play away: zero + travel · angle = front there, and back − 2 half here.
    """
    inverse = np.linalg.inv(np.array([[1.0, homed.back_rad], [1.0, homed.front_rad]]))
    at = np.array([homed.stops_mm[0] - 2 * homed.play.half_mm, homed.stops_mm[1]])
    zero, per_rad = inverse @ at
    step = abs(per_rad) * math.hypot(homed.sigma_rad, TICK_RAD / math.sqrt(12))
    errors = np.diag([step**2 + 4 * homed.play.sigma_mm**2, step**2])
    covariance = inverse @ errors @ inverse.T
    scale = np.array([1.0, 1 / per_rad])
    return SlideInContact(float(zero), float(per_rad), covariance * np.outer(scale, scale))
