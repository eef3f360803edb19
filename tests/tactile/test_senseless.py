"""Answers and frames of arrays that make no sense."""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import pytest

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Hello, Message, MessageBody, MessageType
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.wire import Emission
from support.commands.command import missing
from support.devices.array_wire import MemoryPort, plugged
from support.devices.simple import Quiet
from support.oracles.array_messages import DESCRIBE_PAYLOAD, SMALL, wire

# ----------------------------------------------------------------------------------------------------
# Answers whose CRC holds and whose contents make no sense: the error names array, port, field and value.
#
# It is what the author of new firmware meets first.

DESCRIBE = struct.Struct("<H16sBBBBBIfff")
FIELDS = ("request", "uid", "flags", "shape", "depth", "rows", "cols", "rate", "scale", "per_n", "radius")
PLAIN = dict(zip(FIELDS, DESCRIBE.unpack_from(DESCRIBE_PAYLOAD), strict=True))
REALS = (-0.5, 0.0, 0.5, 1.0, 3.0)


def describe(
    number: int,
    *,
    reals: Sequence[float] = REALS,
    name: bytes = b"emu 1",
    name_length: int | None = None,
    tail: bytes = b"",
    **fields: object,
) -> bytes:
    """Payload of a DESCRIBE in which some fields are not as they should be."""
    head = DESCRIBE.pack(*(PLAIN | {"request": number} | fields).values())
    length = len(name) if name_length is None else name_length
    return head + struct.pack(f"<{len(reals)}f", *reals) + bytes((length,)) + name + tail


class Firmware(Quiet):
    """New firmware: whatever it is asked, it answers with what `say` makes of the request's number."""

    def __init__(self, say: "Say", *, first: bool = False) -> None:
        self.say = say
        self.good = first  # answer HELLO well
        self.ears = Decoder()

    def feed(self, data: bytes, now: float) -> list[Emission]:
        out = []
        for item in self.ears.feed(data):
            assert isinstance(item, Message)
            number = item.body.request_id  # type: ignore[union-attr]
            if self.good:
                self.good = False
                out.append((now, encode(Message(0, 0, Describe(number, SMALL)))))
            else:
                out.append((now, self.say(number)))
        return out


class Say:
    """What a firmware answers: a payload of some type."""

    def __init__(self, kind: int = MessageType.DESCRIBE, grow: int = 0, **wrong: object) -> None:
        self.kind, self.grow, self.wrong = kind, grow, wrong

    def __call__(self, number: int) -> bytes:
        payload = self.wrong.get("payload")
        if isinstance(payload, bytes):
            payload = struct.pack("<H", number) + payload if self.wrong.get("numbered", True) else payload
        else:
            payload = describe(number, **self.wrong)  # type: ignore[arg-type]
        return wire(self.kind, 0, 0, payload, grow=self.grow)


NAN, INF = math.nan, math.inf
SENSELESS: dict[str, tuple[dict[str, object], str]] = {
    "no rows": ({"rows": 0, "reals": (-0.5, 0.0, 0.5)}, "rows 0 (allowed: 1 to 255)"),
    "more rows than positions": ({"rows": 40}, "a payload of 65 bytes (allowed: 212 or more, with 40 rows"),
    "depth 0": ({"depth": 0}, "bit depth 0 (allowed: 1 to 16)"),
    "scale 0": ({"scale": 0.0}, "full scale 0 N (allowed: 0.001 to 100000 N)"),
    "shape 3": ({"shape": 3}, "shape 3 (allowed: 0 flat, 1 cylinder, 2 free)"),
    "free with positions": ({"shape": 2}, "name length 0 (allowed: 25, the bytes that follow)"),
    "columns nan": ({"reals": (-0.5, NAN, 0.5, 1.0, 3.0)}, "column 1 at nan rad"),
    "pitch 0": ({"reals": (0.0, 0.0, 0.5, 1.0, 3.0)}, "column 1 at 0 rad after one at 0 rad (allowed"),
    "name not UTF-8": ({"name": b"caf\xe9"}, "firmware name 'caf\\xe9' (allowed: UTF-8)"),
    "name cut": ({"name": b"emu", "name_length": 9}, "name length 9 (allowed: 3, the bytes that follow)"),
    "name long": ({"tail": b"\0\0"}, "name length 5 (allowed: 7, the bytes that follow)"),
    "empty": ({"payload": b""}, "DESCRIBE with a payload of 2 bytes"),
    "nothing at all": ({"payload": b"", "numbered": False}, "DESCRIBE with a payload of 0 bytes"),
    "no name": ({"name": b"", "payload": DESCRIBE_PAYLOAD[2:-6]}, "a payload of 59 bytes (allowed: 60"),
}


