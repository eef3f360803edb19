"""Whatever is sent to an emulated servo: its control table stays one that the manual allows."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.control_table import Access, Area, TableItem
from palpate.drivers.dynamixel.packet import Instruction, InstructionPacket, Parser, encode_instruction
from palpate.drivers.dynamixel.x_series import MODEL_NAMES, table_of
from palpate.drivers.emulators.servo import EmulatedServo

FIRMWARE = 52
TABLES = {number: table_of(number, FIRMWARE) or () for number in MODEL_NAMES}
# a servo with another Status Return Level could not be watched; see `Watched`
UNTOUCHED = {"Status Return Level", "ID", "Secondary(Shadow) ID"}


class Watched:
    """A servo, and what its table should be."""

    def __init__(self, number: int) -> None:
        self.items: tuple[TableItem, ...] = TABLES[number]
        self.end = max(item.address + item.size for item in self.items)
        self.servo = EmulatedServo(1, model=MODEL_NAMES[number], firmware=FIRMWARE)

    def memory(self) -> bytes:
        """All of the table as it is stored, the present values aside."""
        raw = bytearray(self._read(0, self.end))
        for item in self.items:
            if item.access is Access.R or item.name.startswith("Indirect Data"):
                raw[item.address : item.address + item.size] = bytes(item.size)
        return bytes(raw)

    def values(self) -> dict[str, int]:
        raw = self._read(0, self.end)
        return {
            item.name: int.from_bytes(raw[item.address :][: item.size], "little", signed=item.signed)
            for item in self.items
        }

    def _read(self, address: int, length: int) -> bytes:
        answer = self.servo.answer_block(address, length)
        assert answer is not None
        assert answer.error_number == 0
        return answer.params

    def send(self, instruction: int, params: bytes) -> int:
        answer = self.servo.handle(InstructionPacket(1, instruction, params))
        assert answer is not None
        return answer.error_number

    def check(self) -> None:
        for item, value in zip(self.items, self.values().values(), strict=True):
            assert item.low <= value <= item.high, (item.name, value)
        assert math.isfinite(self.servo.shaft_rad)
        assert math.isfinite(self.servo.shaft_rad_s)


@st.composite
def one_write(draw: st.DrawFn) -> tuple[str, int, int]:
    """(name, value to be cut to its size, bytes more or fewer)."""
    names = sorted({item.name for items in TABLES.values() for item in items} - UNTOUCHED)
    name = draw(st.sampled_from(names))
    value = draw(st.integers(-2, 130) | st.integers(-5000, 5000) | st.integers(-(2**31), 2**31 - 1))
    return name, value, draw(st.sampled_from([0, 0, 0, 0, -1, 1]))


actions = (
    one_write()
    | st.tuples(st.just("raw"), st.integers(0, 700).filter(lambda a: a not in (7, 12, 68)), st.just(0))
    | st.tuples(st.just("steps"), st.integers(1, 60), st.just(0))
    | st.tuples(st.just("supply"), st.integers(0, 18), st.just(0))
    | st.tuples(
        st.just("send"),
        st.sampled_from([0x04, 0x05, 0x06, 0x08, 0x10, 0x20, 0x77]),
        st.sampled_from([0, 1, 2]),
    )
)
PARAMS = {
    Instruction.FACTORY_RESET: b"\x01",
    Instruction.CLEAR: bytes.fromhex("0144584C22"),
    Instruction.REG_WRITE: b"\x40\0\1",
}


def act(watched: Watched, action: tuple[str, int, int]) -> None:
    kind, value, more = action
    if kind == "steps":
        for _ in range(value):
            watched.servo.step(5e-3, 0.1)
    elif kind == "supply":
        watched.servo.set_supply(float(value))
    elif kind == "send":
        backup = bytes([1 + more % 2]) + b"CTRL"
        before = watched.memory()
        refused = watched.send(value, PARAMS.get(value, backup if value == 0x20 else b""))
        if refused and value != Instruction.ACTION:
            assert watched.memory() == before
    else:
        write(watched, kind, value, more)


def write(watched: Watched, name: str, value: int, more: int) -> None:
    found = {item.name: item for item in watched.items}.get(name)
    if found is None and name != "raw":
        return  # an item of another model
    address, size = (value, 2) if found is None else (found.address, found.size)
    data = (value & 0xFFFF_FFFF).to_bytes(4, "little")[:size] + b"\0"
    data = data[: max(0, size + more)]
    before, torque = watched.memory(), watched.values()["Torque Enable"]
    refused = watched.send(Instruction.WRITE, address.to_bytes(2, "little") + data)
    after = watched.memory()
    if refused:
        assert after == before
    elif torque:
        eeprom_end = max(item.address + item.size for item in watched.items if item.area is Area.EEPROM)
        assert after[:eeprom_end] == before[:eeprom_end]
    elif found is not None and more == 0:
        assert found.access is Access.RW


@given(st.sampled_from(list(MODEL_NAMES)), st.lists(actions, max_size=30))
@settings(max_examples=150)
def test_any_sequence_keeps_the_table_within_the_manuals_ranges(
    number: int, sequence: list[tuple[str, int, int]]
) -> None:
    watched = Watched(number)
    for action in sequence:
        act(watched, action)
        watched.check()


@given(st.binary(max_size=60), st.lists(st.integers(0, 60), max_size=3))
@settings(max_examples=150)
def test_noise_round_a_packet_never_hides_it(noise: bytes, cuts: list[int]) -> None:
    """Unless the noise looks like the beginning of a packet, whose rest the servo then waits for."""
    packet = InstructionPacket(1, Instruction.PING)
    stream = noise.replace(b"\xff\xff\xfd\0", b"") + encode_instruction(packet)
    if b"\xff\xff\xfd\0" in stream[:-10]:
        return
    parser = Parser()
    found = []
    ends = [*sorted(cut for cut in cuts if cut < len(stream)), len(stream)]
    for begin, end in zip([0, *ends], ends, strict=False):
        found += parser.feed(stream[begin:end])
    assert found == [packet]
