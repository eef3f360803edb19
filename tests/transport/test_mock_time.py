"""Time on mock wires, and how ports that are not there are reported."""

import gc

import pytest

from palpate.base.errors import DeviceError
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission


class Echo:
    def feed(self, data: bytes, now: float) -> list[Emission]:
        return [(now + 1e-4, data)]

    def poll(self, now: float) -> list[Emission]:  # noqa: ARG002
        return []

    def next_due(self) -> float | None:
        return None


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
