"""The objects file that a command writes: limits on options, previous contents, and writing."""

import math
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from palpate.base.errors import InputError
from palpate.base.file_io import write_text
from palpate.config.loading import check_readable
from palpate.config.objects_file import load_objects, load_objects_text, objects_from_text
from palpate.config.objects_tables import ObjectsFileText, objects_json
from palpate.jobs.files import load_rig
from palpate.rig.catalogue.cad_import import ImportOptions
from palpate.rig.catalogue.import_states import Height

_MIN_TOLERANCE_MM, _MAX_TOLERANCE_MM = 0.001, 5.0
_MAX_THICKNESS_MM = 1000.0
_MAX_WRITING_TIME_SHARE = 0.05  # of the time of an import, for what is kept in case that it does not end


def parse_heights(text: str) -> tuple[Height, ...]:
    """The heights of "5,12", and from which to which of "5-15", ascending. Raises InputError."""
    found = []
    for part in text.split(","):
        ends = part.split("-")
        try:
            low, high = float(ends[0]), float(ends[-1])
        except ValueError:
            low = high = math.nan
        if len(ends) > 2 or not 0 <= low <= high < math.inf:
            raise InputError(
                f'--heights "{text}": "{part}" is no height in mm; write them as 5,12 or, from to, 5-15'
            )
        found.append((low, high))
    return _sort_heights(found)


def _sort_heights(spans_mm: Iterable[tuple[float, float]]) -> tuple[Height, ...]:
    """Each once."""
    return tuple(low if low == high else (low, high) for low, high in sorted(set(spans_mm)))


def split_names(option: str, text: str | None) -> tuple[str, ...]:
    """The names of "one, two". Raises InputError."""
    if text is None:
        return ()
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise InputError(f'{option} "{text}": write names with commas between them')
    return names


def requested_heights(
    rig: Path | None, heights: str | None, *, all_heights: bool
) -> tuple[Height, ...] | None:
    """The heights asked for, or those along the tips of a rig, ascending; None: all. Raises InputError."""
    if sum((rig is not None, heights is not None, all_heights)) > 1:
        raise InputError("give one of --rig, --heights and --all-heights")
    if all_heights:
        return None
    if heights is not None:
        return parse_heights(heights)
    return _sort_heights(finger.span_mm for finger in load_rig(rig).fingers)


def check_options(options: ImportOptions, *, several: bool = False) -> None:
    """Raises InputError for what is outside its limits, and for a name of `several` files."""
    if several and options.name is not None:
        raise InputError("--name is for one file; objects of several are named after their files")
    if several and options.parts:
        raise InputError("--parts is for one file")
    limits = (
        ("--tolerance", options.tolerance_mm, _MIN_TOLERANCE_MM, _MAX_TOLERANCE_MM, " mm"),
        ("--deviation", options.deviation_mm, 0.0, _MAX_TOLERANCE_MM, " mm"),
        ("--thickness", options.thickness_mm, _MIN_TOLERANCE_MM, _MAX_THICKNESS_MM, " mm"),
        ("--least-probability", options.least_probability, 0.0, 1.0, ""),
    )
    for option, value, least, most, unit in limits:
        if value is not None and not least <= value <= most:
            raise InputError(f"{option} is {value:g}{unit}; it must be from {least:g} to {most:g}{unit}")
    if options.name is not None:
        check_name("--name", options.name)


def check_name(what: str, name: str) -> None:
    """Raises InputError for what is no name of an object."""
    if not name.isprintable() or name.strip() != name:
        raise InputError(f"{what} must be printable characters without blanks around them")
    if not 0 < len(name) <= 90:
        raise InputError(f"{what} has {len(name)} characters; it must have from 1 to 90")


def load_target(target: Path, *, add: bool, again: bool = False) -> ObjectsFileText | None:
    """Return what the objects file holds; InputError, before anything is computed, if it stays as it is.

    `again`: one that was made by imports alone is brought up to date.
    """
    if not target.exists():
        return None
    refused = f"{target} is there already: add to it with --add, or choose another with --out"
    if not add and not again:
        raise InputError(refused)
    load_objects(target)
    there = load_objects_text(target)
    if not add and any(item.source is None for item in there.objects):
        raise InputError(f"{refused}; it holds objects that were not imported")
    return there


def load_for_edit(file: Path) -> ObjectsFileText:
    """The text of an objects file without fault. Raises InputError."""
    load_objects(file)
    return load_objects_text(file)


def write_edited(file: Path, text: ObjectsFileText) -> None:
    """Write an edited text, if it can be read again. Raises InputError."""
    write_text(file, _readable_json(text, file))


def _readable_json(text: ObjectsFileText, file: Path) -> str:
    """A text as it is written. Raises InputError if it could not be read again."""
    objects_from_text(text, str(file))
    json = objects_json(text)
    check_readable(str(file), json)
    return json


class ObjectsTarget:
    """The objects file that is written; as a context, what ends it early leaves in it what is done."""

    def __init__(self, path: Path, there: ObjectsFileText | None) -> None:
        """`there`: what the file holds already."""
        self._path = path
        self._written = there
        self._kept: ObjectsFileText | None = None
        self._not_before = 0.0

    def keep(self, text: ObjectsFileText) -> None:
        """Take what is done so far; it is written now and then, so that little is lost where power fails."""
        self._kept, begin = text, time.monotonic()
        if begin >= self._not_before:
            self.write(text)
            end = time.monotonic()
            self._not_before = end + (end - begin) / _MAX_WRITING_TIME_SHARE

    def write(self, text: ObjectsFileText) -> int:
        """Write a text that can be read again, unless the file holds it already; its number of bytes."""
        if text != self._written:
            write_text(self._path, _readable_json(text, self._path))
            self._written = text
        return self._path.stat().st_size

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or self._kept is None:
            return
        with suppress(InputError):  # it is too large: what was written before stays
            self.write(self._kept)
            error.add_note(f"what was done is in {self._path}; the same command goes on with the rest")
