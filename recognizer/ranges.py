"""Ranges of indices unrolled into flat arrays: several stages look at a run of neighbours for each row."""

import numpy as np

from palpate.geometry import Ints

__all__ = ["expand_ranges"]


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
