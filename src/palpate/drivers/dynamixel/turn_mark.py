"""Turn mark: a note in a servo's RAM of which turn its count is in, lost whenever the count of turns is lost.

A servo that has been without power reports its angle within one turn, and forgets its RAM at the same moment.
So a mark that is still there says that the turns have been counted on since it was written. It stands in the
last two indirect addresses, which nothing else uses. Sans-IO: where it is, and what its value means.
"""

from palpate.drivers.dynamixel.control_table import Item
from palpate.drivers.dynamixel.models import Model

__all__ = ["LARGEST_TURNS", "NO_MARK", "mark_item", "mark_value", "turns_in"]

LARGEST_TURNS = 80
"""A mark holds so many turns, either way."""

_LEAST = 64  # an indirect address may be 64 to 227 on every model with current
_KEY = 97  # no default of these addresses: those are where Indirect Data lies
_MIDDLE = 145
_USED = 14  # by the state block
_WORD = 16

NO_MARK = _LEAST | _LEAST << _WORD
"""Value of a mark that says nothing."""


def mark_item(model: Model) -> Item | None:
    """Where a model has its mark; None if it has no two indirect addresses to spare."""
    place = model.indirect
    if place is None or place.count < _USED + 2:
        return None
    first = place.count - 1
    return Item(
        f"Indirect Address {first} and {place.count}", place.address + 2 * (first - 1), 4, signed=False
    )


def mark_value(turns: int) -> int:
    """Value of the mark for a count that is `turns` ahead. ValueError above LARGEST_TURNS."""
    if abs(turns) > LARGEST_TURNS:
        raise ValueError(f"a mark holds {LARGEST_TURNS} turns either way, not {turns}")
    return _KEY | (_MIDDLE + turns) << _WORD


def turns_in(value: int) -> int | None:
    """How many turns the count is ahead; None if the value is no mark."""
    key, turns = value & 0xFFFF, (value >> _WORD) - _MIDDLE
    return turns if key == _KEY and abs(turns) <= LARGEST_TURNS else None
