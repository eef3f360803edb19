"""The bus on bad wires: answers, faults, goals."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

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
from support.campaign.sampling import sample
from support.devices.spoiling_wire import KINDS, Kind, talk

# ----------------------------------------------------------------------------------------------------
# A million instructions are `benchmarks/bench_bad_wires.py`'s; these are few, of every kind of wire.

INSTRUCTIONS = 2500


@pytest.mark.parametrize("kind", sample(KINDS, KINDS[::3]), ids=lambda kind: kind.name)
def test_whatever_the_wire_does_no_value_confirmation_or_refusal_is_wrong(kind: Kind) -> None:
    tally = talk(kind, 1, INSTRUCTIONS)
    assert tally.values > INSTRUCTIONS / 2
    assert tally.wrong == tally.unconfirmed == tally.misled == 0
    assert tally.failed < tally.calls / 100, "answers up to 120 ms late are waited for"
    assert tally.old == 0, "questions that differ are not answered by old measurements"


def test_on_a_wire_that_changes_all_the_time_nothing_is_wrong_either() -> None:
    tally = talk(KINDS[0], 2, 2 * INSTRUCTIONS, weather=KINDS)
    assert tally.values > INSTRUCTIONS / 2
    assert tally.wrong == tally.unconfirmed == tally.misled == tally.old == 0


# ----------------------------------------------------------------------------------------------------
# Answers that come late, twice, behind garbage, or of another length: what the bus makes of each.

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


# ----------------------------------------------------------------------------------------------------
# The bus as a state machine: whatever is written, lost or switched off, the host's picture stays right.

# extended goals, among them those whose bytes look like headers
goals = st.integers(-1_048_575, 1_048_575) | st.sampled_from([-769, -1, -3, -131_073])


IDS = (1, 2, 3)
ids = st.sampled_from(IDS)


class BusMachine(RuleBasedStateMachine):
    """Three servos in Extended Position Control Mode with torque off, and what the host believes of them."""

    @initialize()
    def power_up(self) -> None:
        self.clock = VirtualClock()
        self.emulated = {dxl_id: EmulatedServo(dxl_id) for dxl_id in IDS}
        self.hub = MockHub(self.clock, "machine")
        url = self.hub.attach("bus", ServoChain(list(self.emulated.values()), self._advance), 1_000_000)
        self.bus = Bus(open_port(url, 1_000_000), self.clock, 1_000_000)
        self.dead: set[int] = set()
        self.locked: set[int] = set()
        self.goal: dict[int, int] = {}
        self.limit = dict.fromkeys(IDS, 1193)
        for dxl_id in IDS:
            self.bus.write(dxl_id, ct.ITEMS["Operating Mode"], ct.OperatingMode.EXTENDED_POSITION)
            self.goal[dxl_id] = self.bus.read(dxl_id, ct.ITEMS["Goal Position"])

    def _advance(self, now: float) -> None:
        """The shafts stand still: only the registers matter here."""

    def _expect(self, dxl_id: int, action: Any) -> bool:
        """Run an action; True if the servo is alive, otherwise it must be reported as not answering."""
        if dxl_id not in self.dead:
            action()
            return True
        with pytest.raises(NotAnswering) as caught:
            action()
        assert caught.value.dxl_ids == (dxl_id,)
        return False

    @rule(dxl_id=ids, goal=goals)
    def write_goal(self, dxl_id: int, goal: int) -> None:
        if self._expect(dxl_id, lambda: self.bus.write(dxl_id, ct.ITEMS["Goal Position"], goal)):
            self.goal[dxl_id] = goal

    @rule(chosen=st.dictionaries(ids, goals, min_size=1))
    def sync_write_goals(self, chosen: dict[int, int]) -> None:
        self.bus.sync_write(ct.ITEMS["Goal Position"], chosen)
        self.goal.update({dxl_id: goal for dxl_id, goal in chosen.items() if dxl_id not in self.dead})

    @rule(dxl_id=ids, units=st.integers(0, 1193))
    def write_limit(self, dxl_id: int, units: int) -> None:
        def action() -> None:
            self.bus.write(dxl_id, ct.ITEMS["Current Limit"], units)

        if dxl_id in self.locked and dxl_id not in self.dead:
            with pytest.raises(StatusError) as caught:
                action()
            assert caught.value.code is StatusErrorCode.ACCESS_ERROR
        elif self._expect(dxl_id, action):
            self.limit[dxl_id] = units

    @rule(dxl_id=ids, on=st.booleans())
    def torque(self, dxl_id: int, on: bool) -> None:
        if self._expect(dxl_id, lambda: self.bus.write(dxl_id, ct.TORQUE_ENABLE, int(on))):
            if on and dxl_id not in self.locked:
                self.goal[dxl_id] = 2048  # switching on makes the present position the goal
            (self.locked.add if on else self.locked.discard)(dxl_id)

    @rule(dxl_id=ids)
    def cut_power(self, dxl_id: int) -> None:
        self.emulated[dxl_id].power_off()
        self.dead.add(dxl_id)
        self.locked.discard(dxl_id)

    @rule(dxl_id=ids)
    def restore_power(self, dxl_id: int) -> None:
        if dxl_id in self.dead:
            self.emulated[dxl_id].power_on()
            self.dead.discard(dxl_id)
            self.goal[dxl_id] = 2048

    @invariant()
    def a_sync_read_tells_all_or_names_the_dead(self) -> None:
        if self.dead:
            with pytest.raises(NotAnswering) as caught:
                self.bus.sync_read(IDS, ct.ITEMS["Goal Position"]).all()
            assert set(caught.value.dxl_ids) == self.dead
        alive = [dxl_id for dxl_id in IDS if dxl_id not in self.dead]
        if alive:
            block = self.bus.sync_read(alive, ct.ITEMS["Goal Position"]).all()
            assert block == {dxl_id: self.goal[dxl_id] for dxl_id in alive}
            for dxl_id in alive:
                assert self.bus.read(dxl_id, ct.ITEMS["Current Limit"]) == self.limit[dxl_id]

    def teardown(self) -> None:
        if hasattr(self, "bus"):
            self.bus.close()
            self.hub.close()


TestBus = BusMachine.TestCase
TestBus.settings = settings(max_examples=25, stateful_step_count=25)
