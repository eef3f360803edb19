"""Answers that come late, twice, behind garbage, or of another length: what the bus makes of each."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler

from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.errors import AnsweringLate, NotAnswering, StatusError, WrongLength
from palpate.drivers.dynamixel.exchanges import Timing
from palpate.drivers.dynamixel.packet import InstructionPacket, StatusErrorCode, encode_instruction
from palpate.drivers.dynamixel.sdk import ClockedPortHandler, StuffingPacketHandler
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission

BAUD = 1_000_000
FALSE_HEADER = b"\xff\xff\xfd\x00"
GARBAGE = {
    "a header": FALSE_HEADER,
    "a head whose packet ends within the answer": FALSE_HEADER + b"\x01\x08\x00\x55",
    "a head whose packet would end behind it": FALSE_HEADER + b"\x01\xff\x03\x55",
    "two heads": (FALSE_HEADER + b"\x01\x08\x00\x55") * 2,
}

Change = Callable[[int, Emission], list[Emission]]


@dataclass
class Tampered:
    """Servos 1 to 3 whose answers, counted from 0, are changed on their way."""

    change: Change = lambda _number, answer: [answer]
    lost_instructions: set[int] = field(default_factory=set)
    heard: int = 0
    answered: int = 0
    pending: list[Emission] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.servos = {dxl_id: EmulatedServo(dxl_id) for dxl_id in (1, 2, 3)}
        self.chain = ServoChain(list(self.servos.values()), lambda _: None)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        due = self.poll(now)
        self.heard += 1
        if self.heard - 1 in self.lost_instructions:
            return due
        for answer in self.chain.feed(data, now):
            self.pending += self.change(self.answered, answer)
            self.answered += 1
        self.pending.sort()
        return due + self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        due = [item for item in self.pending if item[0] <= now]
        self.pending = self.pending[len(due) :]
        return due

    def next_due(self) -> float | None:
        return self.pending[0][0] if self.pending else None


class Host:
    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.hub = MockHub(self.clock, "tampered")
        self.wire = Tampered()
        self.url = self.hub.attach("bus", self.wire, BAUD)
        self.bus = Bus(open_port(self.url, BAUD), self.clock, BAUD, latency_s=1e-3)
        for dxl_id in (1, 2, 3):
            self.bus.write(dxl_id, ct.RETURN_DELAY_TIME, 0)
        self.clock.sleep(1.0)
        self.wire.heard = self.wire.answered = 0


@pytest.fixture
def host() -> Iterator[Host]:
    host = Host()
    yield host
    host.bus.close()
    host.hub.close()


def late(seconds: float) -> Change:
    return lambda _number, answer: [(answer[0] + seconds, answer[1])]


@pytest.mark.parametrize("seconds", [0.0005, 0.001, 0.0021, 0.005, 0.013, 0.04])
def test_every_answer_comes_again_and_none_is_taken_for_another(host: Host, seconds: float) -> None:
    held = {ct.ITEMS["Profile Velocity"]: 100, ct.ITEMS["Profile Acceleration"]: 7}
    for item, value in held.items():
        host.bus.write(1, item, value)
    host.wire.change = lambda _number, answer: [answer, (answer[0] + seconds, answer[1])]
    items = list(held) * 150
    assert [host.bus.read(1, item) for item in items] == [held[item] for item in items]


def test_a_read_after_a_write_is_not_answered_by_a_read_before_it(host: Host) -> None:
    host.wire.change = lambda _number, answer: [answer, (answer[0] + 0.002, answer[1])]
    for value in range(1, 100):
        host.bus.write(1, ct.ITEMS["Profile Velocity"], value)
        assert host.bus.read(1, ct.ITEMS["Profile Velocity"]) == value


def test_a_confirmation_that_comes_again_confirms_nothing_else(host: Host) -> None:
    """The second write is lost once; what the first one's confirmation says of it is not believed."""
    host.wire.change = lambda number, answer: [answer, (answer[0] + 0.0006, answer[1])][: 2 - (number > 0)]
    host.wire.lost_instructions = {1}
    host.bus.write(1, ct.ITEMS["Profile Velocity"], 11)
    host.bus.write(1, ct.ITEMS["Profile Velocity"], 22)
    assert host.wire.servos[1].answer_block(112, 4).params == (22).to_bytes(4, "little")  # type: ignore[union-attr]


