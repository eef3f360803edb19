"""Types of values in the file formats: strict numbers, points, names, and rounded measurements.

Pydantic's own leniency ("1" for 1, true for 1.0) is switched off value by value, so that a wrong kind of
value in a file is an error with a place rather than a guess. Measured numbers are rounded when a value is
made, so that file and memory hold the same ones: seven digits (gains five), bounds and standard deviations
four, rounded up.

*Results.* Keys of published formats come out in the order declared, numbers rounded to a fixed number of
decimals (bounds outward), so that two runs with one seed can be compared byte by byte. A number that is not
finite is a bug and raises.
"""

import json
import math
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from palpate.base.errors import InputError
from palpate.base.extensions import load_extension
from palpate.base.short_repr import ShortRepr
from palpate.config.problems import excerpt, problem

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A finite number; whole numbers are taken too, texts and true/false are not."""

Length = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
"""A finite number that is not negative."""

Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
"""A finite number above zero."""

Fraction = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1)]
"""A share between 0 and 1."""

Count = Annotated[int, Field(strict=True, ge=0)]
"""A whole number that is not negative."""

Flag = Annotated[bool, Field(strict=True)]
"""true or false, nothing else."""

Text = Annotated[str, Field(strict=True, min_length=1, max_length=4096)]
"""A text that is not empty, and no longer than the path of a file may be."""


_T = TypeVar("_T")

Items = Annotated[list[_T], Field(fail_fast=True)]
"""A list, checked up to its first wrong entry: there may be millions."""


def _printable(name: str) -> str:
    if not name.isprintable():
        raise problem(f"is {excerpt(name)}; a name is made of printable characters")
    return name


Name = Annotated[
    str,
    Field(strict=True, min_length=1, max_length=100, pattern=r"^\S(.*\S)?$"),
    AfterValidator(_printable),
]
"""A name on one line of printable characters, without blanks around it."""

Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
"""mm; within a kilometre, so that squares of squares stay finite."""

Point = tuple[Coordinate, Coordinate]
"""x, y in mm; the frame is the file format's."""


def in_order(pair: tuple[float, float]) -> tuple[float, float]:
    """Pass [lo, hi] on if lo < hi; a validator."""
    if not pair[0] < pair[1]:
        raise problem(f"is [{pair[0]:g}, {pair[1]:g}]; the first value must be below the second")
    return pair


Bounded = Annotated[tuple[Number, Number], AfterValidator(in_order)]
"""[lo, hi] with lo < hi."""


def plugin(group: str, name: str, built_in: Iterable[str], *place: str) -> object:
    """Return what a plug-in registers as `name` in `group`; a validator's error at `place` if none does."""
    try:
        return load_extension(group, name, built_in)
    except InputError as error:
        raise problem(str(error), *place) from error


def check_gains(gain: list[list[float]], gain_bound: list[list[float]]) -> tuple[int, int]:
    """Rows and columns of two matrices by taxel; refuses those that differ in shape."""
    rows, cols = len(gain), len(gain[0]) if gain else 0
    for key, matrix in (("gain", gain), ("gain_bound", gain_bound)):
        if 0 in (rows, cols) or len(matrix) != rows or any(len(row) != cols for row in matrix):
            raise problem("has rows of different lengths; both matrices have a value for each taxel", key)
    return rows, cols


class FileModel(ShortRepr, BaseModel):
    """A table of a file: unknown keys are refused, values cannot be changed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def variant(cls, _data: object) -> "type[FileModel]":
        """The model that validates `data`: this one, or the subclass that a key in `data` chooses."""
        return cls


_DIGITS = 7
_BOUND_DIGITS = 4
_GAIN_DIGITS = 5
_PRECISE_DIGITS = 12
_MAX_ASYMMETRY = 1e-6  # of entries that twelve digits and another order of sums cannot explain


def _round_digits(value: float, digits: int, rounding: str) -> float:
    exact = Decimal(repr(value))
    if not exact:
        return 0.0  # also for -0.0
    return float(exact.quantize(Decimal((0, (1,), exact.adjusted() - digits + 1)), rounding))


def _near(value: float) -> float:
    return _round_digits(value, _DIGITS, ROUND_HALF_EVEN)


def _not_zero(value: float) -> float:
    if value == 0:
        raise problem("is 0; it must not be")
    return value


def _gain(value: float) -> float:
    return _round_digits(value, _GAIN_DIGITS, ROUND_HALF_EVEN)


def _up(value: float) -> float:
    return _round_digits(value, _BOUND_DIGITS, ROUND_CEILING)


def _precise(value: float) -> float:
    return _round_digits(value, _PRECISE_DIGITS, ROUND_HALF_EVEN)


def _in_utc(value: Any) -> datetime:
    if not isinstance(value, datetime) or value.utcoffset() != timedelta(0):
        raise problem(f"is {excerpt(value)}; it must be a date and time in UTC, such as 2026-05-04T12:30:00Z")
    return value.astimezone(UTC).replace(microsecond=0)


def _hash(value: str) -> str:
    if len(value) != 64 or set(value) - set("0123456789abcdef"):
        raise problem(f"is {excerpt(value)}; a SHA-256 is 64 characters of 0-9 and a-f")
    return value


Measured = Annotated[Number, AfterValidator(_near)]
"""A measured value."""

MeasuredLength = Annotated[Length, AfterValidator(_near)]
"""A measured value that is not negative."""

MeasuredPositive = Annotated[Positive, AfterValidator(_near)]
"""A measured value above zero."""

TravelPerTurn = Annotated[Number, AfterValidator(_not_zero), AfterValidator(_near)]
"""A measured travel per turn, whose sign is its direction."""

Gain = Annotated[Positive, AfterValidator(_gain)]
"""A gain of one taxel: a matrix of them is to be read by people, and five digits are plenty."""

UpLength = Annotated[Length, AfterValidator(_up)]
"""A bound or a standard deviation."""

UpPositive = Annotated[Positive, AfterValidator(_up)]
"""A bound that cannot be zero."""

ShareUp = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.999), AfterValidator(_up)]
"""A bound as a share of a value, which leaves something of it."""

Precise = Annotated[Number, AfterValidator(_precise)]
"""An entry of a covariance: with fewer digits it might lose its meaning."""

Matrix = Items[Items[Precise]]
"""Rows of a matrix."""

UtcTime = Annotated[datetime, BeforeValidator(_in_utc)]
"""A point in time, to the second."""

Hash = Annotated[
    str, Field(strict=True, json_schema_extra={"pattern": "^[0-9a-f]{64}$"}), AfterValidator(_hash)
]
"""A SHA-256 in hexadecimal."""


def covariance_of(unknowns: int) -> AfterValidator:
    """Validate a `Matrix`: refuse what cannot be the covariance of so many unknowns."""

    def checked(rows: list[list[float]]) -> list[list[float]]:
        if [len(row) for row in rows] != [unknowns] * unknowns:
            raise problem(f"must have {unknowns} rows of {unknowns} values")
        matrix = np.array(rows)
        limit = _MAX_ASYMMETRY * np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
        if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > limit).any():
            raise problem("is not one: it must be symmetric, with a diagonal from 0")
        return rows

    return AfterValidator(checked)


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

    def to_json(self) -> str:
        """The result as one JSON object, as commands print it."""
        return to_json(self)

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
    return json.dumps(
        result.model_dump(mode="json", by_alias=True), indent=indent, allow_nan=False, ensure_ascii=False
    )
