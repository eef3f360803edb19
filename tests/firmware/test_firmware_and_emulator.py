"""The firmware and the emulated array, written apart from each other from one page, say the same bytes."""

import struct
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from firmware_bench import Bench, Makeup
from wire_messages import (
    ACK,
    DESCRIBE,
    FRAME,
    GEOMETRY,
    HELLO,
    NACK,
    RATE,
    REPORT,
    SELF_TEST,
    START,
    STOP,
    TARE,
    TAXELS,
    said,
    wire,
)

from palpate.base.geometry import Counts, Floats
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.tactile.codec import Decoder
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import Describe

SIZE = (2, 3)
LARGEST = 4095
RATES = (1_000, 20_000, 100_000, 200_000, 200_001, 0)
LENGTHS = {START: 6, RATE: 6, TARE: 6, GEOMETRY: 4}
STEPS = 4000


class Skin:
    """Taxels whose counts are given; under a test signal they rise as good ones do."""

    def __init__(self, description: Description) -> None:
        self.description = description
        self.raw = np.zeros(SIZE, np.uint16)

    def counts(self, force_n: Floats, now: float = 0.0) -> Counts:  # noqa: ARG002
        return np.full(SIZE, LARGEST, np.uint16) if force_n.any() else self.raw


class Both:
    """Both arrays on the same line, sampling the same counts at the same instants."""

    def __init__(self, built: Path, rng: np.random.Generator) -> None:
        self.rng = rng
        self.firmware = Bench(built, Makeup())
        description = self._description(Bench(built, Makeup()))
        places = np.concatenate((description.positions_mm(), description.normals()), axis=-1)
        self.firmware.place(places.reshape(-1, 6).tolist())
        self.skin = Skin(description)
        self.emulator = EmulatedArray(self.skin, self_test_s=0.0)  # type: ignore[arg-type]
        self.now_us = 0

    @staticmethod
    def _description(bench: Bench) -> Description:
        bench.send(wire(1, HELLO, 0, 0, b"\x01\x00"))
        (item,) = Decoder().feed(bench.poll(0))
        assert isinstance(item.body, Describe)  # type: ignore[union-attr]
        return item.body.description  # type: ignore[union-attr]

    def feel(self) -> None:
        raw = self.rng.integers(0, 1500, SIZE).astype(np.uint16)
        raw[self.rng.random(SIZE) < 0.05] = LARGEST
        self.skin.raw = raw
        self.firmware.feel(raw.ravel().tolist())

    def run(self, until_us: int) -> tuple[bytes, bytes]:
        """What both say up to an instant, frames included."""
        mine = theirs = b""
        while (due := self.due_us()) is not None and due <= until_us:
            self.feel()
            mine += self.firmware.poll(due)
            theirs += self.frame(due)
        self.now_us = until_us
        return mine + self.firmware.poll(until_us), theirs

    def due_us(self) -> int | None:
        due = self.emulator.next_sample_s()
        return None if due is None else round(due * 1e6)

    def frame(self, now_us: int) -> bytes:
        """The emulator's next frame."""
        self.emulator.sample(now_us * 1e-6, np.zeros(SIZE))
        return b"".join(data for _, data in self.emulator.poll(now_us * 1e-6))

    def hear(self, data: bytes) -> tuple[bytes, bytes]:
        """What both answer now."""
        self.firmware.send(data)
        mine = b"".join(self.firmware.poll(self.now_us) for _ in range(1 + len(data) // 64))
        theirs = b"".join(answer for _, answer in self.emulator.feed(data, self.now_us * 1e-6))
        if self.due_us() == self.now_us:  # after a RATE whose period is over
            theirs += self.frame(self.now_us)
        return mine, theirs


def any_request(rng: np.random.Generator) -> bytes:
    """A request that is likely to make sense, or noise."""
    kind = int(rng.choice([HELLO, START, STOP, RATE, TARE, SELF_TEST, GEOMETRY, rng.integers(0, 256)]))
    length = LENGTHS.get(kind, 2) if rng.random() < 0.9 else int(rng.integers(0, 12))
    values = {
        START: struct.pack("<I", rng.choice(RATES)),
        RATE: struct.pack("<I", rng.choice(RATES)),
        TARE: struct.pack("<HH", rng.choice([0, 1, 2, 3, 1025]), rng.choice([0, 64, 4095, 4096])),
        GEOMETRY: struct.pack("<H", rng.integers(0, 8)),
    }.get(kind, b"")
    payload = (struct.pack("<H", rng.integers(0, 1 << 16)) + values).ljust(length, b"\x05")[:length]
    version = 1 if rng.random() < 0.95 else 2
    data = bytearray(wire(version, kind, 0, 0, payload, None if rng.random() < 0.95 else 99))
    if rng.random() < 0.1:
        data[rng.integers(len(data) - 1)] ^= 1 << rng.integers(8)
    return bytes(data)


def plain(stream: bytes) -> list[bytes]:
    """Messages. Of a report only type, number and time: what an array finds in itself is its own business."""
    pieces = [cobs.decode(piece) for piece in stream.split(b"\x00") if piece]
    return [piece[:16] if piece[1] == REPORT else piece for piece in pieces]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_both_say_the_same(built: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    both = Both(built, rng)
    kinds = set()
    for _ in range(STEPS):
        until_us = both.now_us + int(rng.integers(0, 20_000))
        for mine, theirs in (both.run(until_us), both.hear(any_request(rng))):
            assert plain(mine) == plain(theirs), both.now_us
            kinds |= {found.type for found in said(mine)}
    assert kinds == {DESCRIBE, ACK, NACK, REPORT, TAXELS, FRAME}
