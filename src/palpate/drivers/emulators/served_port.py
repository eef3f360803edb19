"""What one served device hangs on, seen from the service. Between `serve` and a device.

A line feeds the device what its client sends, and delivers the device's answers when their last bit has
arrived. `pty_port` and `tcp_port` say how clients come, send and receive.
"""

from abc import ABC, abstractmethod
from collections import deque

from palpate.drivers.transport.wire import AdaptedDevice, Device, Emission, RatedDevice, wire_time_s

__all__ = ["CHUNK", "ServedPort"]

CHUNK = 4096
"""Most bytes that are taken from a client at once."""


class ServedPort(ABC):
    """One device, and the port on which clients reach it. `address` is what a client opens."""

    address: str

    def __init__(self, device: Device, baudrate: int) -> None:
        self.device = device
        self.baudrate = baudrate
        self._free_s = 0.0
        self._outgoing: deque[tuple[float, bytes, int]] = deque()  # arrival, bytes, their rate

    @abstractmethod
    def handles(self) -> list[int]:
        """File descriptors that become readable when there is something to `take`."""

    @abstractmethod
    def close(self) -> None:
        """Take the port away."""

    @abstractmethod
    def _receive(self) -> bytes:
        """What a client has sent, empty if nothing. Does not wait."""

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Hand bytes to the client. One that does not read loses them, as at a full receive buffer."""

    def _client_rate(self) -> int:
        """The client's baud rate, or the device's where that is unknown."""
        return self.baudrate

    def take(self, now: float) -> None:
        """Feed the device what a client has sent."""
        data = self._receive()
        if not data:
            return
        rate = self._client_rate()
        if isinstance(self.device, RatedDevice):
            self._schedule(self.device.feed_at(data, now, rate), rate)
        elif rate == self.baudrate:
            self._schedule(self.device.feed(data, now), rate)

    def run(self, now: float) -> None:
        """Let the device speak, and deliver what has arrived at the client by now."""
        self._schedule(self.device.poll(now), self.baudrate)
        while self._outgoing and self._outgoing[0][0] <= now:
            _, data, rate = self._outgoing.popleft()
            if rate == self._client_rate():
                self._send(data)

    def next_event_s(self) -> float | None:
        """Instant of the next delivery or of the device's next own emission."""
        own = self.device.next_due()
        if not self._outgoing:
            return own
        return self._outgoing[0][0] if own is None else min(own, self._outgoing[0][0])

    def _schedule(self, emissions: list[Emission], rate: int) -> None:
        adapted = self.device if isinstance(self.device, AdaptedDevice) else None
        if adapted is not None:
            rate = adapted.arrival_rate
        for instant, data in emissions:
            lasts = wire_time_s(len(data), rate) if adapted is None else 0.0
            self._free_s = max(instant, self._free_s) + lasts
            self._outgoing.append((self._free_s, data, rate))
