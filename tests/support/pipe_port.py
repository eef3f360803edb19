"""A port made of two named pipes, one for each way; with the methods that a driver calls on a serial port."""

import array
import fcntl
import os
import select
import termios

__all__ = ["PipePort"]

_HELD_BYTES = 1 << 20  # what Linux lets any user ask for


class PipePort:
    """Reads `path`.out, which then holds a MiB that has not been read, and writes `path`.in."""

    def __init__(self, path: str) -> None:
        self._incoming = os.open(f"{path}.out", os.O_RDONLY | os.O_NONBLOCK)
        self._outgoing = os.open(f"{path}.in", os.O_WRONLY)
        fcntl.fcntl(self._incoming, fcntl.F_SETPIPE_SZ, _HELD_BYTES)
        self.port: str | None = path
        self.timeout: float | None = 0.0

    @property
    def in_waiting(self) -> int:
        held = array.array("i", [0])
        fcntl.ioctl(self._incoming, termios.FIONREAD, held)
        return held[0]

    def read(self, size: int = 1, /) -> bytes:
        ready, _, _ = select.select([self._incoming], [], [], self.timeout)
        return os.read(self._incoming, size) if ready else b""

    def write(self, data: bytes, /) -> int | None:
        return os.write(self._outgoing, data)

    def close(self) -> None:
        os.close(self._incoming)
        os.close(self._outgoing)
