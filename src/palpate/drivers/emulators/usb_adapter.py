"""The USB adapter between host and emulated device: effects of its chip, hub and operating system on bytes.

Collects what the device sends until a buffer is full or the latency timer runs out, and hands that over at
once, so that answers come late, joined with others or in pieces (FTDI, application note AN232B-04: packets of
64 bytes, two of them the chip's own; the timer runs anew from each packet, an empty one included). A hub that
stalls holds both directions back. An adapter that echoes returns what was sent. One that is gone comes back
under the same name or another one; while another program has the port, too, that writes and reads as well.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import serial

from palpate.drivers.transport.ports import PortMissing
from palpate.drivers.transport.wire import (
    BITS_PER_BYTE,
    Device,
    Emission,
    OpenedDevice,
    RatedDevice,
    wire_time_s,
)

_BUFFER_BYTES = 62
_MODEM_PROBES = (b"AT\r", b"ATE0\r", b"\x7e\x78\xf0\x7e")  # what ModemManager asks a port that may be a modem
_PROBE_PERIOD_S = 0.5
_STOLEN_SHARE = 0.5  # of what arrives, which the other program gets

_Deliver = Callable[[bytes, float], list[Emission]]


@dataclass(frozen=True)
class HubStalls:
    """A hub that passes nothing for `lo_s` to `hi_s`, on average once in `every_s`."""

    lo_s: float
    hi_s: float
    every_s: float


@dataclass(frozen=True)
class PortIntruder:
    """Another program that has the port, too, for `seconds` after it was plugged in."""

    seconds: float


@dataclass(frozen=True)
class AdapterTruth:
    """True behaviour of an adapter. `latency_s`: its latency timer. `gone_s`: [instant, instant at which it
    is back].

    `renamed`: it then has another name.
    """

    latency_s: float = 1e-3
    echoes: bool = False
    stalls: HubStalls | None = None
    gone_s: tuple[float, float] | None = None
    renamed: bool = False
    grab: PortIntruder | None = None


class UsbAdapter:
    """A device behind an adapter. Hosts reach it through a `PluggedPort`."""

    def __init__(self, device: Device, baudrate: int, truth: AdapterTruth, seed: int) -> None:
        """`baudrate`: the device's. `rate`: that of what it sends now, which a `RatedDevice` may change."""
        self.truth = truth
        self.baudrate = self.rate = baudrate
        self._device = device
        self._rated = device if isinstance(device, RatedDevice) else None
        self._rng = np.random.default_rng(seed)
        self._sent_s = float(self._rng.uniform(-truth.latency_s, 0.0))  # it runs from the plug on
        self._wire: deque[tuple[float, bytes, float]] = deque()  # first bit, bytes, time of one
        self._free_s = -math.inf
        self._buffer = bytearray()
        self._late: deque[tuple[float, bytes, _Deliver]] = deque()
        self._stalls = _Stalling(truth.stalls, self._rng)
        self._first_s: float | None = None
        self._probes = 0

    def enumeration(self, now: float) -> int | None:
        """Number of times that the adapter has been given a name; None while it has none."""
        if self.truth.gone_s is None or now < self.truth.gone_s[0]:
            return 0
        return 1 if now >= self.truth.gone_s[1] else None

    def note_opened(self, now: float) -> None:
        """Note that its port was opened."""
        self._first_s = now if self._first_s is None else self._first_s
        if isinstance(self._device, OpenedDevice):
            self._device.note_opened(now)

    def lose(self, now: float) -> None:
        """Forget what is under way, as when the plug is pulled; the device lives on."""
        self._late.clear()
        self._wire.clear()
        self._buffer.clear()
        self._device.poll(now)

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:
        """Pass the host's bytes on; returns what reaches the host by now."""
        self._deliver(now)
        if self._rated is None and baudrate != self.baudrate:
            return self._take_arrivals(now)
        self.rate = baudrate
        hand = self._device.feed if self._rated is None else partial(_at_rate, self._rated, baudrate)
        free = self._stalls.free_from(now)
        if free > now or self._late:
            self._late.append((max(free, now), data, hand))
        else:
            self._hand(data, now, hand)
        return self._take_arrivals(now)

    def poll(self, now: float) -> list[Emission]:
        """Bytes that reach the host up to `now`."""
        self._deliver(now)
        self._take(self._device.poll(now))
        return self._take_arrivals(now)

    def next_due(self) -> float | None:
        """Time at which bytes reach the device, the chip or the host next."""
        times = [self._late[0][0]] if self._late else []
        if self._buffer or self._wire:
            times.append(self._next_packet_s())
        own = self._device.next_due()
        times += [] if own is None else [own]
        return min(times, default=None)

    def _hand(self, data: bytes, now: float, hand: _Deliver) -> None:
        if self.truth.echoes:
            self._on_wire(now - wire_time_s(len(data), self.rate), data)
        self._take(hand(data, now))

    def _deliver(self, now: float) -> None:
        """Hand the device what was held back, and what another program sends."""
        while self._late and self._late[0][0] <= now:
            due, data, hand = self._late.popleft()
            self._hand(data, due, hand)
        grab = self.truth.grab
        if grab is None or self._first_s is None:
            return
        while (at := self._first_s + (self._probes + 0.2) * _PROBE_PERIOD_S) <= now:
            if at > self._first_s + grab.seconds:
                return
            self._take(self._device.feed(_MODEM_PROBES[self._probes % len(_MODEM_PROBES)], at))
            self._probes += 1

    def _take(self, emissions: list[Emission]) -> None:
        for start, data in emissions:
            self._on_wire(start, data)

    def _on_wire(self, start_s: float, data: bytes) -> None:
        if data:
            byte_s = BITS_PER_BYTE / self.rate
            start = max(start_s, self._free_s)
            self._free_s = start + len(data) * byte_s
            self._wire.append((start, data, byte_s))

    def _next_packet_s(self) -> float:
        """Time at which the chip sends its next packet that is not empty: it is full, or its timer
        runs out.
        """
        missing, full_s = _BUFFER_BYTES - len(self._buffer), math.inf
        if missing <= 0:
            return self._stalls.free_from(self._sent_s)
        for start, data, byte_s in self._wire:
            if missing <= len(data):
                full_s = start + missing * byte_s
                break
            missing -= len(data)
        first = self._sent_s if self._buffer or not self._wire else self._wire[0][0] + self._wire[0][2]
        return self._stalls.free_from(min(full_s, self._tick_s(max(first, self._sent_s))))

    def _tick_s(self, since_s: float) -> float:
        """Time at which the timer runs out next, at `since_s` or later; it has run since the last packet."""
        timer = self.truth.latency_s
        return self._sent_s + timer * max(1, math.ceil((since_s - self._sent_s) / timer - 1e-9))

    def _take_arrivals(self, now: float) -> list[Emission]:
        """Packets that the chip has sent by now, which reach the host at once."""
        found: list[Emission] = []
        while (self._buffer or self._wire) and (at := self._next_packet_s()) <= now:
            self._fill(at)
            self._sent_s = at
            packet = bytes(self._buffer[:_BUFFER_BYTES])
            del self._buffer[:_BUFFER_BYTES]
            if packet and not self._read_by_other(at):
                found.append((at, packet))
        return found

    def _fill(self, now: float) -> None:
        """Move what has arrived at the chip by now into its buffer, which holds as much as a stall lasts."""
        while self._wire:
            start, data, byte_s = self._wire[0]
            count = int((now - start) / byte_s + 1e-3)
            if count < len(data):
                if count > 0:
                    self._buffer += data[:count]
                    self._wire[0] = (start + count * byte_s, data[count:], byte_s)
                return
            self._buffer += data
            self._wire.popleft()

    def _read_by_other(self, now: float) -> bool:
        grab = self.truth.grab
        held = grab is not None and self._first_s is not None and now < self._first_s + grab.seconds
        return held and bool(self._rng.uniform() < _STOLEN_SHARE)


