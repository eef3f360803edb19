"""Cache of arrays that can be recomputed, kept in the user's cache folder to save time.

A cache returns what was stored, bit for bit, or nothing. A fault of a file, folder or disk counts as a miss:
it raises no error, and nothing waits for another process. Keys contain a digest of the code and the
libraries used for the computation, because other code may give other results and a manual version number
would be forgotten.

Array files hold named arrays, whole or refused, and are mapped into memory instead of read:

    magic (16 bytes) | SHA-256 of all that follows (32) | length of the table, and of the file (8 + 8)
    table: JSON, [title, [[name, type, shape, offset], …]] | arrays, each on a 64-byte boundary

Integers are little-endian. The title is the file's own name, so that one in the place of another is refused.
A file contains only numbers: nothing in it is ever executed. A file is moved into place when it is complete,
and never written to again, so that other processes may keep it mapped.
"""

import hashlib
import json
import math
import mmap
import os
import platform
import secrets
import shutil
import stat
import struct
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy
import numpy as np
import scipy
import shapely
from numpy.typing import NDArray

from palpate.base.file_access import NO_LINK, NO_WAIT, is_own

Arrays = Mapping[str, NDArray[Any]]
"""Arrays by name."""

_PARTIAL_SUFFIX = ".part"
"""Suffix of a file that is being written."""

_MAGIC = b"palpate/arrays@2"
_HEAD = struct.Struct("<16s32sQQ")
_HASHED_FROM_BYTE = 48
_BOUNDARY_BYTES = 64
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
        at += _padded_size(value.nbytes)
    text = json.dumps([path.name, table]).encode()
    text += b" " * (_padded_size(_HEAD.size + len(text)) - _HEAD.size - len(text))
    size = _HEAD.size + len(text) + at
    head = struct.pack("<QQ", len(text), size) + text
    digest = hashlib.sha256(head)
    for part in _payload(stored):
        digest.update(part)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}{_PARTIAL_SUFFIX}")
    try:
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as f:
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

    Raises ArrayFileError for a file that is not whole, one that was written under another name, and one that
    another user owns or could write to; OSError where there is none.
    """
    data = _map_file(path)
    if len(data) < _HEAD.size:
        raise ArrayFileError("too short")
    magic, digest, length, size = _HEAD.unpack_from(data)
    if magic != _MAGIC:
        raise ArrayFileError("no array file")
    begin = _HEAD.size + length
    if size != len(data) or length > _TABLE_BYTES or begin > size or begin % _BOUNDARY_BYTES:
        raise ArrayFileError("not whole")
    if hashlib.sha256(memoryview(data)[_HASHED_FROM_BYTE:]).digest() != digest:
        raise ArrayFileError("damaged")
    return dict(_parse_arrays(path.name, data, data[_HEAD.size : begin], begin))


def _map_file(path: Path) -> mmap.mmap:
    """A file's bytes, if it is a regular file that only this user can write to."""
    # Neither a link, nor a pipe that would keep us waiting.
    number = os.open(path, os.O_RDONLY | NO_LINK | NO_WAIT)
    try:
        found = os.fstat(number)
        if not stat.S_ISREG(found.st_mode) or not is_own(found):
            raise ArrayFileError("not this user's own file")
        try:
            return mmap.mmap(number, 0, access=mmap.ACCESS_READ)
        except ValueError as error:  # it is empty
            raise ArrayFileError("too short") from error
    finally:
        os.close(number)


def _parse_arrays(title: str, data: mmap.mmap, text: bytes, begin: int) -> Iterator[tuple[str, NDArray[Any]]]:
    try:
        written, table = json.loads(text)
        if written != title:
            raise ArrayFileError("another file's content")
        if len(table) > _MOST_ARRAYS:
            raise ArrayFileError("too many arrays")
        for name, kind, shape, at in table:
            if not isinstance(name, str) or kind not in _TYPES:
                raise ArrayFileError("unknown type")
            if not all(type(value) is int and value >= 0 for value in (at, *shape)):
                raise ArrayFileError("impossible sizes")
            count = math.prod(shape)
            if at % _BOUNDARY_BYTES or begin + at + count * np.dtype(kind).itemsize > len(data):
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
        yield bytes(_padded_size(value.nbytes) - value.nbytes)


