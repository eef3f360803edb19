"""Writing result files so that a reader never meets half of one."""

import os
from contextlib import suppress
from pathlib import Path

from palpate.errors import InputError

__all__ = ["check_place", "write_text"]


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
    """Write `text` beside `path` first and move it there; InputError if the place cannot be written.

    Whatever ends it before the move, such as an interrupt, leaves nothing behind.
    """
    partial = _partial(path)
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(f"{path} cannot be written: {error.strerror}; choose another place") from error
        raise


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
