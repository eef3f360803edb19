"""All errors in a file's data: also those behind the first wrong entry of a list, where validation ends."""

from collections.abc import Iterator
from itertools import islice
from typing import Any, get_args, get_origin

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from palpate.config.model_places import Place, child, is_tag, kind_at

__all__ = ["all_errors"]

_BEHIND = 1000
"""How many entries behind a wrong one are looked at: there may be millions."""


def all_errors(error: ValidationError, kind: Any, data: object) -> Iterator[ErrorDetails]:
    """The errors that validation of `data` as a `kind` found, then those of entries behind them."""
    found = error.errors(include_url=False)
    yield from found
    ended = {
        detail["loc"][:depth]: step
        for detail in found
        for depth, step in enumerate(detail["loc"])
        if isinstance(step, int) and get_origin(kind_at(kind, detail["loc"][:depth])) is list
    }
    for place in sorted(ended, key=len, reverse=True):  # what is nearest to the first error comes first
        yield from _errors_behind(kind, data, place, ended[place])


def _errors_behind(kind: Any, data: object, place: Place, wrong: int) -> Iterator[ErrorDetails]:
    """Errors in the list at `place`, behind its entry `wrong`."""
    (item,) = get_args(kind_at(kind, place))
    entries: Any = data
    for step in place:
        entries = entries if is_tag(step) else child(entries, step)
    checked = TypeAdapter(item)
    for index, entry in islice(enumerate(entries), wrong + 1, wrong + 1 + _BEHIND):
        try:
            checked.validate_python(entry)
        except ValidationError as error:
            for detail in all_errors(error, item, entry):
                detail["loc"] = (*place, index, *detail["loc"])
                yield detail
