"""Load on the part by a touch: peak force, travel in contact and work, and all of it frame by frame."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.config import TipConfig

__all__ = [
    "HIDDEN_FACTOR",
    "TIP_FRICTION",
    "ContactLoad",
    "LoadTrace",
    "TouchStage",
    "drag_shares",
    "friction_factor",
    "friction_of",
]

TIP_FRICTION = 0.7
"""Friction of tips on parts that bounds on motion allow for, unless a rig file allows for more."""

HIDDEN_FACTOR = 1.5
"""So many times the noise's limit: three standard deviations more, and a force is noticed."""


class TouchStage(StrEnum):
    """Stage of a touch: the quick one finds the part, the slow one measures it."""

    QUICK = "quick"
    SLOW = "slow"


@dataclass(frozen=True)
class ContactLoad:
    """Load on the part by one stage of a touch, from the first contact until the finger has left it.

    `peak_force_n`: the largest force in a frame of the array. `travel_mm`: how far the tip went on in
    contact, forwards only, since the last frame without any force. `work_mj`: force times travel, likewise.
    `begun_s`, `ended_s`: from that frame to the first one without force again, on the rig's clock; loads of
    two fingers at different times do not add up. Infinite where that is not known.

    Measured, without bounds. Forces are off by the array's gain, and below its noise nothing is measured; so
    a load below half of contact_force_n is not listed. Between two frames the force may have been larger by
    stiffness × speed × sample period. Servos are read less often: where the tip was meanwhile is
    interpolated, also while it brakes, and how far it went on and came back between two reads is missing.
    """

    stage: TouchStage
    peak_force_n: float
    travel_mm: float
    work_mj: float
    begun_s: float = -math.inf
    ended_s: float = math.inf


@dataclass(frozen=True, eq=False)
class LoadTrace:
    """Load on the part by a finger over time, frame by frame: what motion bounds are computed from.

    `time_s` (n,) ascending, on the rig's clock, within `time_bound_s` of when the frames were sampled;
    `force_n` (n,): what was noticed, in the frame or in the mean
    of up to 64 quiet ones around it, 0 for nothing; `unnoticed_n` (n,): what the noise may hide of
    a steady push; `zero_doubt_n` (n,): what the doubt of the zero may hide of any force beside, and
    `any_zero_doubt_n` (n,) if no way was free; `free_within_mm` (n,): the way there is free of a part that
    the grip has moved by no more than this, 0 where that was not known; `travel_mm` (n,): where the tip was
    on its way; `advance_mm` (n,): how far it can have gone forward since the frame before, or sideways;
    `touch_mm_s`: how fast at most where it might meet the part; `measured_s`: when the grip's contacts were
    measured, nan if never; `unfelt_mm`: so far the tip had come at least before anything was noticed,
    infinite if nothing was; `retreat_mm` (n,): how far it can have gone back since the frame before;
    `dragging_n` (n,): what the force that was noticed may drag the part with then, as much as all of it where
    the tip's back may hook the part, 0 where none was; `quiet` (n,): nothing was noticed in the frame by
    itself.
    """

    time_s: Floats
    time_bound_s: float
    force_n: Floats
    travel_mm: Floats
    advance_mm: Floats
    unnoticed_n: Floats
    zero_doubt_n: Floats
    any_zero_doubt_n: Floats
    free_within_mm: Floats
    touch_mm_s: float
    measured_s: float
    unfelt_mm: float
    retreat_mm: Floats
    dragging_n: Floats
    quiet: Bools

    @property
    def felt(self) -> bool:
        """Whether anything was noticed."""
        return bool(self.force_n.any())


def friction_of(tip: TipConfig) -> float:
    """Largest friction of a tip on parts that bounds on motion allow for."""
    return max(TIP_FRICTION, tip.max_friction)


def friction_factor(friction: float) -> float:
    """Arrays measure what presses, not what shears: with friction a force is larger by this at most."""
    return math.hypot(1.0, friction)


def drag_shares(ahead_rad: Floats, friction: float = TIP_FRICTION) -> Floats:
    """What a tip that goes back drags a part with, at most, as a share of what presses on it.

    `ahead_rad` (n,): how far from straight ahead that is at most. What presses from ahead only gets lighter;
    from atan(1/friction) on, 55° with 0.7, friction may drag the part by more than that. Infinite behind
    the tip.
    """
    shares = friction * np.sin(ahead_rad) - np.cos(ahead_rad)
    result: Floats = np.where(ahead_rad > math.pi / 2, math.inf, np.maximum(shares, 0.0))
    return result
