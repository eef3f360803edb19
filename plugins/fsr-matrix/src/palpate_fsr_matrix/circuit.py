"""Circuit of the matrix: from the converter's readings to conductances, and back.

Row i is high, all others are low, and the column has a resistor of conductance g to ground: it is at the
share G_i / (g + Σ G) of the supply. The sum s of the shares of all rows gives Σ G = g s / (1 − s), so that
G_i / g = share_i / (1 − s): exact, whatever else presses on the column. Conductance grows about linearly with
force, which resistance does not.
"""

import numpy as np

from palpate.plugins import Counts, Floats

__all__ = ["COUNTS_PER_REFERENCE", "MAX_COUNT", "conductances", "readings_of"]

_MAX_READING = 1023
COUNTS_PER_REFERENCE = 4096
"""Counts of a cell that conducts as well as the column's resistor."""
MAX_COUNT = 65535
_MAX_COLUMN_SHARE = 0.95  # beyond, a reading's last digit is worth too much


def conductances(adc: Counts) -> Counts:
    """Counts (rows, cols), linear in each cell's conductance; the largest in a column that is at its end."""
    share = adc / _MAX_READING
    column = share.sum(axis=0)
    full = column > _MAX_COLUMN_SHARE
    counts = COUNTS_PER_REFERENCE * share / np.where(full, 1.0, 1 - column)
    counts[:, full] = np.where(share[:, full] > 0, MAX_COUNT, 0)
    result: Counts = np.minimum(np.rint(counts), MAX_COUNT).astype(np.uint16)
    return result


def readings_of(conductance: Floats, noise: Floats) -> Counts:
    """Readings (rows, cols) for conductances over the resistor's, with noise of the converter added."""
    share = conductance / (1 + conductance.sum(axis=0))
    read = np.clip(np.rint(_MAX_READING * share + noise), 0, _MAX_READING)
    result: Counts = read.astype(np.uint16)
    return result
