"""Devices that babble or flood."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Hello, Message, MessageBody, MessageType
from palpate.drivers.transport.clock import VirtualClock
from palpate.testing import ArrayBench
from support.devices.array_wire import bench
from support.oracles.array_messages import SMALL, wire

# ----------------------------------------------------------------------------------------------------
# Whatever a wire sends, a call takes a bounded part of it; one that goes on like that is named.

PERIOD_S = 0.01
ENDLESS = 1 << 22
CHUNKS = {
    "2 bytes": b"\x01\x00",
    "3 bytes": b"\x01\x01\x00",
    "zeros": b"\x00",
    "no delimiter": b"\x55",
    "long pieces": b"\x01" * 8248 + b"\x00",
    "marks": b"\xaa",
    "packets without payload": b"\xaa\xaa\xaa\x07\x00\x00",
    "long packets": b"\xaa\xaa\xaa\x00\x00\x04",
    "noise": np.random.default_rng(5).bytes(5000),
}
CONTENTS = pytest.mark.parametrize("chunk", CHUNKS.values(), ids=CHUNKS.keys())
PROTOCOLS = pytest.mark.parametrize("protocol", ["palpate", "weiss-wts", "weiss-dsa"])


class Babbler:
    """A port that hands on what an array says until `babble` is set, and that from then on without end."""

    def __init__(self, port: object) -> None:
        self.inner = port
        self.babble = b""
        self.taken = 0
        self.timeout: float | None = 0.0
        self.port: str | None = port.port  # type: ignore[attr-defined]

    @property
    def in_waiting(self) -> int:
        return ENDLESS if self.babble else self.inner.in_waiting  # type: ignore[attr-defined, no-any-return]

    def read(self, size: int = 1, /) -> bytes:
        if not self.babble:
            self.inner.timeout = self.timeout  # type: ignore[attr-defined]
            return self.inner.read(size)  # type: ignore[attr-defined, no-any-return]
        self.taken += size
        return (self.babble * (size // len(self.babble) + 1))[:size]

    def write(self, data: bytes, /) -> int | None:
        return self.inner.write(data)  # type: ignore[attr-defined, no-any-return]


def babbling(protocol: str) -> tuple[ArrayDriver, Babbler, VirtualClock]:
    """An array that streams at 25 Hz, whose port can be made to babble."""
    if protocol == "palpate":
        _, port, clock, _ = bench()
        babbler = Babbler(port)
        driver: ArrayDriver = TactileArray(babbler, clock, "f1")
    else:
        held = ArrayBench(protocol, {"counts_per_n": 1000.0})
        clock, babbler = held.clock, Babbler(held.port)
        babbler.keep = held  # type: ignore[attr-defined]
        driver = held.plugin.driver(babbler, clock, "f1", held.config, held.tip_radius_mm)
    driver.connect()
    driver.start(25.0)
    driver.wait_frame(0.2)
    return driver, babbler, clock


@CONTENTS
@PROTOCOLS
def test_one_call_takes_a_bounded_part(protocol: str, chunk: bytes) -> None:
    array, port, clock = babbling(protocol)
    port.babble = chunk
    port.taken = 0
    for _ in range(5):
        array.frames()
    assert port.taken <= 5 * 64 * 8250 + 65536
    clock.sleep(PERIOD_S)
    array.frames()
    assert port.taken <= 6 * 64 * 8250 + 65536


@CONTENTS
@PROTOCOLS
def test_who_goes_on_like_that_is_named(protocol: str, chunk: bytes) -> None:
    array, port, clock = babbling(protocol)
    port.babble = chunk
    began = clock.now()

    def look_on() -> None:
        while clock.now() < began + 2.0:
            clock.sleep(PERIOD_S)
            array.frames()

    with pytest.raises(DeviceError, match=r"tactile array f1 on \S+ babbles: it sends \d+ bytes/s or more"):
        look_on()
    assert 0.2 < clock.now() - began < 0.4


@CONTENTS
@PROTOCOLS
def test_waiting_for_a_frame_ends_in_time(protocol: str, chunk: bytes) -> None:
    array, port, clock = babbling(protocol)
    port.babble = chunk
    began = clock.now()
    with pytest.raises(DeviceError, match=r"f1 on \S+ sent no frame for 0\.15 s"):
        array.wait_frame(0.15)
    assert clock.now() - began < 0.2


@PROTOCOLS
def test_verbs_that_wait_for_an_answer_end_in_time(protocol: str) -> None:
    array, port, clock = babbling(protocol)
    port.babble = CHUNKS["noise"]
    for verb, limit_s in ((lambda: array.start(25.0), 1.0), (array.stop, 1.0), (array.connect, 17.0)):
        began = clock.now()
        with pytest.raises(DeviceError, match="tactile array f1 on "):
            verb()
        assert clock.now() - began < limit_s


def test_frames_go_on_once_the_babble_is_over() -> None:
    array, port, clock = babbling("palpate")
    port.babble = CHUNKS["3 bytes"]
    array.frames()
    port.babble = b""
    looks = 0
    while not array.frames():  # what was read already has to be worked off
        clock.sleep(PERIOD_S)
        looks += 1
    assert looks < 30
    array.wait_frame(0.2)


def test_a_backlog_of_frames_is_no_babble_and_comes_at_once() -> None:
    array, _, clock, _ = bench()
    array.connect()
    array.start(200.0)
    for pause_s in (3.0, 0.01, 1.0, 5.0):
        clock.sleep(pause_s)
        assert len(array.frames()) == pytest.approx(200 * pause_s, abs=1.1)
    assert array.counters.dropped == array.counters.lost == 0


class Scribbler:
    """A port on which arrives what is put into `coming`; it answers HELLO, once."""

    def __init__(self) -> None:
        self.port: str | None = "mem://scribble"
        self.timeout: float | None = 0.0
        self.coming = bytearray()
        self.taken = 0
        self.requests = 0

    @property
    def in_waiting(self) -> int:
        return len(self.coming)

    def read(self, size: int = 1, /) -> bytes:
        data = bytes(self.coming[:size])
        del self.coming[:size]
        self.taken += len(data)
        return data

    def write(self, data: bytes, /) -> int | None:
        for item in Decoder().feed(data):
            assert isinstance(item, Message)
            if isinstance(item.body, Hello) and not self.requests:
                self.coming += encode(Message(0, 0, Describe(item.body.request_id, SMALL)))
            self.requests += 1
        return len(data)


messages = st.builds(
    wire,
    st.sampled_from([*map(int, MessageType), 0x00, 0x42, 0xFF]),
    st.integers(0, 2**32 - 1) | st.integers(1, 40),
    st.integers(0, 2**64 - 1) | st.integers(0, 10**6),
    st.binary(max_size=60) | st.binary(max_size=30).map(lambda tail: b"\2\3" + tail[:12].ljust(12, b"\1")),
    version=st.sampled_from([0, 1, 1, 1, 1, 2]),
    flags=st.integers(0, 3),
    grow=st.sampled_from([0, 0, 0, 0, 1, 7]),
)
VERBS = ("frames", "wait", "start", "stop", "rate", "connect", "test")


@given(st.lists(st.tuples(st.sampled_from(VERBS), st.lists(messages, max_size=30)), max_size=12))
@settings(max_examples=40)
def test_messages_with_a_right_crc_end_in_values_or_in_errors_that_name_the_array(
    said: list[tuple[str, list[bytes]]],
) -> None:
    clock, port = VirtualClock(), Scribbler()
    array = TactileArray(port, clock, "f1")
    array.connect()
    for verb, data in said:
        port.coming += b"".join(data)
        port.taken = 0
        began = clock.now()
        complaint = call(array, verb)
        assert complaint == "" or complaint.startswith("tactile array f1 on mem://scribble ")
        assert complaint.isprintable()
        assert clock.now() - began < 6.0
        clock.sleep(PERIOD_S)
    counters = array.counters
    assert min(counters.frames, counters.lost, counters.faults, counters.misshapen) >= 0


def call(array: TactileArray, verb: str) -> str:
    """Do what a verb says; its error's message, or "" where what comes of it makes sense."""
    try:
        do(array, verb)
    except DeviceError as error:
        return str(error)
    return ""


