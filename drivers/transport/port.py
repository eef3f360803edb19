"""Opening a serial port by name or URL; the boundary where pyserial's errors become ours.

A port is anything that pyserial's `serial_for_url` takes: a device path, `socket://host:port`, or the
`mock://HUB/NAME` of an emulated rig.
"""

import serial
from serial.serialutil import SerialBase

from palpate.errors import DeviceError

__all__ = ["open_port"]


def open_port(url: str, baudrate: int, *, timeout_s: float = 0.0) -> SerialBase:
    """Open a port (8N1), for this process alone, whose reads wait for at most `timeout_s`.

    Raises DeviceError naming the port if it does not exist, is taken, or refuses the baud rate.
    """
    handlers = __package__ or "palpate.drivers.transport"
    if handlers not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(handlers)
    try:
        port: SerialBase = serial.serial_for_url(url, baudrate=baudrate, timeout=timeout_s, exclusive=True)
    except (OSError, ValueError) as error:
        raise DeviceError(
            f"port {url} does not exist or cannot be opened at {baudrate} baud: {error}; "
            "check the cable and `port` in the rig file"
        ) from error
    return port
