"""Rounding of what decides: values that are equal but for rounding must not be put in an order by that.

Which of two cells is the larger or the nearer would otherwise depend on how sums were taken; the compiled
kernel rounds likewise.
"""

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["to_nine_digits"]


def to_nine_digits(value: Floats) -> Floats:
    """Values (n,) to nine digits, however large or small they are."""
    share, power = np.frexp(value)
    return np.ldexp(share.round(9), power)
