"""Homing of a slide: travel per rad and zero from where its servo stalls against the hard stops.

The stops' distances from the base are known (`stops_mm` of the rig file); the stalls give a servo angle at
each. Servo angles count from Goal Position 2048.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.calibration.backlash import Backlash
from palpate.config import SlideFingerConfig
from palpate.drivers.finger import TICK_RAD

__all__ = ["Homing", "StopStalls", "fit_homing", "line_through_stops"]


_SURE = 5.0  # standard deviations


@dataclass(frozen=True, eq=False)
class StopStalls:
    """Servo angles (rad) at which a slide stalled against its back stop (n,) and its front stop (m,).

    `stops_mm`: distances from the base to the tip's centre at either stop.
    """

    stops_mm: tuple[float, float]
    back_rad: Floats
    front_rad: Floats

    def means_rad(self) -> Floats:
        """Mean at the back and at the front stop."""
        return np.array([self.back_rad.mean(), self.front_rad.mean()])

    def mean_sigmas_rad(self) -> Floats:
        """Standard deviations of the means (2,).

        An encoder that reads the same at every stall is off by the same part of a step: repeating does not
        make the uncertainty smaller than that.
        """
        off = np.concatenate([self.back_rad - self.back_rad.mean(), self.front_rad - self.front_rad.mean()])
        single = math.sqrt(float((off**2).sum()) / max(len(off) - 2, 1))
        counts = np.array([len(self.back_rad), len(self.front_rad)])
        result: Floats = np.hypot(single / np.sqrt(counts), TICK_RAD / math.sqrt(12))
        return result


@dataclass(frozen=True)
class Homing:
    """Travel and zero with standard deviations: distance = zero_mm + mm_per_rad · servo angle.

    The distance is that of the middle of the play: a tip that is pushed back, as in a touch, is nearer to
    the base by the half.
    """

    mm_per_rad: float
    mm_per_rad_sigma: float
    zero_mm: float
    zero_sigma_mm: float


def fit_homing(spec: SlideFingerConfig, stalls: StopStalls, backlash: Backlash) -> Homing:
    """Travel and zero of a slide from its stalls.

    The drive that presses the carriage against the back stop has gone past it by the half backlash, towards
    the base; at the front stop as much outwards. What else yields under the stall, a belt or a rail, acts
    alike: stall at little current, or count it to the backlash. Raises InputError if a stop was not tried, or
    if travel or direction is not what the rig file says.
    """
    servo = f"finger {spec.name}, slide (ID {spec.slide.dxl_id})"
    if not (len(stalls.back_rad) and len(stalls.front_rad)):
        raise InputError(
            f"{servo} was stalled {len(stalls.back_rad)} times at its back and {len(stalls.front_rad)} times "
            "at its front stop; homing needs both; repeat it"
        )
    if float(np.diff(stalls.means_rad())[0]) * spec.slide.mm_per_rad <= 0:
        raise InputError(
            f"{servo} met its front stop where the back one should be: it turns the other way than "
            "the rig file says; change the sign of slide.mm_per_turn, or the servo's Drive Mode"
        )
    (zero, scale), covariance = line_through_stops(stalls, backlash, (-1.0, 1.0))
    zero_sigma, scale_sigma = np.sqrt(np.diag(covariance)).tolist()
    described, spread = spec.slide.mm_per_rad, spec.slide.mm_per_turn_spread
    if abs(scale / described - 1) > spread + _SURE * scale_sigma / abs(described):
        raise InputError(
            f"{servo} moves {2 * math.pi * scale:.3f} mm per turn between its stops; the rig file says "
            f"{spec.slide.mm_per_turn:.3f} mm ± {100 * spread:.2g} %; check slide.stops_mm and "
            "slide.mm_per_turn, and that nothing held the slide before its stops"
        )
    return Homing(float(scale), scale_sigma, float(zero), zero_sigma)


def line_through_stops(
    stalls: StopStalls, backlash: Backlash, halves: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Zero (mm) and travel (mm/rad) of a slide, (2,), and their covariance (2, 2).

    `halves`: how many half backlashes the drive is beyond the back and the front stop, outwards positive,
    when it stalls: -1 and 1 as seen from the middle of the play, -2 and 0 from its flank in a touch.
    """
    halves_of = np.array(halves)
    inverse = np.linalg.inv(np.column_stack([np.ones(2), stalls.means_rad()]))
    line = inverse @ (np.array(stalls.stops_mm) + halves_of * backlash.half_mm)
    # Angles err each by itself, both ends by the same backlash.
    errors = np.diag((line[1] * stalls.mean_sigmas_rad()) ** 2)
    errors += backlash.sigma_mm**2 * np.outer(halves_of, halves_of)
    return line, inverse @ errors @ inverse.T
