"""Workers beside the main thread: a thread that cannot delay devices, and a pool of processes.

Everything other than devices (a log, a disk, a display, an observer) gets its work through a bounded queue.
Its first failure is kept until it is queried, when no device is being driven. Work in processes ends at once
on an interruption, and when the parent process ends.
"""

import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, connection, get_start_method, parent_process
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from palpate.base.errors import InputError, OutputError, PalpateError

_T = TypeVar("_T")

_POLL_S = 0.05  # between two looks at the queue: a kill loses no more
QUEUE_CAPACITY = 50_000  # items: half a minute of a rig's traffic, some 20 MB
_MAX_PENDING_CALLS = 1_000
_CLOSE_TIMEOUT_S = 2.0
_MAX_ENDING_S = 10.0  # longer than the longest computation between two looks at devices
_UNGUARDED_TEXT = '; a script of your own needs if __name__ == "__main__": where processes are spawned'
_ENDED_TEXT, _COMPLETE_TEXT = "the run was ended, torque off", "the run was complete, its result stands"


class ProgramEnd:
    """The end of the program, as noticed by a run in another thread than the main one.

    Such a thread gets no signals, and a daemon is stopped wherever it stands when the program ends, with
    torque on. `check` raises SystemExit there as soon as the program is ending, and the program waits for
    `finish`. In the main thread all of this does nothing.
    """

    def __init__(self) -> None:
        self._ending, self._finished = False, threading.Event()
        if threading.current_thread() is not threading.main_thread():
            atexit.register(self._wait)

    def check(self) -> None:
        """Raise SystemExit if the program is ending."""
        if self._ending:
            raise SystemExit("the program ended")

    def finish(self) -> None:
        """Let the program end."""
        atexit.unregister(self._wait)
        self._finished.set()

    def _wait(self) -> None:
        self._ending = True
        if not self._finished.wait(_MAX_ENDING_S):
            sys.stderr.write(
                "palpate: torque may still be on, as a run did not end with its program; palpate stop\n"
            )


class Background(Generic[_T]):
    """Hands what `put` is given to `consume`, in order and in batches, on a thread of its own.

    After its first failure, and while `capacity` items wait, items are dropped and counted.
    """

    def __init__(
        self,
        consume: Callable[[Sequence[_T]], None],
        capacity: int = QUEUE_CAPACITY,
        finish: Callable[[], None] = lambda: None,
    ) -> None:
        """The thread begins with the first item; it does not keep the process alive. `finish` ends it."""
        self.failure: BaseException | None = None
        self.dropped = 0
        self._consume, self._capacity, self._finish = consume, capacity, finish
        self._queue: SimpleQueue[_T] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._busy_since_s: float | None = None

    def put(self, item: _T) -> None:
        """Give it something to do; neither waits nor raises."""
        if self.failure is not None or self._queue.qsize() >= self._capacity:
            self.dropped += 1
            return
        try:
            self._queue.put(item)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="palpate output", daemon=True)
                self._thread.start()
        except Exception as error:  # no memory, or no further thread
            self.failure = error

    @property
    def busy_s(self) -> float:
        """Time that it has been at the present batch."""
        since = None if self.failure is not None else self._busy_since_s
        return 0.0 if since is None else time.monotonic() - since

    def close(self, patience_s: float) -> bool:
        """Wait until everything is done, or for `patience_s`; whether every item was consumed."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(patience_s)
            if self._thread.is_alive():
                return False
        return self.failure is None and not self.dropped

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:
            self.failure = error
        try:
            self._finish()
        except BaseException as error:
            self.failure = self.failure or error

    def _work(self) -> None:
        while True:
            ends = self._closing.wait(_POLL_S)
            batch = self._waiting()
            if batch:
                self._busy_since_s = time.monotonic()
                self._consume(batch)
                self._busy_since_s = None
            elif ends:
                return

    def _waiting(self) -> list[_T]:
        found: list[_T] = []
        while len(found) < self._capacity:
            try:
                found.append(self._queue.get_nowait())
            except Empty:
                break
        return found


class BackgroundCall:
    """Has a function called beside this thread, with the same arguments; to call it neither waits nor raises.

    What the function raises is an OutputError at the next `check`; KeyboardInterrupt ends the run as Ctrl-C
    does, at once, if this is the main thread. Use as a context manager: at the end, calls that wait are given
    two seconds. The end raises nothing: what failed by then has no part in what the run found.
    """

    def __init__(self, what: str, call: Callable[..., object]) -> None:
        """`what` names it in errors."""
        self._what, self._call = what, call
        self._in_main = threading.current_thread() is threading.main_thread()
        self._background = Background(self._carry_out, _MAX_PENDING_CALLS)

    def __call__(self, *args: object) -> None:
        """Have the function called."""
        self._background.put(args)

    def check(self) -> None:
        """Raise OutputError if the function has raised: ends the run that is under way.

        KeyboardInterrupt instead, if it raised that and the signal that it sent has not been heeded yet.
        """
        if self._in_main and isinstance(self._background.failure, KeyboardInterrupt):
            raise KeyboardInterrupt from self._background.failure
        failure = self._failure(_ENDED_TEXT)
        if failure is not None:
            raise failure

    @property
    def late_failure(self) -> PalpateError | None:
        """OutputError if the function has raised, to be reported beside the result of a complete run."""
        return self._failure(_COMPLETE_TEXT)

    def _failure(self, run: str) -> PalpateError | None:
        """Description of what went wrong and became of the run; palpate's own errors say it themselves."""
        error = self._background.failure
        if error is None or isinstance(error, PalpateError):
            return error
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        failure = OutputError(f"{self._what} failed: {type(error).__name__}: {reason}; {run}")
        failure.__cause__ = error
        return failure

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._background.close(_CLOSE_TIMEOUT_S)

    def _carry_out(self, batch: Sequence[tuple[object, ...]]) -> None:
        for args in batch:
            try:
                self._call(*args)
            except KeyboardInterrupt:
                if self._in_main:  # else no signal would reach the run: it ends at its next check
                    interrupt_main_thread(signal.SIGINT)
                raise


def interrupt_main_thread(number: int) -> None:
    """Send a signal to the main thread, from any other one."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:  # Windows, where os.kill would end the process
        signal.raise_signal(number)


def in_processes(
    function: Callable[..., _T], arguments: Sequence[tuple[Any, ...]], workers: int | None = None
) -> Iterator[tuple[int, _T]]:
    """Call a function of a module with each of the arguments; their index and the result, as they come.

    So many at once, None: as there are cores that this process may use (`taskset` and containers limit them).
    What the function raises is raised here; InputError if a process is ended by something else.
    """
    others = set(active_children())
    with ProcessPoolExecutor(
        min(len(arguments), workers or _core_count()), initializer=_start_worker
    ) as pool:
        try:
            work = {pool.submit(function, *some): index for index, some in enumerate(arguments)}
            for future in as_completed(work):
                yield work[future], future.result()
        except BrokenProcessPool as error:
            unguarded = "" if get_start_method() == "fork" else _UNGUARDED_TEXT
            raise InputError(
                "a process that worked on this was ended from outside, as it is without memory enough; free "
                f"some, or let fewer work at once{unguarded}"
            ) from error
        except BaseException:
            for child in set(active_children()) - others:
                child.terminate()
            raise


def _core_count() -> int:
    # Not every system has affinities.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _start_worker() -> None:
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
