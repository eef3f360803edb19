"""A wire that spoils what it carries, and a host judged on it."""

import heapq
import random
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import count

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import Item
from palpate.drivers.dynamixel.errors import StatusError
from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    DamagedPacket,
    Instruction,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    encode_status,
)
from palpate.drivers.emulators.servo_chain import FastFrame, read_requests, write_requests
from palpate.drivers.transport.clock import VirtualClock

# ----------------------------------------------------------------------------------------------------
# A wire of servos that flips, loses, cuts, delays and repeats, quick enough for millions of instructions.
#
# `SpoilingPort` is a serial port in virtual time with three servos behind it that are nothing but their
# memory:
# bytes in, bytes out, by Protocol 2.0. It remembers what every register held when, so that what the host was
# told can be judged, and it knows which packets reached somebody damaged and whole all the same.
#
# What is handed over at once arrives at once, when its last bit does. A packet that is late holds up those
# behind it, as on a computer that is busy; a copy that is late comes when it comes.

REGISTERS = (100, 102, 104, 108, 112, 116)
"""Where the registers that are written begin (Goal PWM … Goal Position); REALTIME_TICK tells the time."""

_SIZES = {100: 2, 102: 2, 104: 4, 108: 4, 112: 4, 116: 4}
_TICK = 120
_BYTE_S = 1e-5  # at 1 Mbps
_RETURN_DELAY_S = 2e-5
_GAP_S = 1.5e-3  # between two bytes of a packet a servo waits no longer


@dataclass(frozen=True)
class Spoil:
    """Probabilities for each byte (`flipped`) and each packet of one direction, and how late (s).

    One that is `garbled` is random from some byte behind its LEN on, as after a collision: what a CRC of 16
    bits lets through once in 65,536 times.
    """

    flipped: float = 0.0
    lost: float = 0.0
    cut: float = 0.0
    late: float = 0.0
    late_s: tuple[float, float] = (0.0, 0.0)
    twice: float = 0.0
    twice_s: tuple[float, float] = (0.0, 0.0)
    garbled: float = 0.0


@dataclass(frozen=True)
class Kind:
    """A kind of bad wire: what is done to instructions, and to answers."""

    name: str
    out: Spoil
    back: Spoil


class _Servo:
    """A control table that is answered for, and what its registers held since when."""

    def __init__(self, dxl_id: int) -> None:
        self.dxl_id = dxl_id
        self.memory = bytearray(256)
        self.memory[0:7] = bytes([0xFC, 3, 0, 0, 0, 0, 44])
        self.held: dict[int, tuple[list[float], list[int]]] = {at: ([-1.0], [0]) for at in REGISTERS}

    def read(self, address: int, size: int, now: float) -> tuple[int, bytes]:
        if size == 0 or address + size > len(self.memory):
            return StatusErrorCode.ACCESS_ERROR, b""
        self.memory[_TICK : _TICK + 2] = (int(now * 1000) % 32768).to_bytes(2, "little")
        return 0, bytes(self.memory[address : address + size])

    def write(self, address: int, data: bytes, now: float) -> int:
        if _SIZES.get(address) != len(data):
            return StatusErrorCode.DATA_LENGTH_ERROR
        if data[-1] & 0x40:
            return StatusErrorCode.DATA_RANGE_ERROR
        self.memory[address : address + len(data)] = data
        times, values = self.held[address]
        times.append(now)
        values.append(int.from_bytes(data, "little", signed=True))
        if len(times) > 4000:
            del times[:2000], values[:2000]
        return 0


