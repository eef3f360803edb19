"""The page's test vectors through the C codec: requests are understood, answers come out byte for byte."""

import ctypes
import struct
from pathlib import Path

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
    TARE,
    TAXELS,
    Reason,
    page_vectors,
    request,
    said,
    wire,
)

VECTORS = page_vectors()
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
    assert wire(1, FRAME, 3, 5250, frame) == vector("FRAME, sequence 3")


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
