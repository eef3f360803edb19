"""A served device on a pseudo-terminal: for clients that want a device path and a baud rate.

As on a real wire, a client that opens the port at another baud rate than the device's is not understood; a
device that knows rates decides for itself. The slave side is held open here, so that clients may come and go.
"""

import contextlib
import fcntl
import os
import struct
import termios
import tty

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.served_port import CHUNK, ServedPort
from palpate.drivers.transport.wire import Device

__all__ = ["PtyPort", "baud_rate"]

# struct termios2 of <asm-generic/termbits.h>: four words of flags, c_line and c_cc, both speeds as numbers
_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("4I20s2I")
_NAMED = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
}


class PtyPort(ServedPort):
    """One device on its pseudo-terminal; `address` is the terminal's path."""

    def __init__(self, device: Device, baudrate: int) -> None:
        """Open a terminal. Raises DeviceError if the system has none left."""
        super().__init__(device, baudrate)
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
            return os.read(self._master, CHUNK)
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
        return _NAMED.get(termios.tcgetattr(fd)[5])