def refusal(say: Say, *, connected: bool = False) -> str:
    """What the driver says of an array that answers like that, and that it says so at once."""
    array, port, clock = plugged(Firmware(say, first=connected))
    if connected:
        array.connect()
    with pytest.raises(DeviceError) as caught:
        array.start(50.0) if connected else array.connect()
    assert clock.now() < 0.1
    text = str(caught.value)
    assert text.startswith("tactile array f1 on mem://f1 answers "), text
    assert "correct its firmware (docs/tactile-protocol.md, section 2)" in text
    assert text.isprintable()
    assert len(port.written) <= 2
    return text


def test_the_firmware_of_these_tests_can_be_right() -> None:
    array, *_ = plugged(Firmware(Say()))
    assert array.connect() == SMALL


@pytest.mark.parametrize("name", SENSELESS)
def test_a_senseless_description_is_named(name: str) -> None:
    wrong, text = SENSELESS[name]
    said = refusal(Say(**wrong))
    assert "answers HELLO with what cannot be used: DESCRIBE with " in said
    assert text in said


def test_a_length_field_that_is_wrong_is_named() -> None:
    assert "DESCRIBE with length 67 (allowed: 65, the bytes of its payload)" in refusal(Say(grow=2))


def test_answers_of_other_types_are_named() -> None:
    assert "cannot be used: ACK;" in refusal(Say(MessageType.ACK, payload=b""))
    assert "type 0x8f, which version 1 does not have" in refusal(Say(0x8F, payload=b""))
    assert "cannot be used: DESCRIBE;" in refusal(Say(), connected=True)


@pytest.mark.parametrize("reason", [0, 7, 200, 255])
def test_an_unknown_reason_of_a_nack_is_named(reason: int) -> None:
    say = Say(MessageType.NACK, payload=bytes((reason,)))
    assert f"NACK with reason {reason} (allowed: 1 to 6)" in refusal(say)
    assert f"answers START with what cannot be used: NACK with reason {reason}" in refusal(
        say, connected=True
    )


def test_bits_of_flags_that_are_not_known_are_ignored() -> None:
    array, *_ = plugged(Firmware(Say(flags=0xFF)))
    assert array.connect() == SMALL


def test_a_name_that_does_not_print_is_shown_escaped() -> None:
    array, *_ = plugged(Firmware(Say(name="é \x1b[2J\x07\n\u202e v1\0".encode())))
    assert array.connect().firmware == "é \\x1b[2J\\x07\\n\\u202e v1\\x00"


def test_what_is_no_message_at_all_is_told_from_silence() -> None:
    def damaged(number: int) -> bytes:
        data = bytearray(wire(MessageType.DESCRIBE, 0, 0, describe(number)))
        data[10] ^= 0x41
        return bytes(data)

    array, *_ = plugged(Firmware(damaged))  # type: ignore[arg-type]
    with pytest.raises(DeviceError, match=r"does not answer, and what it sends is no message .*10 × CRC"):
        array.connect()


def test_an_answer_that_does_not_repeat_the_number_is_named() -> None:
    array, *_ = plugged(Firmware(lambda _: wire(MessageType.DESCRIBE, 0, 0, describe(0))))  # type: ignore[arg-type]
    with pytest.raises(
        DeviceError, match=r"f1 on mem://f1 answers under request number 0 \(allowed: 1 to 10"
    ):
        array.connect()


# ----------------------------------------------------------------------------------------------------
# Frames whose CRC holds and whose contents make no sense: single ones are dropped, five in a row told.

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


def counting(value: int) -> Spoil:
    body = Frame(2, 3, np.full(6, value, "<u2").tobytes())
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
