"""Cache: arrays that can be made anew, kept in the user's cache folder because that is quicker.

A cache gives what was put in, bit for bit, or nothing. Whatever is wrong with a file, a folder or a disk
means nothing: no error comes from here, and nothing waits for another process.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from palpate.base.files.array_file import PARTIAL, ArrayFileError, Arrays, map_arrays, write_arrays

__all__ = ["CACHE_BYTES", "CACHE_PLACE", "Cache", "user_cache"]

CACHE_PLACE = "PALPATE_CACHE"
"""Environment variable: the cache's folder, or "off"."""

CACHE_BYTES = 1_000_000_000
"""Of all files in a cache: beyond that those that were not used for longest go."""

_SUFFIX = ".arrays"
_ABANDONED_S = 3600.0  # after which nothing writes any more on what is not complete
_ROOM = 4  # times a file's size must be free on the disk, so that others are not left without


@dataclass(frozen=True)
class Cache:
    """Arrays by kind and key, in the files of a `folder`; None: nothing is kept.

    `kind` and `key`: letters, digits and hyphens.
    """

    folder: Path | None
    most_bytes: int = CACHE_BYTES

    def fetch(self, kind: str, key: str) -> dict[str, NDArray[Any]] | None:
        """What was kept, mapped from its file and read-only; None where nothing sound was."""
        return None if self.folder is None else _fetched(self._place(self.folder, kind, key))

    def newest(self, kind: str, most: int) -> Iterator[dict[str, NDArray[Any]]]:
        """What is kept of a kind, whatever its key: the latest used first, from at most so many files."""
        if self.folder is None:
            return
        found = sorted(_files(self.folder, f"{kind}-*{_SUFFIX}"), reverse=True)
        for _, _, path in found[:most]:
            arrays = _fetched(path)
            if arrays is not None:
                yield arrays

    def keep(self, kind: str, key: str, arrays: Arrays) -> None:
        """Keep arrays, if that can be done; the files that were not used for longest make room."""
        if self.folder is None:
            return
        size = sum(value.nbytes for value in arrays.values())
        with suppress(OSError):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if 2 * size > self.most_bytes or shutil.disk_usage(self.folder).free < _ROOM * size:
                return
            place = self._place(self.folder, kind, key)
            write_arrays(place, arrays)
            self._tidy(self.folder, place.stat().st_mtime)

    def _place(self, folder: Path, kind: str, key: str) -> Path:
        return folder / f"{kind}-{key}{_SUFFIX}"

    def _tidy(self, folder: Path, now: float) -> None:
        """Remove what others did not complete, and of what is too much the files not used for longest."""
        for written, _, path in _files(folder, f".*{PARTIAL}"):
            if now - written > _ABANDONED_S:
                path.unlink(missing_ok=True)
        size = 0
        for _, own, path in sorted(_files(folder, f"*{_SUFFIX}"), reverse=True):
            size += own
            if size > self.most_bytes:
                path.unlink(missing_ok=True)


def _fetched(path: Path) -> dict[str, NDArray[Any]] | None:
    try:
        arrays = map_arrays(path)
    except (OSError, ArrayFileError):
        return None
    with suppress(OSError):
        os.utime(path)  # it was used
    return arrays


def _files(folder: Path, pattern: str) -> list[tuple[float, int, Path]]:
    """When each was last used, its size, and the file."""
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
