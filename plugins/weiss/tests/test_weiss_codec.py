"""The codec of Weiss Robotics' sensors against published packets, damaged streams and any bytes whatever."""

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate_weiss.codec import (
    MAX_PAYLOAD,
    WeissDecoder,
    WeissDialect,
    WeissFault,
    WeissFaultKind,
    WeissPacket,
    encode,
)
from palpate_weiss.crc import RunningCrc, crc16

WTS_VECTORS = [
    # CNCR-NTU/wts-ft, scripts/wts_ft_interface_1.py, its three tests of the checksum
    (WeissPacket(0x01, b"\x12\x34"), "aa aa aa 01 02 00 12 34 6d 66"),
    (WeissPacket(0x01), "aa aa aa 01 00 00 e8 10"),
    (WeissPacket(0x06), "aa aa aa 06 00 00 97 26"),
    # a public reader of a WTS, class Weiss_tactile: its request for a single frame, as constant bytes
    (WeissPacket(0x20, b"\x00"), "aa aa aa 20 01 00 00 8f 83"),
]


def reference_crc(data: bytes) -> int:
    """The checksum bit by bit, without a table."""
    register = 0xFFFF
    for byte in data:
        low = (register ^ byte) & 0xFF
        entry = low << 8
        for _ in range(8):
            entry = (entry << 1) ^ (0x1021 if entry & 0x8000 else 0)
        register = (entry & 0xFFFF) ^ (register >> 8)
    return register


def dsa_packet(command: int, payload: bytes) -> bytes:
    """A packet as SDHLibrary's dsa.cpp writes it."""
    body = struct.pack("<BH", command, len(payload)) + payload
    return b"\xaa\xaa\xaa" + body + (struct.pack("<H", reference_crc(body)) if payload else b"")


def test_crc_check_value() -> None:
    assert crc16(b"123456789") == 0x6EB4


@pytest.mark.parametrize(("packet", "text"), WTS_VECTORS)
def test_published_packets_of_the_wts(packet: WeissPacket, text: str) -> None:
    data = bytes.fromhex(text)
    assert encode(WeissDialect.WTS, packet) == data
    assert WeissDecoder(WeissDialect.WTS).feed(data) == [packet]


def test_a_dsa_checks_packets_with_a_payload_only_and_not_their_preamble() -> None:
    for packet in (WeissPacket(0x01), WeissPacket(0x03, b"\x81\x1e\x00"), WeissPacket(0x0B, b"\x05")):
        data = dsa_packet(packet.command, packet.payload)
        assert encode(WeissDialect.DSA, packet) == data
        assert WeissDecoder(WeissDialect.DSA).feed(data) == [packet]
    assert len(encode(WeissDialect.DSA, WeissPacket(0x01))) == 6


@given(st.binary(max_size=300), st.integers(0, 300), st.integers(0, 300))
def test_checksums_of_stretches_follow_from_the_registers_at_their_ends(
    data: bytes, first: int, second: int
) -> None:
    start, end = sorted((first % (len(data) + 1), second % (len(data) + 1)))
    running = RunningCrc()
    running.extend(data)
    dropped = start // 2
    running.drop(dropped)
    assert (
        running.of(start - dropped, end - dropped) == crc16(data[start:end]) == reference_crc(data[start:end])
    )


@pytest.mark.parametrize("packet", [WeissPacket(0xAA), WeissPacket(256), WeissPacket(1, bytes(65536))])
def test_what_does_not_fit_a_packet_is_not_sent(packet: WeissPacket) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        encode(WeissDialect.WTS, packet)


packets = st.builds(WeissPacket, st.integers(0, 255).filter(lambda c: c != 0xAA), st.binary(max_size=40))
# Bytes of which preambles are made come often; sizes above the limit, and below it, too.
noise = st.lists(
    st.sampled_from(
        [b"\xaa", b"\xaa\xaa\xaa", b"\x00", b"\x1b[5n", b"\xaa\xaa\xaa\x00\x05\x00", b"\x20\x01\xff"]
    ),
    max_size=12,
).map(b"".join)


def fed(
    dialect: WeissDialect, data: bytes, cuts: list[int]
) -> tuple[list[WeissPacket | WeissFault], WeissDecoder]:
    decoder = WeissDecoder(dialect, 64)
    places = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    out: list[WeissPacket | WeissFault] = []
    for a, b in pairwise(places):
        out += decoder.feed(data[a:b])
        assert decoder.waiting < 6 + 64 + 2
    return out + decoder.give_up(), decoder


@settings(max_examples=300)
@given(
    st.sampled_from(WeissDialect),
    st.lists(st.tuples(noise, packets), max_size=5),
    noise,
    st.lists(st.integers(0, 400), max_size=6),
)
def test_no_packet_is_lost_to_noise_before_it_however_the_bytes_are_cut(
    dialect: WeissDialect, parts: list[tuple[bytes, WeissPacket]], tail: bytes, cuts: list[int]
) -> None:
    data = b"".join(before + encode(dialect, packet) for before, packet in parts) + tail
    found, decoder = fed(dialect, data, cuts)
    checked = [packet for _, packet in parts if dialect.has_checksum(len(packet.payload))]
    rest = iter(item for item in found if isinstance(item, WeissPacket))
    assert all(any(item == packet for item in rest) for packet in checked), "all there, in their order"
    if not any(before for before, _ in parts) and not tail:
        assert found == [packet for _, packet in parts]
        assert decoder.skipped == 0
    assert decoder.waiting == 0
    assert fed(dialect, data, [])[0] == found, "cuts make no difference"


