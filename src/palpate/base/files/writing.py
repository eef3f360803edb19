"""Writing result files so that a reader never meets half of one."""

import errno
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from itertools import chain, combinations, product
from pathlib import Path

from palpate.base.errors import InputError, OutputError
from palpate.base.files.opening import kind_in_words

__all__ = ["check_different", "check_place", "check_places", "write_text"]

_DISK_FAILS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG, errno.ENODEV, errno.ENXIO, errno.ESTALE)


def check_places(written: Mapping[str, Path | None], read: Mapping[str, Path | None]) -> None:
    """Raise InputError if what a command writes cannot be written, or is what it reads, or another output.

    Paths by the names of their options, or words for what has none. None: not asked for.
    """
    check_different(written, read)
    for _, place in _named(written):
        check_place(place)


def check_different(written: Mapping[str, Path | None], read: Mapping[str, Path | None]) -> None:
    """Raise InputError if what a command writes, files or folders, is what it reads, or another output.

    By whatever path or link. Whether they can be written is not asked.
    """
    outputs, inputs = _named(written), _named(read)
    for (name, place), (other, its) in chain(product(outputs, inputs), combinations(outputs, 2)):
        # What is being written lies beside it first.
        if any(_is_same(own, file) for own in (place, _partial(place)) for file in (its, _partial(its))):
            raise InputError(
                f"{name} {place} cannot be written: it is the same file as {other}; choose another place"
            )


def _named(places: Mapping[str, Path | None]) -> list[tuple[str, Path]]:
    return [(name, place) for name, place in places.items() if place is not None]


def _is_same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:  # one is not there yet
        return os.path.realpath(one) == os.path.realpath(other)


def check_place(path: Path) -> None:
    """Raise InputError if `path` cannot be written: to be known before fingers move, not after."""
    _check_kind(path)
    partial = _partial(path)
    try:
        partial.touch()
        partial.unlink()
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; choose another place") from error


def write_text(path: Path, text: str) -> None:
    """Write `text` beside `path` first and move it there.

    Raises InputError for a place that cannot be written, OutputError for a disk that is full or fails.
    Whatever ends it before the move, such as an interrupt, leaves nothing behind.
    """
    _check_kind(path)
    partial = _partial(path)
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in _DISK_FAILS:
            raise OutputError(
                f"{path} cannot be written: {error.strerror}; make room, or choose another disk"
            ) from error
        if isinstance(error, OSError):
            raise InputError(f"{path} cannot be written: {error.strerror}; choose another place") from error
        raise


def _check_kind(path: Path) -> None:
    """Raise InputError for what is there and no file: a device would be replaced by a file."""
    with suppress(OSError):
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise InputError(f"{path} cannot be written: it is {kind_in_words(mode)}; choose another place")


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
