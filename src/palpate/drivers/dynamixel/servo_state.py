"""State of a group of servos in one read: position, velocity, current, and all fault indicators.

Built on `bus`, and used by the rig's loops. The items needed are scattered over the control table, so each
servo's indirect addresses are set once to map them into one block (e-Manual, Indirect Address). They are in
RAM: a servo that has restarted returns an empty block, which is an error.

The turn mark is a note in the last two indirect addresses, which nothing else uses, of which turn the servo's
count is in. A servo that has been without power reports its angle within one turn, and forgets its RAM at the
same moment: a mark that is still there says that the turns have been counted on since it was written.

`StateTraffic` finds states in recorded bytes of a bus, without a port.
"""

import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus, GroupRead
from palpate.drivers.dynamixel.control_table import HardwareError, Item
from palpate.drivers.dynamixel.errors import (
    HardwareAlert,
    NotConfirmed,
    Restarted,
    StatusError,
)
from palpate.drivers.dynamixel.exchanges import TableBlock, extract_block, fast_read_time_s, group_read_time_s
from palpate.drivers.dynamixel.models import IndirectAddresses, Model, model_by_name
from palpate.drivers.dynamixel.packet import (
    Instruction,
    InstructionPacket,
    Parser,
    StatusPacket,
    parse_fast_status,
)
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.transport.clock import Clock

_BLOCK_ITEMS = (
    "Present Current",
    "Present Velocity",
    "Present Position",
    "Hardware Error Status",
    "Torque Enable",
    "Bus Watchdog",
    "Status Return Level",
)
_NO_HARDWARE_ERROR = HardwareError(0)
_STATE_LAYOUT = struct.Struct("<hiiBBbB")
STATE_BYTES = _STATE_LAYOUT.size
"""Bytes of a state block."""


class ServoState(NamedTuple):
    """Measurements and condition of a servo at one instant."""

    position_rad: float
    velocity_rad_s: float
    current_a: float
    torque_on: bool = True
    watchdog_tripped: bool = False
    hardware_error: HardwareError = _NO_HARDWARE_ERROR


class StateReader:
    """Reads the state of servos on one bus."""

    def __init__(self, bus: Bus, servos: Iterable[Servo]) -> None:
        """Prepare the reader; nothing is sent before `arrange`."""
        self.bus = bus
        self._servos = {servo.dxl_id: servo for servo in servos}
        self._fast = False

    def arrange(self) -> None:
        """Tell every servo what to show, and read it back.

        Raises what the bus raises, and InputError for a model with too few indirect addresses.
        """
        for servo in self._servos.values():
            if servo.model.firmware is None:
                servo.check()
            item, addresses = _block_addresses(servo)
            self.bus.write(servo.dxl_id, item, addresses)
            if self.bus.read(servo.dxl_id, item) != addresses:
                raise NotConfirmed([servo.dxl_id], self.bus.port_name, [item.name])
        self._fast = all(servo.model.answers_fast for servo in self._servos.values())

    @property
    def is_fast(self) -> bool:
        """True if Fast Sync Read is used: all servos know it."""
        return self._fast

    def wire_time_s(self, baudrate: int, return_delays_s: Sequence[float]) -> float:
        """Time on the wire of one `read`, with a return delay for each servo, without any latency."""
        sizes = [_STATE_LAYOUT.size] * len(return_delays_s)
        if self._fast:
            return fast_read_time_s(sizes, baudrate) + max(return_delays_s, default=0.0)
        return group_read_time_s(sizes, baudrate) + sum(return_delays_s)

    def read(self, servos: Sequence[Servo]) -> GroupRead[ServoState]:
        """The state of some of the servos at one instant; with Fast Sync Read where all of them know it."""
        blocks: dict[int, TableBlock] = {
            servo.dxl_id: (_indirect_addresses(servo).data, _STATE_LAYOUT.size) for servo in servos
        }
        answers = self.bus.read_blocks(blocks, fast=self._fast)
        values: dict[int, ServoState] = {}
        errors: dict[int, DeviceError] = {}
        for dxl_id, answer in answers.items():
            state = self._state(self._servos[dxl_id], answer)
            if isinstance(state, DeviceError):
                errors[dxl_id] = state
                continue
            values[dxl_id] = state
            if state.hardware_error:
                errors[dxl_id] = HardwareAlert(
                    dxl_id, self.bus.port_name, state.hardware_error, carried_out=True
                )
        return GroupRead(values, errors)

    def _state(self, servo: Servo, answer: StatusPacket | DeviceError) -> ServoState | DeviceError:
        if isinstance(answer, DeviceError):
            return answer
        if answer.error_number:
            return StatusError(servo.dxl_id, self.bus.port_name, answer.error_number, "to read its state")
        return _decode_state(servo.model, answer.params, servo.turns) or Restarted(
            servo.dxl_id, self.bus.port_name
        )


