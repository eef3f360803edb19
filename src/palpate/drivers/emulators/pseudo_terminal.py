"""Pseudo-terminal with an emulated device at its other end, on systems that have such terminals."""

import contextlib
import os
import struct
import threading

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.device_server import CHUNK_BYTES, Devices, DeviceServer, ServedPort
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import Device

with contextlib.suppress(ImportError):  # Windows has none of them
    import fcntl
    import termios
    import tty

# struct termios2 of <asm-generic/termbits.h>: four words of flags, c_line and c_cc, both speeds as numbers
_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("4I20s2I")


class PtyPort(ServedPort):
    """One device on its pseudo-terminal; `address` is the terminal's path."""

    def __init__(self, device: Device, baudrate: int) -> None:
        """Open a terminal. Raises DeviceError if the system has none, or none left."""
        super().__init__(device, baudrate)
        if not hasattr(os, "openpty"):
            raise DeviceError(
                "this system has no pseudo-terminals; serve on TCP ports (palpate emulate --tcp)"
            )
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise DeviceError(
                f"no pseudo-terminal for an emulated device: {error}; close some terminals"
            ) from error
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(self._slave)

    def handles(self) -> list[int]:
        """The terminal's other side."""
        return [self._master]

    def close(self) -> None:
        """Close both sides; clients see an unplug."""
        os.close(self._master)
        os.close(self._slave)

    def _receive(self) -> bytes:
        try:
            return os.read(self._master, CHUNK_BYTES)
        except BlockingIOError:
            return b""

    def _send(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def _client_rate(self) -> int:
        rate = baud_rate(self._master)
        return self.baudrate if rate is None else rate


def baud_rate(fd: int) -> int | None:
    """Rate (baud) at which a terminal sends; None if the system cannot tell.

    Python's termios knows named rates only, and cannot tell if the client has set its rate as a number, as
    some do at any rate.
    """
    try:
        return int(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size)))[-1])
    except OSError:
        coded = termios.tcgetattr(fd)[5]
        names = (name for name in dir(termios) if name[0] == "B" and name[1:].isdigit())
        return next((int(name[1:]) for name in names if getattr(termios, name) == coded), None)


def serve_pty(devices: Devices, clock: Clock, stop: threading.Event) -> DeviceServer:
    """Serve devices on pseudo-terminals, until `stop` is set; returns at once.

    Devices are given by name with their baud rates. `clock` must run in real time. Raises DeviceError if the
    system has no pseudo-terminals, or none left.
    """
    return DeviceServer(devices, lambda _, device, baudrate: PtyPort(device, baudrate), clock, stop)
