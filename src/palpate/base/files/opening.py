"""The way to a file's bytes: nothing but a regular file, and never more of it than its kind may have."""

import os
import stat
from pathlib import Path

from palpate.base.errors import InputError

__all__ = ["check_file", "kind_in_words", "read_bytes", "size_in_words"]

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_bytes(path: str | os.PathLike[str], most_bytes: int, advice: str) -> bytes:
    """All of a regular file; InputError, with what to do, for one that has more than `most_bytes`."""
    check_file(path, most_bytes, advice)
    try:
        # Neither a pipe put here meanwhile nor a file of the kernel's keeps us waiting.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            data = file.read(most_bytes + 1) or b""
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    if len(data) > most_bytes:
        raise _too_large(path, "more", most_bytes, advice)
    return data


def check_file(path: str | os.PathLike[str], most_bytes: int, advice: str) -> None:
    """Raise InputError for what is no regular file of at most `most_bytes`."""
    try:
        found = Path(path).stat()
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{os.fspath(path)}: is {kind_in_words(found.st_mode)}, not a file")
    if found.st_size > most_bytes:
        raise _too_large(path, size_in_words(found.st_size), most_bytes, advice)


def kind_in_words(mode: int) -> str:
    """What has this `st_mode`, if it is no regular file: "a folder"."""
    return next((words for test, words in _KINDS if test(mode)), "something else")


def size_in_words(count: int) -> str:
    """A number of bytes as people write it: "2.9 MB"."""
    return f"{count / 1e9:.3g} GB" if count >= 999_500_000 else f"{count / 1e6:.3g} MB"


def _too_large(path: str | os.PathLike[str], size: str, most_bytes: int, advice: str) -> InputError:
    return InputError(
        f"{os.fspath(path)}: has {size}; at most {size_in_words(most_bytes)} are read: {advice}"
    )


def _unreadable(path: str | os.PathLike[str], error: OSError | ValueError) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{os.fspath(path)}: there is no such file")
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"{os.fspath(path)}: cannot be read: {reason}")
