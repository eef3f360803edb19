"""Access to files where systems differ: opening without waiting, ownership, relative paths, locks."""

import os
from enum import Enum
from pathlib import Path
from typing import BinaryIO

NO_WAIT: int = getattr(os, "O_NONBLOCK", 0)
"""Flag for opening: a named pipe does not keep us waiting. Windows has none in its folders."""
NO_LINK: int = getattr(os, "O_NOFOLLOW", 0)
"""Flag for opening: a link is refused, where the system can do that."""


def is_own(found: os.stat_result) -> bool:
    """True of a file or folder that belongs to this user, and to which no other may write.

    Where files have no such owners, as on Windows, it is true of all: folders have their profile's rights.
    """
    if not hasattr(os, "geteuid"):
        return True
    return found.st_uid == os.geteuid() and not found.st_mode & 0o022


def relative_path(path: Path, folder: Path) -> str:
    """Path of a file as seen from a folder, with slashes on all systems; absolute if on another drive."""
    try:
        found = os.path.relpath(path, folder)
    except ValueError:  # Windows has drives
        found = os.path.abspath(path)
    return Path(found).as_posix()


class _Lock(Enum):
    NONE = 0
    SHARED = 1
    EXCLUSIVE = 2


try:
    import fcntl
except ImportError:  # Windows
    import msvcrt

    # Far beyond any content: there nobody can read a locked byte. All locks are exclusive.
    _LOCKED_BYTE = 1 << 40

    def _set_lock(number: int, lock: _Lock) -> None:
        mode = "LK_UNLCK" if lock is _Lock.NONE else "LK_NBLCK"
        before = os.lseek(number, 0, os.SEEK_CUR)
        os.lseek(number, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(number, getattr(msvcrt, mode), 1)  # type: ignore[attr-defined]
        except PermissionError as error:
            raise BlockingIOError(error.errno, error.strerror) from None
        finally:
            os.lseek(number, before, os.SEEK_SET)
else:

    def _set_lock(number: int, lock: _Lock) -> None:
        mode = {_Lock.NONE: fcntl.LOCK_UN, _Lock.SHARED: fcntl.LOCK_SH, _Lock.EXCLUSIVE: fcntl.LOCK_EX}[lock]
        fcntl.flock(number, mode | fcntl.LOCK_NB)


def lock_file(file: BinaryIO) -> None:
    """Lock an open file until it is closed; BlockingIOError if it is locked."""
    _set_lock(file.fileno(), _Lock.EXCLUSIVE)


def is_locked(file: BinaryIO) -> bool:
    """True if an open file is locked by way of another opening of it, in this process or in another."""
    try:
        _set_lock(file.fileno(), _Lock.SHARED)
    except BlockingIOError:
        return True
    _set_lock(file.fileno(), _Lock.NONE)
    return False
