"""Faults of a wire: none at rate 0, each counted, the same for the same seed, each way for itself."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.errors import NotAnswering, PortFailed
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.wire_faults import FaultRates, FaultyWire, RatedFaultyWire, WireRates
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission

BAUD = 1_000_000


@dataclass
class Echo:
    """Echoes each packet 1 ms later, says tick every 10 ms, and keeps what it heard and when."""

    heard: list[tuple[float, bytes]] = field(default_factory=list)
    next_s: float = 0.01
    last_s: float = 0.0

    def feed(self, data: bytes, now: float) -> list[Emission]:
        assert now >= self.last_s, "a device's time never runs backwards"
        self.heard.append((now, data))
        return [*self.poll(now), (now + 1e-3, data)]

    def poll(self, now: float) -> list[Emission]:
        assert now >= self.last_s
        self.last_s = now
        said: list[Emission] = []
        while self.next_s <= now:
            said.append((self.next_s, b"tick"))
            self.next_s += 0.01
        return said

    def next_due(self) -> float | None:
        return self.next_s


@dataclass
class Mute(Echo):
    """Hears only."""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        super().feed(data, now)
        return []

    def poll(self, now: float) -> list[Emission]:
        super().poll(now)
        return []

    def next_due(self) -> float | None:
        return None


@dataclass
class Speaker(Mute):
    """Says what it is fed, at once."""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        super().feed(data, now)
        return [(now, data)]


rate = st.floats(0, 1)
any_rates = st.builds(FaultRates, rate, rate, rate, rate, rate, st.floats(0, 0.05))
both_rates = st.builds(WireRates, any_rates, any_rates)
packet = st.binary(min_size=1, max_size=30)
# seconds that pass, then a packet, or none for a mere look
steps = st.lists(st.tuples(st.floats(0, 0.03), packet | st.none()), max_size=30)
PACKETS = [bytes([i % 256, i // 256]) + bytes(range(20)) for i in range(400)]


def played(device: Echo | FaultyWire, course: list[tuple[float, bytes | None]]) -> list[object]:
    """Everything that a skin gets to see."""
    seen: list[object] = []
    now = 0.0
    for wait, data in course:
        now += wait
        seen.append(device.poll(now) if data is None else device.feed(data, now))
        seen.append(device.next_due())
    return seen


def to_device(rates: FaultRates, seed: int = 5) -> tuple[FaultyWire, Mute]:
    """All PACKETS sent, 0.1 s apart; then a long wait."""
    device = Mute()
    wire = FaultyWire(device, seed, WireRates(to_device=rates))
    for index, data in enumerate(PACKETS):
        assert wire.feed(data, index * 0.1) == []
    wire.poll(1e3)
    return wire, device


def to_host(rates: FaultRates, seed: int = 5) -> tuple[FaultyWire, list[Emission]]:
    wire = FaultyWire(Speaker(), seed, WireRates(to_host=rates))
    return wire, [e for index, data in enumerate(PACKETS) for e in wire.feed(data, index * 0.1)]


def differing_bits(sent: bytes, received: bytes) -> list[int]:
    """Flipped bits of each byte that differs."""
    return [(a ^ b).bit_count() for a, b in zip(sent, received, strict=True) if a != b]


@given(steps, st.integers(0, 2**32))
def test_rates_of_zero_change_nothing(course: list[tuple[float, bytes | None]], seed: int) -> None:
    wire = FaultyWire(Echo(), seed)
    assert played(wire, course) == played(Echo(), course)
    assert wire.counts.to_device.faults == wire.counts.to_host.faults == 0
    assert wire.counts.to_device.packets == sum(data is not None for _, data in course)


@given(steps, both_rates, st.integers(0, 2**32))
def test_a_seed_says_everything(
    course: list[tuple[float, bytes | None]], rates: WireRates, seed: int
) -> None:
    first, second = (FaultyWire(Echo(), seed, rates) for _ in range(2))
    assert played(first, course) == played(second, course)
    assert first.counts == second.counts


def test_another_seed_is_another_course() -> None:
    rates = FaultRates(lost=0.5)
    assert to_device(rates, 5)[1].heard == to_device(rates, 5)[1].heard != to_device(rates, 6)[1].heard


def test_flipped_bits_are_counted_in_bytes() -> None:
    wire, device = to_device(FaultRates(flipped=0.01))
    bits = [
        bit for sent, (_, got) in zip(PACKETS, device.heard, strict=True) for bit in differing_bits(sent, got)
    ]
    assert set(bits) == {1}
    assert wire.counts.to_device.flipped == wire.counts.to_device.faults == len(bits)
    assert 40 < len(bits) < 140, "1 % of 8800"
    assert wire.counts.to_host.packets == 0


def test_lost_packets_are_counted() -> None:
    wire, device = to_device(FaultRates(lost=0.1))
    got = [data for _, data in device.heard]
    assert got == [data for data in PACKETS if data in got]
    assert wire.counts.to_device.lost == wire.counts.to_device.faults == len(PACKETS) - len(got)
    assert 20 < wire.counts.to_device.lost < 70


def test_duplicated_packets_are_counted() -> None:
    wire, said = to_host(FaultRates(duplicated=0.1))
    got = [data for _, data in said]
    assert sorted(set(got)) == sorted(PACKETS)
    assert got == [data for data in PACKETS for _ in range(got.count(data))]
    assert wire.counts.to_host.duplicated == wire.counts.to_host.faults == len(got) - len(PACKETS)
    assert 20 < wire.counts.to_host.duplicated < 70


def test_cut_packets_keep_their_beginning_and_are_counted() -> None:
    wire, said = to_host(FaultRates(cut=0.1))
    pairs = list(zip(PACKETS, (data for _, data in said), strict=True))
    assert all(got and sent.startswith(got) for sent, got in pairs)
    assert wire.counts.to_host.cut == wire.counts.to_host.faults == sum(sent != got for sent, got in pairs)
    _, always = to_host(FaultRates(cut=1.0))
    assert {len(data) for _, data in always} == set(range(1, 22))


def test_a_single_byte_is_never_cut() -> None:
    wire = FaultyWire(Speaker(), 1, WireRates(to_host=FaultRates(cut=1.0)))
    assert wire.feed(b"x", 0.0) == [(0.0, b"x")]
    assert wire.counts.to_host.faults == 0


def test_late_packets_are_counted_either_way() -> None:
    rates = FaultRates(late=0.1, late_s=0.05)
    wire, device = to_device(rates)
    assert [data for _, data in device.heard] == PACKETS
    waits = np.array([instant - index * 0.1 for index, (instant, _) in enumerate(device.heard)])
    assert wire.counts.to_device.late == wire.counts.to_device.faults == np.count_nonzero(waits > 0)
    assert 20 < wire.counts.to_device.late < 70
    assert 0.04 < waits.max() <= 0.05 + 1e-9
    back, said = to_host(rates)
    assert [data for _, data in said] == PACKETS
    delays = [instant - index * 0.1 for index, (instant, _) in enumerate(said)]
    assert back.counts.to_host.late == sum(delay > 0 for delay in delays)


def test_what_follows_a_late_packet_waits_behind_it() -> None:
    device = Mute()
    wire = FaultyWire(device, 3, WireRates(to_device=FaultRates(late=1.0, late_s=1.0)))
    wire.feed(b"first", 0.0)
    wire.rates = WireRates()
    wire.feed(b"second", 1e-3)
    due = wire.next_due()
    assert due is not None
    wire.poll(due - 1e-6)
    assert device.heard == []
    wire.poll(due)
    assert device.heard == [(due, b"first"), (due, b"second")]
    assert wire.next_due() is None
    wire.feed(b"third", 2.0)
    assert device.heard[-1] == (2.0, b"third")


@given(steps, any_rates, st.integers(0, 99))
def test_each_way_has_faults_of_its_own(
    course: list[tuple[float, bytes | None]], rates: FaultRates, seed: int
) -> None:
    one_way = FaultyWire(Mute(), seed, WireRates(to_device=rates))
    both = FaultyWire(Mute(), seed, WireRates(rates, FaultRates(lost=1.0)))
    played(one_way, course)
    played(both, course)
    assert one_way.counts.to_device == both.counts.to_device
    back = FaultyWire(Echo(), seed, WireRates(to_host=rates))
    played(back, course)
    assert back.counts.to_device.faults == 0


@given(st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=30)
def test_a_higher_rate_keeps_the_faults_of_a_lower_one(one: float, other: float) -> None:
    low, high = sorted([one, other])
    lost = [set(PACKETS) - {data for _, data in to_device(FaultRates(lost=r))[1].heard} for r in (low, high)]
    assert lost[0] <= lost[1]


@given(steps, both_rates, st.integers(0, 99))
@settings(max_examples=60)
def test_the_books_balance(course: list[tuple[float, bytes | None]], rates: WireRates, seed: int) -> None:
    device = Speaker()
    wire = FaultyWire(device, seed, rates)
    said = [e for batch in played(wire, course) if isinstance(batch, list) for e in batch]
    said += wire.poll(1e3)
    out, back = wire.counts.to_device, wire.counts.to_host
    assert out.packets == sum(data is not None for _, data in course)
    assert len(device.heard) == out.packets - out.lost + out.duplicated == back.packets
    assert len(said) == back.packets - back.lost + back.duplicated
    instants = [instant for instant, _ in said]
    assert instants == sorted(instants), "nothing overtakes on a wire"


def test_rates_change_at_any_time() -> None:
    device = Mute()
    wire = FaultyWire(device, 1)
    for index, data in enumerate(PACKETS):
        if index == 100:
            wire.rates = WireRates(to_device=FaultRates(lost=1.0))
        if index == 200:
            wire.rates = WireRates()
        wire.feed(data, index * 0.1)
    assert [data for _, data in device.heard] == PACKETS[:100] + PACKETS[200:]


@pytest.mark.parametrize("wrong", [{"lost": 1.1}, {"flipped": -0.1}, {"cut": float("nan")}, {"late_s": -1.0}])
def test_what_is_no_rate_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        FaultRates(**wrong)


def test_unplugged_and_plugged_in_again() -> None:
    device = Mute()
    wire = FaultyWire(device, 2, WireRates(to_device=FaultRates(late=1.0, late_s=5.0)))
    wire.feed(b"under way", 0.0)
    wire.unplugged = True
    with pytest.raises(serial.SerialException, match="write failed"):
        wire.feed(b"lost", 0.1)
    with pytest.raises(serial.SerialException, match="device disconnected"):
        wire.poll(0.2)
    assert wire.next_due() is None
    assert device.last_s == 0.2, "the device lives on"
    wire.unplugged = False
    wire.rates = WireRates()
    wire.feed(b"heard", 9.0)
    assert device.heard == [(9.0, b"heard")]


def bus_on(wire: FaultyWire) -> tuple[Bus, MockHub]:
    clock = VirtualClock()
    hub = MockHub(clock, "faulty")
    return Bus(open_port(hub.attach("bus", wire, BAUD), BAUD), clock, BAUD), hub


def test_the_bus_sees_what_the_wire_does() -> None:
    wire = FaultyWire(ServoChain([EmulatedServo(1)], lambda _: None), 1)
    bus, hub = bus_on(wire)
    assert bus.ping(1) == Ping(1020, 45)
    wire.rates = WireRates(
        to_device=FaultRates(late=1.0, late_s=2e-3), to_host=FaultRates(late=1.0, late_s=2e-3)
    )
    assert bus.ping(1) == Ping(1020, 45)
    assert wire.counts.to_device.late == wire.counts.to_host.late == 1
    wire.rates = WireRates(to_host=FaultRates(lost=1.0))
    with pytest.raises(NotAnswering):
        bus.ping(1)
    wire.rates = WireRates()
    wire.unplugged = True
    with pytest.raises(PortFailed, match="faulty/bus failed"):
        bus.ping(1)
    wire.unplugged = False
    assert bus.ping(1) == Ping(1020, 45)
    bus.close()
    hub.close()


@dataclass
class Rated(Mute):
    """Hears at which rate, too."""

    rates: list[int] = field(default_factory=list)

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:
        self.rates.append(baudrate)
        return self.feed(data, now)


def test_rates_of_bytes_are_passed_on_with_them() -> None:
    device = Rated()
    late = WireRates(to_device=FaultRates(late=1.0, late_s=1.0))
    wire = RatedFaultyWire(device, 3, late)
    clock = VirtualClock()
    hub = MockHub(clock, "rated")
    with open_port(hub.attach("bus", wire, BAUD), 57_600) as port:
        port.write(b"slow")
        wire.rates = WireRates()
        port.baudrate = 4_500_000
        port.write(b"fast")
        clock.sleep(2.0)
        assert port.in_waiting == 0  # type: ignore[attr-defined]
    assert [data for _, data in device.heard] == [b"slow", b"fast"]
    assert device.rates == [57_600, 4_500_000]
    hub.close()


def test_servos_of_two_rates_behind_a_faulty_wire() -> None:
    servos = [EmulatedServo(1), EmulatedServo(2, baud_rate_code=1)]
    wire = RatedFaultyWire(ServoChain(servos, lambda _: None), 1)
    clock = VirtualClock()
    hub = MockHub(clock, "rates")
    url = hub.attach("bus", wire, BAUD)
    for dxl_id, rate in ((1, BAUD), (2, 57_600)):
        bus = Bus(open_port(url, rate), clock, rate)
        assert bus.ping(dxl_id) == Ping(1020, 45)
        bus.close()
    hub.close()
