"""Array files: named arrays in one file, whole or refused, and mapped into memory instead of read.

    magic (16 bytes) | SHA-256 of all that follows (32) | length of the table, and of the file (8 + 8)
    table: JSON, [[name, type, shape, offset], …] | arrays, each on a 64-byte boundary

Integers are little-endian. What a file holds are numbers: nothing in it is ever carried out. A file is moved
to its place when it is complete, and never written to again, so that others may have it mapped meanwhile.
"""

import hashlib
import json
import math
import mmap
import os
import secrets
import stat
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["PARTIAL", "ArrayFileError", "Arrays", "map_arrays", "write_arrays"]

Arrays = Mapping[str, NDArray[Any]]
"""Arrays by name."""

PARTIAL = ".part"
"""Suffix of a file that is being written."""

_MAGIC = b"palpate/arrays@1"
_FIXED = struct.Struct("<16s32sQQ")
_HASHED_FROM = 48
_BOUNDARY = 64
_TYPES = ("<f8", "<f4", "<i8", "|b1", "|u1")
_TABLE_BYTES, _MOST_ARRAYS = 1 << 20, 1000


class ArrayFileError(Exception):
    """A file is not what it should be: foreign, torn, damaged, or someone else's."""


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays beside `path` first and move them there; OSError where that cannot be done.

    Whatever ends it before the move leaves `path` as it was. Types: float64, float32, int64, bool, uint8.
    """
    table, at = [], 0
    stored = {name: np.asarray(value, _type_of(value), order="C") for name, value in arrays.items()}
    for name, value in stored.items():
        table.append([name, value.dtype.str, list(value.shape), at])
        at += _padded(value.nbytes)
    text = json.dumps(table).encode()
    text += b" " * (_padded(_FIXED.size + len(text)) - _FIXED.size - len(text))
    size = _FIXED.size + len(text) + at
    head = struct.pack("<QQ", len(text), size) + text
    digest = hashlib.sha256(head)
    for part in _payload(stored):
        digest.update(part)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}{PARTIAL}")
    try:
        with os.fdopen(
            os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600), "wb"
        ) as f:
            f.write(_MAGIC + digest.digest() + head)
            for part in _payload(stored):
                f.write(part)
            f.flush()
            os.fsync(f.fileno())
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def map_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a file, read-only and mapped: processes that have the same file share its memory.

    Raises ArrayFileError for a file that is not whole, and for one that another user owns or could write to;
    OSError where there is none.
    """
    data = _mapped(path)
    if len(data) < _FIXED.size:
        raise ArrayFileError("too short")
    magic, digest, length, size = _FIXED.unpack_from(data)
    if magic != _MAGIC:
        raise ArrayFileError("no array file")
    begin = _FIXED.size + length
    if size != len(data) or length > _TABLE_BYTES or begin > size or begin % _BOUNDARY:
        raise ArrayFileError("not whole")
    if hashlib.sha256(memoryview(data)[_HASHED_FROM:]).digest() != digest:
        raise ArrayFileError("damaged")
    return dict(_arrays(data, data[_FIXED.size : begin], begin))


def _mapped(path: Path) -> mmap.mmap:
    """A file's bytes, if it is a regular file that only this user can write to."""
    # Neither a link, nor a pipe that would keep us waiting.
    number = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = os.fstat(number)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o022:
            raise ArrayFileError("not this user's own file")
        try:
            return mmap.mmap(number, 0, access=mmap.ACCESS_READ)
        except ValueError as error:  # it is empty
            raise ArrayFileError("too short") from error
    finally:
        os.close(number)


def _arrays(data: mmap.mmap, text: bytes, begin: int) -> Iterator[tuple[str, NDArray[Any]]]:
    try:
        table = json.loads(text)
        if len(table) > _MOST_ARRAYS:
            raise ArrayFileError("too many arrays")
        for name, kind, shape, at in table:
            if not isinstance(name, str) or kind not in _TYPES:
                raise ArrayFileError("unknown type")
            if not all(type(value) is int and value >= 0 for value in (at, *shape)):
                raise ArrayFileError("impossible sizes")
            count = math.prod(shape)
            if at % _BOUNDARY or begin + at + count * np.dtype(kind).itemsize > len(data):
                raise ArrayFileError("sizes beyond the end")
            yield name, np.frombuffer(data, kind, count, begin + at if count else 0).reshape(shape)
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        raise ArrayFileError("no table of arrays") from error


def _type_of(value: NDArray[Any]) -> str:
    kind = value.dtype.newbyteorder("<").str
    if kind not in _TYPES:
        raise ValueError(f"arrays of type {value.dtype} are not kept")
    return kind


def _payload(arrays: Arrays) -> Iterator[memoryview | bytes]:
    for value in arrays.values():
        yield value.reshape(-1).view(np.uint8).data
        yield bytes(_padded(value.nbytes) - value.nbytes)


def _padded(size: int) -> int:
    return -(-size // _BOUNDARY) * _BOUNDARY
