"""`socket://` ports where pyserial's own differ from serial ports: counts, hanging up, refusal, addresses."""

import socket
import threading
import time
from collections.abc import Callable

import pytest
import serial
from serial import SerialException

from palpate.base.errors import DeviceError
from palpate.drivers.transport.ports import PortTaken, has_baudrate, open_port

BAUD = 1_000_000


class Server:
    """Takes one connection and keeps it until told."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self.listener.getsockname()[1]}"

    def opened(self) -> tuple[serial.SerialBase, socket.socket]:
        port = open_port(self.url, BAUD, timeout_s=2.0)
        link, _ = self.listener.accept()
        return port, link


@pytest.fixture
def server():
    found = Server()
    yield found
    found.listener.close()


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 5
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_in_waiting_counts_all_bytes(server: Server) -> None:
    port, link = server.opened()
    with port, link:
        assert port.in_waiting == 0
        link.sendall(bytes(300))
        wait_for(lambda: port.in_waiting == 300)
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
        open_port(server.url, BAUD)
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
        open_port(url, BAUD)


def test_a_port_where_nobody_listens() -> None:
    with Server().listener as listener:
        url = f"socket://127.0.0.1:{listener.getsockname()[1]}"
    with pytest.raises(DeviceError, match=f"port {url} does not exist .*: connection refused;"):
        open_port(url, BAUD)


def test_which_ports_have_a_rate() -> None:
    assert has_baudrate("/dev/ttyUSB0")
    assert has_baudrate("mock://bus")
    assert not has_baudrate("socket://127.0.0.1:5000")
