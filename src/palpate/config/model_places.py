"""Walks along models: what may stand at a place of a file, by the model that it is checked with."""

from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag

__all__ = ["TAG", "Place", "child", "is_tag", "keys_at", "kind_at", "tags_at"]

Place = tuple[str | int, ...]
"""Keys and indices (from 0) from the top of a file to a value; in errors also tags, see `TAG`."""

TAG = "type="
"""What the tags of models that are distinguished by a key `type` begin with; they are no part of a place."""


def child(value: object, step: str | int) -> object:
    """What is below a key, or at an index, of a value from a file; None if there is nothing."""
    if isinstance(step, str):
        return value.get(step) if isinstance(value, dict) else None
    return value[step] if isinstance(value, list | tuple) and step < len(value) else None


def keys_at(model: type[BaseModel], place: Place, data: object) -> list[str]:
    """Keys that the table at `place` of `data` may have."""
    kind = kind_at(model, place)
    for step in place:
        data = data if is_tag(step) else child(data, step)
    if hasattr(kind, "variant"):
        kind = kind.variant(data)
    return list(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else []


def tags_at(model: type[BaseModel], place: Place) -> list[str]:
    """Values that the key `type` of the table at `place` may have."""
    options = _tagged(kind_at(model, place))
    return [tag.removeprefix(TAG) for tag in options]


def kind_at(model: type[BaseModel], place: Place) -> Any:
    """The type of what is at `place`, which has a step for every tag."""
    kind: Any = model
    for step in place:
        kind = _inner(kind)
        options = _tagged(kind)
        if options:
            kind = options.get(str(step))
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            field = kind.model_fields.get(str(step))
            kind = field.annotation if field else None
        else:
            arguments = [argument for argument in get_args(kind) if argument is not Ellipsis]
            kind = arguments[-1] if arguments else None
    return _inner(kind)


def _tagged(kind: Any) -> dict[str, Any]:
    """Models of a tagged union, by tag; empty for anything else."""
    if get_origin(kind) not in {Union, UnionType}:
        return {}
    found = {}
    for part in get_args(kind):
        tags = [item.tag for item in get_args(part)[1:] if isinstance(item, Tag)]
        found.update(dict.fromkeys(tags, part))
    return found


def is_tag(step: str | int) -> bool:
    """Whether a step of an error's place is a tag."""
    return isinstance(step, str) and step.startswith(TAG)


def _inner(kind: Any) -> Any:
    """`kind` without Annotated and without the None of an optional value."""
    while True:
        if get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        elif get_origin(kind) in {Union, UnionType} and not _tagged(kind):
            kind = next(part for part in get_args(kind) if part is not type(None))
        else:
            return kind
