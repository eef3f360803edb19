"""A wire of servos that flips, loses, cuts, delays and repeats, quick enough for millions of instructions.

`SpoilingPort` is a serial port in virtual time with three servos behind it that are nothing but their memory:
bytes in, bytes out, by Protocol 2.0. It remembers what every register held when, so that what the host was
told can be judged, and it knows which packets reached somebody damaged and whole all the same.

What is handed over at once arrives at once, when its last bit does. A packet that is late holds up those
behind it, as on a computer that is busy; a copy that is late comes when it comes.
"""

import heapq
import random
from bisect import bisect_right
from dataclasses import dataclass
from itertools import count

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

__all__ = ["REGISTERS", "Kind", "Spoil", "SpoilingPort"]

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
