"""Emulated USB adapters: when what a device sends reaches the host, and in which pieces."""

import pytest
import serial

from palpate.drivers.emulators.usb_adapter import (
    AdapterTruth,
    HubStalls,
    PluggedPort,
    PortIntruder,
    UsbAdapter,
)
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import PortMissing, open_port
from palpate.drivers.transport.replugging import FollowedPorts
from palpate.drivers.transport.wire import Emission


class Answers:
    """Answers each write 0.1 ms later with `answer`."""

    def __init__(self, answer: bytes) -> None:
        self.answer, self.heard = answer, b""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        self.heard += data
        return [(now + 1e-4, self.answer)]

    def poll(self, now: float) -> list[Emission]:  # noqa: ARG002
        return []

    def next_due(self) -> float | None:
        return None


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
