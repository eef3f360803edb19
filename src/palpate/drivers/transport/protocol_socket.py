"""pyserial's handler of `socket://HOST:PORT`, corrected where it behaves differently from a serial port.

pyserial imports this module by its name, before its own, once `ports.open_port` has added this package.
Corrected:

- `in_waiting` says how many bytes there are, not whether there are any, and notices that the other end is
  gone;
- small packets leave at once (TCP_NODELAY): otherwise the system holds a second one back until the first is
  confirmed, for up to 40 ms;
- `close` does not sleep, and closes also when the other end has gone first;
- `out_waiting` is there, and an address without a port is called what it is;
- opening fails at once if the other end hangs up because it serves somebody else, as a serial port that is in
  use does, and says why as other ports do.

A socket has no baud rate: it is accepted and means nothing.
"""

import contextlib
import errno
import os
import select
import socket
from urllib.parse import urlsplit

from serial import PortNotOpenError, SerialException
from serial.urlhandler import protocol_socket

_REFUSAL_S = 0.05  # whoever serves one client at a time hangs up on another one within this time
_MAX_READ_BYTES = 65536


class Serial(protocol_socket.Serial):
    """A TCP connection as a serial port. The name is pyserial's rule for handler modules."""

    _socket: socket.socket | None = None

    def open(self) -> None:
        """Connect. Raises SerialException, with EBUSY if the other end serves somebody else."""
        try:
            super().open()
        except SerialException as error:
            self.close()
            cause = error.__context__
            if isinstance(cause, SerialException):
                raise cause from None
            if isinstance(cause, OSError) and (cause.errno or 0) > 0:
                raise SerialException(cause.errno, os.strerror(cause.errno or 0)) from cause
            raise
        link = self._require_socket()
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        select.select([link], [], [], _REFUSAL_S)
        try:
            self._waiting(link)
        except OSError as error:
            self.close()
            raise SerialException(errno.EBUSY, "the other end has hung up") from error

    def from_url(self, url: str) -> tuple[str, int]:
        """Host and port of an address. Raises SerialException if they are not there."""
        parts = urlsplit(url)
        with contextlib.suppress(ValueError):  # a port number beyond 65535
            if parts.hostname and parts.port:
                return parts.hostname, parts.port
        raise SerialException("it should be socket://HOST:PORT")

    def close(self) -> None:
        """Hang up; closing twice is harmless."""
        self.is_open = False
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived. Raises SerialException if the other end has hung up."""
        return self._waiting(self._require_socket())

    @property
    def out_waiting(self) -> int:
        """Always 0: the system sends on its own."""
        self._require_socket()
        return 0

    def _waiting(self, link: socket.socket) -> int:
        try:
            count = len(link.recv(_MAX_READ_BYTES, socket.MSG_PEEK))
        except BlockingIOError:
            return 0
        except OSError as error:
            raise SerialException(error.errno, f"read failed: {error}") from error
        if not count:
            raise SerialException("the other end has hung up")
        return count

    def _require_socket(self) -> socket.socket:
        if self._socket is None:
            raise PortNotOpenError()
        return self._socket
