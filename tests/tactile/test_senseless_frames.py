"""Frames whose CRC holds and whose contents make no sense: single ones are dropped, five in a row told."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import pytest
from memory_port import MemoryPort, plugged
from tactile_vectors import SMALL, wire
from wording import missing

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Hello, Message, MessageBody
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.wire import Emission

PERIOD_S = 0.01
Spoil = Callable[[Message], Message]


@dataclass
class Streamer:
    """An array whose frames are spoiled by `spoil` before they leave: what its firmware does wrong."""

    description: Description = SMALL
    spoil: Spoil = lambda message: message

    def __post_init__(self) -> None:
        self.ears = Decoder()
        self.sequence = 0
        self.born_s = 0.0
        self.next_s: float | None = None

    def restart(self, now: float, *, streams: bool) -> None:
        """Reset; one that breaks the protocol streams on by itself."""
        self.sequence, self.born_s = 0, now
        self.next_s = now + PERIOD_S if streams else None

    def say(self, body: MessageBody, now: float) -> Emission:
        message = Message(self.sequence, round((now - self.born_s) * 1e6), body)
        self.sequence += 1
        if isinstance(body, Frame):
            message = self.spoil(message)
        return now, encode(message)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        out = self.poll(now)
        for item in self.ears.feed(data):
            assert isinstance(item, Message)
            body = item.body
            if isinstance(body, Hello):
                out.append(self.say(Describe(body.request_id, self.description), now))
            else:
                self.next_s = now + PERIOD_S
                out.append(self.say(Ack(body.request_id), now))  # type: ignore[union-attr]
        return out

    def poll(self, now: float) -> list[Emission]:
        out = []
        while self.next_s is not None and self.next_s <= now:
            d = self.description
            counts = np.full((d.rows, d.cols), 40, "<u2")
            out.append(self.say(Frame(d.rows, d.cols, counts.tobytes()), self.next_s))
            self.next_s += PERIOD_S
        return out

    def next_due(self) -> float | None:
        return self.next_s


def streaming(device: Streamer) -> tuple[TactileArray, MemoryPort, VirtualClock]:
    array, port, clock = plugged(device)
    array.connect()
    array.start(100.0)
    return array, port, clock


def read(array: TactileArray, clock: VirtualClock, looks: int) -> list[int]:
    """Numbers of the frames that come in so many looks, one a period."""
    found = []
    for _ in range(looks):
        clock.sleep(PERIOD_S)
        found += [frame.sequence for frame in array.frames()]
    return found


def at_time(time_us: int) -> Spoil:
    return lambda message: message._replace(time_us=time_us)


def counting(value: int, size: int = 6) -> Spoil:
    body = Frame(2, 3, np.full(size, value, "<u2").tobytes())
    return lambda message: message._replace(body=body)


def standing() -> Spoil:
    seen: list[int] = []

    def spoil(message: Message) -> Message:
        seen.append(message.time_us)
        return message._replace(time_us=seen[0])

    return spoil


def backwards() -> Spoil:
    times = count(10**9, -5000)
    return lambda message: message._replace(time_us=next(times))


WRONG: dict[str, tuple[Callable[[], Spoil], str]] = {
    "count above": (lambda: counting(4096), "count 4096 at row 0, column 0 (allowed: 0 to 4095)"),
    "count highest": (lambda: counting(65535), "count 65535 at row 0, column 0 (allowed: 0 to 4095)"),
    "time runs backwards": (backwards, "device time 99998"),
    "time stands still": (standing, "device time 210000 µs after 210000 µs (allowed: ascending)"),
    "time at the end": (lambda: at_time(2**64 - 1), "device time 18446744073709551615 µs"),
    "time from nowhere": (lambda: at_time(2**60), "device time 1152921504606846976 µs"),
    "a minute ahead": (
        lambda: lambda message: message._replace(time_us=message.time_us + 60_000_000),
        "µs after",
    ),
    "another size": (
        lambda: lambda message: message._replace(body=Frame(3, 2, bytes(12))),
        "3 x 2 taxels (described: 2 x 3)",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_senseless_frames_in_a_row_are_an_error_that_says_why(name: str) -> None:
    make, text = WRONG[name]
    device = Streamer()
    array, _, clock = streaming(device)
    assert len(read(array, clock, 20)) == 20
    device.spoil = make()
    began = clock.now()
    with pytest.raises(DeviceError) as caught:
        read(array, clock, 20)
    assert 5 * PERIOD_S <= clock.now() - began + 1e-9 <= 7 * PERIOD_S
    said = str(caught.value)
    assert said.startswith("tactile array f1 on mem://f1 sent 5 frames in a row that make no sense: "), said
    assert text in said
    assert array.counters.misshapen >= 5
    with pytest.raises(DeviceError, match="make no sense"):
        array.wait_frame(1.0)
    assert clock.now() - began < 0.2


@pytest.mark.parametrize("name", WRONG)
def test_single_ones_are_dropped_and_counted(name: str) -> None:
    make, _ = WRONG[name]
    spoil = make()
    device = Streamer()
    turns = count()
    device.spoil = lambda message: spoil(message) if next(turns) % 7 in (3, 4) else message
    array, _, clock = streaming(device)
    found = read(array, clock, 70)
    assert array.counters.misshapen == 70 - len(found)
    assert 18 <= array.counters.misshapen <= 20  # a first one that is ahead is taken, where there is no other
    assert array.counters.frames == len(found)
    assert array.counters.lost == 0


def test_a_frame_that_is_too_short_is_told_too() -> None:
    device = Streamer()
    array, port, clock = streaming(device)
    numbers = count(100)
    device.next_s = None
    for _ in range(4):
        port.buffer += wire(0x90, next(numbers), 10**6, b"\x02\x03" + bytes(11))
        assert array.frames() == []
    assert missing(array.silence, "4 frames", "2 x 3 taxels", "13 bytes") == []
    port.buffer += wire(0x90, next(numbers), 10**6, b"\x02\x03" + bytes(11))
    with pytest.raises(DeviceError, match="2 x 3 taxels in a payload of 13 bytes"):
        array.frames()
    assert clock.now() < 1.0


def test_deep_arrays_may_send_any_count() -> None:
    device = Streamer(replace(SMALL, bit_depth=16), counting(65535))
    array, _, clock = streaming(device)
    assert len(read(array, clock, 20)) == 20
    device = Streamer(replace(SMALL, bit_depth=1), counting(1))
    array, _, clock = streaming(device)
    assert len(read(array, clock, 20)) == 20


def test_a_reset_in_a_stream_is_told_as_a_restart() -> None:
    device = Streamer()
    array, _, clock = streaming(device)
    read(array, clock, 500)
    device.restart(clock.now(), streams=True)
    with pytest.raises(
        DeviceError, match=r"has restarted \(number 4 at 0\.05 s of its clock, after number 5"
    ):
        read(array, clock, 20)


def test_a_reset_between_two_streams_is_told_once() -> None:
    device = Streamer()
    array, _, clock = streaming(device)
    read(array, clock, 500)
    device.restart(clock.now(), streams=False)
    assert read(array, clock, 100) == []
    with pytest.raises(
        DeviceError, match=r"has restarted .*check its supply and its cable, then start again"
    ):
        array.start(100.0)
    array.start(100.0)
    assert len(read(array, clock, 20)) >= 19


def test_a_host_that_was_held_up_reads_old_frames_and_then_new_ones() -> None:
    device = Streamer()
    array, port, clock = streaming(device)
    read(array, clock, 50)
    clock.sleep(5.0)
    _ = port.in_waiting
    del port.buffer[600:]  # what a terminal's buffer holds; the rest is lost
    assert 10 <= len(array.frames()) <= 20
    assert read(array, clock, 50)[-1] == device.sequence - 1
    assert array.counters.misshapen == 0
    assert array.counters.lost > 400


def test_frames_that_come_twice_are_dropped_without_a_word() -> None:
    device = Streamer()
    array, port, clock = streaming(device)
    for _ in range(50):
        clock.sleep(PERIOD_S)
        _ = port.in_waiting
        port.buffer += bytes(port.buffer)
        assert len(array.frames()) == 1


def test_a_number_that_stands_still_is_told() -> None:
    device = Streamer(spoil=lambda message: message._replace(sequence=7))
    array, _, clock = streaming(device)
    with pytest.raises(DeviceError, match=r"no sense: number 7 at .* s of its clock, after number 7"):
        read(array, clock, 20)