class SpoilingPort:
    """What the bus uses of a pyserial port, on a virtual clock, with servos 1, 2 and 3 behind it."""

    port = "spoiling"
    is_open = True

    def __init__(self, clock: VirtualClock, kind: Kind, seed: int) -> None:
        self.baudrate = 1_000_000
        self.timeout: float | None = 0.0
        self.servos = {dxl_id: _Servo(dxl_id) for dxl_id in (1, 2, 3)}
        self.kind = kind
        self.let_through_s: list[float] = []
        """When a packet was damaged and its CRC right all the same."""
        self._clock = clock
        self._chance = random.Random(seed)
        self._number = count()
        self._events: list[tuple[float, int, bool, bytes, bool]] = []
        self._received = bytearray()
        self._receiver = Parser()
        self._heard_s = self._answering_s = 0.0
        self._held_s = [0.0, 0.0]

    # -- the host's side ----------------------------------------------------------------------------------

    def close(self) -> None:
        self.is_open = False

    def flush(self) -> None:
        return

    @property
    def in_waiting(self) -> int:
        self._run(self._clock.now())
        return len(self._received)

    def reset_input_buffer(self) -> None:
        self._run(self._clock.now())
        self._received.clear()

    def write(self, data: bytes) -> int:
        self._clock.sleep(len(data) * _BYTE_S)
        self._pass(bytes(data), self._clock.now(), out=True)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        end = self._clock.now() + (self.timeout or 0.0)
        self._run(self._clock.now())
        while len(self._received) < size and self._clock.now() < end:
            event_s = self._events[0][0] if self._events else end
            self._clock.advance_to(min(event_s, end))
            self._run(self._clock.now())
        taken = bytes(self._received[:size])
        del self._received[:size]
        return taken

    # -- the wire -----------------------------------------------------------------------------------------

    def _pass(self, data: bytes, now: float, *, out: bool) -> None:
        spoil = self.kind.out if out else self.kind.back
        chance = self._chance.random
        if spoil.lost and chance() < spoil.lost:
            return
        due = now
        if spoil.late and chance() < spoil.late:
            due += self._chance.uniform(*spoil.late_s)
        due = self._held_s[out] = max(due, self._held_s[out])
        self._put(data, due, spoil, out)
        if spoil.twice and chance() < spoil.twice:
            self._put(data, now + self._chance.uniform(*spoil.twice_s), spoil, out)

    def _put(self, data: bytes, due: float, spoil: Spoil, out: bool) -> None:
        chance = self._chance.random
        spoilt = data
        if spoil.flipped:
            mask = [1 << self._chance.randrange(8) if chance() < spoil.flipped else 0 for _ in data]
            if any(mask):
                spoilt = bytes(byte ^ bit for byte, bit in zip(data, mask, strict=True))
        if spoil.cut and chance() < spoil.cut:
            spoilt = spoilt[: self._chance.randrange(1, len(data))]
        if spoil.garbled and chance() < spoil.garbled:
            at = self._chance.randrange(7, len(data))
            spoilt = spoilt[:at] + self._chance.randbytes(len(data) - at)
        heapq.heappush(self._events, (due, next(self._number), out, spoilt, spoilt != data))

    def _run(self, now: float) -> None:
        while self._events and self._events[0][0] <= now:
            due, _, out, data, damaged = heapq.heappop(self._events)
            if damaged and any(not isinstance(packet, DamagedPacket) for packet in Parser().feed(data)):
                self.let_through_s.append(due)
            if out:
                self._hear(data, due)
            else:
                self._received += data

    # -- the servos' side ---------------------------------------------------------------------------------

    def _hear(self, data: bytes, now: float) -> None:
        if now - self._heard_s > _GAP_S:
            self._receiver.reset()
        self._heard_s = now
        self._answering_s = max(self._answering_s, now)
        for packet in self._receiver.feed(data):
            if isinstance(packet, InstructionPacket):
                self._obey(packet, now)
            elif isinstance(packet, DamagedPacket) and packet.dxl_id in self.servos:
                self._answer(packet.dxl_id, StatusErrorCode.CRC_ERROR)

    def _send(self, data: bytes) -> None:
        self._answering_s += _RETURN_DELAY_S + len(data) * _BYTE_S
        self._pass(data, self._answering_s, out=False)

    def _answer(self, dxl_id: int, error: int, params: bytes = b"") -> None:
        self._send(encode_status(StatusPacket(dxl_id, error, params)))

    def _obey(self, packet: InstructionPacket, now: float) -> None:
        if packet.dxl_id == BROADCAST_ID:
            self._obey_all(packet, now)
        servo = self.servos.get(packet.dxl_id)
        if servo is None:
            return
        params = packet.params
        if packet.instruction == Instruction.PING:
            self._answer(packet.dxl_id, 0, bytes(servo.memory[0:2] + servo.memory[6:7]))
        elif packet.instruction == Instruction.READ and len(params) == 4:
            self._answer(packet.dxl_id, *servo.read(_word(params, 0), _word(params, 2), now))
        elif packet.instruction == Instruction.WRITE and len(params) > 2:
            self._answer(packet.dxl_id, servo.write(_word(params, 0), params[2:], now))
        else:
            self._answer(packet.dxl_id, StatusErrorCode.INSTRUCTION_ERROR)

    def _obey_all(self, packet: InstructionPacket, now: float) -> None:
        if packet.instruction == Instruction.SYNC_WRITE:
            for wanted in write_requests(packet):
                if wanted.dxl_id in self.servos:
                    self.servos[wanted.dxl_id].write(wanted.address, wanted.data, now)
        elif packet.instruction in (Instruction.SYNC_READ, Instruction.BULK_READ):
            for request in read_requests(packet):
                if request.dxl_id not in self.servos:
                    return
                servo = self.servos[request.dxl_id]
                self._answer(servo.dxl_id, *servo.read(request.address, request.length, now))
        elif packet.instruction == Instruction.FAST_SYNC_READ:
            self._answer_fast(packet, now)

    def _answer_fast(self, packet: InstructionPacket, now: float) -> None:
        requests = read_requests(packet)
        frame, parts = FastFrame([request.length for request in requests]), b""
        for request in requests:
            if request.dxl_id not in self.servos:
                break
            error, data = self.servos[request.dxl_id].read(request.address, request.length, now)
            parts += frame.part(StatusPacket(request.dxl_id, error, data.ljust(request.length, b"\0")))
        if parts:
            self._send(parts)

    # -- what was true ------------------------------------------------------------------------------------

    def held(self, dxl_id: int, address: int, since_s: float) -> list[int]:
        """The values that a register had at or after an instant."""
        times, values = self.servos[dxl_id].held[address]
        return values[bisect_right(times, since_s) - 1 :]

    def written(self, dxl_id: int, address: int, since_s: float) -> list[int]:
        """The values that a register was given after an instant."""
        times, values = self.servos[dxl_id].held[address]
        return values[bisect_right(times, since_s) :]


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


