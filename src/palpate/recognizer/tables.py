"""Tables of parallel arrays, and runs of their rows: data exchanged by array-based stages of the search."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Table:
    """Base of dataclasses whose fields are arrays, or tables, with one row for each of n items."""

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        """Names of the fields: `dataclasses.fields` would show in the time of small queries."""
        return cls.__match_args__

    def __len__(self) -> int:
        return len(getattr(self, self._names()[0]))

    def select(self, rows: Ints | Bools | slice | Sequence[int]) -> Self:
        """Rows of the table (indices, in that order, a mask or a slice)."""
        return type(self)(*[_rows(getattr(self, name), rows) for name in self._names()])

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The rows of all parts, one part after the other."""
        if len(parts) == 1:
            return parts[0]
        return cls(*[_concatenate([getattr(part, name) for part in parts]) for name in cls._names()])


def _rows(value: Any, rows: Any) -> Any:
    return value.select(rows) if isinstance(value, Table) else value[rows]


def _concatenate(values: list[Any]) -> Any:
    return type(values[0]).join(values) if isinstance(values[0], Table) else np.concatenate(values)


def expand_ranges(first: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Unroll n half-open ranges [first, first + count) into one flat array.

    Returns (owner, index), each of shape (sum(count),): `index` runs through every range in turn and
    `owner` says which range it came from.
    """
    owner = np.repeat(np.arange(len(count)), count)
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    index = np.arange(total) + np.repeat(first - (ends - count), count)
    return owner, index


def split_evenly(count: int, parts: int) -> list[Ints]:
    """Numbers from 0 to `count` - 1 in so many stretches, nearly equally long: bounds temporary arrays."""
    return np.array_split(np.arange(count), parts)


def round_to_nine_digits(value: Floats) -> Floats:
    """Values (n,) to nine digits, however large or small they are."""
    share, power = np.frexp(value)
    return np.ldexp(share.round(9), power)
