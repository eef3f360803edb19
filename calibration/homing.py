"""Homing of a slide: scale and zero from where it stalls against its hard stops.

From servo angles at the back and front stop, whose distances from the base are known (`stops_mm` of the rig
file), to travel per rad and the distance at servo angle 0. Servo angles count from Goal Position 2048.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.calibration.play import Backlash
from palpate.drivers.finger import TICK_RAD
from palpate.errors import InputError
from palpate.geometry import Floats

__all__ = ["Homing", "SlideDescription", "homed"]


_SURE = 5.0  # standard deviations


@dataclass(frozen=True)
class SlideDescription:
    """What the rig file says of a slide: mm_per_rad (signed), off by the share `spread` at most; its stops.

    `servo`: how messages call it, such as "finger f1, slide (ID 12)". `stops_mm`: distances from the base to
    the tip's centre at the back and the front stop; `stops_sigma_mm`: standard deviation of each.
    """

    servo: str
    mm_per_rad: float
    spread: float
    stops_mm: tuple[float, float]
    stops_sigma_mm: float = 0.0


@dataclass(frozen=True)
class Homing:
    """Scale and zero with standard deviations: distance = zero_mm + mm_per_rad · servo angle, ± half play.

    The distance is that of the middle of the play: a tip that is pushed back, as in a touch, is nearer to
    the base by the half play. `covariance` of zero (mm) and scale (mm/rad). `repeatability_mm`: standard
    deviation of single stalls about the mean of theirs.
    """

    mm_per_rad: float
    mm_per_rad_sigma: float
    zero_mm: float
    zero_sigma_mm: float
    covariance: float
    repeatability_mm: float


def homed(described: SlideDescription, back_rad: Floats, front_rad: Floats, play: Backlash) -> Homing:
    """Scale and zero from stalls (n,) at the back and (m,) at the front stop, in rad.

    The drive that presses the carriage against the back stop has gone past it by the half play, towards the
    base; at the front stop as much outwards: zero + scale · angle = back − half there, front + half here.
    What else yields under the stall, a belt or a rail, acts alike: stall at little current, or count it to
    `play`. An encoder that reads the same at every stall is off by the same part of a step: repeating does
    not make the uncertainty smaller than that. Raises InputError if a stop was not tried, or if scale or
    direction is not what the rig file says.
    """
    if not (len(back_rad) and len(front_rad)):
        raise InputError(
            f"{described.servo} was stalled {len(back_rad)} times at its back and {len(front_rad)} times at "
            "its front stop; homing needs both; repeat it"
        )
    servo = np.array([back_rad.mean(), front_rad.mean()])
    length = described.stops_mm[1] - described.stops_mm[0]
    apart = float(servo[1] - servo[0])
    if apart * described.mm_per_rad <= 0:
        raise InputError(
            f"{described.servo} met its front stop where the back one should be: it turns the other way than "
            "the rig file says; change the sign of slide.mm_per_turn, or the servo's Drive Mode"
        )
    scale = (length + 2 * play.half_mm) / apart
    zero = described.stops_mm[0] - play.half_mm - scale * float(servo[0])
    spread = _repeatability_rad(back_rad, front_rad)
    sigma_scale, sigma_zero, both = _uncertainty(
        described, servo, scale, [_mean_sigma_rad(spread, len(x)) for x in (back_rad, front_rad)], play
    )
    _check_scale(described, scale, sigma_scale)
    return Homing(scale, sigma_scale, zero, sigma_zero, both, spread * abs(scale))


def _repeatability_rad(back_rad: Floats, front_rad: Floats) -> float:
    """Standard deviation of single stalls, both stops together."""
    off = np.concatenate([back_rad - back_rad.mean(), front_rad - front_rad.mean()])
    return math.sqrt(float((off**2).sum()) / max(len(off) - 2, 1))


def _mean_sigma_rad(spread_rad: float, count: int) -> float:
    return math.hypot(spread_rad / math.sqrt(count), TICK_RAD / math.sqrt(12))


def _uncertainty(
    described: SlideDescription, servo: Floats, scale: float, mean_sigma_rad: list[float], play: Backlash
) -> tuple[float, float, float]:
    """Standard deviations of scale and zero and their covariance.

    Scale and zero solve two equations, zero + scale · servo = stop ∓ half; their errors are the inverse of
    that times the right sides' errors: of stops and angles each by itself, of the half play against each
    other.
    """
    inverse = np.linalg.inv(np.array([[1.0, servo[0]], [1.0, servo[1]]]))
    own = (np.array(mean_sigma_rad) * scale) ** 2 + described.stops_sigma_mm**2
    half = play.sigma_mm**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    covariance = inverse @ (np.diag(own) + half) @ inverse.T
    return math.sqrt(covariance[1, 1]), math.sqrt(covariance[0, 0]), float(covariance[0, 1])


def _check_scale(described: SlideDescription, scale: float, sigma: float) -> None:
    off = abs(scale / described.mm_per_rad - 1)
    if off > described.spread + _SURE * sigma / abs(described.mm_per_rad):
        raise InputError(
            f"{described.servo} moves {2 * math.pi * scale:.3f} mm per turn between its stops; the rig file "
            f"says {2 * math.pi * described.mm_per_rad:.3f} mm ± {100 * described.spread:.2g} %; check "
            "slide.stops_mm and slide.mm_per_turn, and that nothing held the slide before its stops"
        )
