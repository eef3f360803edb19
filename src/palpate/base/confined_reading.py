"""Confined reading: untrusted files are read in a separate process with limited time and memory.

Third-party parsers may crash on a damaged or hostile file, never end, or exhaust memory. None of this
affects the process that requests the reading, which gets an InputError. The reading process is started
afresh rather than forked, since its parent may have threads; it is this module, run as a script, with a
pickled call on standard input and its outcome on standard output.
"""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from tempfile import TemporaryDirectory
from typing import ParamSpec, TypeVar

from palpate.base.errors import InputError, MissingPackageError
from palpate.base.file_io import READING_BYTES, READING_S, READING_WALL_S, size_in_words

try:
    import resource
except ImportError:  # Windows: there the clock alone limits a reading
    _CPU_IS_LIMITED = False

    def _limit(name: str, soft: int, hard: int) -> None:
        pass
else:
    _CPU_IS_LIMITED = True

    def _limit(name: str, soft: int, hard: int) -> None:
        """Limit this process, unless it has a stricter limit already, or the system has none of that name."""
        with suppress(ValueError, OSError):
            resource.setrlimit(getattr(resource, name), (soft, hard))


_P = ParamSpec("_P")
_R = TypeVar("_R")

_CHILD = "palpate.base.confined_reading"
_INSIDE = "PALPATE_READING_PROCESS"
"""Set in the environment of such a process, in which no second one is needed."""


class UnfinishedReadingError(InputError):
    """A file that was not read in time, for want of processor time: nothing is said of it."""


_TOO_LONG = f"takes more than {READING_S:g} s to read"
_TOO_LARGE = f"takes more than {size_in_words(READING_BYTES)} of memory to read"
_KILLED = {-getattr(signal, name) for name in ("SIGXCPU", "SIGKILL") if hasattr(signal, name)}
"""How a process ends that has used up its processor time."""


def read_confined(
    path: str | os.PathLike[str], advice: str, read: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs
) -> _R:
    """Call `read`, a function of a module, in a process with limits; its value, or its InputError.

    `path`: what is read. Raises InputError, with `advice`, also where the process exceeds `READING_S` of
    processor time or `READING_BYTES`, crashes, or fails unforeseen; UnfinishedReadingError where it does not
    get that time, and MissingPackageError as `read` does. Its temporary files are removed.
    """
    if _INSIDE in os.environ:
        return read(*args, **kwargs)
    name = os.fspath(path)
    with TemporaryDirectory(prefix="palpate-") as folder:
        # Threads that wait for work in a busy loop would take of the processor time.
        threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
        try:
            ended = subprocess.run(
                [sys.executable, "-m", _CHILD],
                input=pickle.dumps((read, args, kwargs)),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=READING_WALL_S,
                check=False,
                env=os.environ | threads | {_INSIDE: "1", "TMPDIR": folder},
                process_group=0,  # a Ctrl-C at the terminal is not for it
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # the same on Windows
            )
        except subprocess.TimeoutExpired:
            had = (
                f", as its reader had less than {READING_S:g} s of processor time" if _CPU_IS_LIMITED else ""
            )
            raise UnfinishedReadingError(
                f"{name}: was not read within {READING_WALL_S:g} s{had}; try again while less runs beside it"
            ) from None
    if ended.returncode in _KILLED:
        raise InputError(f"{name}: {_TOO_LONG}; {advice}")
    if ended.returncode:
        raise InputError(f"{name}: cannot be read: its reader crashed, or {_TOO_LARGE}; {advice}")
    kind, value = pickle.loads(ended.stdout)
    if kind == "value":
        return value  # type: ignore[no-any-return]
    text, *notes = [f"{name}: {value}; {advice}"] if kind == "failed" else value
    error = MissingPackageError(text) if kind == "missing" else InputError(text)
    for note in notes:
        error.add_note(note)
    raise error


_SPARE_MEMORY_BYTES = 32_000_000
"""Of memory: with which to say that there is no more."""


def main() -> int:
    """Carry out the call within the limits."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # OpenCASCADE writes to standard output
        call = sys.stdin.buffer.read()
        _limit("RLIMIT_CPU", int(READING_S), int(READING_S) + 1)
        _limit("RLIMIT_CORE", 0, 0)
        _limit("RLIMIT_FSIZE", READING_BYTES, READING_BYTES)
        _limit("RLIMIT_DATA", READING_BYTES - _SPARE_MEMORY_BYTES, READING_BYTES)
        answer = _answer(call)
        _limit("RLIMIT_DATA", READING_BYTES, READING_BYTES)
        out.write(pickle.dumps(answer))
    return 0


def _answer(call: bytes) -> tuple[str, object]:
    try:
        read, args, kwargs = pickle.loads(call)
        return "value", read(*args, **kwargs)
    except InputError as error:
        kind = "missing" if isinstance(error, MissingPackageError) else "refused"
        return kind, tuple(map(_shorten, (str(error), *getattr(error, "__notes__", ()))))
    except MemoryError:
        return "failed", _TOO_LARGE
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return "failed", f"cannot be read ({what:.200})"


_FIRST_CHARS, _LAST_CHARS = 400, 180
"""What is kept of a message in which a file's own words are long."""


def _shorten(text: str) -> str:
    if len(text) <= _FIRST_CHARS + _LAST_CHARS:
        return text
    return f"{text[:_FIRST_CHARS]} … {text[-_LAST_CHARS:]}"


if __name__ == "__main__":
    sys.exit(main())