class PluggedPort:
    """An adapter under the name that it is given the `number`-th time (from 0). A `Device` for any wire."""

    def __init__(self, adapter: UsbAdapter, number: int = 0) -> None:
        self._adapter, self._number = adapter, number

    @property
    def arrival_rate(self) -> int:
        """Rate of the bytes that it hands over, each packet at once."""
        return self._adapter.rate

    def note_opened(self, now: float) -> None:
        """Open it. Raises PortMissing if the adapter does not have this name now."""
        if not self.is_there(now):
            raise PortMissing("port does not exist: its adapter is not plugged in, or has another name now")
        self._adapter.note_opened(now)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Pass bytes on at the device's rate."""
        return self.feed_at(data, now, self._adapter.baudrate)

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:
        """Pass bytes on. Raises serial.SerialException while the adapter is gone, as pyserial does."""
        self._check(now, "write failed: [Errno 5] Input/output error")
        return self._adapter.feed_at(data, now, baudrate)

    def poll(self, now: float) -> list[Emission]:
        """Bytes that reach the host. Raises as `feed_at`."""
        self._check(now, "device reports readiness to read but returned no data (device disconnected?)")
        return self._adapter.poll(now)

    def next_due(self) -> float | None:
        """Next due time of the adapter."""
        return self._adapter.next_due()

    def is_there(self, now: float) -> bool:
        """True if the adapter is plugged in and has this name."""
        number = self._adapter.enumeration(now)
        return number is not None and (number if self._adapter.truth.renamed else 0) == self._number

    def _check(self, now: float, text: str) -> None:
        if not self.is_there(now):
            self._adapter.lose(now)
            raise serial.SerialException(text)


def _at_rate(device: RatedDevice, baudrate: int, data: bytes, now: float) -> list[Emission]:
    return device.feed_at(data, now, baudrate)


class _Stalling:
    """Stalls of a hub, drawn as time goes on."""

    def __init__(self, stalls: HubStalls | None, rng: np.random.Generator) -> None:
        self._stalls, self._rng = stalls, rng
        self._spans: list[tuple[float, float]] = []
        self._until_s = 0.0

    def free_from(self, now: float) -> float:
        """The first instant from `now` on at which something passes."""
        if self._stalls is None or not math.isfinite(now):
            return now
        while self._until_s <= now:
            begin = self._until_s + float(self._rng.exponential(self._stalls.every_s))
            end = begin + float(self._rng.uniform(self._stalls.lo_s, self._stalls.hi_s))
            self._spans.append((begin, end))
            self._until_s = end
        return next((end for begin, end in reversed(self._spans) if begin <= now < end), now)
