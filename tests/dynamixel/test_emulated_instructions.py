"""Instructions that emulated servos answer, and indirect addresses."""

import pytest

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    StatusErrorCode,
    StatusPacket,
    encode_instruction,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from support.devices.servo_wire import Console

# ----------------------------------------------------------------------------------------------------
# What emulated servos do with each instruction: e-Manual, "DYNAMIXEL Protocol 2.0" and "Secondary ID".

POSITION, EXTENDED = 3, 4
CLEAR_TURNS = bytes.fromhex("01 44 58 4C 22")
STORE = bytes.fromhex("01 43 54 52 4C")
RESTORE = bytes.fromhex("02 43 54 52 4C")
DONE = bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")


def booted(console: Console) -> Console:
    assert not console.servo.listening
    console.run(0.5)
    assert console.servo.listening
    return console


# -- the manual's examples, byte by byte --------------------------------------------------------------


@pytest.mark.parametrize(
    "packet",
    [
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",  # Write: Goal Position 512
        "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",  # Reg Write: Goal Velocity 200
        "FF FF FD 00 01 04 00 06 01 A1 E6",  # Factory Reset: all but ID
        "FF FF FD 00 01 03 00 08 2F 4E",  # Reboot
        "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC",  # Clear: turns
        "FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5",  # Control Table Backup: store
    ],
)
def test_packets_of_the_manual_are_confirmed_with_its_bytes(packet: str) -> None:
    chain = ServoChain([EmulatedServo(1, firmware=45)], lambda _: None)
    assert [data for _, data in chain.feed(bytes.fromhex(packet), 0.0)] == [DONE]


@pytest.mark.parametrize(
    ("first", "then"),
    [
        # Reg Write, Action
        ("FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E", "FF FF FD 00 01 03 00 05 02 CE"),
        # backup, restore; the manual prints the second CRC as 92 F5, which its own rule contradicts
        ("FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5", "FF FF FD 00 01 08 00 20 02 43 54 52 4C 9E F5"),
    ],
)
def test_pairs_of_the_manual(first: str, then: str) -> None:
    chain = ServoChain([EmulatedServo(1, firmware=45)], lambda _: None)
    chain.feed(bytes.fromhex(first), 0.0)
    assert [data for _, data in chain.feed(bytes.fromhex(then), 0.0)] == [DONE]


def test_bulk_write_of_the_manual() -> None:
    servos = [EmulatedServo(1), EmulatedServo(2)]
    chain = ServoChain(servos, lambda _: None)
    servos[1].take_block(31, b"\x46")
    packet = "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68"
    assert chain.feed(bytes.fromhex(packet), 0.0) == []
    assert servos[0].answer_block(32, 2) == StatusPacket(1, 0, b"\xa0\0")
    assert servos[1].answer_block(31, 1) == StatusPacket(2, 0, b"\x50")


# -- Factory Reset ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("option", "dxl_id", "baud"), [(0xFF, 1, 1), (0x01, 9, 1), (0x02, 9, 3)])
def test_factory_reset_keeps_what_it_is_told_to(option: int, dxl_id: int, baud: int) -> None:
    console = Console()
    console.write(7, 9, 1)
    console.dxl_id = 9
    console.write(38, 100, 2)
    console.write(65, 1, 1)
    assert console.send(Instruction.FACTORY_RESET, bytes([option])) == StatusPacket(9)  # the ID asked
    console.dxl_id = dxl_id
    booted(console)
    assert (console.read(7, 1), console.read(8, 1)) == (dxl_id, baud)
    assert (console.read(38, 2), console.read(65, 1)) == (1193, 0)
    assert console.read(0, 2) == 1020


def test_factory_reset_of_all_to_all_is_not_carried_out() -> None:
    console = Console(firmware=42)
    console.write(38, 100, 2)
    for option, limit in ((b"\xff", 100), (b"\x02", 1193)):
        console.servo.handle(InstructionPacket(BROADCAST_ID, Instruction.FACTORY_RESET, option))
        console.run(0.5)
        assert console.read(38, 2) == limit
    older = Console(firmware=41)
    older.write(38, 100, 2)
    older.servo.handle(InstructionPacket(BROADCAST_ID, Instruction.FACTORY_RESET, b"\xff"))
    assert booted(older).read(38, 2) == 1193


