"""Interface between a wire and the devices on it, used by every transport (in process, pty).

A device is a transport-free core: it is fed the bytes that reached it and the time at which they did, and
answers with bytes and the times at which it starts to send them. It never blocks, sleeps or reads a clock.

A plain device has one baud rate, and only the transport knows it: bytes at another rate never reach it. A bus
whose members have rates of their own is a `RatedDevice`.
"""

from typing import Protocol, runtime_checkable

BITS_PER_BYTE = 10  # 8 data bits, one start bit, one stop bit

Emission = tuple[float, bytes]
"""(instant in s at which the first bit leaves the device, the bytes)."""


class Device(Protocol):
    """One end of a serial wire, as a state machine."""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes whose last bit arrived at `now`; return what they provoke."""
        ...

    def poll(self, now: float) -> list[Emission]:
        """Return what the device has sent of its own accord up to `now`.

        A transport polls when it has seen that no bytes came until `now`.
        """
        ...

    def next_due(self) -> float | None:
        """Instant of the next unprovoked emission, or None if there is none in sight."""
        ...


@runtime_checkable
class RatedDevice(Device, Protocol):
    """A device that takes the rate of the bytes that reach it, and answers at that rate."""

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:
        """Take bytes sent at `baudrate` whose last bit arrived at `now`; return what they provoke."""
        ...


@runtime_checkable
class OpenedDevice(Device, Protocol):
    """A device that notices when its port is opened: by DTR, as a rule."""

    def note_opened(self, now: float) -> None:
        """Take note that a port was opened at `now`."""
        ...


@runtime_checkable
class AdaptedDevice(Device, Protocol):
    """A device behind an adapter, whose packets reach the host whole at the instants of their emissions."""

    @property
    def arrival_rate(self) -> int:
        """Rate of what it hands over."""
        ...


def wire_time_s(count: int, baudrate: int) -> float:
    """Seconds that `count` bytes occupy a wire at `baudrate` (8N1)."""
    return count * BITS_PER_BYTE / baudrate
