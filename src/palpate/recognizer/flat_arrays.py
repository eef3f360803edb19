"""Flat arrays by name, as they are kept: looked up with the type and shape that they must have."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Bools, Floats, Ints

__all__ = ["Arrays", "NamedArrays", "begins", "begins_of", "joined_begins"]

Arrays = NDArray[Any]
"""An array of floats, ints or bools."""


@dataclass(frozen=True, eq=False)
class NamedArrays:
    """Arrays whose names begin with a `prefix`. What is not there, or not of its kind, raises ValueError."""

    arrays: Mapping[str, Arrays]
    prefix: str = ""

    def __contains__(self, name: str) -> bool:
        return self.prefix + name in self.arrays

    def floats(self, name: str, shape: tuple[int, ...]) -> Floats:
        """Array of float64."""
        return self._checked(name, np.float64, shape)

    def ints(self, name: str, shape: tuple[int, ...]) -> Ints:
        """Array of int64."""
        return self._checked(name, np.int64, shape)

    def bools(self, name: str, shape: tuple[int, ...]) -> Bools:
        """Array of bool."""
        return self._checked(name, np.bool_, shape)

    def _checked(self, name: str, kind: type[np.generic], shape: tuple[int, ...]) -> Arrays:
        found = self.arrays.get(self.prefix + name)
        if found is None or found.dtype != kind or found.shape != shape:
            raise ValueError(f"{self.prefix}{name} is not {kind.__name__} of shape {shape}")
        return found


def begins(arrays: NamedArrays, name: str, count: int) -> Ints:
    """Where the rows of each of so many states begin, and the last one's end: (count + 1,)."""
    first = arrays.ints(name, (count + 1,))
    if first[0] != 0 or bool(np.any(np.diff(first) < 0)):
        raise ValueError(f"{name} does not ascend from 0")
    return first


def begins_of(count: Sequence[int] | Ints) -> Ints:
    """The same from the number of rows of each (S,)."""
    return np.concatenate([[0], np.cumsum(np.asarray(count, np.int64))]).astype(np.int64)


def joined_begins(parts: Sequence[Ints]) -> Ints:
    """The same of parts that are put one after the other."""
    return begins_of(np.concatenate([np.diff(part) for part in parts]))