def do(array: TactileArray, verb: str) -> None:
    if verb == "frames":
        found = array.frames()
        assert all(int(frame.counts.max()) <= SMALL.max_count for frame in found)
        assert all(a.device_time_s < b.device_time_s for a, b in itertools.pairwise(found))
    elif verb == "wait":
        assert array.wait_frame(0.02).counts.shape == (2, 3)
    elif verb == "connect":
        assert array.connect().problem() is None
    elif verb == "test":
        array.self_test_if_known()
    else:
        {"start": lambda: array.start(100.0), "stop": array.stop, "rate": lambda: array.set_rate(50.0)}[
            verb
        ]()


# ----------------------------------------------------------------------------------------------------
# An array that sends faster than it is read: no verb waits for the end of it, and none drops frames.

COUNTS = np.zeros((SMALL.rows, SMALL.cols), np.uint16).tobytes()
AT_ONCE = 100  # frames that every read finds


class FloodPort:
    """A port that answers HELLO, and that is never empty once anything else has been asked."""

    def __init__(self, *, answers: bool = True) -> None:
        self.port: str | None = "mem://flood"
        self.timeout: float | None = 0.0
        self.answers = answers
        self.decoder = Decoder()
        self.out = bytearray()
        self.sequence = 0
        self.time_us = 0
        self.flows = False
        self.reads = 0

    def say(self, body: MessageBody) -> None:
        self.out += encode(Message(self.sequence, self.time_us, body))
        self.sequence += 1

    @property
    def in_waiting(self) -> int:
        if self.flows and not self.out:
            for _ in range(AT_ONCE):
                self.time_us += 1000
                self.say(Frame(SMALL.rows, SMALL.cols, COUNTS))
        return len(self.out)

    def read(self, size: int = 1, /) -> bytes:
        self.reads += 1
        assert self.reads < 20_000, "nobody ends this"
        data = bytes(self.out[: min(size, self.in_waiting)])
        del self.out[: len(data)]
        return data

    def write(self, data: bytes, /) -> int | None:
        for item in self.decoder.feed(data):
            assert isinstance(item, Message)
            if isinstance(item.body, Hello):
                self.say(Describe(item.body.request_id, SMALL))
            else:
                self.flows = True
                if self.answers:
                    self.say(Ack(item.body.request_id))  # type: ignore[union-attr]
        return len(data)


