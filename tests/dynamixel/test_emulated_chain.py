"""Chains of emulated servos: group reads, the vendor's SDK, invariants."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from dynamixel_sdk import (
    COMM_SUCCESS,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    Protocol2PacketHandler,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.control_table import Access, Area, TableItem
from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    crc16,
    encode_instruction,
)
from palpate.drivers.dynamixel.x_series import MODEL_NAMES, X_SERIES, table_of
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from support.devices.servo_wire import SdkPort

# ----------------------------------------------------------------------------------------------------
# Sync, bulk and fast reads on a chain of emulated servos, against the e-Manual's own examples.

POSITION = (132, 4)


def group_read(instruction: int, *requests: tuple[int, int, int]) -> bytes:
    """(id, address, length) each; sync reads take address and length of the first."""
    if instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
        _, address, length = requests[0]
        params = _words(address, length) + bytes(dxl_id for dxl_id, _, _ in requests)
    else:
        params = b"".join(bytes([dxl_id]) + _words(address, length) for dxl_id, address, length in requests)
    return encode_instruction(InstructionPacket(BROADCAST_ID, instruction, params))


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def chain_of(
    *ids: int, skip_missing: bool = False, **options: object
) -> tuple[ServoChain, list[EmulatedServo]]:
    servos = [EmulatedServo(dxl_id, **({"firmware": 45} | options)) for dxl_id in ids]  # type: ignore[arg-type]
    return ServoChain(servos, lambda _: None, skip_missing=skip_missing), servos


# -- on the wire ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("instruction", [Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ])
def test_a_fast_read_is_one_frame_after_one_return_delay(instruction: int) -> None:
    chain, _ = chain_of(1, 2, 3)
    parts = chain.feed(group_read(instruction, (3, *POSITION), (1, *POSITION), (2, *POSITION)), 1.0)
    frame = b"".join(data for _, data in parts)
    assert len(frame) == int.from_bytes(frame[5:7], "little") + 7
    assert crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
    assert [frame[9 + 8 * k] for k in range(3)] == [3, 1, 2]
    assert frame[10:14] == (2048).to_bytes(4, "little")
    # 500 µs Return Delay Time, then byte after byte
    assert [instant for instant, _ in parts] == pytest.approx([1.0005, 1.00066, 1.00074])


def test_a_fast_read_does_not_stuff_bytes() -> None:
    chain, [servo] = chain_of(1)
    servo.take_block(224, bytes.fromhex("FFFFFD00"))  # Indirect Data 1 … 4 hold what they are given
    [(_, frame)] = chain.feed(group_read(Instruction.FAST_SYNC_READ, (1, 224, 4)), 0.0)
    assert frame[10:-2] == bytes.fromhex("FFFFFD00")
    [(_, status)] = chain.feed(group_read(Instruction.SYNC_READ, (1, 224, 4)), 0.0)
    assert bytes.fromhex("FFFFFDFD00") in status


def test_a_fast_read_breaks_off_at_a_missing_servo() -> None:
    chain, servos = chain_of(1, 2, 3)
    servos[1].power_off()
    [(_, part)] = chain.feed(group_read(Instruction.FAST_SYNC_READ, *((k, *POSITION) for k in (1, 2, 3))), 0)
    assert len(part) == 8 + 8 < int.from_bytes(part[5:7], "little") + 7
    servos[0].power_off()
    assert chain.feed(group_read(Instruction.FAST_SYNC_READ, *((k, *POSITION) for k in (1, 2, 3))), 0) == []


@pytest.mark.parametrize(("model", "first"), [("XM430-W350", 45), ("XL330-M288", 46), ("XC330-M288", 46)])
@pytest.mark.parametrize("instruction", [Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ])
def test_older_firmware_keeps_silent_at_fast_reads(model: str, first: int, instruction: int) -> None:
    request = group_read(instruction, (1, *POSITION))
    old, _ = chain_of(1, model=model, firmware=first - 1)
    new, _ = chain_of(1, model=model, firmware=first)
    assert old.feed(request, 0.0) == []
    assert len(new.feed(request, 0.0)) == 1


def test_a_fast_read_to_one_servo_is_an_instruction_error() -> None:
    chain, _ = chain_of(1)
    packet = InstructionPacket(1, Instruction.FAST_SYNC_READ, _words(*POSITION) + b"\1")
    [(_, answer)] = chain.feed(encode_instruction(packet), 0.0)
    assert Parser().feed(answer) == [StatusPacket(1, StatusErrorCode.INSTRUCTION_ERROR)]


def test_a_refused_block_of_a_fast_read_keeps_its_length() -> None:
    chain, _ = chain_of(1, 2)
    parts = chain.feed(group_read(Instruction.FAST_BULK_READ, (1, 14, 4), (2, *POSITION)), 0.0)
    frame = b"".join(data for _, data in parts)
    assert frame[8:14] == bytes([StatusErrorCode.ACCESS_ERROR, 1, 0, 0, 0, 0])
    assert crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


def test_alerts_travel_in_fast_blocks() -> None:
    chain, servos = chain_of(1, 2)
    servos[1].report_hardware_error(4)
    parts = chain.feed(group_read(Instruction.FAST_SYNC_READ, (1, *POSITION), (2, *POSITION)), 0.0)
    assert (parts[0][1][8], parts[1][1][0]) == (0, 0x80)


@pytest.mark.parametrize("instruction", [Instruction.SYNC_READ, Instruction.BULK_READ])
def test_behind_a_missing_servo(instruction: int) -> None:
    request = group_read(instruction, *((k, *POSITION) for k in (1, 2, 3)))
    strict, servos = chain_of(1, 2, 3)
    servos[1].power_off()
    assert len(strict.feed(request, 0.0)) == 1
    lenient, servos = chain_of(1, 2, 3, skip_missing=True)
    servos[1].power_off()
    answers = lenient.feed(request, 0.0)
    assert [Parser().feed(data)[0].dxl_id for _, data in answers] == [1, 3]
    # its own return delay comes after the time that the missing answer of 15 bytes would have taken
    assert [instant for instant, _ in answers] == pytest.approx([0.0005, 0.00065 + 0.00015 + 0.0005])


def test_a_bulk_read_asks_each_servo_once() -> None:
    chain, _ = chain_of(1, 2)
    answers = chain.feed(group_read(Instruction.BULK_READ, (1, 0, 2), (1, 7, 1), (2, 7, 1)), 0.0)
    assert [Parser().feed(data)[0].params for _, data in answers] == [(1020).to_bytes(2, "little"), b"\2"]


def test_status_return_level_zero_is_silent_in_group_reads() -> None:
    chain, [servo] = chain_of(1)
    servo.take_block(68, b"\0")
    for instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
        assert chain.feed(group_read(instruction, (1, *POSITION)), 0.0) == []


# ----------------------------------------------------------------------------------------------------
# The vendor's SDK on emulated servos, in virtual time: every model, rarer instructions to three of them.

BAUD = 1_000_000
MODELS = {3: ("XM430-W350", 45, 1020), 7: ("XL330-M288", 52, 1200), 4: ("XC330-M288", 52, 1240)}
DONE = (COMM_SUCCESS, 0)


@dataclass
class Client:
    port: SdkPort
    packets: Protocol2PacketHandler
    servos: dict[int, EmulatedServo]

    def run(self, seconds: float) -> None:
        for servo in self.servos.values():
            for _ in range(round(seconds / 1e-3)):
                servo.step(1e-3, 0.0)


def client_of(servos: dict[int, EmulatedServo]) -> Client:
    clock = VirtualClock()
    hub = MockHub(clock, "sdk")
    url = hub.attach("bus", ServoChain(list(servos.values()), lambda _: None), BAUD)
    port = SdkPort(open_port(url, BAUD, timeout_s=0), clock)
    return Client(port, Protocol2PacketHandler(), servos)


@pytest.fixture
def client() -> Iterator[Client]:
    servos = {
        k: EmulatedServo(k, model=model, firmware=firmware, start_rad=0.1 * k)
        for k, (model, firmware, _) in MODELS.items()
    }
    made = client_of(servos)
    yield made
    made.port.closePort()


@pytest.mark.parametrize("number", MODEL_NAMES)
def test_every_model_by_the_vendors_sdk(number: int) -> None:
    """Ping, fast read, its own voltage and limits, and a goal that it moves to."""
    model = X_SERIES[number]
    client = client_of({1: EmulatedServo(1, model=model.name)})
    port, sdk = client.port, client.packets
    assert sdk.ping(port, 1) == (number, *DONE)
    group = GroupSyncRead(port, sdk, 132, 4)
    group.addParam(1)
    assert group.fastSyncRead() == COMM_SUCCESS
    assert group.getData(1, 132, 4) == 2048
    assert sdk.read2ByteTxRx(port, 1, 144)[0] == round(10 * model.family.supply_v[1])
    highest = model.current_limit
    assert sdk.read2ByteTxRx(port, 1, 38) == (highest, *DONE)
    assert sdk.write2ByteTxRx(port, 1, 38, highest + 1) == (COMM_SUCCESS, 4)  # Data Range Error
    assert sdk.write2ByteTxRx(port, 1, 38, highest // 2) == DONE
    assert sdk.write1ByteTxRx(port, 1, 64, 1) == DONE
    assert sdk.write4ByteTxRx(port, 1, 116, 2600) == DONE
    client.run(2.0)
    assert sdk.read4ByteTxRx(port, 1, 132)[0] == pytest.approx(2600, abs=10)
    assert sdk.write2ByteTxRx(port, 1, 38, 9) == (COMM_SUCCESS, 7)  # EEPROM is locked while torque is on
    port.closePort()


def test_group_writes_and_indirect_addresses(client: Client) -> None:
    write = GroupSyncWrite(client.port, client.packets, 168, 2)
    for dxl_id in MODELS:
        write.addParam(dxl_id, [65, 0])  # Indirect Address 1: LED
    assert write.txPacket() == COMM_SUCCESS
    bulk = GroupBulkWrite(client.port, client.packets)
    for dxl_id, data in ((3, 224), (7, 208), (4, 208)):
        bulk.addParam(dxl_id, data, 1, [1])
    assert bulk.txPacket() == COMM_SUCCESS
    assert [client.packets.read1ByteTxRx(client.port, dxl_id, 65)[0] for dxl_id in MODELS] == [1, 1, 1]


def test_clear_reboot_and_factory_reset(client: Client) -> None:
    assert client.packets.clearMultiTurn(client.port, 3) == DONE
    assert client.packets.write2ByteTxRx(client.port, 4, 38, 700) == DONE
    assert client.packets.reboot(client.port, 4) == DONE
    client.run(0.5)
    assert client.packets.read2ByteTxRx(client.port, 4, 38)[0] == 700
    assert client.packets.factoryReset(client.port, 4, 0x02) == DONE
    client.run(0.5)
    assert client.packets.read2ByteTxRx(client.port, 4, 38)[0] == 2352


def test_a_changed_id_answers_at_once(client: Client) -> None:
    assert client.packets.write1ByteTxRx(client.port, 3, 7, 9) == DONE
    assert client.packets.ping(client.port, 9) == (1020, *DONE)


# ----------------------------------------------------------------------------------------------------
# Whatever is sent to an emulated servo: its control table stays one that the manual allows.

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
