"""An emulated array on a wire in memory, and its driver."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from serial.serialutil import PortNotOpenError

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import Frame, Message, MessageBody
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.wire import Device
from support.oracles.array_messages import SMALL

# ----------------------------------------------------------------------------------------------------
# An emulated tactile array on a wire in memory, in virtual time, and its host driver.

PITCH = math.radians(13.5)
DESCRIPTION = Description(
    unique_id=b"test array no. 1",
    firmware="emulated 0.1",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=8,
    cols=20,
    bit_depth=12,
    max_rate_hz=500.0,
    full_scale_n=1.0,
    counts_per_n=4095.0,
    tip_radius_mm=5.0,
    columns=tuple(float(np.float32((j - 9.5) * PITCH)) for j in range(20)),
    row_heights_mm=tuple(1.0 + 2.0 * i for i in range(8)),
)


class MemoryPort:
    """A wire without bit times: bytes written reach the device at once, waiting moves the clock."""

    def __init__(self, device: Device | None, clock: VirtualClock) -> None:
        self.port: str | None = "mem://f1"
        self.timeout: float | None = 0.0
        self.device = device
        self.clock = clock
        self.buffer = bytearray()
        self.damage: set[int] = set()  # indices of received bytes to flip
        self.received = 0
        self.deaf: set[int] = set()  # indices of writes that get lost
        self.written: list[bytes] = []
        self.unplugged = False

    def _take(self, emissions: list[tuple[float, bytes]]) -> None:
        for _, data in emissions:
            for byte in data:
                self.buffer.append(byte ^ (0x55 if self.received in self.damage else 0))
                self.received += 1

    @property
    def in_waiting(self) -> int:
        if self.unplugged:
            raise PortNotOpenError
        if self.device is not None:
            self._take(self.device.poll(self.clock.now()))
        return len(self.buffer)

    def read(self, size: int = 1, /) -> bytes:
        if self.in_waiting < size:
            self.clock.sleep(self.timeout or 0.0)
        data = bytes(self.buffer[: min(size, self.in_waiting)])
        del self.buffer[: len(data)]
        return data

    def write(self, data: bytes, /) -> int | None:
        self.written.append(data)
        if self.device is not None and len(self.written) - 1 not in self.deaf:
            self._take(self.device.feed(data, self.clock.now()))
        return len(data)


class World:
    """Samples an array with a fixed force at the instants it asks for."""

    def __init__(self, force_n: np.ndarray) -> None:
        self.array: EmulatedArray | None = None
        self.force_n = force_n

    def advance(self, now: float) -> None:
        array = self.array
        while array is not None and (due := array.next_sample_s()) is not None and due <= now:
            array.sample(due, self.force_n)


def emulated(taxels: Taxels, force_n: np.ndarray | None = None, **device: Any) -> EmulatedArray:
    """An array in a world that presses it with `force_n` (rows, cols), or not at all."""
    d = taxels.description
    world = World(np.zeros((d.rows, d.cols)) if force_n is None else force_n)
    world.array = EmulatedArray(taxels, world.advance, **device)
    return world.array


def plugged(device: Device | None) -> tuple[TactileArray, MemoryPort, VirtualClock]:
    """A device and its host driver, which is not connected yet."""
    clock = VirtualClock()
    port = MemoryPort(device, clock)
    return TactileArray(port, clock, "f1"), port, clock


def bench(
    force_n: np.ndarray | None = None, **faults: Any
) -> tuple[TactileArray, MemoryPort, VirtualClock, EmulatedArray]:
    """The array of `DESCRIPTION` with what is wrong with its taxels, and its host driver."""
    device = emulated(Taxels(DESCRIPTION, seed=5, **faults), force_n)
    return *plugged(device), device


# ----------------------------------------------------------------------------------------------------
# Talking to an emulated array message by message, and arrays whose counts are known beforehand.

RATE = 100_000  # thousandths of a frame per second: one frame in 10 ms


class Scripted(Taxels):
    """Taxels that count what the script says, sample by sample; the last one again and again."""

    def __init__(self, description: Description, script: Sequence[Sequence[int]]) -> None:
        super().__init__(description, seed=0)
        shape = (description.rows, description.cols)
        self.script = [np.array(counts, "<u2").reshape(shape) for counts in script]

    def counts(self, _force_n: np.ndarray, _now: float = 0.0) -> np.ndarray:
        return self.script.pop(0) if len(self.script) > 1 else self.script[0]


def heard(array: EmulatedArray, data: bytes, now: float = 0.0, version: int = 1) -> list[Message]:
    """What an array answers at `now` to bytes, all of it well formed."""
    items = Decoder(version).feed(b"".join(sent for _, sent in array.feed(data, now)))
    assert all(isinstance(item, Message) for item in items)
    return [item for item in items if isinstance(item, Message)]


def told(array: EmulatedArray, body: MessageBody, now: float = 0.0) -> MessageBody:
    """What an array answers to one request at `now`."""
    *frames, answer = heard(array, encode(Message(0, 0, body)), now)
    assert all(isinstance(frame.body, Frame) for frame in frames)
    return answer.body


def stream(array: EmulatedArray, until: float) -> list[Message]:
    """The frames up to `until`."""
    return heard(array, b"", until)


def small(script: Sequence[Sequence[int]] = ((0,) * 6,)) -> EmulatedArray:
    """A small array that counts what the script says."""
    return emulated(Scripted(SMALL, script))
