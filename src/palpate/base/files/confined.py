"""Reading in a process of its own, which may take so much time and memory and no more.

Foreign parsers of a damaged or hostile file may crash, search without end, or want more memory than there is.
None of this happens to the process that has the file read: there it is an InputError. The process is started
anew rather than forked, since its parent may have threads.
"""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from tempfile import TemporaryDirectory
from typing import ParamSpec, TypeVar

from palpate.base.errors import InputError
from palpate.base.files.limits import READING_BYTES, READING_S, READING_WALL_S
from palpate.base.files.opening import size_in_words

__all__ = ["TOO_LARGE", "confined"]

_P = ParamSpec("_P")
_R = TypeVar("_R")

_CHILD = "palpate.base.files.reading_process"
_INSIDE = "PALPATE_READING_PROCESS"
"""Set in the environment of such a process, in which no second one is needed."""

_TOO_LONG = f"takes more than {READING_S:g} s to read"
TOO_LARGE = f"takes more than {size_in_words(READING_BYTES)} of memory to read"


def confined(
    path: str | os.PathLike[str], advice: str, read: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs
) -> _R:
    """Call `read`, a function of a module, in a process with limits; its value, or its InputError.

    `path`: what is read. Raises InputError, with `advice`, also where the process exceeds `READING_S` of
    processor time or `READING_BYTES`, crashes, or fails unforeseen. Its temporary files are removed.
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
                process_group=0,
            )
        except subprocess.TimeoutExpired:
            raise InputError(f"{name}: {_TOO_LONG}; {advice}") from None
    if ended.returncode in {-signal.SIGXCPU, -signal.SIGKILL}:
        raise InputError(f"{name}: {_TOO_LONG}; {advice}")
    if ended.returncode:
        raise InputError(f"{name}: cannot be read: its reader crashed, or {TOO_LARGE}; {advice}")
    kind, value = pickle.loads(ended.stdout)
    if kind == "value":
        return value  # type: ignore[no-any-return]
    text, *notes = value if kind == "refused" else [f"{name}: {value}; {advice}"]
    error = InputError(text)
    for note in notes:
        error.add_note(note)
    raise error
