"""Background work: callbacks and logs run beside the thread that drives devices and cannot stop or delay it.

What is beside the devices (a log, a disk, a screen, an observer) is given its work through a bounded queue.
Its first failure is kept until somebody who drives nothing at the moment asks for it.
"""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from palpate.errors import OutputError

__all__ = ["Background", "in_background"]

_T = TypeVar("_T")

_EVERY_S = 0.05  # between two looks at the queue: a kill loses no more
_CAPACITY = 50_000  # items: half a minute of a rig's traffic, some 20 MB
_CALLS = 1_000
_PATIENCE_S = 2.0


class Background(Generic[_T]):
    """Hands what `put` is given to `consume`, in order and in batches, on a thread of its own.

    After the first failure of `consume`, or while `capacity` items wait, items are dropped and counted.
    """

    def __init__(self, consume: Callable[[Sequence[_T]], None], capacity: int = _CAPACITY) -> None:
        """The thread begins with the first item; it does not keep the process alive."""
        self.failure: BaseException | None = None
        self.dropped = 0
        self._consume, self._capacity = consume, capacity
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
        """For how long it has been at the present batch."""
        since = self._busy_since_s
        return 0.0 if since is None else time.monotonic() - since

    def close(self, patience_s: float) -> bool:
        """Wait until everything is done, or for `patience_s`; whether everything was."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(patience_s)
            return not self._thread.is_alive() and self.failure is None
        return self.failure is None

    def _run(self) -> None:
        while self.failure is None:
            ends = self._closing.wait(_EVERY_S)
            batch = self._waiting()
            if batch:
                self._busy_since_s = time.monotonic()
                try:
                    self._consume(batch)
                except BaseException as error:
                    self.failure = error
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


@contextmanager
def in_background(what: str, call: Callable[..., object]) -> Iterator[Callable[..., None]]:
    """A function that has `call` called beside this thread, with the same arguments, and returns at once.

    At the end, calls that wait are given two seconds. Raises OutputError, naming `what`, if `call` raised.
    """

    def carry_out(batch: Sequence[tuple[tuple[object, ...], dict[str, object]]]) -> None:
        for args, values in batch:
            call(*args, **values)

    background = Background(carry_out, _CALLS)
    try:
        yield lambda *args, **values: background.put((args, values))
    finally:
        background.close(_PATIENCE_S)
    if background.failure is not None:
        raise failed(what, background.failure) from background.failure


def failed(what: str, error: BaseException) -> OutputError:
    """The error that says that `what` has failed."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return OutputError(f"{what} failed: {type(error).__name__}: {reason}; the run was ended, torque off")