TakeStates = Callable[[Mapping[int, ServoState], float, float], None]
"""Takes servos' states, by id, and the instants (s) at which they were asked for and read."""


class StateSampler:
    """Reads the servos of all that sample, together, whenever a sample is due and one of them asks."""

    def __init__(self, reader: StateReader, clock: Clock) -> None:
        self._reader, self._clock = reader, clock
        self._takers: dict[TakeStates, Sequence[Servo]] = {}
        self._period_s = self._due_s = math.inf

    def start(self, servos: Sequence[Servo], take: TakeStates, rate_hz: float) -> None:
        """Give the states of some servos to `take` from now on."""
        self._takers[take] = servos
        self._period_s = 1 / rate_hz
        self._due_s = min(self._due_s, self._clock.now())

    def stop(self, take: TakeStates) -> None:
        """Give `take` no more."""
        self._takers.pop(take, None)
        if not self._takers:
            self._due_s = math.inf

    def wait(self) -> float:
        """Wait until a sample is due; how long (s) that was, infinite if none will be."""
        wait_s = max(self._due_s - self._clock.now(), 0.0)
        if math.isfinite(wait_s):
            self._clock.sleep(wait_s)
        return wait_s

    def sample_if_due(self) -> None:
        """Read servos if it is time; raises what reading raises."""
        asked_s = self._clock.now()
        if asked_s < self._due_s:
            return
        states = self._reader.read([servo for servos in self._takers.values() for servo in servos]).all()
        read_s = self._clock.now()
        self._due_s = max(self._due_s + self._period_s, asked_s)
        for take in self._takers:
            take(states, asked_s, read_s)


def _decode_state(model: Model, block: bytes, turns: int = 0) -> ServoState | None:
    """The state in a block of `STATE_BYTES` bytes; None if the servo has restarted, or for another size.

    `turns`: how many the servo counts ahead, see `Servo.turns`.
    """
    if len(block) != STATE_BYTES:
        return None
    current, velocity, position, error, torque, watchdog, level = _STATE_LAYOUT.unpack(block)
    if level != ct.ANSWERS_ALL:
        return None
    unit = math.nan if model.torque is None else model.torque.current_unit_a
    return ServoState(
        (position - model.zero_tick) * model.rad_per_tick - 2 * math.pi * turns,
        velocity * model.velocity_unit_rad_s,
        current * unit,
        bool(torque),
        watchdog < 0,
        HardwareError(error) if error else _NO_HARDWARE_ERROR,
    )


def _block_addresses(servo: Servo) -> tuple[Item, int]:
    """All indirect addresses of the block as one item, and its value: two bytes for each byte shown."""
    first = _indirect_addresses(servo).address
    items = [servo.item(name) for name in _BLOCK_ITEMS]
    addresses = [item.address + part for item in items for part in range(item.size)]
    whole = Item(f"Indirect Address 1 to {len(addresses)}", first, 2 * len(addresses))
    return whole, int.from_bytes(b"".join(address.to_bytes(2, "little") for address in addresses), "little")


