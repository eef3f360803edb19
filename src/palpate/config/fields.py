"""Kinds of values that the file formats are made of: strict numbers, points, names.

Pydantic's own leniency ("1" for 1, true for 1.0) is switched off value by value here, so that a wrong
kind of value in a file is an error with a place rather than a guess.
"""

from collections.abc import Iterable
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from palpate.base.errors import InputError
from palpate.base.extensions import load
from palpate.base.vocabulary.short_repr import ShortRepr
from palpate.config.problems import problem, shown

__all__ = [
    "Bounded",
    "Count",
    "FileModel",
    "Flag",
    "Fraction",
    "Items",
    "Length",
    "Name",
    "Number",
    "Point",
    "Positive",
    "Text",
    "in_order",
    "plugin",
]

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
        raise problem(f"is {shown(name)}; a name is made of printable characters")
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
    """What a plug-in registers as `name` in `group`; a validator's error at `place` if none does."""
    try:
        return load(group, name, built_in)
    except InputError as error:
        raise problem(str(error), *place) from error


class FileModel(ShortRepr, BaseModel):
    """A table of a file: unknown keys are refused, values cannot be changed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def variant(cls, _data: object) -> "type[FileModel]":
        """The model that validates `data`: this one, or the subclass that a key in `data` chooses."""
        return cls
