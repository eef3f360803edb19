"""pyserial's handler of `mock://HUB/NAME`: a serial port on a `MockWire`.

pyserial imports this module by its name when `serial_for_url` meets the scheme; see `ports.open_port`. Time
on this port is the wire's virtual clock: writing and waiting move it, nothing else does.
"""

from typing import TYPE_CHECKING

from serial import PortNotOpenError, SerialException
from serial.serialutil import SerialBase

from palpate.drivers.transport.mock import MockWire, wire_for_url

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_POLL_S = 1e-3
"""Most that an empty non-blocking read moves the clock, so that a busy-wait on virtual time ends."""


class Serial(SerialBase):
    """A serial port in virtual time. The name is pyserial's rule for handler modules."""

    _wire: MockWire | None = None

    def open(self) -> None:
        """Connect to the wire. Raises DeviceError if no device is attached under the URL."""
        if self.port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        self._wire = wire_for_url(self.port)
        self.is_open = True
        self._wire.note_opened()
        self.reset_input_buffer()

    def close(self) -> None:
        """Disconnect; closing twice is harmless."""
        self.is_open = False
        self._wire = None

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived; does not move the clock."""
        wire = self._wire or self._require_wire()
        wire.poll()
        return wire.count_arrived(self.baudrate)

    @property
    def out_waiting(self) -> int:
        """Always 0: a write returns once its last bit has left."""
        self._require_wire()
        return 0

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes, waiting for them in virtual time for at most `timeout`.

        With timeout 0 an empty read is one poll: it moves the clock to the next arrival, by `POLL_S` at
        most, and returns what is there then. Without a timeout, a read that can never be filled raises
        SerialException instead of hanging.
        """
        wire = self._wire or self._require_wire()
        clock = wire.clock
        received = wire.take(size, self.baudrate)  # what has arrived before now
        if len(received) < size:
            received += self._take(wire, size - len(received))
        if len(received) >= size or (received and self.timeout == 0):
            return received
        start = clock.now()
        deadline = None if self.timeout is None else start + (self.timeout or _POLL_S)
        while len(received) < size:
            event = wire.next_event_s(size - len(received), together=self.timeout != 0)
            if event is None and deadline is None:
                raise SerialException(f"{self.port}: waiting without timeout for a device that never sends")
            expired = deadline is not None and (event is None or event > deadline)
            instant = deadline if expired else event
            assert instant is not None
            clock.advance_to(instant)
            received += self._take(wire, size - len(received))
            if expired or (received and self.timeout == 0):
                break
        return received

    def write(self, b: "ReadableBuffer", /) -> int:
        """Send bytes to the device, taking their wire time."""
        wire = self._require_wire()
        data = bytes(b)
        wire.send(data, self.baudrate)
        return len(data)

    def flush(self) -> None:
        """Return at once: a write returns once its last bit has left."""
        self._require_wire()

    def reset_input_buffer(self) -> None:
        """Forget the bytes that have arrived; those still under way will arrive."""
        wire = self._require_wire()
        wire.poll()
        wire.forget()

    def reset_output_buffer(self) -> None:
        """Do nothing: a write returns once its last bit has left."""
        self._require_wire()

    def _require_wire(self) -> MockWire:
        if self._wire is None:
            raise PortNotOpenError()
        return self._wire

    def _take(self, wire: MockWire, count: int) -> bytes:
        wire.poll()
        return wire.take(count, self.baudrate)

    def _reconfigure_port(self) -> None:
        """pyserial calls this on every changed setting; all of them are read where they are used."""

    def _update_break_state(self) -> None:
        """A mock wire has no break condition."""

    def _update_rts_state(self) -> None:
        """A mock wire has no modem lines."""

    def _update_dtr_state(self) -> None:
        """A mock wire has no modem lines."""