def _indirect_addresses(servo: Servo) -> IndirectAddresses:
    place = servo.model.indirect
    if place is None or place.count < _STATE_LAYOUT.size:
        raise InputError(
            f"a {servo.model.name} has too few indirect addresses to show its state in one block"
        )
    return place


MAX_TURNS = 80
"""A mark holds so many turns, either way."""

_LOWEST_ADDRESS = 64  # an indirect address may be 64 to 227 on every model with current
_MARK_KEY = 97  # no default of these addresses: those are where Indirect Data lies
_ADDRESS_AT_ZERO_TURNS = 145
_STATE_BLOCK_ADDRESSES = 14  # by the state block
_WORD_BITS = 16

NO_MARK = _LOWEST_ADDRESS | _LOWEST_ADDRESS << _WORD_BITS
"""Value of a mark that says nothing."""


def mark_item(model: Model) -> Item | None:
    """Item that holds a model's mark; None if it has no two indirect addresses to spare."""
    place = model.indirect
    if place is None or place.count < _STATE_BLOCK_ADDRESSES + 2:
        return None
    first = place.count - 1
    return Item(
        f"Indirect Address {first} and {place.count}", place.address + 2 * (first - 1), 4, signed=False
    )


def mark_value(turns: int) -> int:
    """Value of the mark for a count that is `turns` ahead. ValueError above LARGEST_TURNS."""
    if abs(turns) > MAX_TURNS:
        raise ValueError(f"a mark holds {MAX_TURNS} turns either way, not {turns}")
    return _MARK_KEY | (_ADDRESS_AT_ZERO_TURNS + turns) << _WORD_BITS


def turns_of_mark(value: int) -> int | None:
    """Number of turns that the count is ahead; None if the value is no mark."""
    key, turns = value & 0xFFFF, (value >> _WORD_BITS) - _ADDRESS_AT_ZERO_TURNS
    return turns if key == _MARK_KEY and abs(turns) <= MAX_TURNS else None


_SYNC_READ_HEAD = struct.Struct("<HH")  # address and length, before the IDs
_BULK_READ_ENTRY = struct.Struct("<BHH")  # ID, address and length of each
_PING_ANSWER = struct.Struct("<HB")  # model number and firmware
_U16 = struct.Struct("<H")
_FAST_HEAD_BYTES = 8
_FAST_BLOCK_BYTES = 4  # bytes of an answer to a fast read that come with each servo's


