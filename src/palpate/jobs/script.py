"""Surroundings of a script: warnings for its operator, and signals that unwind it, so that torque is off.

The command line imports it at start-up: nothing but the standard library and the session's signals.
"""

import signal
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from palpate.rig.session.signals import Interrupted


class RigWarning(UserWarning):
    """Warning about a run that the operator should know and that does not stop it."""


def warn_operator(text: str) -> None:
    """Warn with `text`."""
    warnings.warn(text, RigWarning, stacklevel=2)


_UNWINDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def unwind_on_signals() -> Iterator[None]:
    """Unwind for SIGTERM and SIGHUP, which would else end the process at once, torque on; SystemExit then.

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
