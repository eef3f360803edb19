"""Errors that come from outside, as values of the session log and back: a replay raises them again."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from serial import PortNotOpenError, SerialException, SerialTimeoutException

from palpate.base.errors import DeviceError
from palpate.drivers.transport.port import PORT_ERRORS, PortTaken
from palpate.rig.session.signals import Interrupted

__all__ = ["INTERRUPTS", "KINDS", "error_of", "values_of"]

INTERRUPTS = ("Interrupted", "KeyboardInterrupt")


def _port_not_open(*_: object) -> PortNotOpenError:
    return PortNotOpenError()


_MAKERS: Mapping[str, tuple[type[BaseException], Callable[..., BaseException]]] = {
    "DeviceError": (DeviceError, DeviceError),
    "Interrupted": (Interrupted, Interrupted.of),
    "KeyboardInterrupt": (KeyboardInterrupt, KeyboardInterrupt),
    "PortTaken": (PortTaken, PortTaken),
    "PortNotOpenError": (PortNotOpenError, _port_not_open),
    "SerialException": (SerialException, SerialException),
    "SerialTimeoutException": (SerialTimeoutException, SerialTimeoutException),
    "OSError": (OSError, OSError),
    "TerminalError": (PORT_ERRORS[-1], PORT_ERRORS[-1]),
    "TypeError": (TypeError, TypeError),
    "ValueError": (ValueError, ValueError),
}

KINDS = tuple(_MAKERS)
"""Names of the kinds of errors that can be raised again."""


def values_of(error: BaseException) -> dict[str, Any]:
    """The error's nearest kind that can be raised again, else its own name, and what it is made from."""
    names = {kind: name for name, (kind, _) in _MAKERS.items()}
    kind = next((names[base] for base in type(error).__mro__ if base in names), type(error).__name__)
    simple = all(isinstance(item, str | int) for item in error.args)
    return {
        "kind": kind,
        "args": list(error.args) if simple else [str(error)],
        "message": str(error),
    }


def error_of(kind: str, args: Sequence[str | int]) -> BaseException | None:
    """The error to raise again; None if there is no such kind, or it cannot be made from that."""
    _, maker = _MAKERS.get(kind, (None, None))
    if maker is not None:
        with contextlib.suppress(TypeError, KeyError, ValueError):
            return maker(*args)
    return None
