"""The emulated XM430-W350 against the e-Manual's rules, instruction by instruction, without a wire."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    encode_instruction,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from support.devices.servo_wire import Console

CURRENT_BASED, EXTENDED, POSITION = 5, 4, 3


@pytest.mark.parametrize(
    ("address", "value", "size", "error"),
    [
        (0, 1030, 2, StatusErrorCode.ACCESS_ERROR),  # Model Number is read only
        (14, 0, 1, StatusErrorCode.ACCESS_ERROR),  # undefined
        (116, 0, 2, StatusErrorCode.DATA_LENGTH_ERROR),  # half of Goal Position
        (64, 2, 1, StatusErrorCode.DATA_RANGE_ERROR),
        (11, 2, 1, StatusErrorCode.DATA_RANGE_ERROR),  # no such mode
        (98, -1, 1, StatusErrorCode.DATA_RANGE_ERROR),
        (116, 4096, 4, StatusErrorCode.DATA_LIMIT_ERROR),  # above Max Position Limit
        (102, 1194, 2, StatusErrorCode.DATA_RANGE_ERROR),
        (116, 4095, 4, StatusErrorCode.NONE),
    ],
)
def test_writes_are_judged(address: int, value: int, size: int, error: StatusErrorCode) -> None:
    assert Console().write(address, value, size) == error


def test_goal_current_above_current_limit() -> None:
    console = Console()
    assert console.write(38, 100, 2) == 0
    assert console.write(102, 101, 2) == StatusErrorCode.DATA_LIMIT_ERROR


def test_eeprom_is_locked_while_torque_is_on() -> None:
    console = Console()
    console.start(POSITION)
    assert console.write(38, 100, 2) == StatusErrorCode.ACCESS_ERROR
    assert console.read(38, 2) == 1193
    assert console.write(64, 0, 1) == 0
    assert console.write(38, 100, 2) == 0


def test_a_write_over_several_items_is_all_or_nothing() -> None:
    console = Console()
    block = (40).to_bytes(4, "little") + (50).to_bytes(4, "little") + (9999).to_bytes(4, "little")
    answer = console.send(Instruction.WRITE, b"\x6c\0" + block)  # 108, 112 and a goal beyond its limit
    assert answer == StatusPacket(1, StatusErrorCode.DATA_LIMIT_ERROR)
    assert console.read(108, 4) == 0
    answer = console.send(Instruction.WRITE, b"\x6c\0" + block[:8])
    assert answer == StatusPacket(1)
    assert (console.read(108, 4), console.read(112, 4)) == (40, 50)


def test_status_return_level() -> None:
    console = Console()
    assert console.send(Instruction.WRITE, b"\x44\0\1") is None  # level 1 holds for its own answer
    assert console.send(Instruction.READ, b"\x44\0\1\0") == StatusPacket(1, 0, b"\1")
    assert console.send(Instruction.WRITE, b"\x44\0\0") is None
    assert console.send(Instruction.READ, b"\x44\0\1\0") is None
    assert console.send(Instruction.PING) is not None


def test_change_of_mode_resets_profile_and_goals() -> None:
    console = Console()
    console.write(38, 300, 2)
    console.start(EXTENDED, velocity=200)
    console.write(84, 700, 2)
    console.write(64, 0, 1)
    console.write(11, CURRENT_BASED, 1)
    assert (console.read(108, 4), console.read(112, 4)) == (0, 0)
    assert (console.read(84, 2), console.read(100, 2), console.read(102, 2)) == (800, 885, 300)


def test_only_position_control_mode_forgets_turns() -> None:
    console = Console()
    console.start(EXTENDED, velocity=200)
    console.write(116, 2048 + 3 * 4096, 4)
    console.run(6)
    console.write(64, 0, 1)
    console.write(11, CURRENT_BASED, 1)
    assert console.read(132, 4) == pytest.approx(2048 + 3 * 4096, abs=3)
    console.write(11, POSITION, 1)
    assert console.read(132, 4) == pytest.approx(2048, abs=3)


def test_power_up_knows_the_angle_within_one_turn() -> None:
    assert Console(start_rad=2 * math.pi * 5 + 0.5).read(132, 4) == 2048 + round(0.5 / (2 * math.pi) * 4096)


def test_torque_on_does_not_jump() -> None:
    console = Console(start_rad=1.0)
    console.write(116, 4000, 4)
    console.start(POSITION)
    console.run(0.5)
    assert console.servo.shaft_rad == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("velocity", "acceleration"), [(0, 0), (100, 0), (100, 40), (20, 5), (200, 1)])
def test_a_move_reaches_its_goal_without_overshoot(velocity: int, acceleration: int) -> None:
    console = Console()
    console.start(POSITION, velocity=velocity, acceleration=acceleration)
    console.write(116, 3000, 4)
    assert console.read(122, 1) == int(velocity > 0)  # Moving while a profile runs
    top = fastest = 0.0
    for _ in range(16):
        console.run(0.5)
        top = max(top, console.servo.shaft_rad)
        fastest = max(fastest, abs(console.servo.shaft_rad_s))
    goal_rad = (3000 - 2048) * 2 * math.pi / 4096
    assert console.read(132, 4) == pytest.approx(3000, abs=3)
    assert top < goal_rad + 3 * 2 * math.pi / 4096
    assert console.read(122, 1) == 0
    assert console.read(123, 1) & 1  # In-Position


def test_profile_velocity_is_kept() -> None:
    console = Console()
    console.start(EXTENDED, velocity=100, acceleration=100)
    console.write(116, 20_000, 4)
    console.run(2)
    assert console.read(128, 4) == pytest.approx(100, abs=1)
    assert console.servo.shaft_rad_s == pytest.approx(100 * 0.229 * 2 * math.pi / 60, rel=0.01)


def test_profile_durations_are_the_trapezoids() -> None:
    console = Console()
    console.start(EXTENDED, velocity=100, acceleration=20)
    console.write(116, 2048 + 4096, 4)
    elapsed = 0.0
    while console.read(123, 1) & 2:  # Profile Ongoing
        console.run(0.01)
        elapsed += 0.01
    speed, rate = 100 * 0.229 * 2 * math.pi / 60, 20 * 214.577 * 2 * math.pi / 3600
    assert elapsed == pytest.approx(2 * math.pi / speed + speed / rate, abs=0.03)


@pytest.mark.parametrize("dt", [5e-4, 1e-3])
@pytest.mark.parametrize("stiffness_n_mm", [1.0, 30.0])
def test_pressing_on_a_spring_ends_at_the_current_limit(stiffness_n_mm: float, dt: float) -> None:
    """A 24 mm/turn slide against a stiff stop whose force lags one step behind."""
    console = Console()
    console.start(CURRENT_BASED, current=60, velocity=50, acceleration=20)
    console.write(116, 2048 + 4 * 4096, 4)
    m_per_rad = 0.024 / (2 * math.pi)
    load = 0.0
    speeds: list[float] = []
    for step in range(round(12 / dt)):
        console.servo.step(dt, load)
        pressed_m = max(0.0, (console.servo.shaft_rad - 1.0) * m_per_rad)
        load = -stiffness_n_mm * 1e3 * pressed_m * m_per_rad
        if step * dt > 11:
            speeds.append(console.servo.shaft_rad_s)
    if stiffness_n_mm > 1.0:
        assert max(map(abs, speeds)) < 1e-6
        assert console.read(126, 2) == 60
        # the motor's torque at the limit, within friction
        assert -load == pytest.approx(60 * 2.69e-3 * 4.1 / 2.3, abs=0.06)
    assert console.read(70, 1) == 0


def test_sustained_overload_shuts_down_until_reboot() -> None:
    console = Console()
    console.start(POSITION)
    console.write(116, 3000, 4)
    console.run(2.5, load_nm=-6.0)
    answer = console.send(Instruction.READ, b"\x46\0\1\0")  # Hardware Error Status
    assert answer == StatusPacket(1, 0x80, bytes([OVERLOAD_BIT]))
    assert console.read(64, 1) == 0
    assert console.write(64, 1, 1) == 0x80 | StatusErrorCode.RESULT_FAIL
    assert console.send(Instruction.REBOOT) is not None
    assert console.servo.listening is False
    console.run(0.5)
    assert console.read(70, 1) == 0
    assert console.write(64, 1, 1) == 0


def test_overload_without_the_shutdown_bit_only_alerts() -> None:
    console = Console()
    console.write(63, 0, 1)
    console.start(POSITION)
    console.run(2.5, load_nm=-6.0)
    assert console.read(70, 1) == OVERLOAD_BIT
    assert console.read(64, 1) == 1


def test_holding_at_a_low_current_is_no_overload() -> None:
    console = Console()
    console.start(CURRENT_BASED, current=100)
    console.write(116, 20_000, 4)
    console.run(5, load_nm=-0.45)
    assert console.read(70, 1) == 0


def test_bus_watchdog_stops_and_is_cleared_by_zero() -> None:
    console = Console()
    console.start(EXTENDED, velocity=50)
    console.write(116, 100_000, 4)
    console.write(98, 5, 1)  # 100 ms
    for _ in range(5):
        console.run(0.08)
        console.servo.note_packet()
    assert console.servo.shaft_rad_s > 0.5
    console.run(0.5)
    assert abs(console.servo.shaft_rad_s) < 1e-4
    assert console.read(98, 1) == -1
    assert (console.read(108, 4), console.read(112, 4)) == (0, 0)
    assert console.write(116, 3000, 4) == StatusErrorCode.DATA_RANGE_ERROR
    assert console.write(98, 0, 1) == 0
    assert console.write(116, 3000, 4) == 0


def test_torque_off_gives_way_to_a_load_beyond_friction() -> None:
    console = Console()
    console.run(0.2, load_nm=0.04)
    assert console.servo.shaft_rad == 0.0
    console.run(0.2, load_nm=0.3)
    assert console.servo.shaft_rad > 0.01


# -- several on one wire ----------------------------------------------------------------------------------


def chain_of(*ids: int) -> tuple[ServoChain, dict[int, EmulatedServo]]:
    servos = {dxl_id: EmulatedServo(dxl_id) for dxl_id in ids}
    return ServoChain(list(servos.values()), lambda _: None), servos


def test_broadcast_ping_is_answered_by_all_and_broadcast_write_by_none() -> None:
    chain, servos = chain_of(5, 2)
    ping = encode_instruction(InstructionPacket(BROADCAST_ID, Instruction.PING))
    assert [Parser().feed(data)[0].dxl_id for _, data in chain.feed(ping, 0.0)] == [2, 5]
    led = encode_instruction(InstructionPacket(BROADCAST_ID, Instruction.WRITE, b"\x41\0\1"))
    assert chain.feed(led, 0.0) == []
    for servo in servos.values():
        block = servo.answer_block(65, 1)
        assert block is not None
        assert block.params == b"\1"


def test_a_damaged_packet_is_answered_by_the_servo_that_it_names() -> None:
    chain, servos = chain_of(1, 2)
    ping = bytearray(encode_instruction(InstructionPacket(1, Instruction.PING)))
    ping[-1] ^= 1
    [(_, answer)] = chain.feed(bytes(ping), 0.0)
    assert Parser().feed(answer) == [StatusPacket(1, StatusErrorCode.CRC_ERROR)]
    servos[1].take_block(68, b"\1")  # Status Return Level: pings and reads only
    assert chain.feed(bytes(ping), 0.0) == []
    ping[-1] ^= 1
    assert len(chain.feed(bytes(ping), 0.0)) == 1


def test_a_damaged_packet_to_all_is_answered_by_none() -> None:
    chain, _ = chain_of(1)
    ping = bytearray(encode_instruction(InstructionPacket(BROADCAST_ID, Instruction.PING)))
    ping[-1] ^= 1
    assert chain.feed(bytes(ping), 0.0) == []


def test_a_packet_inside_a_damaged_one_is_found() -> None:
    chain, _ = chain_of(1)
    ping = encode_instruction(InstructionPacket(1, Instruction.PING))
    assert chain.feed(b"\xff\xff\xfd\0\7\x0c\0" + ping, 0.0) == []  # LEN goes beyond the ping
    assert [len(data) for _, data in chain.feed(b"\0\0", 0.0)] == [14]


def test_half_a_packet_is_given_up_after_a_pause() -> None:
    chain, _ = chain_of(1)
    ping = encode_instruction(InstructionPacket(1, Instruction.PING))
    assert chain.feed(ping[:6], 0.0) == []
    assert len(chain.feed(ping[6:], 0.001)) == 1
    assert chain.feed(ping[:6], 0.1) == []
    assert chain.feed(ping[6:], 1.0) == []


@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=14)), max_size=20))
@settings(max_examples=100)
def test_no_instruction_breaks_a_chain(packets: list[tuple[int, bytes]]) -> None:
    chain, servos = chain_of(1, 2)
    for number, params in packets:
        for dxl_id in (1, BROADCAST_ID):
            chain.feed(encode_instruction(InstructionPacket(dxl_id, number, params)), 0.0)
    for servo in servos.values():
        servo.step(1e-3, 0.0)
        assert math.isfinite(servo.shaft_rad)
