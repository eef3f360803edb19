"""Indirect Address and Data of the emulated servos: e-Manual, "Indirect Address, Indirect Data"."""

import pytest
from servo_console import Console

from palpate.drivers.dynamixel.packet import Instruction, StatusErrorCode, StatusPacket

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
