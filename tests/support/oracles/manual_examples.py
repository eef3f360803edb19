"""Every hex example of the e-Manual's page "DYNAMIXEL Protocol 2.0", byte for byte, with what it means.

In the page's order, section by section. Addresses and values are those of each example's conditions, in
decimal: a printed frame and its meaning are two transcriptions of the same example that check each other.

The page misprints two CRCs. Restore from Control Table Backup: 92 F5 for 9E F5. Fast Bulk Read: 20 F2, which
is the CRC of the Fast Sync Read instruction, for DA 2D. Both stand here as printed; `MISPRINTED_CRC` has the
right ones.
"""

from dataclasses import dataclass

from palpate.drivers.dynamixel.packet import BROADCAST_ID, Instruction, InstructionPacket, StatusPacket


@dataclass(frozen=True)
class Example:
    """One printed frame: section, bytes as printed, meaning."""

    section: str
    printed: str
    meaning: InstructionPacket | StatusPacket

    @property
    def wire(self) -> bytes:
        return bytes.fromhex(self.printed)


@dataclass(frozen=True)
class FastExample:
    """The one answer of several servos to a fast read: each servo's piece as printed, each one's meaning."""

    section: str
    printed: tuple[str, ...]
    meaning: tuple[StatusPacket, ...]

    @property
    def pieces(self) -> list[bytes]:
        return [bytes.fromhex(piece) for piece in self.printed]


@dataclass(frozen=True)
class Exchange:
    """An instruction and all that the servos answer to it; sync and bulk write are not answered."""

    instruction: Example
    answers: tuple[Example, ...] | FastExample = ()

    @property
    def section(self) -> str:
        return self.instruction.section

    @property
    def answer_wire(self) -> bytes:
        """All answers in a row."""
        if isinstance(self.answers, FastExample):
            return b"".join(self.answers.pieces)
        return b"".join(answer.wire for answer in self.answers)