# ----------------------------------------------------------------------------------------------------
# A host that reads and writes at random over a bad wire, and is judged by what the servos really held.
#
# For `benchmarks/bench_bad_wires.py`, which does it ten million times, and its short version among the tests.

_ITEMS = {
    item.address: item
    for item in (
        ct.ITEMS["Goal PWM"],
        ct.ITEMS["Goal Current"],
        ct.ITEMS["Goal Velocity"],
        ct.ITEMS["Profile Acceleration"],
        ct.ITEMS["Profile Velocity"],
        ct.ITEMS["Goal Position"],
    )
}
_IDS = (1, 2, 3)
_HEADER_LIKE = 0x00FDFFFF
_REFUSED = 0x40 << 8
_TELLING_S = 1.0  # how long a packet that was damaged unnoticed may be to blame for what is wrong
_FRESH_S = 2e-3

_FLIPS, _LOSSES = Spoil(flipped=0.003), Spoil(lost=0.1, cut=0.05)
_GARBLED = Spoil(garbled=0.2)
_LATE = Spoil(late=0.1, late_s=(0.0, 0.12))
_TWICE = Spoil(twice=0.2)
_TWICE_LATE = Spoil(twice=0.2, twice_s=(0.0005, 0.04))
_ALL = Spoil(0.0005, 0.01, 0.01, 0.01, (0.0, 0.12), 0.03, (0.0, 0.04))
_FINE = Spoil()

