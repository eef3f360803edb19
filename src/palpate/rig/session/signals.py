"""Signals that end a run in an orderly way, so that torque is off.

A run holds them back until the host next asks something of its environment, so that a recording says where
they hit. Between two calls on clock and ports the host takes note of what it got, a few lines at most; an
interrupt there could not be brought about again. In a long computation, where no call comes, it hits after
`_MAX_HOLD_S` at latest. A moving rig makes hundreds of calls a second.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Self

from palpate.rig.workers import interrupt_main_thread

_MAX_HOLD_S = 0.25

_WORDS = {
    "SIGINT": "interrupted",
    "SIGTERM": "terminated",
    "SIGHUP": "hung_up",  # its terminal was closed
    "SIGBREAK": "hung_up",  # as Windows has it
    "SIGXCPU": "cpu_time",  # its limit of computing time is reached; killed at the hard limit
    "SIGUSR1": "sigusr1",  # batch systems warn by these
    "SIGUSR2": "sigusr2",
}
INTERRUPTS: dict[signal.Signals, str] = {
    getattr(signal, name): word for name, word in _WORDS.items() if hasattr(signal, name)
}
"""Signals of this system that end a command in order, and what session logs call the end then."""


class Interrupted(BaseException):
    """A signal asked the process to end.

    Not a KeyboardInterrupt: typer makes one exit code of all of those.
    """

    def __init__(self, number: signal.Signals, word: str | None = None) -> None:
        super().__init__(word or INTERRUPTS[number])
        self.signal = number

    @classmethod
    def of(cls, name: str) -> Self:
        """The interrupt that a session log names so, of another system, too; KeyError for an unknown name."""
        if name not in _WORDS.values():
            raise KeyError(name)
        return cls(next((n for n, word in INTERRUPTS.items() if word == name), signal.SIGTERM), name)


class HeldInterrupts:
    """Holds the signals of `INTERRUPTS` back for `check`, which does what their handlers would have done.

    Use as a context manager; outside of the main thread, which alone gets signals, it does nothing.
    """

    def __init__(self) -> None:
        self._handlers = {number: signal.getsignal(number) for number in INTERRUPTS}
        self._pending: int | None = None
        self._overdue = False
        self._timer: threading.Timer | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._handlers.items():
                if callable(handler):
                    signal.signal(number, self._hold)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._handlers.items():
            if signal.getsignal(number) == self._hold:
                signal.signal(number, handler)
        self.check()

    def check(self) -> None:
        """Let a signal that came through now: its own handler is called, which may raise."""
        if self._pending is None:
            return
        number, self._pending = self._pending, None
        if self._timer is not None:
            self._timer.cancel()
        handler = self._handlers[signal.Signals(number)]
        if callable(handler):
            handler(number, None)

    def _hold(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self._pending is None:
            self._pending = number
            self._timer = threading.Timer(_MAX_HOLD_S, self._remind, (number,))
            self._timer.daemon = True
            self._timer.start()
        elif self._overdue:
            self.check()

    def _remind(self, number: int) -> None:
        """Send the signal once more, from another thread: no call came."""
        self._overdue = True
        if self._pending is not None:
            interrupt_main_thread(number)


_UNWINDING_SIGNALS = [number for number in INTERRUPTS if number != signal.SIGINT]


@contextmanager
def unwind_on_signals() -> Iterator[None]:
    """Unwind for SIGTERM and the like, which would else end the process at once; SystemExit then.

    Handlers that a program has set stay. Outside of the main thread, which alone gets signals, this is idle.
    """
    main = threading.current_thread() is threading.main_thread()
    ours = [number for number in _UNWINDING_SIGNALS if main and signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, _unwind)
    try:
        yield
    except Interrupted as interruption:  # by this name a session log can replay it
        if interruption.signal not in ours:
            raise
        raise SystemExit(128 + interruption.signal) from None
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def _unwind(number: int, frame: FrameType | None) -> None:
    del frame
    for each in _UNWINDING_SIGNALS:  # once: torque is being switched off
        if signal.getsignal(each) is _unwind:
            signal.signal(each, signal.SIG_IGN)
    raise Interrupted(signal.Signals(number))
