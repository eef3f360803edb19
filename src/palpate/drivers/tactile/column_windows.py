"""Windows of neighbouring columns: what a light contact touches, wherever it is between columns."""

import numpy as np

from palpate.base.geometry import Bools, Floats

__all__ = ["WINDOW_COLUMNS", "column_windows", "windows_within"]

WINDOW_COLUMNS = 3
"""A light contact's share of a cylinder."""


def column_windows(weights: Floats) -> Floats:
    """Matrix (rows · cols, windows) that takes counts (row by row) to their sums in each few columns.

    `weights` (rows, cols): of each taxel, 0 for one that is left out.
    """
    rows, cols = weights.shape
    width = min(WINDOW_COLUMNS, cols)
    matrix = np.zeros((rows, cols, cols - width + 1))
    for window in range(matrix.shape[2]):
        matrix[:, window : window + width, window] = weights[:, window : window + width]
    return matrix.reshape(rows * cols, -1)


def windows_within(columns: Bools) -> tuple[Bools, Bools]:
    """Windows (windows,) of which all columns are among some (cols,), and the columns (cols,) of these."""
    width = min(WINDOW_COLUMNS, len(columns))
    windows = np.asarray(np.lib.stride_tricks.sliding_window_view(columns, width).all(axis=1))
    return windows, np.convolve(windows, np.ones(width)) > 0
