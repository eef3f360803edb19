"""Writing result files so that a reader never meets half of one."""

import errno
import os
from contextlib import suppress
from pathlib import Path

from palpate.errors import InputError, OutputError

__all__ = ["check_place", "write_text"]

_DISK_FAILS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG, errno.ENODEV, errno.ENXIO, errno.ESTALE)


def check_place(path: Path) -> None:
    """Raise InputError if `path` cannot be written: to be known before fingers move, not after."""
    if path.is_dir():
        raise InputError(f"{path} cannot be written: it is a folder; choose another place")
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


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