KINDS = (
    Kind("nothing", _FINE, _FINE),
    Kind("bits flip", _FLIPS, _FLIPS),
    Kind("garbled", _GARBLED, _GARBLED),
    Kind("lost or cut", _LOSSES, _LOSSES),
    Kind("instructions late", _LATE, _FINE),
    Kind("answers late", _FINE, _LATE),
    Kind("instructions twice", _TWICE, _FINE),
    Kind("answers twice", _FINE, _TWICE),
    Kind("instructions twice, late", _TWICE_LATE, _FINE),
    Kind("answers twice, late", _FINE, _TWICE_LATE),
    Kind("all of it", _ALL, _ALL),
)
LOOPS = tuple(
    Kind(f"loop: {kind.name}", kind.out, kind.back)
    for kind in KINDS
    if kind.back in (_LATE, _TWICE_LATE, _ALL)
)
"""Wires on which a control loop, which always asks the same, may be told what was true before."""


@dataclass
class Tally:
    """What came of it.

    `instructions`: packets sent by the host, each with its answers. `values`: values that it was told.
    `wrong`: those that the register did not hold at any time between the call and its return. `unconfirmed`:
    writes that were confirmed and not done. `misled`: refusals of what was not refused, and the other way
    round. `let_through`: what is wrong, but follows a damaged packet whose CRC is right. `undone`: values
    that are right and not what was last written, because a late copy of an earlier write came. `old`: values
    of a clock in the servo that were older than the question. `failed`: calls that ended in an error.
    """

    instructions: int = 0
    values: int = 0
    wrong: int = 0
    unconfirmed: int = 0
    misled: int = 0
    let_through: int = 0
    undone: int = 0
    old: int = 0
    clock_values: int = 0
    damaged_packets_let_through: int = 0
    calls: int = 0
    failed: int = 0

    def add(self, other: "Tally") -> None:
        for item in fields(self):
            setattr(self, item.name, getattr(self, item.name) + getattr(other, item.name))

    def as_dict(self) -> dict[str, int]:
        return asdict(self)


