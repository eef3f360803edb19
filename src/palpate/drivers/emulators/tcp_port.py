"""A served device on a TCP port of this computer: for clients that open `socket://HOST:PORT`.

Raw bytes both ways, as serial device servers give them. A socket has no baud rate: the device is spoken to at
its own. One client at a time: whoever comes while there is one finds the connection closed again at once.
"""

import contextlib
import os
import socket

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.served_port import CHUNK, ServedPort
from palpate.drivers.transport.wire import Device

__all__ = ["LOOPBACK", "TcpPort"]

LOOPBACK = "127.0.0.1"


class TcpPort(ServedPort):
    """One device on its TCP port; `address` is the port's URL."""

    def __init__(self, device: Device, baudrate: int, port: int = 0, host: str = LOOPBACK) -> None:
        """Listen on `port` of an address of this computer, 0 for any free one. DeviceError if it is taken."""
        super().__init__(device, baudrate)
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._client: socket.socket | None = None
        try:
            # ports of a service that has just ended may be used again at once
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((host, port))
            self._listener.listen()
        except (OSError, OverflowError) as error:
            self._listener.close()
            code = error.errno if isinstance(error, OSError) else None
            reason = os.strerror(code).lower() if code else str(error)
            raise DeviceError(
                f"no TCP port {host}:{port} for an emulated device: {reason}; choose other ports"
            ) from error
        self._listener.setblocking(False)
        self.address = f"socket://{host}:{self._listener.getsockname()[1]}"

    def handles(self) -> list[int]:
        """Where clients come, and the one that is there."""
        found = [self._listener, *([] if self._client is None else [self._client])]
        return [one.fileno() for one in found]

    def close(self) -> None:
        """Stop listening and leave the client, which sees an unplug."""
        self._listener.close()
        self._leave()

    def _receive(self) -> bytes:
        data = self._heard()
        if not data:  # only now is it known whether the last client is still there
            self._welcome()
        return data

    def _heard(self) -> bytes:
        if self._client is None:
            return b""
        try:
            data = self._client.recv(CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._leave()
        return data

    def _welcome(self) -> None:
        try:
            come, _ = self._listener.accept()
        except OSError:  # no client, or gone again
            return
        if self._client is not None:
            come.close()
            return
        come.setblocking(False)
        # without this the system holds small packets back until earlier ones are confirmed
        come.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = come

    def _leave(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _send(self, data: bytes) -> None:
        if self._client is None:
            return
        try:
            with contextlib.suppress(BlockingIOError):
                self._client.send(data)
        except OSError:
            self._leave()
