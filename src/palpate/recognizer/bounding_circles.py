"""Bounding circles: round features of an outline, and round blocks of features that follow each other.

What is far from a circle is far from all that it goes round: the compiled kernel passes over whole blocks.
"""

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.tables import expand_ranges

__all__ = ["BLOCK_ROWS", "ROUNDING_MM", "blocks", "circles_round"]

BLOCK_ROWS = 16
"""Features in a block; the last one of a state may have fewer."""

ROUNDING_MM = 1e-7
"""Circles are larger by so much."""


def circles_round(start: Floats, end: Floats) -> Floats:
    """Circles (n, 3) round segments (n, 2): middle x, y, radius mm."""
    return np.column_stack([(start + end) / 2, np.hypot(*(end - start).T) / 2 + ROUNDING_MM])


def blocks(circles: Floats, first: Ints) -> tuple[Ints, Floats]:
    """Circles (b, 3) round blocks of circles (n, 3), and where the blocks of each state begin (S + 1,).

    `first` (S + 1,): where the circles of each state begin. A circle's middle is that of its box.
    """
    count = -(-np.diff(first) // BLOCK_ROWS)
    begins = np.cumsum(np.append(0, count))
    state, nth = expand_ranges(np.zeros_like(count), count)
    rows = first[state] + BLOCK_ROWS * nth
    if not len(rows):
        return begins, np.empty((0, 3))
    place, radius = circles[:, :2], circles[:, 2:]
    lo = np.minimum.reduceat(place - radius, rows)
    middle = (lo + np.maximum.reduceat(place + radius, rows)) / 2
    own = np.repeat(np.arange(len(rows)), np.diff(np.append(rows, len(circles))))
    reach = np.maximum.reduceat(np.hypot(*(place - middle[own]).T) + circles[:, 2], rows)
    return begins, np.column_stack([middle, reach + ROUNDING_MM])