def test_factory_reset_without_a_known_option() -> None:
    console = Console()
    assert console.send(Instruction.FACTORY_RESET) == StatusPacket(1, StatusErrorCode.DATA_LENGTH_ERROR)
    answer = console.send(Instruction.FACTORY_RESET, b"\x03")
    assert answer == StatusPacket(1, StatusErrorCode.DATA_RANGE_ERROR)


# -- Clear ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("torque", [False, True])
def test_clear_brings_the_position_back_into_one_turn(torque: bool) -> None:
    console = Console()
    console.start(EXTENDED)
    console.write(116, 2048 + 2 * 4096, 4)
    console.run(4)
    console.write(64, int(torque), 1)
    before = console.servo.shaft_rad
    assert console.send(Instruction.CLEAR, CLEAR_TURNS) == StatusPacket(1)
    console.run(0.5)
    assert console.read(132, 4) == pytest.approx(2048, abs=3)
    assert console.servo.shaft_rad == pytest.approx(before, abs=2e-3)  # a held shaft does not run back


def test_clear_fails_while_the_shaft_moves() -> None:
    console = Console()
    console.start(EXTENDED, velocity=50)
    console.write(116, 100_000, 4)
    console.run(0.5)
    assert console.send(Instruction.CLEAR, CLEAR_TURNS) == StatusPacket(1, StatusErrorCode.RESULT_FAIL)


@pytest.mark.parametrize(
    ("params", "error"),
    [
        (b"\x01", StatusErrorCode.DATA_LENGTH_ERROR),
        (b"\x01\x44\x58\x4c\x23", StatusErrorCode.DATA_RANGE_ERROR),
        (b"\x02\x44\x58\x4c\x22", StatusErrorCode.DATA_RANGE_ERROR),  # reserved
    ],
)
def test_clear_needs_its_fixed_values(params: bytes, error: StatusErrorCode) -> None:
    assert Console().send(Instruction.CLEAR, params) == StatusPacket(1, error)


# -- Control Table Backup ---------------------------------------------------------------------------------


def test_backup_and_restore_of_eeprom() -> None:
    console = Console(firmware=45)
    assert console.read(147, 1) == 0  # Backup Ready
    assert console.send(Instruction.CONTROL_TABLE_BACKUP, RESTORE) == StatusPacket(
        1, StatusErrorCode.RESULT_FAIL
    )
    console.write(38, 100, 2)
    console.write(84, 700, 2)
    assert console.send(Instruction.CONTROL_TABLE_BACKUP, STORE) == StatusPacket(1)
    assert console.read(147, 1) == 1
    console.write(38, 200, 2)
    assert console.send(Instruction.CONTROL_TABLE_BACKUP, RESTORE) == StatusPacket(1)
    assert booted(console).read(38, 2) == 100
    assert console.read(84, 2) == 800  # RAM only comes back if Startup Configuration says so
    assert console.read(147, 1) == 1
    console.servo.power_off()
    console.servo.power_on()
    assert console.read(147, 1) == 1


def test_backup_needs_torque_off() -> None:
    console = Console(firmware=45)
    console.start(POSITION)
    for params in (STORE, RESTORE):
        assert console.send(Instruction.CONTROL_TABLE_BACKUP, params) == StatusPacket(
            1, StatusErrorCode.RESULT_FAIL
        )


def test_backup_is_unknown_to_older_firmware() -> None:
    answer = Console(firmware=44).send(Instruction.CONTROL_TABLE_BACKUP, STORE)
    assert answer == StatusPacket(1, StatusErrorCode.INSTRUCTION_ERROR)


def test_startup_configuration_restores_ram() -> None:
    console = Console(model="XL330-M288")
    kept = {78: (250, 2), 84: (333, 2), 90: (7, 2), 108: (5, 4), 112: (6, 4), 168: (65, 2)}
    lost = {65: (1, 1), 98: (20, 1)}
    for address, (value, size) in (kept | lost).items():
        assert console.write(address, value, size) == 0
    assert console.write(60, 2, 1) == 0
    console.send(Instruction.CONTROL_TABLE_BACKUP, STORE)
    console.send(Instruction.REBOOT)
    booted(console)
    assert {a: console.read(a, size) for a, (_, size) in kept.items()} == {a: v for a, (v, _) in kept.items()}
    assert all(console.read(address, size) == 0 for address, (_, size) in lost.items())


