"""Which profile a goal gets: the e-Manual's "What is the Profile", as velocity and acceleration.

Between the items Profile Velocity and Profile Acceleration and the trajectory in `servo_motion`.
"""

import math
from enum import IntEnum

__all__ = ["ProfileType", "profile_shape", "timed_profile"]


class ProfileType(IntEnum):
    """Profile Type, bits 4 and 5 of Moving Status."""

    NONE = 0
    RECTANGULAR = 1
    TRIANGULAR = 2
    TRAPEZOIDAL = 3


def profile_shape(velocity: float, acceleration: float, distance: float) -> ProfileType:
    """Shape of a profile over `distance` from standstill; 0 velocity means none, 0 acceleration infinite.

    All three in units that belong together (rad/s, rad/s², rad).
    """
    if velocity == 0.0:
        return ProfileType.NONE
    if acceleration == 0.0:
        return ProfileType.RECTANGULAR
    return (
        ProfileType.TRIANGULAR if distance * acceleration < velocity * velocity else ProfileType.TRAPEZOIDAL
    )


def timed_profile(span_s: float, rise_s: float, distance: float) -> tuple[float, float]:
    """Velocity and acceleration that cover `distance` in `span_s`, speeding up for `rise_s`.

    The rise is at most half the span. (0, 0), a step, for a span of 0; acceleration 0 is an infinite one.
    A profile that begins in motion takes longer or shorter: the manual reckons from standstill.
    """
    if span_s <= 0.0 or distance <= 0.0:
        return 0.0, 0.0
    rise_s = min(rise_s, span_s / 2)
    velocity = distance / (span_s - rise_s)
    if rise_s <= 0.0:
        return velocity, 0.0
    # a trace above what is exact, so that rounding does not turn half the span into a triangle cut short
    return velocity, math.nextafter(velocity / rise_s, math.inf)