def _padded_size(size: int) -> int:
    return -(-size // _BOUNDARY_BYTES) * _BOUNDARY_BYTES


CACHE_PLACE = "PALPATE_CACHE"
"""Environment variable: the cache's folder, or "off"."""

_CACHE_BYTES = 1_000_000_000
"""Of all files in a cache: beyond that those that were not used for longest go."""

_SUFFIX = ".arrays"
_ABANDONED_S = 3600.0  # after which nothing writes any more on what is not complete
_FREE_DISK_FACTOR = 4  # times a file's size must be free on the disk, so that others are not left without


@dataclass(frozen=True)
class Cache:
    """Arrays by kind and key, in the files of a `folder`; None: nothing is kept.

    `kind` and `key`: letters, digits and hyphens.
    """

    folder: Path | None
    most_bytes: int = _CACHE_BYTES

    def fetch(self, kind: str, key: str) -> dict[str, NDArray[Any]] | None:
        """Return what was kept, mapped from its file and read-only; None where nothing sound was."""
        if self.folder is None or not _is_private(self.folder):
            return None
        return _fetch_file(self._place(self.folder, kind, key))

    def newest(self, kind: str, most: int) -> Iterator[dict[str, NDArray[Any]]]:
        """Return what is kept of a kind, whatever its key: the latest used first, from so many files."""
        if self.folder is None or not _is_private(self.folder):
            return
        found = sorted(_cached_files(self.folder, f"{kind}-*{_SUFFIX}"), reverse=True)
        for _, _, path in found[:most]:
            arrays = _fetch_file(path)
            if arrays is not None:
                yield arrays

    def keep(self, kind: str, key: str, arrays: Arrays) -> None:
        """Keep arrays, if that can be done; the files that were not used for longest make room."""
        if self.folder is None:
            return
        size = sum(value.nbytes for value in arrays.values())
        with suppress(OSError):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not _is_private(self.folder):
                return
            if 2 * size > self.most_bytes or shutil.disk_usage(self.folder).free < _FREE_DISK_FACTOR * size:
                return
            place = self._place(self.folder, kind, key)
            write_arrays(place, arrays)
            self._tidy(self.folder, place.stat().st_mtime)

    def _place(self, folder: Path, kind: str, key: str) -> Path:
        return folder / f"{kind}-{key}{_SUFFIX}"

    def _tidy(self, folder: Path, now: float) -> None:
        """Remove what others did not complete, and of what is too much the files not used for longest."""
        for written, _, path in _cached_files(folder, f".*{_PARTIAL_SUFFIX}"):
            if now - written > _ABANDONED_S:
                path.unlink(missing_ok=True)
        size = 0
        for _, own, path in sorted(_cached_files(folder, f"*{_SUFFIX}"), reverse=True):
            size += own
            if size > self.most_bytes:
                with suppress(OSError):  # Windows keeps a file that a process has mapped
                    path.unlink()


def _is_private(folder: Path) -> bool:
    """True of a folder that only this user can write to."""
    try:
        found = folder.stat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and is_own(found)


def _fetch_file(path: Path) -> dict[str, NDArray[Any]] | None:
    try:
        arrays = map_arrays(path)
    except (OSError, ArrayFileError):
        return None
    with suppress(OSError):
        os.utime(path)  # it was used
    return arrays


def _cached_files(folder: Path, pattern: str) -> list[tuple[float, int, Path]]:
    """Time of last use, size and path of each file."""
    found = []
    with suppress(OSError):
        for path in folder.glob(pattern):
            with suppress(OSError):
                entry = path.lstat()
                found.append((entry.st_mtime, entry.st_size, path))
    return found


def user_cache() -> Cache:
    """The cache of the user who runs this: PALPATE_CACHE, or palpate in XDG_CACHE_HOME or ~/.cache."""
    named = os.environ.get(CACHE_PLACE)
    if named:
        return Cache(None if named == "off" else Path(named).expanduser())
    home = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Cache((Path(home) if os.path.isabs(home) else Path.home() / ".cache") / "palpate")
    except RuntimeError:  # nobody knows where this user is at home
        return Cache(None)


@cache
def source_digest(*packages: str, compiled: bool) -> str:
    """16 hexadecimal digits that change with every line of packages and those within them, nothing else.

    `compiled`: also with what has been compiled for them.
    """
    digest, suffixes = hashlib.sha256(), (".py", ".so", ".pyd") if compiled else (".py",)
    for package in packages:
        for place, file in _source_files(files(package), package):
            if place.endswith(suffixes):
                digest.update(place.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _source_files(folder: Traversable, place: str) -> Iterator[tuple[str, Traversable]]:
    for item in sorted(folder.iterdir(), key=lambda item: item.name):
        inside = f"{place}/{item.name}"
        if item.is_dir():
            yield from _source_files(item, inside)
        else:
            yield inside, item


@cache
def code_digest(*packages: str) -> str:
    """16 hexadecimal digits that change with every line of some packages, with libraries and the machine."""
    versions = (numpy.__version__, scipy.__version__, shapely.__version__, shapely.geos_version_string)
    source = source_digest(*packages, compiled=False)
    return hashlib.sha256(repr((*versions, sys.version, platform.machine(), source)).encode()).hexdigest()[
        :16
    ]
