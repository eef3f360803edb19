"""Heights at which a state is known, or is not, in as few words as there is room for."""

import math
from collections.abc import Sequence

from palpate.base.errors import counted
from palpate.rig.catalogue.section_stack import Range

__all__ = ["known_words"]

_STEPS = 100  # in a mm, to which heights are rounded
_ROUNDING = 1e-6  # of a step: binary fractions of what is a whole number of them


def known_words(known_mm: Sequence[Range], top_mm: float, most: int) -> str:
    """Such as "known at 4.5–5.5 mm only", or "not known at 17.33–17.36 mm" where little is unknown.

    `known_mm`: ascending ranges, both ends included; `top_mm`: how high the part is. Ends are rounded to
    0.01 mm so that no more is called known than is. `most`: how many ranges are listed.
    """
    ends = [0.0, *(z for found in known_mm for z in found), top_mm]
    gaps = [(low, high) for low, high in zip(ends[::2], ends[1::2], strict=True) if low < high]
    if gaps and sum(high - low for low, high in gaps) < top_mm / 2:
        return f"not known at {_ranges([_outside(*gap) for gap in gaps], most)}"
    return f"known at {_ranges([_inside(*found) for found in known_mm], most)} only"


def _outside(low: float, high: float) -> Range:
    return math.floor(_STEPS * low + _ROUNDING) / _STEPS, math.ceil(_STEPS * high - _ROUNDING) / _STEPS


def _inside(low: float, high: float) -> Range:
    """Rounded inward; as it is where nothing would be left."""
    first = math.ceil(_STEPS * low - _ROUNDING) / _STEPS
    last = math.floor(_STEPS * high + _ROUNDING) / _STEPS
    return (first, last) if first < last else (low, high)


def _ranges(ranges_mm: Sequence[Range], most: int) -> str:
    words = [f"{low:.6g}–{high:.6g}" for low, high in ranges_mm[:most]]
    more = len(ranges_mm) - len(words)
    if not words:
        return counted(more, "range of height", "ranges of height")
    if more:
        return f"{', '.join(words)} mm and {counted(more, 'more range', 'more ranges')}"
    *before, last = words
    return f"{', '.join(before)} and {last} mm" if before else f"{last} mm"
