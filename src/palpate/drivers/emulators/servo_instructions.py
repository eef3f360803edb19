"""What an emulated servo does with an instruction packet that is for it alone: e-Manual, "Protocol 2.0".

Between `servo`, which decides whether an answer goes out, and `servo_unit`, which carries things out. What
the manual leaves open is decided here and said where it is decided.
"""

from palpate.drivers.dynamixel.emanual_tables import BROADCAST_RESET_FIRMWARE
from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    StatusErrorCode,
)
from palpate.drivers.emulators.servo_table import Refused
from palpate.drivers.emulators.servo_unit import BOOT_S, ServoUnit

__all__ = ["SECONDARY_INSTRUCTIONS", "carry_out"]

SECONDARY_INSTRUCTIONS = frozenset(
    {
        Instruction.WRITE,
        Instruction.REG_WRITE,
        Instruction.ACTION,
        Instruction.REBOOT,
        Instruction.CLEAR,
    }
)
"""What Secondary ID can have carried out: it cannot change EEPROM, and nothing is answered to it."""

_RESET_ALL = 0xFF
_KEPT_BY_RESET: dict[int, frozenset[str]] = {
    _RESET_ALL: frozenset(),
    0x01: frozenset({"ID"}),
    0x02: frozenset({"ID", "Baud Rate"}),
}
_CLEAR_TURNS = bytes.fromhex("01 44 58 4C 22")
_STORE = bytes.fromhex("01 43 54 52 4C")
_RESTORE = bytes.fromhex("02 43 54 52 4C")


def carry_out(unit: ServoUnit, packet: InstructionPacket, *, secondary: bool = False) -> bytes:
    """Carry out an instruction; returns the answer's parameters. Raises Refused.

    `secondary`: it came to the servo's Secondary ID, which reaches RAM only.
    """
    params = packet.params
    match packet.instruction:
        case Instruction.PING:
            return unit.read(0, 2) + unit.read(6, 1)
        case Instruction.READ:
            if len(params) != 4:
                raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
            return unit.read(_word(params, 0), _word(params, 2))
        case Instruction.WRITE:
            unit.write(*_split_write(params), ram_only=secondary)
        case Instruction.REG_WRITE:
            address, data = _split_write(params)
            unit.checked(address, data, ram_only=secondary)
            unit.registered = (address, data)
            unit.table.set("Registered Instruction", 1)
        case Instruction.ACTION:
            _act(unit, secondary=secondary)
        case Instruction.FACTORY_RESET:
            _factory_reset(unit, packet)
        case Instruction.REBOOT:
            unit.start(BOOT_S)
        case Instruction.CLEAR:
            _clear(unit, params)
        case Instruction.CONTROL_TABLE_BACKUP if unit.extended:
            _back_up(unit, params)
        case _:
            raise Refused(StatusErrorCode.INSTRUCTION_ERROR)
    return b""


def _act(unit: ServoUnit, *, secondary: bool) -> None:
    if unit.registered is None:
        raise Refused(StatusErrorCode.INSTRUCTION_ERROR)
    registered, unit.registered = unit.registered, None
    unit.table.set("Registered Instruction", 0)
    unit.write(*registered, ram_only=secondary)


def _factory_reset(unit: ServoUnit, packet: InstructionPacket) -> None:
    if len(packet.params) != 1:
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    option = packet.params[0]
    if option not in _KEPT_BY_RESET:
        raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
    if option == _RESET_ALL and packet.dxl_id == BROADCAST_ID and unit.firmware >= BROADCAST_RESET_FIRMWARE:
        # a whole bus of servos with ID 1 at 57,600 bps could not be told apart any more
        raise Refused(StatusErrorCode.RESULT_FAIL)
    unit.factory_reset(_KEPT_BY_RESET[option])


def _clear(unit: ServoUnit, params: bytes) -> None:
    _expect(params, _CLEAR_TURNS)
    if unit.drive.moving:
        raise Refused(StatusErrorCode.RESULT_FAIL)
    unit.drive.clear_turns()


def _back_up(unit: ServoUnit, params: bytes) -> None:
    _expect(params, _STORE, _RESTORE)
    if unit.motion.driven:
        raise Refused(StatusErrorCode.RESULT_FAIL)
    if params == _STORE:
        unit.back_up()
        return
    if not unit.has_backup:
        raise Refused(StatusErrorCode.RESULT_FAIL)
    unit.restore()


def _expect(params: bytes, *allowed: bytes) -> None:
    """Refuse other parameters than these; the manual calls them reserved and names no error."""
    if len(params) != len(allowed[0]):
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    if params not in allowed:
        raise Refused(StatusErrorCode.DATA_RANGE_ERROR)


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


def _split_write(params: bytes) -> tuple[int, bytes]:
    if len(params) < 3:
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    return _word(params, 0), params[2:]
