"""Baud rates on a chain of emulated servos, and packets that are interrupted."""

import threading
from collections.abc import Iterator

import pytest

from palpate.drivers.dynamixel import Bus, NotAnswering
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.control_table import BAUD_RATES
from palpate.drivers.dynamixel.errors import StatusError
from palpate.drivers.dynamixel.packet import Instruction, InstructionPacket, encode_instruction
from palpate.drivers.emulators.device_server import serve_pty
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port

PING_1 = encode_instruction(InstructionPacket(1, Instruction.PING))


def slow_and_fast() -> ServoChain:
    """Servo 1 at 57,600 bps, servo 2 at 1 Mbps."""
    return ServoChain([EmulatedServo(1, baud_rate_code=1), EmulatedServo(2)], lambda _: None)


@pytest.fixture(params=["mock", pytest.param("pty", marks=pytest.mark.realtime)])
def wire(request: pytest.FixtureRequest) -> Iterator[tuple[str, Clock]]:
    if request.param == "mock":
        clock = VirtualClock()
        hub = MockHub(clock, "rates")
        yield hub.attach("bus", slow_and_fast(), 1_000_000), clock
        return
    with serve_pty({"bus": (slow_and_fast(), 1_000_000)}, MonotonicClock(), threading.Event()) as service:
        yield service.paths["bus"], MonotonicClock()


def test_a_client_reaches_only_the_servos_at_its_rate(wire: tuple[str, Clock]) -> None:
    url, clock = wire
    for rate, reached in ((57_600, 1), (1_000_000, 2), (4_500_000, None)):
        bus = Bus(open_port(url, rate), clock, rate)
        for dxl_id in (1, 2):
            if dxl_id == reached:
                assert bus.ping(dxl_id).model_number == 1020
            else:
                with pytest.raises(NotAnswering):
                    bus.ping(dxl_id)
        bus.close()


def test_a_new_baud_rate_holds_at_once(wire: tuple[str, Clock]) -> None:
    url, clock = wire
    bus = Bus(open_port(url, 1_000_000), clock, 1_000_000)
    bus.write(2, ct.BAUD_RATE, 6)  # confirmed at the old rate
    with pytest.raises(NotAnswering):
        bus.ping(2)
    bus.close()
    bus = Bus(open_port(url, BAUD_RATES[6]), clock, BAUD_RATES[6])
    assert bus.read(2, ct.BAUD_RATE) == 6
    bus.close()


def test_a_rate_that_the_model_lacks_is_refused() -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "rates")
    chain = ServoChain([EmulatedServo(1, model="XL330-M288"), EmulatedServo(2)], lambda _: None)
    bus = Bus(open_port(hub.attach("bus", chain, 1_000_000), 1_000_000), clock, 1_000_000)
    with pytest.raises(StatusError, match="Data Range Error"):
        bus.write(1, ct.BAUD_RATE, 7)
    bus.write(2, ct.BAUD_RATE, 7)  # 4.5 Mbps, on the XM430 alone


def test_rates_off_by_less_than_three_percent_are_understood() -> None:
    chain = slow_and_fast()
    assert len(chain.feed_at(PING_1, 0.0, 56_000)) == 1
    assert chain.feed_at(PING_1, 1.0, 55_000) == []


def test_an_answer_takes_the_time_of_its_rate() -> None:
    chain = slow_and_fast()
    everybody = encode_instruction(InstructionPacket(0xFE, Instruction.PING))
    [(instant, _)] = chain.feed_at(everybody, 1.0, 57_600)
    assert instant == pytest.approx(1.0005)  # servo 2 does not hear it, and is not waited for


def test_noise_at_another_rate_breaks_a_packet() -> None:
    chain = slow_and_fast()
    assert chain.feed_at(PING_1[:6], 0.0, 57_600) == []
    assert chain.feed_at(b"\x55", 0.0001, 1_000_000) == []
    assert chain.feed_at(PING_1[6:], 0.0002, 57_600) == []
    assert len(chain.feed_at(PING_1, 0.0003, 57_600)) == 1


@pytest.mark.parametrize(("pause_s", "answered"), [(0.0014, True), (0.0016, False)])
def test_a_packet_interrupted_for_longer_than_the_manual_allows(pause_s: float, answered: bool) -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "gaps")
    chain = ServoChain([EmulatedServo(1)], lambda _: None)
    with open_port(hub.attach("bus", chain, 1_000_000), 1_000_000, timeout_s=0.01) as port:
        port.write(PING_1[:6])
        clock.sleep(pause_s)
        port.write(PING_1[6:])
        assert len(port.read(14)) == (14 if answered else 0)


def test_a_pause_that_nobody_saw_is_forgiven() -> None:
    """On a pty only the arrival is seen: late bytes may be the computer's fault."""
    chain = ServoChain([EmulatedServo(1)], lambda _: None)
    assert chain.feed(PING_1[:6], 0.0) == []
    assert len(chain.feed(PING_1[6:], 0.015)) == 1
    assert chain.feed(PING_1[:6], 0.1) == []
    chain.poll(0.102)  # nothing came until then
    assert chain.feed(PING_1[6:], 0.103) == []
