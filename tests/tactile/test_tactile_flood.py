"""An array that sends faster than it is read: no verb waits for the end of it, and none drops frames."""

import numpy as np
from tactile_vectors import SMALL

from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Hello, Message, MessageBody
from palpate.drivers.transport.clock import VirtualClock

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
