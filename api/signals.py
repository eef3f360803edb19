"""Signals that end a script: they unwind it, so that torque is switched off on the way."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["unwinding_signals"]

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def unwinding_signals() -> Iterator[None]:
    """Raise SystemExit for SIGTERM and SIGHUP, which would else end the process at once, torque on.

    Handlers that a program has set stay. Outside of the main thread, which alone gets signals, this is idle.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = [number for number in _SIGNALS if signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, _unwind)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def _unwind(number: int, frame: FrameType | None) -> None:
    del frame
    for each in _SIGNALS:  # once: torque is being switched off
        signal.signal(each, signal.SIG_IGN)
    raise SystemExit(128 + number)
