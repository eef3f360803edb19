"""Short `repr`: a value of any size in one line, for notebooks and messages."""

from collections.abc import Iterable, Iterator, Sized
from enum import Enum

_MAX_CHARACTERS, _MAX_PART_CHARACTERS = 200, 60
_HEADERS = ("format", "units")


class ShortRepr:
    """Gives a dataclass (with `repr=False`) or a pydantic model a `repr` of one line, at most 200 characters.

    It shows what is short, and how many there are of what is not: `<TouchEvent grip=2, 3 touches>`.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        names: Iterable[str] = getattr(self, "__dataclass_fields__", None) or vars(self)
        parts = ", ".join(part for name in names for part in _parts(name, getattr(self, name)))
        text = f"{type(self).__name__} {parts}".rstrip()
        return f"<{text if len(text) <= _MAX_CHARACTERS - 2 else text[: _MAX_CHARACTERS - 3] + '…'}>"

    def __str__(self) -> str:
        return repr(self)


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
