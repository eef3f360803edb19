"""Numbers for people: a typographic minus sign, and bounds rounded outward."""

import math

_SLACK = 1e-9
"""Part of a step of the last decimal that binary fractions of a whole number of steps are off by, at most."""


def minus_signs(words: str) -> str:
    """Words with a minus sign for each hyphen."""
    return words.replace("-", "−")


def decimal(value: float, decimals: int = 2) -> str:
    """A number with so many decimals; a zero has no sign."""
    return minus_signs(f"{round(value, decimals) + 0.0:.{decimals}f}")


def signed(value: float, form: str) -> str:
    """A number with its sign; a zero has none."""
    words = f"{value:+{form}}"
    return minus_signs(words) if float(words) else words[1:]


def ceil_to(value: float, decimals: int = 2) -> float:
    """The next number up with so many decimals."""
    scale = 10.0**decimals
    return math.ceil(value * scale - _SLACK) / scale


def floor_to(value: float, decimals: int = 2) -> float:
    """The next number down with so many decimals."""
    scale = 10.0**decimals
    return math.floor(value * scale + _SLACK) / scale


def at_most(bound: float, decimals: int = 2) -> str:
    """An upper bound with so many decimals, rounded up."""
    return decimal(ceil_to(bound, decimals), decimals)


def at_least(bound: float, decimals: int = 2) -> str:
    """A lower bound with so many decimals, rounded down."""
    return decimal(floor_to(bound, decimals), decimals)
