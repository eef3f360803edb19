"""Base of results as JSON: from computed values to keys, numbers and order of the published formats.

The keys come out in the order declared, numbers rounded to a fixed number of decimals (bounds outward), so
that two runs with one seed can be compared byte by byte. A number that is not finite is a bug and raises.
"""

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from palpate.base.short_repr import ShortRepr

DECIMALS = 6
"""Decimals of every number written: nanometres, microradians, microseconds."""


def _round(value: float) -> float:
    return round(value, DECIMALS) + 0.0  # + 0.0 turns -0.0 into 0.0


def _round_outward(interval: tuple[float, float]) -> tuple[float, float]:
    """Widen to whole decimals: a bound that was rounded inward would no longer be one."""
    scale = 10**DECIMALS
    lo, hi = math.floor(interval[0] * scale), math.ceil(interval[1] * scale)
    lo -= lo / scale > interval[0]
    hi += hi / scale < interval[1]
    return lo / scale, hi / scale


Rounded = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_round)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
Interval = Annotated[tuple[_Finite, _Finite], AfterValidator(_round_outward)]


_UNITS = ("", "_mm", "_rad")


class Out(ShortRepr, BaseModel):
    """A part of a result, given by its fields, or by a value: then each is the attribute of the same name.

    In a value the name may end in its unit, which a result's header says.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def of(cls, value: object, **fields: object) -> Self:
        """Map a value; `fields` go before its attributes."""
        return cls.model_validate(_attributes(cls, value) | fields)

    @model_validator(mode="before")
    @classmethod
    def _from_value(cls, value: Any) -> Any:
        return value if isinstance(value, Mapping | Out) else _attributes(cls, value)


def _attributes(model: type[BaseModel], value: object) -> dict[str, Any]:
    names = [(name, name + unit) for name in model.model_fields for unit in _UNITS]
    return {name: getattr(value, own) for name, own in names if hasattr(value, own)}


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


class UnfinishedOut(Out):
    """Work that the budget, in units, did not suffice for. What is said holds, with wider bounds.

    `unpaired`: fingers of those touches that interpretations pair with no edge; configurations satisfy them.
    `coarse`: cells of orientations were wider than they would be with a larger budget.
    """

    budget: int
    unpaired: tuple[str, ...]
    coarse: bool


def to_json(result: BaseModel, *, indent: int | None = None) -> str:
    """Write `result` as one JSON object: declared key order, rounded numbers, no NaN (ValueError)."""
    return json.dumps(result.model_dump(mode="json"), indent=indent, allow_nan=False, ensure_ascii=False)