def test_startup_configuration_switches_torque_on() -> None:
    console = Console(firmware=45, start_rad=1.0)
    assert console.write(60, 1, 1) == 0
    console.send(Instruction.REBOOT)
    assert booted(console).read(64, 1) == 1
    console.run(0.5, load_nm=0.5)
    assert console.servo.shaft_rad == pytest.approx(1.0, abs=0.05)


# -- IDs, answers -----------------------------------------------------------------------------------------


def test_a_new_id_holds_after_its_confirmation() -> None:
    console = Console()
    assert console.send(Instruction.WRITE, b"\7\0\5") == StatusPacket(1)
    assert console.send(Instruction.PING) is None
    console.dxl_id = 5
    assert console.send(Instruction.PING) is not None


def test_secondary_id_groups_servos_without_answers() -> None:
    servos = {dxl_id: EmulatedServo(dxl_id) for dxl_id in range(1, 6)}
    chain = ServoChain(list(servos.values()), lambda _: None)

    def write(dxl_id: int, address: int, value: int) -> int:
        params = address.to_bytes(2, "little") + bytes([value])
        return len(chain.feed(encode_instruction(InstructionPacket(dxl_id, Instruction.WRITE, params)), 0.0))

    def items(address: int) -> list[int]:
        blocks = [servo.answer_block(address, 1) for servo in servos.values()]
        return [block.params[0] for block in blocks if block is not None]

    for dxl_id in servos:
        write(dxl_id, 12, 5)
    assert write(1, 65, 1) == 1
    assert items(65) == [1, 0, 0, 0, 0]
    assert write(5, 65, 1) == 1  # the one whose ID it is answers
    assert items(65) == [1] * 5
    write(BROADCAST_ID, 12, 100)
    assert write(100, 65, 0) == 0
    assert items(65) == [0] * 5
    assert write(100, 9, 0) == 0  # EEPROM is out of reach
    assert items(9) == [250] * 5
    ping = encode_instruction(InstructionPacket(100, Instruction.PING))
    assert chain.feed(ping, 0.0) == []
    write(BROADCAST_ID, 12, 253)
    write(253, 65, 1)
    assert items(65) == [0] * 5


def test_nothing_but_a_ping_to_all_is_answered() -> None:
    chain = ServoChain([EmulatedServo(1, firmware=45)], lambda _: None)
    for number in range(256):
        answers = chain.feed(encode_instruction(InstructionPacket(BROADCAST_ID, number, b"\x41\0\1")), 0.0)
        assert bool(answers) == (number == Instruction.PING), number


def test_the_cause_can_be_read_while_alerting() -> None:
    console = Console()
    console.servo.report_hardware_error(4)
    assert console.send(Instruction.PING) == StatusPacket(1, 0x80, b"\xfc\x03\x2d")
    assert console.send(Instruction.READ, b"\x46\0\1\0") == StatusPacket(1, 0x80, b"\4")


@pytest.mark.parametrize("length", [0, 1])
def test_reads_outside_the_table_are_access_errors(length: int) -> None:
    console = Console()
    address = 700 if length else 64
    answer = console.send(Instruction.READ, address.to_bytes(2, "little") + bytes([length, 0]))
    assert answer == StatusPacket(1, StatusErrorCode.ACCESS_ERROR)


def test_a_read_across_undefined_addresses_gives_zeros_there() -> None:
    answer = Console().send(Instruction.READ, b"\x41\0\4\0")
    assert answer == StatusPacket(1, 0, b"\0\0\0\2")


# ----------------------------------------------------------------------------------------------------
# Indirect Address and Data of the emulated servos: e-Manual, "Indirect Address, Indirect Data".

ADDRESS_1, DATA_1 = 168, 224


def point(console: Console, number: int, address: int) -> int:
    return console.write(ADDRESS_1 + 2 * (number - 1), address, 2)


