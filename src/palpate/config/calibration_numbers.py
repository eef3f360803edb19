"""Numbers of a calibration file: rounded when a value is made, so that file and memory hold the same ones.

What was measured keeps seven digits (gains five), bounds and standard deviations four, which are rounded up:
a bound that was rounded inward would no longer be one. Rounding a rounded number changes nothing.
"""

from datetime import UTC, datetime, timedelta
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from palpate.config.fields import Items, Length, Number, Positive
from palpate.config.problems import problem, shown

__all__ = [
    "Gain",
    "Hash",
    "Matrix",
    "Measured",
    "MeasuredLength",
    "MeasuredPositive",
    "Precise",
    "ShareUp",
    "Travel",
    "UpLength",
    "UpPositive",
    "UtcTime",
    "covariance_of",
]

_DIGITS = 7
_BOUND_DIGITS = 4
_GAIN_DIGITS = 5
_PRECISE_DIGITS = 12
_ASYMMETRY = 1e-6  # of entries that twelve digits and another order of sums cannot explain


def _rounded(value: float, digits: int, rounding: str) -> float:
    exact = Decimal(repr(value))
    if not exact:
        return 0.0  # also for -0.0
    return float(exact.quantize(Decimal((0, (1,), exact.adjusted() - digits + 1)), rounding))


def _near(value: float) -> float:
    return _rounded(value, _DIGITS, ROUND_HALF_EVEN)


def _not_zero(value: float) -> float:
    if value == 0:
        raise problem("is 0; it must not be")
    return value


def _gain(value: float) -> float:
    return _rounded(value, _GAIN_DIGITS, ROUND_HALF_EVEN)


def _up(value: float) -> float:
    return _rounded(value, _BOUND_DIGITS, ROUND_CEILING)


def _precise(value: float) -> float:
    return _rounded(value, _PRECISE_DIGITS, ROUND_HALF_EVEN)


def _in_utc(value: Any) -> datetime:
    if not isinstance(value, datetime) or value.utcoffset() != timedelta(0):
        raise problem(f"is {shown(value)}; it must be a date and time in UTC, such as 2026-05-04T12:30:00Z")
    return value.astimezone(UTC).replace(microsecond=0)


def _hash(value: str) -> str:
    if len(value) != 64 or set(value) - set("0123456789abcdef"):
        raise problem(f"is {shown(value)}; a SHA-256 is 64 characters of 0-9 and a-f")
    return value


Measured = Annotated[Number, AfterValidator(_near)]
"""A measured value."""

MeasuredLength = Annotated[Length, AfterValidator(_near)]
"""A measured value that is not negative."""

MeasuredPositive = Annotated[Positive, AfterValidator(_near)]
"""A measured value above zero."""

Travel = Annotated[Number, AfterValidator(_not_zero), AfterValidator(_near)]
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
    """Of a `Matrix`: refuse what cannot be the covariance of so many unknowns."""

    def checked(rows: list[list[float]]) -> list[list[float]]:
        if [len(row) for row in rows] != [unknowns] * unknowns:
            raise problem(f"must have {unknowns} rows of {unknowns} values")
        matrix = np.array(rows)
        limit = _ASYMMETRY * np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
        if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > limit).any():
            raise problem("is not one: it must be symmetric, with a diagonal from 0")
        return rows

    return AfterValidator(checked)
