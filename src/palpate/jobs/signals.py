"""Signals that end a script: they unwind it, so that torque is switched off on the way."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from palpate.rig.session.signals import Interrupted

__all__ = ["unwinding_signals"]

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def unwinding_signals() -> Iterator[None]:
    """Unwind for SIGTERM and SIGHUP, which would else end the process at once, torque on; SystemExit then.

    Handlers that a program has set stay. Outside of the main thread, which alone gets signals, this is idle.
    """
    main = threading.current_thread() is threading.main_thread()
    ours = [number for number in _SIGNALS if main and signal.getsignal(number) is signal.SIG_DFL]
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
    for each in _SIGNALS:  # once: torque is being switched off
        if signal.getsignal(each) is _unwind:
            signal.signal(each, signal.SIG_IGN)
    raise Interrupted(signal.Signals(number))