def test_one_byte_through_an_indirect_address() -> None:
    console = Console()
    assert point(console, 1, 65) == 0  # LED
    for value in (1, 0):
        assert console.write(DATA_1, value, 1) == 0
        assert (console.read(65, 1), console.read(DATA_1, 1)) == (value, value)


def test_four_bytes_through_indirect_addresses() -> None:
    console = Console()
    for k in range(4):
        assert point(console, 2 + k, 116 + k) == 0
    assert console.write(DATA_1 + 1, 1024, 4) == 0
    assert console.read(116, 4) == 1024


def test_distant_items_side_by_side() -> None:
    console = Console(start_rad=1.0)
    for k, address in enumerate([132, 133, 134, 135, 146]):
        point(console, 1 + k, address)
    answer = console.send(Instruction.READ, bytes([DATA_1, 0, 5, 0]))
    assert answer is not None
    assert answer.params == console.read(132, 4).to_bytes(4, "little") + b"\x1e"


def test_the_upper_group_of_an_xm430() -> None:
    console = Console()
    assert console.write(578, 65, 2) == 0
    assert console.write(634, 1, 1) == 0
    assert console.read(65, 1) == 1


def test_access_and_range_are_the_targets() -> None:
    console = Console()
    point(console, 1, 146)  # Present Temperature is read only
    assert console.write(DATA_1, 1, 1) == StatusErrorCode.ACCESS_ERROR
    point(console, 1, 64)  # Torque Enable
    assert console.write(DATA_1, 2, 1) == StatusErrorCode.DATA_RANGE_ERROR
    for k in range(4):
        point(console, 1 + k, 116 + k)
    assert console.write(DATA_1, 4096, 4) == StatusErrorCode.DATA_LIMIT_ERROR


def test_half_an_item_cannot_be_written() -> None:
    console = Console()
    point(console, 1, 116)
    assert console.write(DATA_1, 1024, 4) == StatusErrorCode.DATA_LENGTH_ERROR
    point(console, 1, 117)  # its middle
    assert console.write(DATA_1, 1, 1) == StatusErrorCode.ACCESS_ERROR


@pytest.mark.parametrize("address", [0, 7, 63, 662])
def test_only_ram_can_be_pointed_at(address: int) -> None:
    assert point(Console(), 1, address) == StatusErrorCode.DATA_RANGE_ERROR


def test_an_undefined_target() -> None:
    console = Console()
    point(console, 1, 66)
    read = console.send(Instruction.READ, bytes([DATA_1, 0, 1, 0]))
    assert read == StatusPacket(1, StatusErrorCode.ACCESS_ERROR)
    assert console.write(DATA_1, 1, 1) == StatusErrorCode.ACCESS_ERROR


def test_without_a_target_indirect_data_hold_what_they_are_given() -> None:
    console = Console()
    assert console.write(DATA_1, 0x12345678, 4) == 0
    assert console.read(DATA_1, 4) == 0x12345678


def test_a_registered_write_goes_through_too() -> None:
    console = Console()
    point(console, 1, 65)
    assert console.send(Instruction.REG_WRITE, bytes([DATA_1, 0, 1])) == StatusPacket(1)
    assert console.read(65, 1) == 0
    assert console.send(Instruction.ACTION) == StatusPacket(1)
    assert console.read(65, 1) == 1


def test_group_blocks_go_through_too() -> None:
    console = Console()
    point(console, 1, 65)
    console.servo.take_block(DATA_1, b"\1")
    block = console.servo.answer_block(DATA_1, 1)
    assert block == StatusPacket(1, 0, b"\1")
    assert console.read(65, 1) == 1


@pytest.mark.parametrize(("firmware", "data"), [(51, 224), (52, 208)])
@pytest.mark.parametrize("model", ["XL330-M288", "XC330-M288"])
def test_both_layouts_of_the_x330s(model: str, firmware: int, data: int) -> None:
    console = Console(model=model, firmware=firmware)
    assert point(console, 20, 65) == 0
    assert console.write(data + 19, 1, 1) == 0
    assert console.read(65, 1) == 1
    assert console.write(168, data + 20, 2) == StatusErrorCode.DATA_RANGE_ERROR
