"""Edits of an objects file as a whole: objects removed, renamed, or taken over from several files.

From text to text, so that everything else in the file stays as it is.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from palpate.base.errors import InputError
from palpate.config.objects_tables import ObjectsFileText, ObjectText, RefusedText, SourceText
from palpate.config.problems import nearest

__all__ = ["merge_objects", "remove_objects", "rename_object"]

_SHOWN = 12


def remove_objects(text: ObjectsFileText, names: Sequence[str], file: str) -> ObjectsFileText:
    """Leave out objects. Raises InputError for a name that no object has, and if no object would be left."""
    for name in names:
        _check_there(text, name, file)
    left = [item for item in text.objects if item.name not in names]
    if not left:
        raise InputError(f"{file} would hold no object any more; delete the file instead")
    return text.model_copy(update={"objects": left})


def rename_object(text: ObjectsFileText, old: str, new: str, file: str) -> ObjectsFileText:
    """Give an object another name. Raises InputError for a name that none has, or that another one has."""
    _check_there(text, old, file)
    if new != old and any(item.name == new for item in text.objects):
        raise InputError(f'{file}: another object is named "{new}" already')
    objects = [item.model_copy(update={"name": new}) if item.name == old else item for item in text.objects]
    return text.model_copy(update={"objects": objects})


def merge_objects(texts: Sequence[tuple[Path, ObjectsFileText]], target: Path) -> ObjectsFileText:
    """All objects of several files, for a file at `target`.

    CAD files that they came from are named as seen from there. The same object twice is taken once. Raises
    InputError if two files have different objects of one name.
    """
    objects: dict[str, ObjectText] = {}
    owner: dict[str, Path] = {}
    refused: list[RefusedText] = []
    for path, text in texts:
        for item in text.objects:
            moved = item
            if item.source is not None:
                moved = item.model_copy(update={"source": _seen_from(item.source, path, target)})
            there = objects.setdefault(item.name, moved)
            if there != moved:
                raise InputError(
                    f'{path} and {owner[item.name]} have different objects named "{item.name}"; rename one'
                )
            owner.setdefault(item.name, path)
        for entry in text.refused or []:
            seen = entry.model_copy(update={"source": _seen_from(entry.source, path, target)})
            refused += [] if seen in refused else [seen]
    made = texts[0][1].model_copy(update={"objects": list(objects.values())})
    return made.model_copy(update={"refused": refused}) if refused else made


def _seen_from(source: SourceText, path: Path, target: Path) -> SourceText:
    """A source as an objects file in another folder has it."""
    file = os.path.relpath(path.parent / source.file, target.parent)
    return source.model_copy(update={"file": Path(file).as_posix()})


def _check_there(text: ObjectsFileText, name: str, file: str) -> None:
    names = [item.name for item in text.objects]
    if name in names:
        return
    near = nearest(name, names)
    hint = f"it has {', '.join(names[:_SHOWN])}{', …' if len(names) > _SHOWN else ''}"
    hint = hint if near is None else f'did you mean "{near}"?'
    raise InputError(f'{file}: has no object "{name}"; {hint}')
