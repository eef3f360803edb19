"""A served device on a pseudo-terminal: for clients that want a device path and a baud rate.

As on a real wire, a client that opens the port at another baud rate than the device's is not understood; a
device that knows rates decides for itself. The slave side is held open here, so that clients may come and go.
"""

import contextlib
import os
import tty

from palpate.drivers.emulators.line import CHUNK, Line
from palpate.drivers.emulators.terminal import baud_rate
from palpate.drivers.transport.wire import Device
from palpate.errors import DeviceError

__all__ = ["PtyLine"]


class PtyLine(Line):
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
