"""Fingertips whose maker publishes places and normals of their taxels, as matrices on an upright tip.

A tip's list is in the order in which a board sends its taxels, as ORCA's `orca_core` 0.12.0 has it: x across
the tip, y along it towards its round end, z outward. Its taxels stand in 5 lines of 9 across the tip, and 6
at its round end, which are left out.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal, get_args

import numpy as np

from palpate.plugins import Counts, Floats
from palpate_paxini.codec import Forces

__all__ = [
    "COLUMNS",
    "FINGERTIPS",
    "READING_BITS",
    "READING_PER_STEP",
    "ROWS",
    "Fingertip",
    "FingertipName",
    "fingertip",
]

FingertipName = Literal["PXSR-CMDDP18A", "PXSR-CMDDP18C"]
FINGERTIPS: tuple[FingertipName, ...] = get_args(FingertipName)

_LINES = np.array(
    [
        [0, 1, 7, 14, 22, 30, 37, 42, 43],
        [2, 3, 8, 15, 23, 34, 38, 44, 45],
        [4, 5, 9, 16, 24, 31, 39, 46, 47],
        [6, 10, 11, 18, 25, 32, 40, 49, 48],
        [12, 13, 17, 21, 26, 29, 36, 41, 50],
    ]
)
_AXIS_MM: dict[FingertipName, float] = {"PXSR-CMDDP18A": -0.9, "PXSR-CMDDP18C": 1.0}
"""z of the axis about which the walls of a tip are roundest."""

ROWS, COLUMNS = _LINES.shape


READING_PER_STEP = 2
"""Steps of 0.1 N are sent on as two each: four standard deviations of the least noise that is reckoned with,
0.3, are then just more than the half step by which a taxel's force is rounded."""
FULL_STEPS = 255
READING_BITS = 9
MAX_READING = (1 << READING_BITS) - 1


@dataclass(frozen=True, eq=False)
class Fingertip:
    """One kind of fingertip as it is mounted.

    `taxels`: how many it has; `matrix` (rows, columns): which of them are on the tip's side, row by row from
    its lower end. `place_mm`, `normal` (rows, columns, 3): in the tip frame.
    """

    taxels: int
    matrix: Forces
    place_mm: Floats
    normal: Floats

    def pressed(self, forces: Forces) -> Counts:
        """Readings (rows, columns) of forces (taxels, 3): what presses along the normals, in half steps."""
        steps = forces[self.matrix, 2]
        return np.where(steps >= FULL_STEPS, MAX_READING, READING_PER_STEP * steps).astype(np.uint16)


@cache
def fingertip(name: FingertipName, *, upside_down: bool) -> Fingertip:
    """A kind of fingertip, its round end up, or down."""
    text = files(__package__).joinpath(f"{name}.csv").read_text(encoding="ascii")
    listed = np.array([row.split(",") for row in text.split()[1:]], dtype=np.float64)
    matrix = _LINES[::-1, ::-1] if upside_down else _LINES
    turn = -1 if upside_down else 1
    # The tip frame has x outward, z up.
    place, normal = listed[matrix][..., [2, 0, 1]], listed[matrix][..., [5, 3, 4]]
    place[..., 0] -= _AXIS_MM[name]
    place[..., 1:] *= turn
    normal[..., 1:] *= turn
    place[..., 2] -= place[..., 2].min()
    return Fingertip(len(listed), matrix, place, normal / np.linalg.norm(normal, axis=2, keepdims=True))