def test_noise_of_a_booting_dsa_is_one_reported_stretch() -> None:
    decoder = WeissDecoder(WeissDialect.DSA)
    answer = dsa_packet(0x03, b"\0\0")
    assert decoder.feed(b"\x1b[5n" * 3 + answer) == [
        WeissFault(WeissFaultKind.NOISE),
        WeissPacket(0x03, b"\0\0"),
    ]
    assert (decoder.skipped, decoder.faults) == (12, {WeissFaultKind.NOISE: 1})


def test_marks_before_the_preamble_do_not_hide_a_packet_whose_size_is_a_multiple_of_256() -> None:
    """AA, then a frame (command 0) of 256 bytes, begins like a packet without payload and checksum."""
    packet = WeissPacket(0x00, bytes(256))
    for marks in range(1, 5):
        assert WeissDecoder(WeissDialect.DSA).feed(b"\xaa" * marks + encode(WeissDialect.DSA, packet))[
            1:
        ] == [packet]


def test_a_damaged_size_costs_its_own_packet_only() -> None:
    good = encode(WeissDialect.WTS, WeissPacket(0x00, bytes(range(60))))
    for size, kind in ((200, WeissFaultKind.LENGTH), (63, WeissFaultKind.CRC), (3, WeissFaultKind.CRC)):
        damaged = bytearray(good)
        damaged[4] = size
        decoder = WeissDecoder(WeissDialect.WTS, 64)
        found = decoder.feed(bytes(damaged) + good + good)
        assert found == [WeissFault(kind), *[WeissPacket(0x00, bytes(range(60)))] * 2]
        assert decoder.faults == {kind: 1}


def test_a_packet_behind_one_that_never_ends_is_there_once_that_is_given_up() -> None:
    decoder = WeissDecoder(WeissDialect.DSA)
    answer = WeissPacket(0x01, b"\0\0")
    assert decoder.feed(b"\xaa\xaa\xaa\x00\x00\x10" + encode(WeissDialect.DSA, answer)) == []
    assert decoder.give_up() == [WeissFault(WeissFaultKind.CUT), answer]
    assert decoder.give_up() == []


def fuzzed_stream(dialect: WeissDialect, total: int, seed: int) -> bytes:
    """Frames, some damaged: bytes flipped, cut out, put in, and preambles where none belong."""
    rng = np.random.default_rng(seed)
    parts: list[bytes] = []
    size = 0
    while size < total:
        data = bytearray(
            encode(dialect, WeissPacket(int(rng.choice([0, 1, 0x20])), rng.bytes(int(rng.integers(0, 330)))))
        )
        match rng.integers(0, 8):
            case 0:
                data[rng.integers(0, len(data))] ^= 1 << rng.integers(0, 8)
            case 1:
                del data[rng.integers(0, len(data)) :]
            case 2:
                data[0:0] = rng.bytes(int(rng.integers(1, 100)))
            case 3:
                at = int(rng.integers(0, len(data)))
                data[at:at] = b"\xaa" * int(rng.integers(1, 8)) + b"\0" + rng.bytes(2)
            case 4:
                data = bytearray(b"\xaa\xaa\xaa\x00\x00\x1f" * int(rng.integers(1, 30)))
        parts.append(bytes(data))
        size += len(data)
    return b"".join(parts)


@pytest.mark.parametrize("dialect", WeissDialect)
def test_fuzz_gives_packets_or_counted_faults_in_bounded_memory(dialect: WeissDialect) -> None:
    data = fuzzed_stream(dialect, 300_000, 11)
    decoder = WeissDecoder(dialect)
    rng = np.random.default_rng(12)
    at = taken = 0
    while at < len(data):
        step = int(rng.integers(1, 3000))
        for item in decoder.feed(data[at : at + step]):
            if isinstance(item, WeissPacket):
                size = len(item.payload)
                taken += 6 + size + (2 if dialect.has_checksum(size) else 0)
        at += step
        assert decoder.waiting < 6 + MAX_PAYLOAD + 2
    assert taken + decoder.skipped + decoder.waiting == len(data), "every byte is accounted for"
    assert taken > 0.4 * len(data)
    assert sum(decoder.faults.values()) > 200
    decoder.give_up()
    good = WeissPacket(0x20, b"\0\0 and still alive")
    assert decoder.feed(encode(dialect, good)) == [good]


@settings(max_examples=200)
@given(st.sampled_from(WeissDialect), st.binary(max_size=600))
def test_any_bytes_whatever(dialect: WeissDialect, data: bytes) -> None:
    decoder = WeissDecoder(dialect, 100)
    for item in decoder.feed(data) + decoder.give_up():
        assert isinstance(item, WeissPacket | WeissFault)
    assert decoder.waiting == 0
