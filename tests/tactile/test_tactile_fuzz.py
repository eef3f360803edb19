"""Ten million wrong bytes through the decoder, and some through the emulated array."""

import itertools
import pickle
import struct
import tracemalloc
from collections import Counter

import numpy as np
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_port import emulated
from tactile_bodies import bodies, u16, u32, u64
from tactile_vectors import FREE, PLACES, SMALL, VECTORS, VERSION_2, seal

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import MAX_ENCODED_BYTES, DecodeFault, Decoder, FaultKind, encode
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    Message,
    MessageType,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Start,
    Stop,
    Tare,
    TaxelFault,
    TaxelPlaces,
)
from palpate.testing import fuzz


def from_an_array() -> bytes:
    """A delimiter, and 90 messages of every type that an array sends, about 30 kB."""
    rng = np.random.default_rng(705)
    bad = (BadTaxel(1, 2, TaxelFault.UNSTEADY),)
    parts = [
        Describe(1, SMALL),
        Ack(2),
        Nack(3, NackReason.BAD_STATE),
        SelfTestReport(4, SelfTestResult.TAXELS, 1, bad),
        Describe(5, FREE),
        TaxelPlaces(6, 0, PLACES),
    ]
    parts += [Frame(8, 20, rng.integers(0, 4096, 160, dtype="<u2").tobytes()) for _ in range(84)]
    return b"\0" + b"".join(encode(Message(n, 5000 * n, body)) for n, body in enumerate(parts))


def from_a_host() -> bytes:
    """A delimiter, and every request, right and wrong."""
    parts = [Hello(1), Start(2, 100_000), Rate(3, 200_000), Tare(4, 3, 9), Geometry(5, 1), SelfTest(6)]
    parts += [Stop(7), SelfTest(8), Start(9, 0), Tare(10, 5000, 0), Geometry(11, 99), Stop(12)]
    once = b"\0" + b"".join(encode(Message(n, n, body)) for n, body in enumerate(parts)) + VERSION_2
    return once * 40


def test_ten_million_bytes_give_messages_or_counted_faults() -> None:
    tally = fuzz(Decoder, from_an_array(), 10_000_000, seed=705)
    assert tally.fed == 10_000_000
    assert MAX_ENCODED_BYTES // 2 < tally.most_waiting <= MAX_ENCODED_BYTES
    assert tally.items["DecodeFault"] == tally.faults.total() > 20_000
    assert tally.items["Message"] > 5_000
    assert set(tally.items) == {"Message", "DecodeFault"}
    for after in tally.recovered:  # the delimiter in front ends what was left of the garbage
        assert after["Message"] == tally.undisturbed["Message"] == 90


class Receiver:
    """An emulated array as a decoder: what it sends must be well-formed."""

    def __init__(self) -> None:
        self.array: EmulatedArray = emulated(Taxels(SMALL, seed=1), self_test_s=0.003)
        self.ears = Decoder()
        self.now = 0.0

    @property
    def faults(self) -> Counter[FaultKind]:
        return self.ears.faults

    @property
    def waiting(self) -> int:
        return self.ears.waiting

    def feed(self, data: bytes, /) -> list[Message | DecodeFault]:
        self.now += 0.001
        return self.ears.feed(b"".join(said for _, said in self.array.feed(data, self.now)))


def test_an_emulated_array_answers_garbage_with_nothing_but_messages() -> None:
    receivers: list[Receiver] = []

    def make() -> Receiver:
        receivers.append(Receiver())
        return receivers[-1]

    fresh = len(pickle.dumps(Receiver().array))
    tally = fuzz(make, from_a_host(), 1_000_000, seed=17)
    assert tally.fed == 1_000_000
    assert set(tally.items) == {"Message"}
    assert tally.items["Message"] > 3_000
    assert tally.most_waiting == 0
    for receiver in receivers:
        receiver.array.poll(receiver.now + 1.0)
        assert len(pickle.dumps(receiver.array)) < fresh + MAX_ENCODED_BYTES + 2_000


def test_a_gap_without_end_takes_no_memory() -> None:
    decoder = Decoder()
    gap = b"\x55" * 5_000
    tracemalloc.start()
    try:
        faults = [item for _ in range(1_000) for item in decoder.feed(gap)]
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert [fault.kind for fault in faults if isinstance(fault, DecodeFault)] == [FaultKind.OVERSIZED]
    assert held < 20_000
    (message,) = decoder.feed(b"\0" + VECTORS["HELLO"][1])
    assert message == VECTORS["HELLO"][0]


def test_whatever_has_a_right_crc_gives_messages_or_faults() -> None:
    rng = np.random.default_rng(3)
    decoder = Decoder()
    plains = [cobs.decode(data[:-1])[:-4] for _, data in VECTORS.values()]
    seen: Counter[str] = Counter()
    for k in range(20_000):
        plain = bytearray(plains[k % len(plains)])
        for at in rng.integers(0, len(plain), int(rng.integers(1, 4))):
            plain[at] = int(rng.choice([0, 1, 2, 127, 128, 255, int(rng.integers(256))]))
        cut = bytes(plain[: int(rng.integers(18, len(plain) + 1))] if k % 3 == 0 else plain)
        if k % 2:
            cut = cut[:16] + struct.pack("<H", len(cut) - 18) + cut[18:]
        (item,) = decoder.feed(seal(cut))[-1:]
        seen[item.kind.name if isinstance(item, DecodeFault) else type(item.body).__name__] += 1
    wanted = {
        "VERSION",
        "LENGTH",
        "UNKNOWN_TYPE",
        "PAYLOAD",
        "Describe",
        "SelfTestReport",
        "TaxelPlaces",
        "Tare",
        "Frame",
    }
    assert wanted <= set(seen)
    assert {"FRAMING", "SHORT", "CRC", "OVERSIZED"}.isdisjoint(seen)


damaged = st.builds(
    lambda body, at, new: encode(Message(5, 6, body))[:at] + new,
    bodies,
    st.integers(0, 60),
    st.binary(max_size=8),
)
sealed = st.builds(
    lambda head, payload: seal(struct.pack("<BBHIQH", *head, len(payload)) + payload),
    st.tuples(st.integers(0, 2), st.sampled_from([*MessageType, 0x42]), u16, u32, u64),
    st.binary(max_size=80),
)
parts = st.one_of(
    st.binary(max_size=60),
    sealed,
    st.builds(lambda body, number: encode(Message(number, 0, body)), bodies, st.integers(0, 5)),
    damaged,
    st.sampled_from([b"\0", VERSION_2, b"\x77" * MAX_ENCODED_BYTES, b"\x77" * (MAX_ENCODED_BYTES + 1)]),
)


@given(st.lists(parts, max_size=8), st.lists(st.integers(1, 300), min_size=1, max_size=8))
@settings(max_examples=150, deadline=None)
def test_how_the_bytes_are_cut_makes_no_difference(stream: list[bytes], sizes: list[int]) -> None:
    data = b"".join(stream) + b"\0"
    whole, cut = Decoder(), Decoder()
    items = whole.feed(data)
    pieces: list[Message | DecodeFault] = []
    at, lengths = 0, itertools.cycle(sizes)
    while at < len(data):
        size = next(lengths)
        pieces += cut.feed(data[at : at + size])
        at += size
        assert cut.waiting <= MAX_ENCODED_BYTES
    assert pieces == items
    assert cut.faults == whole.faults
    assert whole.faults.total() == sum(isinstance(item, DecodeFault) for item in items)
    assert cut.waiting == whole.waiting == 0
    assert Message(0, 0, Hello(9)) in cut.feed(encode(Message(0, 0, Hello(9))))
