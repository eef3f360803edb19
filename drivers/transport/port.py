"""Opening a serial port by name or URL; the boundary where pyserial's errors become ours.

A port is anything that pyserial's `serial_for_url` takes: a device path, `socket://host:port`, or the
`mock://HUB/NAME` of an emulated rig.
"""

import errno
import os

import serial
from serial.serialutil import SerialBase

from palpate.errors import DeviceError

try:
    from termios import error as _terminal_error
except ImportError:  # Windows has no terminals of this kind
    PORT_ERRORS: tuple[type[Exception], ...] = (OSError,)
else:
    PORT_ERRORS = (OSError, _terminal_error)
"""What a pyserial port may raise when its device goes away: SerialException is an OSError, and flushing an
unplugged port lets the terminal's own error through."""

_OPENING_ERRORS: tuple[type[Exception], ...] = (*PORT_ERRORS, ValueError)

__all__ = ["PORT_ERRORS", "open_port"]


def open_port(url: str, baudrate: int, *, timeout_s: float = 0.0) -> SerialBase:
    """Open a port (8N1), for this process alone, whose reads wait for at most `timeout_s`.

    Raises DeviceError naming the port if it does not exist, is taken, or refuses the baud rate.
    """
    handlers = __package__ or "palpate.drivers.transport"
    if handlers not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(handlers)
    try:
        port: SerialBase = serial.serial_for_url(url, baudrate=baudrate, timeout=timeout_s, exclusive=True)
    except _OPENING_ERRORS as error:
        raise DeviceError(
            f"port {url} does not exist or cannot be opened at {baudrate} baud: {_reason(error)}; "
            "check the cable and `port` in the rig file"
        ) from error
    return port


def _reason(error: Exception) -> str:
    """What the system said, without the layers that pyserial wraps around it."""
    code = error.errno if isinstance(error, OSError) else None
    if code in (errno.EAGAIN, errno.EBUSY):
        return "another program is using it"
    return os.strerror(code).lower() if code else str(error)
