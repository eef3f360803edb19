"""Reading of users' files and writing of results: limits on size and content, complete files only.

Only regular files are read, and no more of one than the limit for its kind. All limits are in the table
below: each is several times what a large useful file needs; together they keep the cost of any file below 10
s and 1 GB (docs/file-limits.md is the version for users). Results are written so that a reader never sees an
incomplete one.
"""

import errno
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from itertools import chain, combinations, product
from pathlib import Path

from palpate.base.errors import InputError, OutputError
from palpate.base.file_access import NO_WAIT

MB = 1_000_000

TOML_BYTES = 1 * MB
"""A rig, calibration or references file; those of 16 fingers take 0.1 MB."""
JSON_BYTES = 32 * MB
"""An objects, contacts or scene file, or the record of a calibration; a leaning state takes 0.1 to 1 MB."""
LOG_BYTES = 640 * MB
"""A session's log, also unpacked; a minute takes 15 to 70 MB."""
RUNS_BYTES = 128 * MB
"""A file of a study's runs; 360,000 take that, and 700 MB of memory."""
CAD_BYTES = 64 * MB
"""A mesh, STEP file or drawing, also unpacked; 200,000 facets take 58 MB as ASCII STL."""

MOST_VALUES = 4_000_000
"""Numbers, texts, lists and tables in a JSON file, counted by commas and brackets."""
MOST_OUTLINES = 1_000
"""Outlines in one cross section, holes counted."""
MOST_TABLE_KEYS = 1_000
"""Keys in one table of a TOML or JSON file."""
MOST_NESTING = 64
"""Parts of a dotted key in TOML, blocks within blocks in DXF, elements within elements in SVG."""
MOST_LOG_LINES = 1_000_000
"""Lines in a log; 480 MB of a real one, seven minutes, have 700,000."""
MOST_LOG_VALUES = 24_000_000
"""The same as `VALUES` in a log, lines of bytes left out; 480 MB of a real one have up to 18,000,000."""
LOG_LINE_BYTES = 16 * MB
"""A line of a log; the longest, with the traces of three fingers that crept for half a minute, take 7 MB."""

MOST_FACETS = 500_000
"""Triangles in a mesh or STEP file."""
MOST_PARTS = 1_000
"""Bodies or parts in a CAD file."""
MOST_MEMBERS = 1_000
"""Files in a 3MF file, which is a ZIP archive."""
MOST_DRAWN_PIECES = 50_000
"""Entities or elements of a drawing, its blocks and copies unfolded."""
MOST_DRAWN_NUMBERS = 400_000
"""Numbers in the outlines of a drawing, its copies unfolded: two for each point."""

READING_S = 8.0
"""Processor time to read and check a CAD file or a large objects file, in a process of its own."""
UNCONFINED_BYTES = 100_000
"""Objects files up to this are read without such a process."""
READING_WALL_S = 60.0
"""Time on the clock for the same, where the computer is busy with something else."""
READING_BYTES = 768 * MB
"""Memory of that process."""


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
        with os.fdopen(os.open(path, os.O_RDONLY | NO_WAIT), "rb") as file:
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
        raise InputError(f"{os.fspath(path)}: is {_kind_in_words(found.st_mode)}, not a file")
    if found.st_size > most_bytes:
        raise _too_large(path, size_in_words(found.st_size), most_bytes, advice)


def _kind_in_words(mode: int) -> str:
    """Name of what has this `st_mode`, if it is no regular file: "a folder"."""
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
    """Write `text` beside `path` first and move it there; who may read and write a file stays as it was.

    Raises InputError for a place that cannot be written, OutputError for a disk that is full or fails.
    Whatever ends it before the move, such as an interrupt, leaves nothing behind.
    """
    _check_kind(path)
    partial = _partial(path)
    try:
        partial.write_text(text, encoding="utf-8", newline="\n")
        with suppress(FileNotFoundError):
            partial.chmod(stat.S_IMODE(path.stat().st_mode))
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
            raise InputError(f"{path} cannot be written: it is {_kind_in_words(mode)}; choose another place")


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
