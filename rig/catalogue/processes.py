"""Work of an import in parallel processes: an interruption ends it at once, whatever has been begun."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children
from typing import Any, TypeVar

__all__ = ["in_processes"]

_T = TypeVar("_T")


def in_processes(
    function: Callable[..., _T], arguments: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[int, _T]]:
    """Call a function of a module with each of the arguments; their index and the result, as they come.

    As many at once as there are cores that this process may use (`taskset` and containers limit them). What
    the function raises is raised here.
    """
    others = set(active_children())
    with ProcessPoolExecutor(min(len(arguments), _cores()), initializer=_leave_signals) as pool:
        try:
            work = {pool.submit(function, *some): index for index, some in enumerate(arguments)}
            for future in as_completed(work):
                yield work[future], future.result()
        except BaseException:
            for child in set(active_children()) - others:
                child.terminate()
            raise


def _cores() -> int:
    # Not every system has affinities.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _leave_signals() -> None:
    """Interruptions are for the process that was started; it ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
