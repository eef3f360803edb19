"""The firmware's codec: vectors of the page, and the emulator beside it."""

import ctypes
import struct
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs

from palpate.base.geometry import Counts, Floats
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.tactile.codec import Decoder
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import Describe
from support.devices.firmware import Bench, Makeup
from support.oracles.array_messages import (
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
    Reason,
    message_wire,
    request,
    said,
    written_vectors,
)

# ----------------------------------------------------------------------------------------------------
# The written test vectors through the C codec: requests are understood, answers come out byte for byte.

VECTORS = written_vectors()
FREE = Makeup(shape=2, columns=None, rows=None, size=(1, 2), radius_mm=0.0)


def vector(start: str) -> bytes:
    """The one vector whose description starts like this."""
    (found,) = [data for name, data in VECTORS.items() if name.startswith(start)]
    return found


def test_the_page_has_a_vector_of_every_message() -> None:
    types = {said(data)[0].type for data in VECTORS.values()}
    assert types == {*range(HELLO, GEOMETRY + 1), DESCRIBE, ACK, NACK, REPORT, TAXELS, FRAME}


@pytest.mark.parametrize(
    ("name", "number", "answer"),
    [
        ("HELLO, ", 1, DESCRIBE),
        ("START", 2, ACK),
        ("STOP", 3, ACK),
        ("RATE", 4, NACK),  # no stream
        ("TARE", 5, ACK),
        ("SELF_TEST", 6, REPORT),
        ("HELLO of", 8, NACK),
    ],
)
def test_requests_are_understood(built: Path, name: str, number: int, answer: int) -> None:
    bench = Bench(built)
    bench.send(vector(name))
    (told,) = said(bench.poll(0))
    assert (told.type, told.request) == (answer, number)


def test_a_request_for_geometry_is_understood(built: Path) -> None:
    bench = Bench(built, FREE)
    bench.send(vector("GEOMETRY"))
    (told,) = said(bench.poll(0))
    assert (told.type, told.request) == (TAXELS, 7)


def test_describe_of_a_cylinder(built: Path) -> None:
    bench = Bench(built)
    bench.send(vector("HELLO, "))
    assert bench.poll(200) == vector("DESCRIBE, sequence 0")


def test_describe_of_a_free_array(built: Path) -> None:
    bench = Bench(built, FREE)
    bench.send(vector("HELLO, "))
    assert bench.poll(200) == vector("DESCRIBE, as above but free")


def test_ack_nack_and_frame(built: Path) -> None:
    bench = Bench(built)
    bench.number(1)
    bench.send(vector("START"))
    assert bench.poll(250) == vector("ACK")
    bench.send(request(START, 9, 0))
    assert bench.poll(300) == vector("NACK, sequence 2")
    bench.feel([0, 1, 255, 256, 4095, 65535])
    assert bench.poll(5249) == b""
    assert bench.poll(5250) == vector("FRAME, sequence 3")


def test_a_tared_frame(built: Path) -> None:
    bench = Bench(built, FREE)
    bench.feel([1000, 2000])
    assert bench.ask(0, TARE, 1, 1, 64).type == ACK
    assert bench.ask(4249, START, 2, 400_000).reason == Reason.BAD_RATE
    assert bench.ask(4250, START, 3, 200_000).type == ACK
    bench.number(5)
    bench.poll(9250)
    bench.number(6)
    bench.send(request(START, 4, 200_000))
    bench.poll(4250)
    bench.number(6)
    bench.feel([1000, 2006])
    assert bench.poll(9250) == vector("FRAME, sequence 6")


def test_report(built: Path) -> None:
    bench = Bench(built)
    bench.number(3)
    bench.ail([0, 1, 0, 0, 0, 2])
    bench.send(vector("SELF_TEST"))
    assert bench.poll(400) == vector("REPORT")


def test_taxels(built: Path) -> None:
    bench = Bench(built, FREE)
    bench.number(4)
    bench.place([(5, 0, 1, 1, 0, 0), (0, 5, 1, 0, 1, 0)])
    bench.send(vector("GEOMETRY"))
    assert bench.poll(450) == vector("TAXELS")


def test_another_version_is_told_ours(built: Path) -> None:
    bench = Bench(built)
    bench.number(5)
    bench.send(vector("HELLO of"))
    assert bench.poll(500) == vector("NACK, sequence 5")


def test_struct_and_page_agree(built: Path) -> None:
    assert request(RATE, 4, 100_000, sequence=3, time_us=2000) == vector("RATE")
    assert request(SELF_TEST, 6, sequence=5, time_us=3000) == vector("SELF_TEST")
    frame = struct.pack("<BB6H", 2, 3, 0, 1, 255, 256, 4095, 65535)
    assert message_wire(1, FRAME, 3, 5250, frame) == vector("FRAME, sequence 3")


# ---- the parts by themselves ----


def decoded(built: Path, stuffed: bytes) -> bytes | None:
    """What the firmware decodes; None if it says that this is not COBS."""
    library = ctypes.CDLL(str(built / "bench.so"))
    library.palpate_cobs_decode.restype = ctypes.c_bool
    data = ctypes.create_string_buffer(stuffed, len(stuffed))
    size = ctypes.c_size_t()
    good = library.palpate_cobs_decode(data, ctypes.c_size_t(len(stuffed)), ctypes.byref(size))
    return data.raw[: size.value] if good else None


@pytest.mark.parametrize("length", [1, 2, 253, 254, 255, 256, 507, 508, 509, 762])
def test_cobs_of_any_length(built: Path, length: int) -> None:
    for plain in (
        b"\x07" * length,
        b"\x00" * length,
        b"\x07" * (length - 1) + b"\x00",
        b"\x00".rjust(length),
    ):
        assert decoded(built, cobs.encode(plain)) == plain


def test_an_empty_block_may_follow_254_bytes_at_the_end(built: Path) -> None:
    plain = b"\x07" * 254
    assert decoded(built, b"\xff" + plain) == plain
    assert decoded(built, b"\xff" + plain + b"\x01") == plain


@pytest.mark.parametrize("stuffed", [b"", b"\x02", b"\x05\x01\x01", b"\x03\x01\x00", b"\x00", b"\x01\x00"])
def test_what_is_not_cobs(built: Path, stuffed: bytes) -> None:
    assert decoded(built, stuffed) is None


def test_crc(built: Path) -> None:
    library = ctypes.CDLL(str(built / "bench.so"))
    library.palpate_crc32.restype = ctypes.c_uint32
    assert library.palpate_crc32(0, b"123456789", ctypes.c_size_t(9)) == 0xCBF43926


# ----------------------------------------------------------------------------------------------------
# The firmware and the emulated array, written apart from each other from one page, say the same bytes.

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
        bench.send(message_wire(1, HELLO, 0, 0, b"\x01\x00"))
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
    data = bytearray(message_wire(version, kind, 0, 0, payload, None if rng.random() < 0.95 else 99))
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
