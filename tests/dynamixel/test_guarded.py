"""Guarded motion and the traffic of states."""

import math
import random
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial.serialutil import SerialBase

from palpate.base.errors import SafetyStop
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import OperatingMode
from palpate.drivers.dynamixel.errors import HardwareAlert
from palpate.drivers.dynamixel.guarded_motion import Guard, MoveEnd, ServoMover, guarded_loop, guarded_move
from palpate.drivers.dynamixel.models import model_by_name
from palpate.drivers.dynamixel.packet import (
    Instruction,
    InstructionPacket,
    StatusPacket,
    encode_instruction,
    encode_status,
)
from palpate.drivers.dynamixel.servo import Servo, write_goals
from palpate.drivers.dynamixel.servo_state import (
    STATE_BYTES,
    ServoState,
    StateReader,
    StateTraffic,
    mark_item,
    mark_value,
    turns_of_mark,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from support.devices.servo_wire import MotorWire

# ----------------------------------------------------------------------------------------------------
# Moves that stop by themselves, and the other operating modes, on emulated shafts with a wall.

STEP_S = 1e-3
SOFT_NM_PER_RAD, HARD_NM_PER_RAD = 3.0, 60.0


class Shafts:
    """Two servos in Current-based Position Control Mode; in front of the first one stands a wall."""

    def __init__(self, model: str) -> None:
        self.clock = VirtualClock()
        self.emulated = {dxl_id: EmulatedServo(dxl_id, model=model) for dxl_id in (1, 2)}
        self.wall_rad, self.stiffness = 1e9, SOFT_NM_PER_RAD
        self.stepped_s = 0.0
        self.hub = MockHub(self.clock, "guarded")
        url = self.hub.attach("bus", ServoChain(list(self.emulated.values()), self._advance), 1_000_000)
        self.bus = Bus(open_port(url, 1_000_000), self.clock, 1_000_000, latency_s=1e-3)
        self.servos = [Servo(self.bus, dxl_id, model) for dxl_id in self.emulated]
        self.reader = StateReader(self.bus, self.servos)
        self.reader.arrange()
        for servo in self.servos:
            servo.prepare(OperatingMode.CURRENT_BASED_POSITION, current_limit_a=0.5)
            servo.set_goal_current_a(0.3)
            servo.set_profile(2.0, 20.0)
            servo.enable_torque()

    def _advance(self, now: float) -> None:
        while self.stepped_s + STEP_S <= now:
            self.stepped_s += STEP_S
            for dxl_id, servo in self.emulated.items():
                inside = max(0.0, servo.shaft_rad - self.wall_rad) if dxl_id == 1 else 0.0
                servo.step(STEP_S, -self.stiffness * inside - (0.2 * servo.shaft_rad_s if inside else 0.0))

    def move(self, *goals_rad: float, contact_a: float = 9.0) -> list[MoveEnd]:
        ends = guarded_move(
            self.reader,
            self.clock,
            dict(zip(self.servos, goals_rad, strict=False)),
            contact=lambda _, state: abs(state.current_a) > contact_a,
            guard=Guard(poll_s=0.005),
        )
        return [ends[servo] for servo in self.servos[: len(goals_rad)]]


@pytest.fixture(params=["XM430-W350", "XL330-M288"])
def shafts(request: pytest.FixtureRequest) -> Iterator[Shafts]:
    shafts = Shafts(request.param)
    yield shafts
    shafts.bus.close()
    shafts.hub.close()


def test_free_servos_reach_their_goals(shafts: Shafts) -> None:
    assert shafts.move(1.0, -0.7) == [MoveEnd.REACHED, MoveEnd.REACHED]
    states = shafts.reader.read(shafts.servos).all()
    assert states[1].position_rad == pytest.approx(1.0, abs=0.02)
    assert states[2].position_rad == pytest.approx(-0.7, abs=0.02)


def test_one_stops_at_contact_and_the_other_goes_on(shafts: Shafts) -> None:
    shafts.wall_rad = 0.4
    assert shafts.move(1.0, 1.0, contact_a=0.25) == [MoveEnd.CONTACT, MoveEnd.REACHED]
    touching = shafts.reader.read(shafts.servos).all()[1]
    assert 0.4 < touching.position_rad < 0.9
    shafts.clock.sleep(1.0)
    still = shafts.reader.read(shafts.servos).all()[1]
    assert still.position_rad == pytest.approx(touching.position_rad, abs=0.05)
    assert still.velocity_rad_s == 0.0


def test_a_mover_is_told_of_its_stop_once_the_servo_holds_it(shafts: Shafts) -> None:
    """Until then it may have gone on: what it does in that time counts."""

    class Sensing(ServoMover):
        sensed_s = stopped_s = goal_rad = 0.0

        def sense(self, now: float) -> MoveEnd | None:
            if self.seen[-1][1].position_rad < 0.2:
                return None
            self.sensed_s = now
            return MoveEnd.CONTACT

        def stopped(self, now: float) -> None:
            self.stopped_s = now
            self.goal_rad = self.servo.read("Goal Position") * self.servo.model.rad_per_tick

    servo = shafts.servos[0]
    mover = Sensing(servo, 1.0, 0.02)
    ends = guarded_loop(
        shafts.bus,
        lambda servos: shafts.reader.read(servos).all(),
        shafts.clock.now,
        shafts.clock.sleep,
        [mover],
        period_s=0.005,
    )
    assert ends == {mover: MoveEnd.CONTACT}
    assert mover.stopped_s > mover.sensed_s
    assert mover.goal_rad - servo.zero_tick * servo.model.rad_per_tick < 0.4


def test_one_that_is_held_is_stopped_where_it_stands(shafts: Shafts) -> None:
    shafts.wall_rad, shafts.stiffness = 0.4, HARD_NM_PER_RAD
    began = shafts.clock.now()
    assert shafts.move(1.0) == [MoveEnd.STALL]
    assert shafts.clock.now() - began < 3.0
    goal = shafts.servos[0].read("Goal Position")
    present = shafts.servos[0].read("Present Position")
    assert abs(goal - present) < 60, "it does not press on towards the goal"


def test_a_hardware_error_on_the_way_is_raised(shafts: Shafts) -> None:
    shafts.emulated[2].report_hardware_error(OVERLOAD_BIT)
    with pytest.raises(HardwareAlert, match=r"servo 2 .*overload"):
        shafts.move(1.0, 1.0)


def test_a_goal_out_of_range_moves_nobody(shafts: Shafts) -> None:
    with pytest.raises(SafetyStop, match="servo 2 "):
        shafts.move(0.5, 7.0)
    shafts.clock.sleep(1.0)
    assert shafts.reader.read(shafts.servos).all()[1].position_rad == pytest.approx(0.0, abs=0.01)


def test_current_control_mode(shafts: Shafts) -> None:
    servo, shaft = shafts.servos[0], shafts.emulated[1]
    servo.prepare(OperatingMode.CURRENT, 0.5)
    servo.enable_torque()
    begin = shaft.shaft_rad
    servo.set_goal_current_a(0.2)
    shafts.clock.sleep(0.3)
    assert shafts.reader.read([servo]).all()[1].velocity_rad_s > 0
    assert shaft.shaft_rad > begin + 0.05
    with pytest.raises(ValueError, match="servo 1"):
        servo.set_goal_current_a(-9.0)


# ----------------------------------------------------------------------------------------------------
# States in recorded bytes are those that the host has read, however it asked for them.


def tap(
    port: SerialBase, traffic: StateTraffic, monkeypatch: pytest.MonkeyPatch, rng: random.Random
) -> list[tuple[int, ServoState]]:
    """What `traffic` finds in what goes over a port from now on, cut anywhere."""
    found: list[tuple[int, ServoState]] = []
    write, read = port.write, port.read

    def written(data: bytes) -> int | None:
        traffic.take_sent(data)
        return write(data)

    def taken(size: int = 1) -> bytes:
        data = read(size)
        cut = rng.randint(0, len(data))
        for piece in (data[:cut], data[cut:]):
            found.extend(traffic.take_received(piece))
        return data

    monkeypatch.setattr(port, "write", written)
    monkeypatch.setattr(port, "read", taken)
    return found


@pytest.mark.parametrize("firmware", [44, 52])
@pytest.mark.parametrize("models", [("XM430-W350",) * 4, ("XM430-W350", "XL330-M288", "XM430-W350")])
def test_every_state_that_was_read_is_found(
    firmware: int, models: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = MotorWire([EmulatedServo(k, model=name, firmware=firmware) for k, name in enumerate(models, 1)])
    port = open_port(wire.url, 1_000_000)
    traffic = StateTraffic({k: model_by_name(name) for k, name in enumerate(models, 1)})
    rng = random.Random(firmware)
    found = tap(port, traffic, monkeypatch, rng)
    bus = Bus(port, wire.clock, 1_000_000, latency_s=1e-3)
    servos = [Servo(bus, k, name) for k, name in enumerate(models, 1)]
    for servo in servos:
        servo.check()
        servo.enable_torque()
    reader = StateReader(bus, servos)
    reader.arrange()
    known: list[tuple[int, ServoState]] = []
    for _ in range(50):
        some = rng.sample(servos, rng.randint(1, len(servos)))
        write_goals(bus, {servo: rng.uniform(-1, 1) for servo in some})
        wire.clock.sleep(rng.uniform(0, 0.1))
        known.extend(reader.read(some).all().items())
    assert reader.is_fast == (firmware == 52)
    assert len({state.position_rad for _, state in known}) > 20
    assert sorted(found, key=repr) == sorted(known, key=repr)
    assert bus.counts.retries == 0, "no length that is read in turn was refused"


@pytest.mark.parametrize("is_read", [False, True])
def test_a_turn_that_is_marked_counts_from_then_on(is_read: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether the recording holds how the mark was written, or only how a later run read it."""
    wire = MotorWire([EmulatedServo(1, start_rad=1.0)])
    port = open_port(wire.url, 1_000_000)
    bus = Bus(port, wire.clock, 1_000_000, latency_s=1e-3)
    servo = Servo(bus, 1, "XM430-W350")
    reader = StateReader(bus, [servo])
    servo.check()
    reader.arrange()
    item = mark_item(servo.model)
    assert item is not None
    if is_read:
        bus.write(1, item, mark_value(-2))
    found = tap(port, StateTraffic({1: servo.model}), monkeypatch, random.Random(1))
    if is_read:
        assert turns_of_mark(bus.read(1, item)) == -2
    else:
        bus.write(1, item, mark_value(-2))
    servo.turns = -2
    known = reader.read([servo]).all()[1]
    assert known.position_rad == pytest.approx(1.0 + 4 * math.pi, abs=0.002)
    assert found == [(1, known)]


@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=60)), max_size=20))
def test_noise_is_no_state(pieces: list[tuple[bool, bytes]]) -> None:
    traffic = StateTraffic({1: model_by_name("XM430-W350")})
    for is_sent, data in pieces:
        if is_sent:
            traffic.take_sent(data)
        else:
            assert list(traffic.take_received(data)) == []


def test_other_bytes_of_the_control_table_are_no_state() -> None:
    place = model_by_name("XM430-W350").indirect
    assert place is not None
    for first in (place.data - STATE_BYTES, place.data - 3, place.data + 1, 0):
        traffic = StateTraffic({1: model_by_name("XM430-W350")})
        params = first.to_bytes(2, "little") + STATE_BYTES.to_bytes(2, "little") + b"\x01"
        traffic.take_sent(encode_instruction(InstructionPacket(254, Instruction.SYNC_READ, params)))
        block = bytes(STATE_BYTES - 1) + b"\x02"
        assert list(traffic.take_received(encode_status(StatusPacket(1, 0, block)))) == []
