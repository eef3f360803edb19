"""Listening to a port without disturbing it. For the bytes alone; the session log needs more: see `record`.

`TappedPort` wraps any pyserial port, real or emulated, and tells an observer of every byte that passes.
"""

from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING

from serial.serialutil import SerialBase

from palpate.drivers.transport.clock import Clock

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

__all__ = ["BytesObserver", "Direction", "TappedPort"]


class Direction(Enum):
    """Which way bytes went, seen from the host."""

    SENT = "sent"
    RECEIVED = "received"


BytesObserver = Callable[[Direction, float, bytes], None]
"""Called with the direction, the instant (s on the port's clock) at which the host handed over or got the
bytes, and the bytes (never empty)."""


class TappedPort(SerialBase):
    """A pyserial port that passes everything on to another one and reports the bytes to an observer."""

    def __init__(self, port: SerialBase, clock: Clock, on_bytes: BytesObserver) -> None:
        """Wrap an open port; the wrapper takes over closing it."""
        super().__init__()
        self._inner = port
        self._clock = clock
        self._on_bytes = on_bytes
        self._port = port.port
        self.name = self.portstr = port.port
        self._baudrate = port.baudrate
        self._timeout = port.timeout
        self._write_timeout = port.write_timeout
        self.is_open = port.is_open

    def open(self) -> None:
        """Open the port beneath again after it was closed."""
        self._inner.open()  # type: ignore[attr-defined]  # every pyserial port has it, the base class has not
        self.is_open = True

    def close(self) -> None:
        """Close the port beneath; closing twice is harmless."""
        self.is_open = False
        inner = self.__dict__.get("_inner")  # absent if the garbage collector closes a half-made wrapper
        if inner is not None:
            inner.close()

    @property
    def in_waiting(self) -> int:
        """Number of bytes that the port beneath has ready."""
        return int(self._inner.in_waiting)  # type: ignore[attr-defined]

    @property
    def out_waiting(self) -> int:
        """Number of bytes that the port beneath has still to send."""
        return int(self._inner.out_waiting)  # type: ignore[attr-defined]

    def read(self, size: int = 1, /) -> bytes:
        """Read from the port beneath and report what came."""
        data = self._inner.read(size)
        if data:
            self._on_bytes(Direction.RECEIVED, self._clock.now(), data)
        return data

    def write(self, b: "ReadableBuffer", /) -> int | None:
        """Report the bytes and write them to the port beneath."""
        data = bytes(b)
        if data:
            self._on_bytes(Direction.SENT, self._clock.now(), data)
        return self._inner.write(data)

    def flush(self) -> None:
        """Wait until the port beneath has sent everything."""
        self._inner.flush()

    def reset_input_buffer(self) -> None:
        """Drop what the port beneath has ready; bytes dropped unread are not reported."""
        self._inner.reset_input_buffer()  # type: ignore[attr-defined]

    def reset_output_buffer(self) -> None:
        """Drop what the port beneath has still to send."""
        self._inner.reset_output_buffer()  # type: ignore[attr-defined]

    def _reconfigure_port(self) -> None:
        self._inner.baudrate = self._baudrate
        self._inner.timeout = self._timeout
        self._inner.write_timeout = self._write_timeout

    def _update_break_state(self) -> None:
        self._inner.break_condition = self.break_condition

    def _update_rts_state(self) -> None:
        self._inner.rts = self.rts

    def _update_dtr_state(self) -> None:
        self._inner.dtr = self.dtr
