"""The wire in memory: time, USB adapter, playback."""

import gc

import pytest
import serial

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.usb_adapter import (
    AdapterTruth,
    HubStalls,
    PluggedPort,
    PortIntruder,
    UsbAdapter,
)
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import FollowedPorts, PortMissing, open_port
from palpate.drivers.transport.recording import Direction
from palpate.drivers.transport.replay import PlaybackPort, RecordedBytes
from palpate.drivers.transport.wire import Emission
from support.devices.simple import Quiet

# ----------------------------------------------------------------------------------------------------
# Time on mock wires, and how ports that are not there are reported.


class Echo(Quiet):
    def feed(self, data: bytes, now: float) -> list[Emission]:
        return [(now + 1e-4, data)]


def test_wire_time_is_accounted_both_ways() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    with open_port(hub.attach("echo", Echo(), 1_000_000), 1_000_000, timeout_s=1) as port:
        port.write(bytes(100))
        assert clock.now() == pytest.approx(1e-3)
        assert port.read(1) == b"\0"
        assert clock.now() == pytest.approx(1e-3 + 1e-4 + 1e-5)
        assert len(port.read(99)) == 99
        assert clock.now() == pytest.approx(1e-3 + 1e-4 + 1e-3)


def test_answers_queue_behind_one_another() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    with open_port(hub.attach("echo", Echo(), 10_000), 10_000, timeout_s=1) as port:
        port.write(b"a")  # its echo would start at 1.1 ms and take 1 ms
        port.write(b"b")  # its echo would start at 2.1 ms
        assert port.read(2) == b"ab"
        assert clock.now() == pytest.approx(3.1e-3)


class Teller(Echo):
    """Answers in pieces, with a pause between them, and counts how often it is asked for more."""

    asked = 0

    def feed(self, data: bytes, now: float) -> list[Emission]:
        return [(now + 0.9e-3 * k, bytes([byte])) for k, byte in enumerate(data)]

    def poll(self, now: float) -> list[Emission]:
        self.asked += 1
        return super().poll(now)


def test_a_read_waits_for_all_pieces_at_once() -> None:
    clock, teller = VirtualClock(), Teller()
    hub = MockHub(clock)
    with open_port(hub.attach("t", teller, 1_000_000), 1_000_000, timeout_s=1) as port:
        port.write(b"abcd")
        begun_s, teller.asked = clock.now(), 0
        assert port.read(3) == b"abc"
        assert clock.now() - begun_s == pytest.approx(1.8e-3 + 1e-5)
        assert teller.asked <= 2
        assert port.read(1) == b"d"


def test_a_read_whose_time_is_up_has_the_pieces_that_came() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    with open_port(hub.attach("t", Teller(), 1_000_000), 1_000_000, timeout_s=1.5e-3) as port:
        port.write(b"abcd")
        begun_s = clock.now()
        assert port.read(4) == b"ab"
        assert clock.now() - begun_s == pytest.approx(1.5e-3)
        assert port.read(4) == b"cd"


def test_a_read_that_does_not_wait_has_the_first_piece() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    with open_port(hub.attach("t", Teller(), 1_000_000), 1_000_000) as port:
        port.write(b"abcd")
        assert [port.read(4) for _ in range(4)] == [b"a", b"b", b"c", b"d"]


def test_an_empty_poll_moves_the_clock_by_a_millisecond_at_most() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    with open_port(hub.attach("echo", Echo(), 1_000_000), 1_000_000) as port:
        assert port.read(1) == b""
        assert clock.now() == pytest.approx(1e-3)
        assert port.in_waiting == 0  # type: ignore[attr-defined]
        assert clock.now() == pytest.approx(1e-3)


def test_an_answer_at_another_rate_than_the_ports_is_lost() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    with open_port(hub.attach("echo", Echo(), 57_600), 57_600, timeout_s=0.1) as port:
        port.write(b"lost")
        port.baudrate = 1_000_000
        assert port.read(4) == b""
        port.baudrate = 57_600
        port.write(b"kept")
        assert port.read(4) == b"kept"


def test_two_wires_share_the_clock_but_not_the_bytes() -> None:
    clock = VirtualClock()
    hub = MockHub(clock)
    first = open_port(hub.attach("a", Echo(), 1_000_000), 1_000_000, timeout_s=1)
    second = open_port(hub.attach("b", Echo(), 1_000_000), 1_000_000, timeout_s=1)
    first.write(b"1")
    second.write(b"2")
    assert second.read(1) == b"2"
    assert first.read(1) == b"1"


@pytest.mark.parametrize("url", ["mock://nobody/bus", "/dev/does-not-exist", "nonsense://x"])
def test_a_port_that_is_not_there_is_named(url: str) -> None:
    with pytest.raises(DeviceError, match=url):
        open_port(url, 115_200)


def test_a_hub_that_is_gone_takes_its_ports_with_it() -> None:
    hub = MockHub(VirtualClock(), "short-lived")
    url = hub.attach("x", Echo(), 9600)
    open_port(url, 9600).close()
    del hub
    gc.collect()
    with pytest.raises(DeviceError, match="short-lived"):
        open_port(url, 9600)


