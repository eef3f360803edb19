"""A port that plays a recording back: answers first, then by the clock."""

from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.recording import Direction
from palpate.drivers.transport.replay import PlaybackPort, RecordedBytes

SENT, RECEIVED = Direction.SENT, Direction.RECEIVED
PIECES = [
    RecordedBytes(0.5, RECEIVED, b"noise"),
    RecordedBytes(1.0, SENT, b"hello"),
    RecordedBytes(1.6, SENT, b"hello"),
    RecordedBytes(1.7, RECEIVED, b"I am"),
    RecordedBytes(1.8, RECEIVED, b" f1"),
    RecordedBytes(2.0, SENT, b"start"),
    RecordedBytes(2.1, RECEIVED, b"one"),
    RecordedBytes(2.2, RECEIVED, b"two"),
]


def test_each_write_gets_what_followed_the_recorded_one() -> None:
    clock = VirtualClock()
    port = PlaybackPort("/dev/f1", PIECES, clock)
    assert (port.in_waiting, port.read(9)) == (0, b"")
    assert port.write(b"hello") == 5
    assert port.read(9) == b"noise", "the first question was not answered"
    assert port.read(9) == b""
    port.write(b"hello")
    assert port.read(3) == b"I a"
    assert port.read(9) == b"m f1"
    assert (port.writes, port.ended, clock.now()) == (2, False, 0.0)
    port.write(b"start")
    port.write(b"one more than recorded")
    assert port.read(9) == b"onetwo"
    assert port.ended


def test_then_the_clock_decides() -> None:
    clock = VirtualClock()
    port = PlaybackPort("/dev/f1", PIECES, clock)
    port.play()
    clock.advance_to(1.75)
    assert (port.in_waiting, port.writes) == (9, 2)
    assert port.write(b"anything") == 8
    assert port.read(99) == b"noiseI am"
    clock.advance_to(9.0)
    assert not port.ended
    assert port.read(99) == b" f1onetwo"
    assert port.ended


def test_waiting_lets_time_pass() -> None:
    clock = VirtualClock()
    port = PlaybackPort("/dev/f1", PIECES, clock)
    port.play()
    port.timeout = 0.3
    assert port.read(1) == b""
    assert port.read(1) == b"n"
    assert clock.now() == 0.6
