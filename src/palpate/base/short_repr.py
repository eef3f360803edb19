"""Short `repr`: a value of any size in one line, for notebooks and messages."""

import math
from collections.abc import Iterable, Iterator, Sequence, Sized
from enum import Enum

_MAX_CHARACTERS, _MAX_PART_CHARACTERS = 200, 60
_HEADERS = ("format", "units")


class ShortRepr:
    """Gives a dataclass (with `repr=False`) or a pydantic model a `repr` of one line, at most 200 characters.

    It shows what is short, and how many there are of what is not: `<TouchEvent grip=2, 3 touches>`; or what
    the class says in `_facts`.
    """

    __slots__ = ()

    def _facts(self) -> Iterable[str]:
        """Parts of the line, in order."""
        return self._short_fields()

    def _short_fields(self) -> Iterator[str]:
        names: Iterable[str] = getattr(self, "__dataclass_fields__", None) or vars(self)
        return (part for name in names for part in _parts(name, getattr(self, name, None)))

    def __repr__(self) -> str:
        try:
            parts = ", ".join(self._facts())
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):  # fields of other kinds
            parts = ", ".join(self._short_fields())
        text = f"{type(self).__name__} {parts}".rstrip()
        return f"<{text if len(text) <= _MAX_CHARACTERS - 2 else text[: _MAX_CHARACTERS - 3] + '…'}>"

    def __str__(self) -> str:
        return repr(self)


def show_point(point_mm: Sequence[float]) -> str:
    """A place in mm, with two decimals."""
    return f"({', '.join(f'{value:.2f}' for value in point_mm)})"


def show_within(value: float, interval: tuple[float, float], unit: str) -> str:
    """A value with two decimals, and the half-width, rounded up, that holds for it as shown."""
    shown = round(value, 2)
    half = math.ceil(max(interval[1] - shown, shown - interval[0]) * 100 - 1e-6) / 100
    return f"{shown:.2f}±{half:.2f}{unit}"


def _parts(name: str, value: object) -> Iterator[str]:
    if value is None or callable(value) or name in _HEADERS or name.startswith("_"):
        return
    if isinstance(value, bool | int | float | str | Enum | ShortRepr):
        number = f"{value:.6g}" if isinstance(value, float) else repr(value)
        text = value.name.lower() if isinstance(value, Enum) else number
        if len(text) <= _MAX_PART_CHARACTERS:
            yield f"{name}={text}"
    elif isinstance(value, Sized):
        size = getattr(value, "shape", (len(value),))
        yield f"{'x'.join(map(str, size))} {name}"
