"""Seeded faults of a wire: noise, loss, repetition, delay, broken packets, unplugging, a board that resets.

A `FaultyWire` stands between any transport and any emulated device, and is a `Device` itself. A packet here
is what is handed over at once: the bytes of one write of the host, or of one emission of the device. Chance
comes from the seed alone, by its own stream for each direction.

A `BootingBoard` resets as its port is opened, as those with an Arduino's reset circuit do: DTR pulls the
reset line through a capacitor. The bootloader then waits for a new program and throws away whatever else it
hears; only then does the firmware run, with all settings lost.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import serial

from palpate.drivers.transport.wire import Device, Emission, OpenedDevice, RatedDevice

_Deliver = Callable[[bytes, float], list[Emission]]
"""How a device is handed bytes: their last bit arrived at the instant (s)."""

_WRITE_FAILED = "write failed: [Errno 5] Input/output error"
_READ_FAILED = (
    "device reports readiness to read but returned no data (device disconnected or multiple access on port?)"
)


@dataclass(frozen=True, slots=True)
class FaultRates:
    """Probabilities of faults in one direction.

    `flipped` counts for each byte, which then has one bit flipped; the others count for each packet. A
    packet that is `lost` has no other fault. One that is `cut` keeps its beginning, of one byte at least,
    so a packet of a single byte is never cut. One that is `duplicated` comes twice, each copy with flipped
    bits of its own. One that is `late` is held back by up to `late_s` (s), and what follows it waits behind
    it.
    """

    flipped: float = 0.0
    lost: float = 0.0
    cut: float = 0.0
    duplicated: float = 0.0
    late: float = 0.0
    late_s: float = 0.01

    def __post_init__(self) -> None:
        """Refuse what is no probability, and a negative delay, with ValueError."""
        for rate in ("flipped", "lost", "cut", "duplicated", "late"):
            if not 0.0 <= getattr(self, rate) <= 1.0:
                raise ValueError(f"{rate} is {getattr(self, rate)}; a rate is from 0 to 1")
        if not 0.0 <= self.late_s < np.inf:
            raise ValueError(f"late_s is {self.late_s}; a delay is 0 or more")


@dataclass(frozen=True, slots=True)
class WireRates:
    """Rates of both directions."""

    to_device: FaultRates = FaultRates()
    to_host: FaultRates = FaultRates()


@dataclass(slots=True)
class FaultCounts:
    """Counts of one direction so far: packets that came, and how many of them had which fault.

    `flipped` counts bytes, in every copy of a packet.
    """

    packets: int = 0
    flipped: int = 0
    lost: int = 0
    cut: int = 0
    duplicated: int = 0
    late: int = 0

    @property
    def faults(self) -> int:
        """Faults of all kinds."""
        return self.flipped + self.lost + self.cut + self.duplicated + self.late


@dataclass(slots=True)
class WireCounts:
    """Counts of both directions."""

    to_device: FaultCounts = field(default_factory=FaultCounts)
    to_host: FaultCounts = field(default_factory=FaultCounts)


class FaultyWire:
    """A device behind a wire that spoils what passes. `rates` may be changed at any time.

    With `unplugged` set, every use raises serial.SerialException as pyserial does once an adapter is gone;
    the device lives on, unheard. What was under way is lost.
    """

    def __init__(self, device: Device, seed: int, rates: WireRates | None = None) -> None:
        self.rates = rates or WireRates()
        self.counts = WireCounts()
        self.unplugged = False
        self._device = device
        self._chance_out, self._chance_back = (np.random.default_rng([seed, way]) for way in (0, 1))
        self._waiting: deque[tuple[float, bytes, _Deliver]] = deque()
        self._held_s = -np.inf

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Pass bytes on to the device, now or later; return what reaches the host."""
        return self._pass(data, now, self._device.feed)

    def _pass(self, data: bytes, now: float, hand: _Deliver) -> list[Emission]:
        if self.unplugged:
            self._live_unheard(now)
            raise serial.SerialException(_WRITE_FAILED)
        emissions = self._deliver(now)
        heard = False
        delay, copies = _corrupt(data, self.rates.to_device, self.counts.to_device, self._chance_out)
        for copy in copies:
            if delay > 0.0 or self._waiting:
                due = now + delay
                self._waiting.append((max(due, self._waiting[-1][0]) if self._waiting else due, copy, hand))
            else:
                emissions += hand(copy, now)
                heard = True
        if not heard:
            emissions += self._device.poll(now)
        return self._spoil(emissions)

    def poll(self, now: float) -> list[Emission]:
        """Return what reaches the host of what the device has sent of its own accord up to `now`."""
        if self.unplugged:
            self._live_unheard(now)
            raise serial.SerialException(_READ_FAILED)
        return self._spoil(self._deliver(now) + self._device.poll(now))

    def note_opened(self, now: float) -> None:
        """Let the device notice that its port was opened, if it does such things."""
        if isinstance(self._device, OpenedDevice):
            self._device.note_opened(now)

    def next_due(self) -> float | None:
        """Instant of the next unprovoked emission, or of the next late packet's arrival at the device."""
        if self.unplugged:
            return None
        own = self._device.next_due()
        if not self._waiting:
            return own
        return self._waiting[0][0] if own is None else min(own, self._waiting[0][0])

    def _deliver(self, now: float) -> list[Emission]:
        """Hand the device the late packets that are due, at the instants at which they were."""
        emissions: list[Emission] = []
        while self._waiting and self._waiting[0][0] <= now:
            due, data, hand = self._waiting.popleft()
            emissions += hand(data, due)
        return emissions

    def _spoil(self, emissions: list[Emission]) -> list[Emission]:
        spoiled: list[Emission] = []
        for instant, data in emissions:
            delay, copies = _corrupt(data, self.rates.to_host, self.counts.to_host, self._chance_back)
            arrival = max(instant + delay, self._held_s)
            if delay > 0.0:
                self._held_s = arrival
            spoiled += [(arrival, copy) for copy in copies]
        return spoiled

    def _live_unheard(self, now: float) -> None:
        self._waiting.clear()
        self._device.poll(now)


