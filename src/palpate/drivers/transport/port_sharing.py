"""Several users of one connection: what comes goes to each of them.

A board may carry the sensors of several fingers. In a rig file their ports are the board's with a mark and a
name of their own, as `/dev/ttyACM0#1` and `/dev/ttyACM0#2`.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import cast

from serial.serialutil import SerialBase, SerialException

_MARK = "#"
_MAX_KEPT_BYTES = 1 << 16  # for a user who does not read


def connection_of(port: str) -> str:
    """Port without what tells its users apart."""
    return port.partition(_MARK)[0]


class _Line:
    """An open port and its users."""

    def __init__(self, port: SerialBase) -> None:
        self.port = port
        self.users: list[SharedPort] = []
        self.is_open = True

    def read(self, size: int, timeout_s: float | None) -> None:
        """Read up to `size` bytes for all users; one that fails ends the connection for all."""
        try:
            self.port.timeout = timeout_s
            data = self.port.read(size)
        except Exception:
            self.close()
            raise
        for user in self.users:
            user.unread = (user.unread + data)[-_MAX_KEPT_BYTES:]

    def waiting(self) -> int:
        """Bytes that can be read without waiting; raises SerialException once it was closed."""
        if not self.is_open:
            raise SerialException("the connection that it shares has failed")
        try:
            return int(self.port.in_waiting)  # type: ignore[attr-defined]
        except Exception:
            self.close()
            raise

    def close(self) -> None:
        """Close it for all users."""
        if self.is_open:
            self.is_open = False
            with suppress(Exception):  # an adapter that is gone cannot be closed properly
                self.port.close()


class SharedPort:
    """The part of pyserial's port that drivers of arrays use, for one of the users of a connection."""

    def __init__(self, line: _Line, name: str) -> None:
        self.port: str | None = name
        self.timeout: float | None = 0.0
        self.write_timeout: float | None = line.port.write_timeout
        self.baudrate: int = line.port.baudrate
        self.unread = b""
        self._line = line
        line.users.append(self)

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        if waiting := self._line.waiting():
            self._line.read(waiting, 0.0)
        return len(self.unread)

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes, waiting up to `timeout` for the first."""
        if not self.in_waiting:
            self._line.read(size, self.timeout)
        data, self.unread = self.unread[:size], self.unread[size:]
        return data

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        self._line.waiting()
        return self._line.port.write(data)

    def close(self) -> None:
        """Leave the connection, which its last user closes."""
        if self in self._line.users:
            self._line.users.remove(self)
        if not self._line.users:
            self._line.close()


class PortSharing:
    """Opens ports by `open_port`, those of one connection once."""

    def __init__(self, open_port: Callable[[str, int], SerialBase]) -> None:
        self._open_port = open_port
        self._lines: dict[str, _Line] = {}

    def open(self, port: str, baudrate: int) -> SerialBase:
        """Open a port, or join those who have its connection open. Raises what opening raises."""
        name = connection_of(port)
        if name == port:
            return self._open_port(port, baudrate)
        line = self._lines.get(name)
        if line is None or not line.is_open:
            line = self._lines[name] = _Line(self._open_port(name, baudrate))
        return cast("SerialBase", SharedPort(line, port))
