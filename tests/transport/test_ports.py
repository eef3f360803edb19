"""Ports: what holds for every kind, sockets, terminals, serial ports."""

import fcntl
import os
import socket
import struct
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import serial
from serial import SerialException
from serial.serialutil import SerialBase
from serial.tools.list_ports_common import ListPortInfo

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.device_server import DeviceServer, serve_tcp
from palpate.drivers.emulators.pseudo_terminal import baud_rate, serve_pty
from palpate.drivers.emulators.wire_faults import FaultyWire
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import PortTaken, describe_ports, has_baudrate, open_port, serial_ports
from palpate.drivers.transport.recording import Direction
from palpate.drivers.transport.wire import Device, Emission
from support.commands.command import PATIENCE_S, until
from support.devices.ports import Listener
from support.devices.simple import Quiet

# ----------------------------------------------------------------------------------------------------
# One suite for every kind of port: what a client may rely on, in virtual time, on a pty and on TCP alike.

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
        def open_(baudrate: int = BAUD, timeout_s: float = 10.0) -> SerialBase:
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
        start = bench.clock.now()
        port.write(b"T")
        assert port.read(8) == b"ticktick"
        assert bench.clock.now() - start > 0.09


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
        port.timeout = PATIENCE_S
        late = []
        for _ in range(12):
            begin = clock.now()
            port.write(b"?")
            assert port.read(1) == b"?"
            late.append(clock.now() - begin)
            clock.sleep(0.05)
    assert sorted(late)[len(late) // 2] < 2.0, late


# ----------------------------------------------------------------------------------------------------
# `socket://` ports where pyserial's own differ from serial ports: counts, hanging up, refusal, addresses.

SOCKET_BAUD = 1_000_000


class Server:
    """Takes one connection and keeps it until told."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self.listener.getsockname()[1]}"

    def opened(self) -> tuple[serial.SerialBase, socket.socket]:
        port = open_port(self.url, SOCKET_BAUD, timeout_s=2.0)
        link, _ = self.listener.accept()
        return port, link


@pytest.fixture
def server():
    found = Server()
    yield found
    found.listener.close()


def test_in_waiting_counts_all_bytes(server: Server) -> None:
    port, link = server.opened()
    with port, link:
        assert port.in_waiting == 0
        link.sendall(bytes(300))
        until(lambda: port.in_waiting == 300)
        assert port.read(300) == bytes(300)
        assert port.out_waiting == 0


def test_the_other_end_may_go_first(server: Server) -> None:
    port, link = server.opened()
    link.sendall(b"last")
    link.close()
    assert port.read(4) == b"last", "what came before is there"
    with pytest.raises(SerialException, match="hung up"):
        _ = port.in_waiting
    with pytest.raises(SerialException):
        port.read(1)
    port.close()
    port.close()
    with pytest.raises(SerialException):
        _ = port.in_waiting


def test_small_packets_are_not_held_back(server: Server) -> None:
    port, link = server.opened()
    with port, link:
        assert port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_server_that_hangs_up_at_once_counts_as_in_use(server: Server) -> None:
    def refuse() -> None:
        server.listener.accept()[0].close()

    refusing = threading.Thread(target=refuse)
    refusing.start()
    with pytest.raises(PortTaken, match=r"socket://127.0.0.1:\d+ is in use"):
        open_port(server.url, SOCKET_BAUD)
    refusing.join()


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("socket://127.0.0.1", "baud: it should be socket://HOST:PORT;"),
        ("socket://127.0.0.1:99999", "baud: it should be socket://HOST:PORT;"),
        ("socket://:5000", "baud: it should be socket://HOST:PORT;"),
        ("socket://no-such-host.invalid:5000", "no-such-host.invalid:5000 does not exist"),
    ],
)
def test_an_address_that_leads_nowhere(url: str, said: str) -> None:
    with pytest.raises(DeviceError, match=said):
        open_port(url, SOCKET_BAUD)


def test_a_port_where_nobody_listens() -> None:
    with Server().listener as listener:
        url = f"socket://127.0.0.1:{listener.getsockname()[1]}"
    with pytest.raises(DeviceError, match=f"port {url} does not exist .*: connection refused;"):
        open_port(url, SOCKET_BAUD)


def test_which_ports_have_a_rate() -> None:
    assert has_baudrate("/dev/ttyUSB0")
    assert has_baudrate("mock://bus")
    assert not has_baudrate("socket://127.0.0.1:5000")


# ----------------------------------------------------------------------------------------------------
# The baud rate of a client on a pseudo-terminal, however it was set, is the one that counts.


@pytest.fixture
def pty() -> Iterator[tuple[int, int]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, slave
    os.close(master)
    os.close(slave)


def set_by_number(fd: int, rate: int) -> None:
    """As clients do that use the system's BOTHER for every rate (Rust's serialport)."""
    get, put, bother, cbaud = 0x802C542A, 0x402C542B, 0o10000, 0o10017
    layout = struct.Struct("4I20s2I")
    iflag, oflag, cflag, lflag, rest, _, _ = layout.unpack(fcntl.ioctl(fd, get, bytes(44)))
    fcntl.ioctl(fd, put, layout.pack(iflag, oflag, cflag & ~cbaud | bother, lflag, rest, rate, rate))


@pytest.mark.parametrize("rate", [9600, 57_600, 1_000_000, 4_000_000])
def test_named_rate(pty: tuple[int, int], rate: int) -> None:
    master, slave = pty
    flags = termios.tcgetattr(slave)
    flags[4] = flags[5] = getattr(termios, f"B{rate}")
    termios.tcsetattr(slave, termios.TCSANOW, flags)
    assert baud_rate(master) == rate


@pytest.mark.parametrize("rate", [57_600, 250_000, 1_000_000, 4_500_000])
def test_rate_set_by_number(pty: tuple[int, int], rate: int) -> None:
    master, slave = pty
    set_by_number(slave, rate)
    assert baud_rate(master) == rate


class Echo(Quiet):
    def feed(self, data: bytes, now: float) -> list[Emission]:
        return [(now, data)]


@pytest.mark.parametrize("rate", [1_000_000, 4_500_000])
def test_a_served_device_is_understood_at_its_rate_only(rate: int) -> None:
    with (
        serve_pty({"echo": (Echo(), rate)}, MonotonicClock(), threading.Event()) as service,
        serial.Serial(service.paths["echo"], 115_200, timeout=0.05) as port,
    ):
        port.write(b"slow")
        assert port.read(4) == b""
        port.timeout = 2.0
        port.baudrate = rate
        port.write(b"fast")
        assert port.read(4) == b"fast"
        set_by_number(port.fileno(), rate)
        port.write(b"again")
        assert port.read(5) == b"again"


# ----------------------------------------------------------------------------------------------------
# What is told of serial ports, from folders as Linux has them.


def info(device: Path, **known: object) -> ListPortInfo:
    found = ListPortInfo(str(device))
    for name, value in known.items():
        setattr(found, name, value)
    return found


def test_an_adapter_with_everything_that_linux_tells(tmp_path: Path) -> None:
    device, other = tmp_path / "dev" / "ttyUSB7", tmp_path / "dev" / "ttyS0"
    by_id = tmp_path / "by-id" / "usb-FTDI_USB__-__Serial_Converter_FT3WHRKK-if00-port0"
    timer = tmp_path / "tty" / "ttyUSB7" / "device" / "latency_timer"
    process = tmp_path / "proc" / "4711"
    for folder in (device.parent, by_id.parent, timer.parent, process / "fd"):
        folder.mkdir(parents=True)
    device.touch()
    other.touch()
    by_id.symlink_to(device)
    timer.write_text("16\n")
    (process / "comm").write_text("screen\n")
    (process / "fd" / "3").symlink_to(device)
    (tmp_path / "proc" / "self").mkdir()
    usb = {
        "vid": 0x0403,
        "pid": 0x6014,
        "serial_number": "FT3WHRKK",
        "description": "USB <-> Serial Converter",
    }
    plain, adapter = describe_ports(
        [info(device, **usb), info(other)], by_id.parent, tmp_path / "tty", tmp_path / "proc"
    )
    assert adapter.name == str(by_id)
    assert adapter.kind == "FTDI FT232H, as in ROBOTIS U2D2"
    assert (adapter.usb_ids, adapter.serial_number) == ((0x0403, 0x6014), "FT3WHRKK")
    assert adapter.latency_timer_s == 0.016
    assert adapter.used_by == "screen (process 4711)"
    assert plain.name == str(other)
    assert (plain.kind, plain.usb_ids, plain.by_id, plain.latency_timer_s, plain.used_by) == (None,) * 5


def test_folders_that_are_not_there(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    device.touch()
    gone = tmp_path / "gone"
    (port,) = describe_ports([info(device)], gone, gone, gone)
    assert port.name == str(device)
    assert port.permitted


def test_a_port_that_is_gone_again_is_not_permitted(tmp_path: Path) -> None:
    (port,) = describe_ports([info(tmp_path / "ttyUSB0")], tmp_path, tmp_path, tmp_path)
    assert not port.permitted


def test_this_computers_ports_can_be_listed() -> None:
    names = [port.device for port in serial_ports()]
    assert names == sorted(names)
    assert all(os.path.exists(name) for name in names)