class StateTraffic:
    """Finds states of servos, whose models are given by their IDs, in the traffic of one bus."""

    def __init__(self, models: Mapping[int, Model]) -> None:
        self._models = dict(models)
        self._sent, self._received = Parser(), Parser()
        self._asked: Mapping[int, TableBlock] = {}
        self._is_ping = False
        self._is_fast = False
        self._turns: dict[int, int] = {}
        self._mark: tuple[int, TableBlock, TableBlock] | None = None
        self._answer = bytearray()

    def take_sent(self, data: bytes) -> None:
        """Process bytes that the host has sent."""
        for packet in self._sent.feed(data):
            if isinstance(packet, InstructionPacket):
                self._begin(packet)

    def take_received(self, data: bytes) -> Iterator[tuple[int, ServoState]]:
        """Process bytes that the host has received; yield ID and state of every servo whose answer they
        complete.
        """
        if self._is_ping or self._mark is not None or (self._asked and not self._is_fast):
            for packet in self._received.feed(data):
                if isinstance(packet, StatusPacket) and self._is_ping:
                    self._note_firmware(packet)
                elif isinstance(packet, StatusPacket) and self._mark is not None:
                    self._note_read_mark(packet)
                elif isinstance(packet, StatusPacket):
                    yield from self._state(packet)
            return
        if not self._asked:
            return
        self._answer += data
        sizes = [size for _, size in self._asked.values()]
        if len(self._answer) >= _FAST_HEAD_BYTES + sum(sizes) + _FAST_BLOCK_BYTES * len(sizes):
            blocks = parse_fast_status(bytes(self._answer), sizes)
            self._answer.clear()
            for block in blocks:
                if block is not None:
                    yield from self._state(block)

    def _begin(self, packet: InstructionPacket) -> None:
        """Begin the next answer."""
        self._received.reset()
        self._answer.clear()
        self._is_ping = packet.instruction == Instruction.PING
        self._is_fast = packet.instruction in (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
        self._asked = _requested_blocks(packet)
        self._mark = None
        if packet.instruction in (Instruction.READ, Instruction.WRITE):
            self._begin_mark(packet)

    def _begin_mark(self, packet: InstructionPacket) -> None:
        """Note the turns where a mark is written, and that one is read."""
        model, params = self._models.get(packet.dxl_id), packet.params
        item = None if model is None else mark_item(model)
        if item is None:
            return
        if packet.instruction == Instruction.WRITE:
            if params[: _U16.size] == _U16.pack(item.address):
                self._note_mark(packet.dxl_id, params[_U16.size :])
        elif len(params) == _SYNC_READ_HEAD.size:
            first, size = _SYNC_READ_HEAD.unpack(params)
            if first <= item.address and item.address + item.size <= first + size:
                self._mark = (packet.dxl_id, (first, size), (item.address, item.size))

    def _note_mark(self, dxl_id: int, mark: bytes) -> None:
        self._turns[dxl_id] = turns_of_mark(int.from_bytes(mark, "little")) or 0

    def _note_read_mark(self, answer: StatusPacket) -> None:
        """The mark in an answer, which may hold more, see `pending`."""
        assert self._mark is not None
        dxl_id, wide, place = self._mark
        if answer.dxl_id == dxl_id and not answer.error_number and len(answer.params) == wide[1]:
            self._note_mark(dxl_id, extract_block(answer.params, wide, place))

    def _note_firmware(self, answer: StatusPacket) -> None:
        """Note the firmware, on which the place of the state depends."""
        model = self._models.get(answer.dxl_id)
        if model is None or len(answer.params) != _PING_ANSWER.size:
            return
        number, firmware = _PING_ANSWER.unpack(answer.params)
        if number == model.number:
            self._models[answer.dxl_id] = model_by_name(model.name, firmware)

    def _state(self, packet: StatusPacket) -> Iterator[tuple[int, ServoState]]:
        """The state in an answer; the bus asks for more than that in turn, see `pending`."""
        model, wide = self._models.get(packet.dxl_id), self._asked.get(packet.dxl_id)
        if model is None or model.indirect is None or wide is None or packet.error_number:
            return
        place = (model.indirect.data, STATE_BYTES)
        is_within = wide[0] <= place[0] and place[0] + STATE_BYTES <= wide[0] + wide[1]
        if not is_within or len(packet.params) != wide[1]:
            return
        state = _decode_state(
            model, extract_block(packet.params, wide, place), self._turns.get(packet.dxl_id, 0)
        )
        if state is not None:
            yield packet.dxl_id, state


def _requested_blocks(packet: InstructionPacket) -> Mapping[int, TableBlock]:
    """The block that each servo is asked for; none if the packet is no group read."""
    params = packet.params
    if (
        packet.instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)
        and len(params) >= _SYNC_READ_HEAD.size
    ):
        first, size = _SYNC_READ_HEAD.unpack_from(params)
        return dict.fromkeys(params[_SYNC_READ_HEAD.size :], (first, size))
    if packet.instruction in (Instruction.BULK_READ, Instruction.FAST_BULK_READ):
        whole = params[: len(params) // _BULK_READ_ENTRY.size * _BULK_READ_ENTRY.size]
        return {dxl_id: (first, size) for dxl_id, first, size in _BULK_READ_ENTRY.iter_unpack(whole)}
    return {}
