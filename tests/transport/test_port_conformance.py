"""One suite for every kind of port: what a client may rely on, in virtual time, on a pty and on TCP alike."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
import serial
from recorded_ports import Listener
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.device_server import DeviceServer, serve_pty, serve_tcp
from palpate.drivers.emulators.wire_faults import FaultyWire
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.recording import Direction
from palpate.drivers.transport.wire import Device, Emission

BAUD = 115_200


class EchoTicker:
    """Echoes every byte 1 ms later, and sends b'tick' every 50 ms while ticking."""

    def __init__(self) -> None:
        self.ticking = False
        self._next = 0.05

    def feed(self, data: bytes, now: float) -> list[Emission]:
        if data == b"T":
            self.ticking = True
            self._next = now + 0.05
            return []
        return [(now + 1e-3, data)]

    def poll(self, now: float) -> list[Emission]:
        emissions: list[Emission] = []
        while self.ticking and self._next <= now:
            emissions.append((self._next, b"tick"))
            self._next += 0.05
        return emissions

    def next_due(self) -> float | None:
        return self._next if self.ticking else None


class RateTeller(EchoTicker):
    """Hears every rate, and answers with the one at which it was spoken to."""

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:  # noqa: ARG002
        return [(now + 1e-3, b"%d" % baudrate)]


@dataclass
class Bench:
    clock: Clock
    open: Callable[..., SerialBase]
    open_teller: Callable[..., SerialBase]
    has_rates: bool = True

    def need_rates(self) -> None:
        if not self.has_rates:
            pytest.skip("a socket has no baud rate")


@pytest.fixture(
    params=[*(f"{how}{where}" for how in ("", "recorded ", "faulty ") for where in ("mock", "pty", "tcp"))]
)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    recorded = request.param.startswith("recorded")
    device = FaultyWire(EchoTicker(), 7) if request.param.startswith("faulty") else EchoTicker()

    def opener(url: str, clock: Clock) -> Callable[..., SerialBase]:
        def open_(baudrate: int = BAUD, timeout_s: float = 0.5) -> SerialBase:
            port = open_port(url, baudrate, timeout_s=timeout_s)
            return Listener(clock).on(port) if recorded else port

        return open_

    if request.param.endswith("mock"):
        virtual = VirtualClock()
        hub = MockHub(virtual, "conformance")
        urls = [hub.attach("echo", device, BAUD), hub.attach("teller", RateTeller(), BAUD)]
        yield Bench(virtual, *(opener(url, virtual) for url in urls))
        return
    real = MonotonicClock()
    devices: dict[str, tuple[Device, int]] = {"echo": (device, BAUD), "teller": (RateTeller(), BAUD)}
    tcp = request.param.endswith("tcp")
    with (serve_tcp if tcp else serve_pty)(devices, real, threading.Event()) as service:
        yield Bench(real, *(opener(service.paths[name], real) for name in devices), has_rates=not tcp)


def test_bytes_come_back_in_order(bench: Bench) -> None:
    data = bytes(range(256))
    with bench.open() as port:
        assert port.write(data) == 256
        assert port.read(256) == data


def test_read_gives_no_more_than_asked(bench: Bench) -> None:
    with bench.open() as port:
        port.write(b"abcdef")
        assert port.read(2) == b"ab"
        assert port.read(4) == b"cdef"


def test_read_returns_what_came_when_time_is_up(bench: Bench) -> None:
    with bench.open(timeout_s=0.05) as port:
        port.write(b"abc")
        start = bench.clock.now()
        assert port.read(10) == b"abc"
        assert 0.04 < bench.clock.now() - start < 0.3


def test_a_silent_device_costs_the_timeout(bench: Bench) -> None:
    with bench.open(timeout_s=0.05) as port:
        start = bench.clock.now()
        assert port.read(1) == b""
        assert 0.049 < bench.clock.now() - start < 0.3


def test_polling_without_timeout_ends(bench: Bench) -> None:
    with bench.open(timeout_s=0) as port:
        port.write(b"xyz")
        received = b""
        start = bench.clock.now()
        while len(received) < 3:
            received += port.read(3)
            assert bench.clock.now() - start < 1.0
        assert received == b"xyz"


def test_in_waiting_counts_what_a_read_would_give(bench: Bench) -> None:
    with bench.open() as port:
        assert port.in_waiting == 0  # type: ignore[attr-defined]
        port.write(b"12345")
        assert port.read(1) == b"1"
        bench.clock.sleep(0.05)
        assert port.in_waiting == 4  # type: ignore[attr-defined]
        assert port.read(4) == b"2345"


def test_reset_forgets_what_came(bench: Bench) -> None:
    with bench.open(timeout_s=0.05) as port:
        port.write(b"old")
        bench.clock.sleep(0.05)
        port.reset_input_buffer()  # type: ignore[attr-defined]
        assert port.read(3) == b""
        port.write(b"new")
        assert port.read(3) == b"new"


def test_unasked_bytes_arrive_in_time(bench: Bench) -> None:
    with bench.open() as port:
        port.write(b"T")
        start = bench.clock.now()
        assert port.read(8) == b"ticktick"
        assert 0.09 < bench.clock.now() - start < 0.3


def test_another_client_may_follow(bench: Bench) -> None:
    for word in (b"one", b"two"):
        with bench.open() as port:
            port.write(word)
            assert port.read(3) == word


def test_closing_twice_is_harmless_and_use_after_is_an_error(bench: Bench) -> None:
    port = bench.open()
    port.close()
    port.close()
    with pytest.raises(serial.SerialException):
        port.read(1)
    with pytest.raises(serial.SerialException):
        port.write(b"x")


def test_wrong_baud_rate_is_not_understood(bench: Bench) -> None:
    bench.need_rates()
    with bench.open(baudrate=57_600, timeout_s=0.05) as port:
        port.write(b"hello")
        assert port.read(5) == b""


@pytest.mark.parametrize("rate", [9600, 57_600, 1_000_000, 4_500_000])
def test_a_device_that_knows_rates_hears_the_clients(bench: Bench, rate: int) -> None:
    bench.need_rates()
    with bench.open_teller(baudrate=rate) as port:
        port.write(b"?")
        assert port.read(len(str(rate))) == b"%d" % rate


def test_a_client_may_change_its_rate(bench: Bench) -> None:
    bench.need_rates()
    with bench.open_teller(baudrate=57_600) as port:
        port.write(b"?")
        assert port.read(5) == b"57600"
        port.baudrate = 115_200
        port.write(b"?")
        assert port.read(6) == b"115200"


def test_a_recorder_sees_both_directions(bench: Bench) -> None:
    listener = Listener(bench.clock)
    with listener.on(bench.open()) as port:
        port.write(b"ping")
        assert port.read(4) == b"ping"
    seen = listener.heard
    assert seen[0][0] is Direction.SENT
    assert b"".join(s[2] for s in seen if s[0] is Direction.RECEIVED) == b"ping"
    assert seen == sorted(seen, key=lambda s: s[1])


@pytest.mark.parametrize("serve", [serve_pty, serve_tcp])
def test_a_real_port_in_use_says_so(serve: Callable[..., DeviceServer]) -> None:
    with serve({"echo": (EchoTicker(), BAUD)}, MonotonicClock(), threading.Event()) as service:
        path = service.paths["echo"]
        with open_port(path, BAUD), pytest.raises(DeviceError, match=f"{path} .* another program"):
            open_port(path, BAUD)


class Ponderous:
    """An echo whose every second of life takes two seconds to compute."""

    def __init__(self) -> None:
        self._lived = MonotonicClock().now()

    def feed(self, data: bytes, now: float) -> list[Emission]:
        self._live(now)
        return [(now, data)]

    def poll(self, now: float) -> list[Emission]:
        self._live(now)
        return []

    def next_due(self) -> float | None:
        return None

    def _live(self, now: float) -> None:
        MonotonicClock().sleep(2 * max(0.0, now - self._lived))
        self._lived = now


@pytest.mark.realtime
def test_a_device_that_is_slow_to_compute_still_answers_in_time() -> None:
    """Its time runs slower then; before, it fell behind ever further."""
    clock = MonotonicClock()
    with (
        serve_pty({"slow": (Ponderous(), BAUD)}, clock, threading.Event()) as service,
        open_port(service.paths["slow"], BAUD) as port,
    ):
        port.timeout = 2.0
        late = []
        for _ in range(12):
            begin = clock.now()
            port.write(b"?")
            assert port.read(1) == b"?"
            late.append(clock.now() - begin)
            clock.sleep(0.05)
    assert max(late) < 0.3, late
