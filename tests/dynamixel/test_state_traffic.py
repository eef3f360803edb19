"""States in recorded bytes are those that the host has read, however it asked for them."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor_wire import MotorWire

from palpate.drivers.dynamixel.bus import Bus
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
from palpate.drivers.transport.ports import open_port


@pytest.mark.parametrize("firmware", [44, 52])
@pytest.mark.parametrize("models", [("XM430-W350",) * 4, ("XM430-W350", "XL330-M288", "XM430-W350")])
def test_every_state_that_was_read_is_found(
    firmware: int, models: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = MotorWire([EmulatedServo(k, model=name, firmware=firmware) for k, name in enumerate(models, 1)])
    port = open_port(wire.url, 1_000_000)
    traffic = StateTraffic({k: model_by_name(name) for k, name in enumerate(models, 1)})
    found: list[tuple[int, ServoState]] = []
    write, read = port.write, port.read
    rng = random.Random(firmware)

    def written(data: bytes) -> int | None:
        traffic.sent(data)
        return write(data)

    def taken(size: int = 1) -> bytes:
        data = read(size)
        cut = rng.randint(0, len(data))
        for piece in (data[:cut], data[cut:]):
            found.extend(traffic.received(piece))
        return data

    monkeypatch.setattr(port, "write", written)
    monkeypatch.setattr(port, "read", taken)
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
    traffic, found = StateTraffic({1: servo.model}), []
    write, read = port.write, port.read

    def written(data: bytes) -> int | None:
        traffic.sent(data)
        return write(data)

    def taken(size: int = 1) -> bytes:
        data = read(size)
        found.extend(traffic.received(data))
        return data

    monkeypatch.setattr(port, "write", written)
    monkeypatch.setattr(port, "read", taken)
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
            traffic.sent(data)
        else:
            assert list(traffic.received(data)) == []


def test_other_bytes_of_the_control_table_are_no_state() -> None:
    place = model_by_name("XM430-W350").indirect
    assert place is not None
    for first in (place.data - STATE_BYTES, place.data - 3, place.data + 1, 0):
        traffic = StateTraffic({1: model_by_name("XM430-W350")})
        params = first.to_bytes(2, "little") + STATE_BYTES.to_bytes(2, "little") + b"\x01"
        traffic.sent(encode_instruction(InstructionPacket(254, Instruction.SYNC_READ, params)))
        block = bytes(STATE_BYTES - 1) + b"\x02"
        assert list(traffic.received(encode_status(StatusPacket(1, 0, block)))) == []
