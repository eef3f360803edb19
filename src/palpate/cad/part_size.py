"""Sizes and units of parts: a wrong unit makes a part 25.4 or 1000 times too large or too small."""

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["GIVE_NO_UNITS", "MAX_SIZE_MM", "MIN_SIZE_MM", "UNIT_MM", "size_problem"]


MIN_SIZE_MM = 1.0
MAX_SIZE_MM = 1000.0

UNIT_MM = {"mm": 1.0, "inch": 25.4, "m": 1000.0, "pt": 25.4 / 72}
"""Units that can be asked for, in mm; points (pt) are those of programs that draw for print."""


GIVE_NO_UNITS = "give no units"
"""Ends the message where units were asked for and the file states others itself."""


def size_problem(size_mm: Floats, units: str | None) -> str | None:
    """Say what is wrong with a part whose bounding box has sides `size_mm` (2,) or (3,), if anything.

    `units`: the unit that its file's numbers were taken to be in; others that would make it fit are named.
    None, or a unit that is not in `UNIT_MM`: none is named.
    """
    largest = float(np.max(size_mm))
    if MIN_SIZE_MM <= largest <= MAX_SIZE_MM:
        return None
    problem = (
        f"its largest side is {largest:.6g} mm; it must be from {MIN_SIZE_MM:g} mm to {MAX_SIZE_MM:g} mm"
    )
    if units in UNIT_MM:
        other = {unit: largest / UNIT_MM[units] * factor for unit, factor in UNIT_MM.items()}
        fitting = [
            f"{side:.6g} mm if its unit were {unit}"
            for unit, side in other.items()
            if unit != "pt"
            if MIN_SIZE_MM <= side <= MAX_SIZE_MM
        ]
        if fitting:
            problem += f" (it would be {', or '.join(fitting)})"
    return problem
