"""Work in parallel processes: an interruption ends it at once, and so does the end of what began it."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, connection, parent_process
from typing import Any, TypeVar

from palpate.base.errors import InputError

__all__ = ["in_processes"]

_T = TypeVar("_T")


def in_processes(
    function: Callable[..., _T], arguments: Sequence[tuple[Any, ...]], workers: int | None = None
) -> Iterator[tuple[int, _T]]:
    """Call a function of a module with each of the arguments; their index and the result, as they come.

    So many at once, None: as there are cores that this process may use (`taskset` and containers limit them).
    What the function raises is raised here; InputError if a process is ended by something else.
    """
    others = set(active_children())
    with ProcessPoolExecutor(min(len(arguments), workers or _cores()), initializer=_begin) as pool:
        try:
            work = {pool.submit(function, *some): index for index, some in enumerate(arguments)}
            for future in as_completed(work):
                yield work[future], future.result()
        except BrokenProcessPool as error:
            raise InputError(
                "a process that worked on this was ended from outside, as it is without memory enough; free "
                "some, or let fewer work at once"
            ) from error
        except BaseException:
            for child in set(active_children()) - others:
                child.terminate()
            raise


def _cores() -> int:
    # Not every system has affinities.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _begin() -> None:
    """Interruptions are for the process that was started; it ends the others, unless it has been killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Or this process waits for ever for work, and holds the files and pipes of what began it."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