class CountedPort(FloodPort):
    """A port that counts how often it is asked whether something waits."""

    asked = 0

    @property
    def in_waiting(self) -> int:
        self.asked += 1
        return len(self.out)

    def read(self, size: int = 1, /) -> bytes:
        data = bytes(self.out[:size])
        del self.out[: len(data)]
        return data


def test_a_port_is_asked_once_where_no_time_passes() -> None:
    port, clock = CountedPort(), VirtualClock()
    array = TactileArray(port, clock, "f1")
    array.connect()
    array.start(100)
    for frames in (1, 3, 5000 // len(COUNTS)):  # the last ones are more than a read brings
        for _ in range(frames):
            port.time_us += 10_000
            clock.sleep(0.01)
            port.say(Frame(SMALL.rows, SMALL.cols, COUNTS))
        port.asked, waiting = 0, len(port.out)
        assert len(array.frames()) == frames
        assert port.asked == -(-waiting // 4096)
    assert waiting > 4096


def flooded() -> tuple[TactileArray, FloodPort]:
    port = FloodPort()
    array = TactileArray(port, VirtualClock(), "f1")
    array.connect()
    return array, port


def test_start_and_stop_end_with_their_answer() -> None:
    array, port = flooded()
    array.start(100)
    assert port.reads < 10
    array.stop()
    assert port.reads < 20
    assert array.counters.dropped == 0


def test_frames_come_by_and_by_and_none_is_dropped() -> None:
    array, _ = flooded()
    array.start(100)
    numbers = [frame.sequence for _ in range(3) for frame in array.frames()]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len(numbers) > 3 * 50
    assert (array.counters.dropped, array.counters.lost) == (0, 0)


def test_frames_that_are_waited_for_come_in_order() -> None:
    array, _ = flooded()
    array.start(100)
    numbers = [array.wait_frame(1.0).sequence for _ in range(5000)]
    assert numbers == list(range(numbers[0], numbers[0] + 5000))
    assert array.counters.dropped == 0


def test_noise_without_end_is_left_alone_after_a_while() -> None:
    array, port = flooded()
    array.start(100)
    port.say = lambda _: port.out.extend(b"\x01" * 10_000)  # type: ignore[method-assign]
    array.frames()
    assert array.frames() == []
    assert array.counters.faults > 0
