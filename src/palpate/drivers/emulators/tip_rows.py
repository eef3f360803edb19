"""Rows of an emulated tip's taxels that face a section of a part: those bear what presses there."""

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["rows_facing"]


def rows_facing(row_mm: Floats, z_mm: Floats) -> Floats:
    """Share (m, rows) of each of m rays' force that rows at some heights (rows,) bear.

    `z_mm` (m, 2): from which height to which what a ray meets stands. The rows in between bear it evenly; if
    there are none, the nearest one does.
    """
    facing = (z_mm[:, :1] <= row_mm) & (row_mm <= z_mm[:, 1:])
    nearest = np.argmin(np.abs(row_mm - z_mm.mean(axis=1)[:, None]), axis=1)
    none = ~facing.any(axis=1)
    facing[none, nearest[none]] = True
    result: Floats = facing / facing.sum(axis=1, keepdims=True)
    return result