def test_a_closed_hub_frees_its_name() -> None:
    hub = MockHub(VirtualClock(), "closing")
    url = hub.attach("x", Echo(), 9600)
    hub.close()
    hub.close()
    with pytest.raises(DeviceError):
        open_port(url, 9600)
    assert MockHub(VirtualClock(), "closing").name == "closing"


def test_hubs_of_one_name_do_not_collide() -> None:
    clock = VirtualClock()
    one, two = MockHub(clock, "twin"), MockHub(clock, "twin")
    assert one.attach("x", Echo(), 9600) != two.attach("x", Echo(), 9600)
    with pytest.raises(ValueError, match="already"):
        one.attach("x", Echo(), 9600)


# ----------------------------------------------------------------------------------------------------
# Emulated USB adapters: when what a device sends reaches the host, and in which pieces.


class Answers(Quiet):
    """Answers each write 0.1 ms later with `answer`."""

    def __init__(self, answer: bytes) -> None:
        self.answer, self.heard = answer, b""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        self.heard += data
        return [(now + 1e-4, self.answer)]


def plugged(
    answer: bytes, truth: AdapterTruth, seed: int = 1
) -> tuple[VirtualClock, MockHub, Answers, serial.SerialBase]:
    clock, device = VirtualClock(), Answers(answer)
    hub = MockHub(clock, "plugged")
    adapter = UsbAdapter(device, 1_000_000, truth, seed)
    hub.attach("again", PluggedPort(adapter, 1), 1_000_000)
    url = hub.attach("first", PluggedPort(adapter), 1_000_000)
    return clock, hub, device, open_port(url, 1_000_000, timeout_s=1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_short_answer_waits_for_the_latency_timer_at_most(seed: int) -> None:
    clock, _hub, _, port = plugged(b"0123456789", AdapterTruth(latency_s=0.016), seed)
    waits = []
    for number in range(50):
        begin = clock.now()
        port.write(b"?")
        assert port.read(10) == b"0123456789"
        waits.append(clock.now() - begin)
        clock.sleep(0.0037 * number % 0.016)
    assert max(waits) <= 0.016 + 3e-4
    assert max(waits) > 0.012
    assert min(waits) < 0.008


def test_a_long_answer_comes_in_full_packets_and_a_rest() -> None:
    clock, _hub, _, port = plugged(bytes(range(150)), AdapterTruth(latency_s=0.016))
    port.write(b"?")
    begin = clock.now()
    sizes = []
    while sum(sizes) < 150:
        port.timeout = 0
        if found := port.read(1000):
            sizes.append(len(found))
    assert sizes[-1] < 62
    assert sum(sizes) == 150
    assert clock.now() - begin <= 0.016 + 2e-3


def test_an_echo_comes_before_the_answer() -> None:
    _clock, _hub, _, port = plugged(b"answer", AdapterTruth(echoes=True))
    port.write(b"question")
    assert port.read(14) == b"questionanswer"


def test_a_hub_that_stalls_holds_both_ways_back_and_loses_nothing() -> None:
    stalls = HubStalls(0.05, 0.1, 0.2)
    clock, _hub, device, port = plugged(b"abc", AdapterTruth(stalls=stalls))
    longest = 0.0
    for _ in range(100):
        begin = clock.now()
        port.write(b"?")
        assert port.read(3) == b"abc"
        longest = max(longest, clock.now() - begin)
    assert device.heard == b"?" * 100
    assert 0.05 < longest < 0.25


def test_another_program_writes_and_reads_too() -> None:
    clock, _hub, device, port = plugged(b"abc", AdapterTruth(grab=PortIntruder(5.0)))
    port.timeout = 0.01
    answered = 0
    for _ in range(200):
        port.write(b"?")
        answered += port.read(3) == b"abc"
        clock.sleep(0.015)
    assert b"AT\r" in device.heard
    assert 20 < answered < 180


class _Plugs:
    def __init__(self, clock: VirtualClock, urls: dict[str, float], until_s: dict[str, float]) -> None:
        self._clock, self._from, self._until = clock, urls, until_s

    def adapter_of(self, port: str) -> str | None:
        now = self._clock.now()
        return "the adapter" if self._from[port] <= now < self._until[port] else None

    def port_of(self, adapter: object) -> str | None:
        assert adapter == "the adapter"
        return next((url for url in self._from if self.adapter_of(url)), None)


def test_an_adapter_is_followed_to_its_new_name() -> None:
    clock, hub, _, port = plugged(b"abc", AdapterTruth(gone_s=(1.0, 2.0), renamed=True))
    port.close()
    first, again = f"mock://{hub.name}/first", f"mock://{hub.name}/again"
    ports = FollowedPorts(_Plugs(clock, {first: 0.0, again: 2.0}, {first: 1.0, again: 1e9}))
    before = ports.open(first, 1_000_000)
    clock.sleep(1.5)
    with pytest.raises(serial.SerialException):
        before.write(b"?")
    with pytest.raises(PortMissing):
        ports.open(first, 1_000_000)
    clock.sleep(1.0)
    after = ports.open(first, 1_000_000)
    assert after.port == again
    after.timeout = 0.1
    after.write(b"?")
    assert after.read(3) == b"abc"


# ----------------------------------------------------------------------------------------------------
# A port that plays a recording back: answers first, then by the clock.

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
