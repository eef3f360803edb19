"""A port that can be opened again while somebody keeps using it: its adapter was unplugged for a moment."""

from collections.abc import Callable
from contextlib import suppress

from serial.serialutil import SerialBase

__all__ = ["ReopenedPort"]


class ReopenedPort:
    """The part of pyserial's port that drivers of arrays use, on whatever was opened last."""

    def __init__(self, reopen: Callable[[], SerialBase]) -> None:
        """Open it. Raises what `reopen` raises."""
        self._reopen = reopen
        self._port = reopen()

    def reopen(self) -> None:
        """Close it and open it again. Raises what opening raises; the old one is closed then, too."""
        self.close()
        self._port = self._reopen()

    def close(self) -> None:
        """Close it; closing twice is harmless."""
        with suppress(Exception):  # an adapter that is gone cannot be closed properly
            self._port.close()

    @property
    def port(self) -> str | None:
        """Name or URL."""
        name: str | None = self._port.port
        return name

    @property
    def timeout(self) -> float | None:
        """How long a read waits, s."""
        timeout: float | None = self._port.timeout
        return timeout

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        self._port.timeout = seconds

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        waiting: int = self._port.in_waiting  # type: ignore[attr-defined]
        return waiting

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes, waiting up to `timeout`."""
        return self._port.read(size)

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        return self._port.write(data)
