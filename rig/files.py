"""Writing result files so that a reader never meets half of one."""

import os
from pathlib import Path

from palpate.errors import InputError

__all__ = ["write_text"]


def write_text(path: Path, text: str) -> None:
    """Write `text` beside `path` first and move it there; InputError if the place cannot be written."""
    partial = path.with_name(f".{path.name}.part")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; choose another place") from error
