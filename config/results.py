"""What all results that are written as JSON have in common. The far end of the data's way.

The keys come out in the order declared, numbers rounded to a fixed number of decimals (bounds outward), so
that two runs with one seed can be compared byte by byte. A number that is not finite is a bug and raises.
The formats themselves: `recognition_result`, `identification_result`, `grip_result`.
"""

import json
import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

__all__ = ["DECIMALS", "BoundsOut", "ConfigurationOut", "Interval", "Out", "Rounded", "to_json"]

DECIMALS = 6
"""Decimals of every number written: nanometres, microradians, microseconds."""


def _rounded(value: float) -> float:
    return round(value, DECIMALS) + 0.0  # + 0.0 turns -0.0 into 0.0


def _rounded_outward(interval: tuple[float, float]) -> tuple[float, float]:
    """Widen to whole decimals: a bound that was rounded inward would no longer be one."""
    scale = 10**DECIMALS
    lo, hi = math.floor(interval[0] * scale), math.ceil(interval[1] * scale)
    lo -= lo / scale > interval[0]
    hi += hi / scale < interval[1]
    return lo / scale, hi / scale


Rounded = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_rounded)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
Interval = Annotated[tuple[_Finite, _Finite], AfterValidator(_rounded_outward)]


class Out(BaseModel):
    """A part of a result."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ConfigurationOut(Out):
    """Maps object coordinates as given in the objects file to the support plane: mm, mm, rad."""

    x: Rounded
    y: Rounded
    theta: Rounded


class BoundsOut(Out):
    """[lo, hi] of each coordinate; `theta` may exceed ±π rather than wrap."""

    x: Interval
    y: Interval
    theta: Interval


def to_json(result: BaseModel, *, indent: int | None = None) -> str:
    """Write `result` as one JSON object: declared key order, rounded numbers, no NaN (ValueError)."""
    return json.dumps(result.model_dump(mode="json"), indent=indent, allow_nan=False, ensure_ascii=False)
