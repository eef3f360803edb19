"""Wires in virtual time: the connection between a `mock://` port and an emulated device.

A `MockHub` owns the wires of one emulated rig and shares one `VirtualClock` among them. A wire carries one
byte after another: a byte is there once its last bit has arrived, so every byte costs its wire time.

pyserial makes ports from strings alone, through classes that it finds by module name. The table of hubs
below is therefore the one piece of module-level state in the drivers. It holds its hubs weakly: a hub
that is collected takes its URLs with it.
"""

import weakref
from collections import deque
from dataclasses import dataclass

from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.ports import PortMissing
from palpate.drivers.transport.wire import (
    BITS_PER_BYTE,
    AdaptedDevice,
    Device,
    Emission,
    OpenedDevice,
    RatedDevice,
    wire_time_s,
)

_MOCK_SCHEME = "mock"
_BURST_BYTE_S = 1e-9  # for a byte of a packet that an adapter hands over
_ROUNDING_BYTES = 1e-3  # of one byte's wire time; far above the clock's rounding, far below a byte

_HUBS: "weakref.WeakValueDictionary[str, MockHub]" = weakref.WeakValueDictionary()


@dataclass(slots=True)
class _Burst:
    """Bytes sent without a gap; byte i (from 0) has arrived at start_s + (i + 1) byte times."""

    start_s: float
    data: bytes
    baudrate: int
    byte_s: float
    taken: int = 0


class MockWire:
    """A serial wire with a device at its far end, in virtual time.

    `baudrate` is the device's; a `RatedDevice` speaks at the rate at which it was spoken to.
    """

    def __init__(self, url: str, device: Device, baudrate: int, clock: VirtualClock) -> None:
        if baudrate <= 0:
            raise ValueError(f"baud rate of {url} is {baudrate}; it must be positive")
        self.url = url
        self.baudrate = baudrate
        self.clock = clock
        self._device = device
        self._rated = device if isinstance(device, RatedDevice) else None
        self._adapted = device if isinstance(device, AdaptedDevice) else None
        self._bursts: deque[_Burst] = deque()
        self._free_s = 0.0

    def note_opened(self) -> None:
        """Note that a port has been opened at this end."""
        if isinstance(self._device, OpenedDevice):
            self._device.note_opened(self.clock.now())

    def send(self, data: bytes, baudrate: int) -> None:
        """Carry bytes to the device; moves the clock by their wire time.

        At a baud rate that is not the device's the time passes and the device understands nothing.
        """
        self.poll()
        self.clock.sleep(wire_time_s(len(data), baudrate))
        now = self.clock.now()
        if self._rated is not None:
            self._enqueue(self._rated.feed_at(data, now, baudrate), baudrate)
        elif baudrate == self.baudrate:
            self._enqueue(self._device.feed(data, now), baudrate)
        else:
            self.poll()

    def poll(self) -> None:
        """Take over what the device has sent of its own accord up to now. Does not move the clock."""
        emissions = self._device.poll(self.clock.now())
        if emissions:
            self._enqueue(emissions, self.baudrate)

    def count_arrived(self, baudrate: int) -> int:
        """Number of bytes that have arrived at a port of this rate and were not taken."""
        if not self._bursts:
            return 0
        now, count = self.clock.now(), 0
        for burst in self._bursts:
            arrived = _complete(burst, now)
            if burst.baudrate == baudrate:
                count += arrived - burst.taken
            if arrived < len(burst.data):
                break  # the next one begins after it
        return count

    def take(self, count: int, baudrate: int) -> bytes:
        """Take up to `count` of the bytes that have arrived at a port of this rate.

        Bytes at another rate are framing errors on a real port, nothing that could be read as a packet:
        they are lost.
        """
        bursts = self._bursts
        if not bursts:
            return b""
        now = self.clock.now()
        parts: list[bytes] = []
        while bursts and count > 0:
            burst = bursts[0]
            taken = burst.taken
            end = min(_complete(burst, now), taken + count)
            if end <= taken:
                break
            if burst.baudrate == baudrate:
                parts.append(burst.data[taken:end])
                count -= end - taken
            if end < len(burst.data):
                burst.taken = end
                break
            bursts.popleft()
        return b"".join(parts)

    def forget(self) -> None:
        """Drop all bytes that have arrived."""
        for rate in {burst.baudrate for burst in self._bursts}:
            self.take(self.count_arrived(rate), rate)

    def next_event_s(self, wanted: int, *, together: bool = True) -> float | None:
        """Instant at which up to `wanted` more bytes of the bursts under way will be there.

        `together`: of all of them, or of the first. With nothing under way: the instant at which the device
        will next send of its own accord; None if it never will.
        """
        for burst in self._bursts:
            left = len(burst.data) - burst.taken
            if wanted <= left or not together or burst is self._bursts[-1]:
                return burst.start_s + (burst.taken + min(wanted, left)) * burst.byte_s
            wanted -= left
        return self._device.next_due()

    def _enqueue(self, emissions: list[Emission], baudrate: int) -> None:
        byte_s = BITS_PER_BYTE / baudrate
        if self._adapted is not None:
            baudrate, byte_s = self._adapted.arrival_rate, _BURST_BYTE_S
        for instant, data in emissions:
            if not data:
                continue
            start = instant if instant > self._free_s else self._free_s
            burst = _Burst(start, data, baudrate, byte_s)
            self._free_s = start + len(data) * byte_s
            self._bursts.append(burst)


def _complete(burst: _Burst, now: float) -> int:
    """Number of its bytes that have arrived; those that were taken have."""
    count, most = int((now - burst.start_s) / burst.byte_s + _ROUNDING_BYTES), len(burst.data)
    if count >= most:
        return most
    return count if count > burst.taken else burst.taken


class MockHub:
    """The wires of one emulated rig, all on one virtual clock."""

    def __init__(self, clock: VirtualClock, name: str = "rig") -> None:
        """Claim the first free of `name`, `name-2`, `name-3`, … as this hub's part of the URL.

        It is free again once the hub is closed or collected.
        """
        self.clock = clock
        self._wires: dict[str, MockWire] = {}
        unique = name
        number = 1
        while unique in _HUBS:
            number += 1
            unique = f"{name}-{number}"
        self.name = unique
        _HUBS[unique] = self

    def attach(self, name: str, device: Device, baudrate: int) -> str:
        """Put a device on a new wire and return the URL of its port, good as long as the hub lives.

        Raises ValueError if the hub has a wire of that name.
        """
        if name in self._wires:
            raise ValueError(f"hub {self.name} already has a wire named {name}")
        url = f"{_MOCK_SCHEME}://{self.name}/{name}"
        self._wires[name] = MockWire(url, device, baudrate, self.clock)
        return url

    def close(self) -> None:
        """Give up name and URLs at once; open ports stay usable. Closing twice is harmless."""
        if _HUBS.get(self.name) is self:
            del _HUBS[self.name]

    def wire(self, name: str) -> MockWire | None:
        """Return the wire of that name, or None."""
        return self._wires.get(name)


def wire_for_url(url: str) -> MockWire:
    """Find the wire behind `mock://HUB/NAME`. Raises PortMissing if there is none."""
    hub_name, _, wire_name = url.partition("://")[2].partition("/")
    hub = _HUBS.get(hub_name)
    wire = hub.wire(wire_name) if hub is not None else None
    if wire is None:
        raise PortMissing(
            f"port {url} does not exist: no emulated device is attached under that name; "
            "check `port` in the rig file, or start the emulated rig first"
        )
    return wire