class _Talk:
    def __init__(self, kind: Kind, seed: int) -> None:
        self.tally = Tally()
        self.clock = VirtualClock()
        self.port = SpoilingPort(self.clock, Kind(kind.name, _FINE, _FINE), seed)
        self.bus = Bus(self.port, self.clock, 1_000_000, latency_s=1e-3)  # type: ignore[arg-type]
        self.port.kind = kind
        self.chance = random.Random(seed + 1)
        self.last: dict[tuple[int, int], int] = {}

    def step(self) -> None:
        chance = self.chance
        if chance.random() < 0.2:
            self.clock.sleep(chance.random() ** 3 * 0.03)
        self.tally.calls += 1
        begin = self.clock.now()
        try:
            self._call(chance.random(), chance.choice(_IDS), chance.choice(list(_ITEMS.values())), begin)
        except StatusError:
            self._count_wrong("misled")
        except DeviceError:
            self.tally.failed += 1
        self.tally.instructions = self.bus.counts.instructions

    def cycle(self, number: int) -> None:
        """One cycle of a control loop: a measurement of all, and a goal for all."""
        self.clock.sleep((0.0, 0.001, 0.005)[number % 3])
        self.tally.calls += 1
        self._read_clocks(fast=number % 1000 < 500)
        self.bus.sync_write(ct.ITEMS["Goal Position"], dict.fromkeys(_IDS, 5))
        self.tally.instructions = self.bus.counts.instructions

    def _call(self, draw: float, dxl_id: int, item: Item, begin: float) -> None:
        if draw < 0.35:
            self._judge(dxl_id, item, self.bus.read(dxl_id, item), begin)
        elif draw < 0.42:
            self._judge_clock(self.bus.read(dxl_id, ct.ITEMS["Realtime Tick"]), begin)
        elif draw < 0.60:
            self._write(dxl_id, item, begin)
        elif draw < 0.70:
            self._write_some(item)
        elif draw < 0.95:
            self._read_some(draw, item, begin)
        else:
            answer = self.bus.ping(dxl_id)
            self.tally.values += 1
            if (answer.model_number, answer.firmware) != (1020, 44):
                self._count_wrong("wrong")

    def _read_some(self, draw: float, item: Item, begin: float) -> None:
        if draw < 0.85:
            found = self.bus.sync_read(_IDS, item, fast=draw < 0.75)
            items = dict.fromkeys(_IDS, item)
        elif draw < 0.87:
            self._read_clocks(fast=False)
            return
        else:
            items = {i: self.chance.choice(list(_ITEMS.values())) for i in _IDS}
            found = self.bus.bulk_read(items)
        self._count_failed(found.errors.values())
        for i, value in found.values.items():
            self._judge(i, items[i], value, begin)

    def _read_clocks(self, *, fast: bool) -> None:
        begin = self.clock.now()
        clocks = self.bus.sync_read(_IDS, ct.ITEMS["Realtime Tick"], fast=fast)
        self._count_failed(clocks.errors.values())
        for value in clocks.values.values():
            self._judge_clock(value, begin)

    def _write_some(self, item: Item) -> None:
        ids = self.chance.sample(_IDS, self.chance.randint(1, 3))
        self.bus.sync_write(item, {i: self._value(item) for i in ids})
        for i in ids:
            self.last.pop((i, item.address), None)  # servos do not confirm it

    def _write(self, dxl_id: int, item: Item, begin: float) -> None:
        value = self._value(item)
        self.last.pop((dxl_id, item.address), None)
        refused = self.chance.random() < 0.02
        if refused:
            value |= _REFUSED << (8 * item.size - 16)
        try:
            self.bus.write(dxl_id, item, value)
        except StatusError:
            if not refused:
                self._count_wrong("misled")
            return
        if refused:
            self._count_wrong("misled")
            return
        if value not in self.port.written(dxl_id, item.address, begin):
            self._count_wrong("unconfirmed")
        self.last[dxl_id, item.address] = value

    def _value(self, item: Item) -> int:
        if item.size == 4 and self.chance.random() < 0.1:
            return _HEADER_LIKE
        return self.chance.randrange(1 << (8 * item.size - 2))

    def _judge(self, dxl_id: int, item: Item, value: int, begin: float) -> None:
        self.tally.values += 1
        if value not in self.port.held(dxl_id, item.address, begin):
            self._count_wrong("wrong")
        elif value != self.last.get((dxl_id, item.address), value):
            self.tally.undone += 1
            self.last[dxl_id, item.address] = value

    def _judge_clock(self, value: int, begin: float) -> None:
        """Realtime Tick goes round after 32.8 s."""
        self.tally.clock_values += 1
        age_ms = (int(begin * 1000) - value) % 32768
        self.tally.old += _FRESH_S * 1000 < age_ms < 16384
        if 1000 < age_ms < 16384:
            self._count_wrong("wrong")

    def _count_failed(self, errors: Iterable[DeviceError]) -> None:
        kinds = {type(error) for error in errors}
        self.tally.failed += bool(kinds)
        if StatusError in kinds:
            self._count_wrong("misled")

    def _count_wrong(self, what: str) -> None:
        told = self.port.let_through_s
        if told and self.clock.now() - told[-1] < _TELLING_S:
            what = "let_through"
        setattr(self.tally, what, getattr(self.tally, what) + 1)


def talk(kind: Kind, seed: int, instructions: int, weather: Sequence[Kind] = ()) -> Tally:
    """Exchange so many instructions over a wire of a kind, all chance from the seed.

    `weather`: kinds of which every 200th step chooses another one.
    """
    talking = _Talk(kind, seed)
    while talking.tally.instructions < instructions:
        if weather and talking.tally.calls % 200 == 0:
            talking.port.kind = talking.chance.choice(weather)
        talking.step()
    talking.tally.damaged_packets_let_through = len(talking.port.let_through_s)
    return talking.tally


def loop(kind: Kind, seed: int, instructions: int) -> Tally:
    """The same with a control loop, in which only the age of what is measured is judged."""
    looping = _Talk(kind, seed)
    number = 0
    while looping.tally.instructions < instructions:
        looping.cycle(number)
        number += 1
    return looping.tally