def _u16(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _sent(section: str, printed: str, dxl_id: int, instruction: int, params: bytes = b"") -> Example:
    return Example(section, printed, InstructionPacket(dxl_id, instruction, params))


def _answered(section: str, printed: str, dxl_id: int, params: bytes = b"") -> Example:
    return Example(section, printed, StatusPacket(dxl_id, 0, params))


def _confirmed(sent: Example) -> Exchange:
    """An instruction to servo 1 whose answer carries no data: the page prints the same one each time."""
    return Exchange(sent, (_answered(sent.section, "FF FF FD 00 01 04 00 55 00 A1 0C", 1),))


_ALL = BROADCAST_ID
_XM430_W210 = _u16(1030) + bytes([38])  # model number, firmware
_PING_1 = "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"
_POSITION_1 = "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
_BACKUP = bytes.fromhex("43 54 52 4C")

EXCHANGES: tuple[Exchange, ...] = (
    Exchange(
        _sent("Ping, example 1", "FF FF FD 00 01 03 00 01 19 4E", 1, Instruction.PING),
        (_answered("Ping, example 1", _PING_1, 1, _XM430_W210),),
    ),
    Exchange(
        _sent("Ping, example 2", "FF FF FD 00 FE 03 00 01 31 42", _ALL, Instruction.PING),
        (
            _answered("Ping, example 2", _PING_1, 1, _XM430_W210),
            _answered("Ping, example 2", "FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", 2, _XM430_W210),
        ),
    ),
    Exchange(  # Present Position
        _sent("Read", "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", 1, Instruction.READ, _u16(132, 4)),
        (_answered("Read", _POSITION_1, 1, _u32(166)),),
    ),
    _confirmed(  # Goal Position
        _sent(
            "Write",
            "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
            1,
            Instruction.WRITE,
            _u16(116) + _u32(512),
        )
    ),
    _confirmed(  # Goal Velocity
        _sent(
            "Reg Write",
            "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",
            1,
            Instruction.REG_WRITE,
            _u16(104) + _u32(200),
        )
    ),
    _confirmed(_sent("Action", "FF FF FD 00 01 03 00 05 02 CE", 1, Instruction.ACTION)),
    _confirmed(  # option 0x01: all except ID
        _sent("Factory Reset", "FF FF FD 00 01 04 00 06 01 A1 E6", 1, Instruction.FACTORY_RESET, b"\1")
    ),
    _confirmed(_sent("Reboot", "FF FF FD 00 01 03 00 08 2F 4E", 1, Instruction.REBOOT)),
    _confirmed(
        _sent(
            "Clear",
            "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC",
            1,
            Instruction.CLEAR,
            b"\x01" + bytes.fromhex("44 58 4C 22"),
        )
    ),
    _confirmed(
        _sent(
            "Control Table Backup, example 1",
            "FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5",
            1,
            Instruction.CONTROL_TABLE_BACKUP,
            b"\x01" + _BACKUP,
        )
    ),
    _confirmed(
        _sent(
            "Control Table Backup, example 2",
            "FF FF FD 00 01 08 00 20 02 43 54 52 4C 92 F5",
            1,
            Instruction.CONTROL_TABLE_BACKUP,
            b"\x02" + _BACKUP,
        )
    ),
    Exchange(  # Present Position
        _sent(
            "Sync Read",
            "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
            _ALL,
            Instruction.SYNC_READ,
            _u16(132, 4) + bytes([1, 2]),
        ),
        (
            _answered("Sync Read", _POSITION_1, 1, _u32(166)),
            _answered("Sync Read", "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE", 2, _u32(2079)),
        ),
    ),
    Exchange(  # Goal Position
        _sent(
            "Sync Write",
            "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
            _ALL,
            Instruction.SYNC_WRITE,
            _u16(116, 4) + bytes([1]) + _u32(150) + bytes([2]) + _u32(170),
        )
    ),
    Exchange(  # Present Position
        _sent(
            "Fast Sync Read",
            "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
            _ALL,
            Instruction.FAST_SYNC_READ,
            _u16(132, 4) + bytes([3, 7, 4]),
        ),
        FastExample(
            "Fast Sync Read",
            (
                "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08",
                "00 07 1F 08 00 00 16 CA",
                "00 04 FF 03 00 00 D1 9E",
            ),
            (StatusPacket(3, 0, _u32(166)), StatusPacket(7, 0, _u32(2079)), StatusPacket(4, 0, _u32(1023))),
        ),
    ),
    Exchange(  # Present Input Voltage of one, Present Temperature of the other
        _sent(
            "Bulk Read",
            "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
            _ALL,
            Instruction.BULK_READ,
            bytes([1]) + _u16(144, 2) + bytes([2]) + _u16(146, 1),
        ),
        (
            _answered("Bulk Read", "FF FF FD 00 01 06 00 55 00 77 00 C3 69", 1, _u16(119)),
            _answered("Bulk Read", "FF FF FD 00 02 05 00 55 00 24 8B A9", 2, bytes([36])),
        ),
    ),
    Exchange(  # Max Voltage Limit of one, Temperature Limit of the other
        _sent(
            "Bulk Write",
            "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
            _ALL,
            Instruction.BULK_WRITE,
            bytes([1]) + _u16(32, 2) + _u16(160) + bytes([2]) + _u16(31, 1) + bytes([80]),
        )
    ),
    Exchange(  # Present Position, Present PWM, Present Temperature
        _sent(
            "Fast Bulk Read",
            "FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 20 F2",
            _ALL,
            Instruction.FAST_BULK_READ,
            bytes([3]) + _u16(132, 4) + bytes([7]) + _u16(124, 2) + bytes([4]) + _u16(146, 1),
        ),
        FastExample(
            "Fast Bulk Read",
            (
                "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4",
                "00 07 A5 01 24 74",
                "00 04 1F D9 C1",
            ),
            (StatusPacket(3, 0, _u32(166)), StatusPacket(7, 0, _u16(421)), StatusPacket(4, 0, bytes([31]))),
        ),
    ),
)

EXAMPLES: tuple[Example, ...] = tuple(
    example
    for exchange in EXCHANGES
    for example in (
        exchange.instruction,
        *(() if isinstance(exchange.answers, FastExample) else exchange.answers),
    )
)

FAST_EXAMPLES: tuple[FastExample, ...] = tuple(
    exchange.answers for exchange in EXCHANGES if isinstance(exchange.answers, FastExample)
)

MISPRINTED_CRC: dict[str, str] = {
    "FF FF FD 00 01 08 00 20 02 43 54 52 4C 92 F5": "9E F5",
    "FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 20 F2": "DA 2D",
}
"""What the CRC of a misprinted frame should be, by the frame as printed."""