def test_a_refusal_that_comes_again_refuses_nothing_else(host: Host) -> None:
    host.wire.change = lambda number, answer: [answer, (answer[0] + 0.0006, answer[1])][: 2 - (number > 0)]
    with pytest.raises(StatusError):
        host.bus.write(1, ct.ITEMS["Goal Position"], 5000)
    assert host.bus.read(1, ct.ITEMS["Profile Velocity"]) == 0
    host.wire.answered = 0
    with pytest.raises(StatusError):
        host.bus.write(1, ct.ITEMS["Goal Position"], 5000)
    host.bus.write(1, ct.ITEMS["Profile Velocity"], 5)
    assert host.bus.ping(1).model_number == 1020


def test_a_servo_that_refuses_a_wider_read_is_asked_for_the_item_alone(host: Host) -> None:
    table = host.wire.servos[1]._unit.table
    read = table.read

    def narrow(address: int, length: int) -> bytes:
        if length > 4:
            from palpate.drivers.emulators.servo_table import Refused

            raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
        return read(address, length)

    table.read = narrow  # type: ignore[method-assign]
    assert [host.bus.read(1, ct.ITEMS["Profile Velocity"]) for _ in range(5)] == [0] * 5


def test_answers_of_another_length_are_named_as_such(host: Host) -> None:
    read = host.wire.servos[2]._unit.table.read
    host.wire.servos[2]._unit.table.read = lambda address, _length: read(address, 2)  # type: ignore[method-assign]
    found = host.bus.sync_read((1, 2, 3), ct.ITEMS["Profile Velocity"])
    assert set(found.values) == {1, 3}
    with pytest.raises(WrongLength, match=r"servo 2 on \S+ answered with 2 bytes instead of 4.*model"):
        found.all()
    with pytest.raises(WrongLength, match=r"servo 2 .* answered with 2 bytes instead of "):
        host.bus.read(2, ct.ITEMS["Profile Velocity"])


@pytest.mark.parametrize("seconds", [0.02, 0.1, 0.12])
def test_answers_of_a_busy_computer_are_waited_for(host: Host, seconds: float) -> None:
    host.bus.write(1, ct.ITEMS["Profile Velocity"], 9)
    host.wire.change = late(seconds)
    assert host.bus.read(1, ct.ITEMS["Profile Velocity"]) == 9
    assert host.bus.read(1, ct.ITEMS["Profile Acceleration"]) == 0
    found = host.bus.sync_read((1, 2, 3), ct.ITEMS["Profile Velocity"]).all()
    assert [found[i] for i in (1, 2, 3)] == [9, 0, 0]
    assert host.bus.ping(2).model_number == 1020


def test_answers_that_are_later_still_are_told_as_late(host: Host) -> None:
    host.wire.change = late(0.17)
    with pytest.raises(NotAnswering):
        host.bus.read(1, ct.ITEMS["Profile Velocity"])
    with pytest.raises(
        AnsweringLate, match=r"servo 1 on \S+ answers too late.*computer busy.*latency"
    ) as told:
        host.bus.read(1, ct.ITEMS["Profile Acceleration"])
    assert "check" not in str(told.value)


def test_one_silent_servo_beside_one_that_answers_is_not_waited_for(host: Host) -> None:
    host.wire.servos[2].power_off()
    begin = host.clock.now()
    found = host.bus.sync_read((1, 2, 3), ct.ITEMS["Profile Velocity"])
    assert set(found.errors) == {2}
    assert host.clock.now() - begin < 0.02


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE)
def test_a_false_header_loses_no_answer(host: Host, garbage: bytes) -> None:
    host.bus.write(1, ct.ITEMS["Profile Velocity"], 77)
    host.wire.change = lambda _number, answer: [(answer[0], garbage + answer[1])]
    assert host.bus.read(1, ct.ITEMS["Profile Velocity"]) == 77
    found = host.bus.sync_read((1, 2, 3), ct.ITEMS["Profile Velocity"]).all()
    assert [found[i] for i in (1, 2, 3)] == [77, 0, 0]
    assert host.bus.counts.retries == 0


def test_the_plain_sdk_loses_the_answer_behind_a_false_header(host: Host) -> None:
    """When this fails, the vendor has mended it."""
    lost = []
    for handler in (Protocol2PacketHandler(), StuffingPacketHandler()):
        garbage = GARBAGE["a head whose packet ends within the answer"]
        host.wire.change = lambda _number, answer, garbage=garbage: [(answer[0], garbage + answer[1])]  # type: ignore[misc]
        port = ClockedPortHandler(open_port(host.url, BAUD), host.clock, Timing(BAUD, 1e-3))
        port.openPort()
        port.writePort(list(encode_instruction(InstructionPacket(1, 2, bytes([112, 0, 4, 0])))))
        port.setPacketTimeout(15)
        lost.append(handler.rxPacket(port, False)[1] != COMM_SUCCESS)
    assert lost == [True, False]
