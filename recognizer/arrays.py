"""The array types that the recogniser passes about, and the few index tricks that several stages share."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bools", "Floats", "Ints", "expand_ranges", "wrap_angle"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def expand_ranges(first: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Unroll n half-open ranges [first, first + count) into one flat array.

    Returns (owner, index), each of shape (sum(count),): `index` runs through every range in turn and
    `owner` says which range it came from.
    """
    owner = np.repeat(np.arange(len(count)), count)
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    index = np.arange(total) + np.repeat(first - (ends - count), count)
    return owner, index


def wrap_angle(angle: Floats) -> Floats:
    """The same angles (rad, any shape) in [−π, π)."""
    wrapped: Floats = (angle + np.pi) % (2 * np.pi) - np.pi
    return wrapped
