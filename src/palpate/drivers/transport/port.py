"""Opening a serial port by name or URL; the boundary where pyserial's errors become ours.

A port is anything that pyserial's `serial_for_url` takes: a device path, `socket://host:port`, or the
`mock://HUB/NAME` of an emulated rig.
"""

import errno
import os

import serial
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError

try:
    from termios import error as _terminal_error
except ImportError:  # Windows has no terminals of this kind
    PORT_ERRORS: tuple[type[Exception], ...] = (OSError,)
else:
    PORT_ERRORS = (OSError, _terminal_error)
"""What a pyserial port may raise when its device goes away: SerialException is an OSError, and flushing an
unplugged port lets the terminal's own error through."""

_OPENING_ERRORS: tuple[type[Exception], ...] = (*PORT_ERRORS, ValueError)
_TAKEN = (errno.EAGAIN, errno.EBUSY)
_FORBIDDEN = (errno.EACCES, errno.EPERM)
_MISSING = (errno.ENOENT, errno.ENODEV, errno.ENXIO)
_FIND = "check the cable and the port's name (palpate find-port lists what is there)"

__all__ = ["PORT_ERRORS", "PortForbidden", "PortMissing", "PortTaken", "has_baudrate", "open_port"]


class PortTaken(DeviceError):
    """Another program has the port for itself."""


class PortForbidden(DeviceError):
    """This user may not open the port."""


class PortMissing(DeviceError):
    """There is no such port."""


def open_port(url: str, baudrate: int, *, timeout_s: float = 0.0, shared: bool = False) -> SerialBase:
    """Open a port (8N1), for this process alone, whose reads wait for at most `timeout_s`.

    `shared`: also if another program has it, which loses what is read here; for an emergency stop only.
    Raises PortTaken if another program uses the port, PortForbidden if this user may not, PortMissing if it
    does not exist, another DeviceError naming it if it refuses the baud rate.
    """
    handlers = __package__ or "palpate.drivers.transport"
    if handlers not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.insert(
            0, handlers
        )  # before pyserial's own: ours correct one of them
    try:
        port: SerialBase = serial.serial_for_url(
            url, baudrate=baudrate, timeout=timeout_s, exclusive=None if shared else True
        )
    except _OPENING_ERRORS as error:
        if isinstance(error, OSError) and error.errno in _TAKEN:
            raise PortTaken(
                f"port {url} is in use: another program is using it; close that program, then try again"
            ) from error
        if isinstance(error, OSError) and error.errno in _FORBIDDEN:
            raise PortForbidden(
                f"port {url} may not be opened by this user; join the group that owns it "
                "(sudo usermod -aG dialout $USER), then log in again"
            ) from error
        missing = isinstance(error, OSError) and error.errno in _MISSING
        what = "does not exist" if missing else f"does not exist or cannot be opened at {baudrate} baud"
        raise (PortMissing if missing else DeviceError)(
            f"port {url} {what}: {_reason(error)}; {_FIND}"
        ) from error
    return port


def has_baudrate(url: str) -> bool:
    """Whether a port sends at the rate with which it is opened; of `socket://` the other end decides."""
    return not url.lower().startswith("socket://")


def _reason(error: Exception) -> str:
    """What the system said, without the layers that pyserial wraps around it."""
    code = error.errno if isinstance(error, OSError) else None
    return os.strerror(code).lower() if code else str(error)