class RatedFaultyWire(FaultyWire):
    """Faulty wire for a device that takes the rate of bytes with them; it answers late ones at the usual
    rate.
    """

    def __init__(self, device: RatedDevice, seed: int, rates: WireRates | None = None) -> None:
        super().__init__(device, seed, rates)
        self._rated = device

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:
        """Pass bytes sent at `baudrate` on to the device, now or later; return what reaches the host."""
        return self._pass(data, now, lambda copy, instant: self._rated.feed_at(copy, instant, baudrate))


def _corrupt(
    data: bytes, rates: FaultRates, counts: FaultCounts, chance: np.random.Generator
) -> tuple[float, list[bytes]]:
    """The delay (s) of a packet and the copies of it that get through, spoiled and counted.

    Bytes that are none are passed on as they are.
    """
    if not data:
        return 0.0, [data]
    lost, cut, duplicated, late, end, delay = chance.random(6)
    flips = chance.random((2, len(data))) < rates.flipped
    bits = 1 << chance.integers(0, 8, (2, len(data)))
    counts.packets += 1
    if lost < rates.lost:
        counts.lost += 1
        return 0.0, []
    size = len(data)
    if cut < rates.cut and size > 1:
        counts.cut += 1
        size = 1 + int(end * (size - 1))
    number = 1
    if duplicated < rates.duplicated:
        counts.duplicated += 1
        number = 2
    flipped = np.where(flips, bits, 0)[:number, :size]
    counts.flipped += int(np.count_nonzero(flipped))
    plain = np.frombuffer(data, np.uint8)[:size]
    copies = [(plain ^ row).astype(np.uint8).tobytes() for row in flipped]
    if late < rates.late and rates.late_s > 0.0:
        counts.late += 1
        return (1.0 - float(delay)) * rates.late_s, copies
    return 0.0, copies


class BootingBoard:
    """`device` on a board that is deaf for `boot_s` after each reset, and prints `says` when that is over.

    `restart(now)` is called when the device begins to run. `boot_s` may be changed at any time.
    `reset_s`: when it resets once by itself, as by a dip of its supply; None: never. `has_dtr`: whether
    opening its port resets it.
    """

    def __init__(
        self,
        device: Device,
        boot_s: float,
        restart: Callable[[float], None],
        says: bytes = b"",
        *,
        reset_s: float | None = None,
        has_dtr: bool = True,
    ) -> None:
        self.resets = 0
        self._device = device
        self.boot_s = boot_s
        self._restart = restart
        self._says = says
        self._runs_s: float | None = None
        self._reset_s = reset_s
        self._has_dtr = has_dtr

    def note_opened(self, now: float) -> None:
        """Reset, if opening the port does that."""
        if self._has_dtr:
            self.reset(now)

    def reset(self, now: float) -> None:
        """Reset."""
        self._device.poll(now)  # what was on its way is lost
        self.resets += 1
        self._runs_s = now + self.boot_s

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes; the bootloader drops them."""
        said = self._boot(now)
        return said if self._runs_s is not None else said + self._device.feed(data, now)

    def poll(self, now: float) -> list[Emission]:
        """Bytes that the board sends of its own accord."""
        said = self._boot(now)
        return said if self._runs_s is not None else said + self._device.poll(now)

    def next_due(self) -> float | None:
        """Time at which it resets or boots, or of the device's next emission."""
        own = self._device.next_due() if self._runs_s is None else self._runs_s
        if self._reset_s is None:
            return own
        return self._reset_s if own is None else min(own, self._reset_s)

    def _boot(self, now: float) -> list[Emission]:
        """Reset, and begin to run, if it is time."""
        if self._reset_s is not None and now >= self._reset_s:
            at, self._reset_s = self._reset_s, None
            self.reset(at)
        if self._runs_s is None or now < self._runs_s:
            return []
        began, self._runs_s = self._runs_s, None
        self._restart(began)
        return [(began, self._says)] if self._says else []
