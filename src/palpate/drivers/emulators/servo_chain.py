"""Daisy chain of emulated servos on one half-duplex wire: who answers which packet, and when.

A `Device` for any wire (in process or pty), and one that knows rates. Before it looks at bytes it lets the
world's physics catch up, so that a servo is read as it stands at the instant at which the instruction came. A
packet whose CRC is wrong is answered with CRC Error by the servo whose ID stands in it. A fast read is
answered as if by one servo with ID FE (e-Manual, "DYNAMIXEL Protocol 2.0", sections Sync Read to Fast Bulk
Read):

    FF FF FD 00 | FE | LEN | 55 | ERR ID data CRC | ERR ID data CRC | …

without byte stuffing; every CRC is taken over all bytes before it, CRCs included.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    DamagedPacket,
    Instruction,
    InstructionPacket,
    Parser,
    StatusPacket,
    crc16,
    encode_status,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.wire import Emission, wire_time_s

_FAST_BLOCK = 4  # bytes of a block besides its data: ERR, ID, CRC


class ReadRequest(NamedTuple):
    """Request to read of one servo."""

    dxl_id: int
    address: int
    length: int


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """Request to write of one servo."""

    dxl_id: int
    address: int
    data: bytes


class FastFrame:
    """The answer to a fast read as it grows, servo by servo."""

    def __init__(self, lengths: Sequence[int]) -> None:
        """`lengths`: bytes that are read from each servo."""
        length = 1 + sum(lengths) + _FAST_BLOCK * len(lengths)
        self._head = b"\xff\xff\xfd\x00" + bytes((BROADCAST_ID, length & 0xFF, length >> 8 & 0xFF, 0x55))
        self._end, self._crc = b"", 0  # CRC that was sent last, and that of all before it

    def part(self, answer: StatusPacket) -> bytes:
        """The bytes that the next servo sends; the first one sends the head too."""
        block = self._head + bytes((answer.error, answer.dxl_id)) + answer.params
        self._head = b""
        self._crc = crc16(self._end + block, self._crc)
        self._end = self._crc.to_bytes(2, "little")
        return block + self._end


def read_requests(packet: InstructionPacket) -> list[ReadRequest]:
    """Requests of a sync, bulk or fast read, in order; none if the packet is cut short.

    In a bulk read each servo is asked once: a second request to the same ID counts for nothing.
    """
    params = packet.params
    if packet.instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
        if len(params) < 5:
            return []
        return [ReadRequest(dxl_id, _word(params, 0), _word(params, 2)) for dxl_id in params[4:]]
    asked: dict[int, ReadRequest] = {}
    for at in range(0, len(params) - 4, 5):
        request = ReadRequest(params[at], _word(params, at + 1), _word(params, at + 3))
        asked.setdefault(request.dxl_id, request)
    return list(asked.values())


def write_requests(packet: InstructionPacket) -> Iterator[WriteRequest]:
    """Requests of a sync or bulk write, up to where the packet is cut short; see `read_requests` for IDs."""
    if packet.instruction == Instruction.SYNC_WRITE:
        yield from _sync_writes(packet.params)
        return
    seen: set[int] = set()
    params, at = packet.params, 0
    while at + 5 <= len(params):
        length = _word(params, at + 3)
        if at + 5 + length > len(params):
            return
        if params[at] not in seen:
            yield WriteRequest(params[at], _word(params, at + 1), params[at + 5 : at + 5 + length])
        seen.add(params[at])
        at += 5 + length


def _sync_writes(params: bytes) -> Iterator[WriteRequest]:
    if len(params) < 5:
        return
    address, length = _word(params, 0), _word(params, 2)
    for at in range(4, len(params) - length, length + 1):
        yield WriteRequest(params[at], address, params[at + 1 : at + 1 + length])


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


_BYTE_GAP_S = 0.0015  # e-Manual, "Byte to Byte Time": a packet interrupted for longer is given up
# Where only the arrival of bytes is known, not that the wire was silent before, a busy computer may be to
# blame for a gap. Up to this long it is forgiven.
_UNSEEN_GAP_S = 0.02
_RATE_MARGIN = 0.03  # e-Manual, "Baud Rate": rates off by less than 3 % are understood
_STATUS_BYTES = 11  # of a status packet besides its data


class _HalfDuplexWire:
    """The wire while one instruction is answered: `now` is when it falls free."""

    def __init__(self, now: float, baudrate: int) -> None:
        self.now = now
        self.baudrate = baudrate
        self.emissions: list[Emission] = []

    def send(self, delay_s: float, data: bytes) -> None:
        start = self.now + delay_s
        self.emissions.append((start, data))
        self.now = start + wire_time_s(len(data), self.baudrate)

    def skip(self, delay_s: float, count: int) -> None:
        self.now += delay_s + wire_time_s(count, self.baudrate)


class ServoChain:
    """Servos sharing a wire, each at its own baud rate."""

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        advance: Callable[[float], None],
        *,
        baudrate: int = 1_000_000,
        skip_missing: bool = False,
    ) -> None:
        """`advance(now)` brings the physics, and with it every servo, up to `now` (s).

        `baudrate` is the rate of bytes that come without one.
        """
        self._servos = list(servos)
        self._advance = advance
        self._baudrate = baudrate
        self._skip_missing = skip_missing
        self._parsers: dict[int, Parser] = {}
        self._last_s = 0.0

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes at the chain's usual rate; see `feed_at`."""
        return self.feed_at(data, now, self._baudrate)

    def feed_at(self, data: bytes, now: float, baudrate: int) -> list[Emission]:
        """Take bytes sent at `baudrate` whose last bit arrived at `now`; return the servos' answers.

        Servos at other rates hear noise that never parses, and that breaks a packet they were receiving.
        """
        self._advance(now)
        if now - self._last_s > _UNSEEN_GAP_S:
            self._forget_unfinished()
        self._last_s = now
        line = _HalfDuplexWire(now, baudrate)
        for rate in sorted({servo.baudrate for servo in self._servos}):
            parser = self._parsers.setdefault(rate, Parser())
            if not _is_understood(rate, baudrate):
                parser.reset()
                continue
            for packet in parser.feed(data):
                line.now = max(line.now, now)
                if isinstance(packet, InstructionPacket):
                    self._dispatch(packet, line)
                elif isinstance(packet, DamagedPacket):
                    self._answer_damaged(packet.dxl_id, line)
        return line.emissions

    def poll(self, now: float) -> list[Emission]:
        """Let the physics catch up; servos never speak unasked, and give up a packet that was interrupted."""
        self._advance(now)
        if now - self._last_s > _BYTE_GAP_S:
            self._forget_unfinished()
        return []

    def next_due(self) -> float | None:
        """Servos never speak unasked."""
        return None

    def _forget_unfinished(self) -> None:
        for parser in self._parsers.values():
            parser.reset()

    def _listening(self, baudrate: int) -> list[tuple[int, EmulatedServo]]:
        """Servos that understand the rate, in order of their IDs."""
        hearing = [s for s in self._servos if s.listening and _is_understood(s.baudrate, baudrate)]
        return sorted(((servo.dxl_id, servo) for servo in hearing), key=itemgetter(0))

    def _answer_damaged(self, dxl_id: int, line: _HalfDuplexWire) -> None:
        for own_id, servo in self._listening(line.baudrate):
            answer = servo.answer_damaged() if own_id == dxl_id else None
            if answer is not None:
                line.send(servo.return_delay_s, encode_status(answer))

    def _dispatch(self, packet: InstructionPacket, line: _HalfDuplexWire) -> None:
        listening = self._listening(line.baudrate)
        for _, servo in listening:
            servo.note_packet()
        if packet.dxl_id == BROADCAST_ID:
            self._dispatch_to_all(packet, dict(listening), line)
            return
        for _, servo in listening:
            _answer(servo, packet, line)

    def _dispatch_to_all(
        self, packet: InstructionPacket, by_id: dict[int, EmulatedServo], line: _HalfDuplexWire
    ) -> None:
        match packet.instruction:
            case Instruction.SYNC_READ | Instruction.BULK_READ:
                self._read_group(read_requests(packet), by_id, line)
            case Instruction.FAST_SYNC_READ | Instruction.FAST_BULK_READ:
                _read_fast(read_requests(packet), by_id, line)
            case Instruction.SYNC_WRITE | Instruction.BULK_WRITE:
                for request in write_requests(packet):
                    if request.dxl_id in by_id:
                        by_id[request.dxl_id].take_block(request.address, request.data)
            case Instruction.READ:
                return
            case _:
                for servo in by_id.values():
                    _answer(servo, packet, line)

    def _read_group(
        self, requests: Sequence[ReadRequest], by_id: dict[int, EmulatedServo], line: _HalfDuplexWire
    ) -> None:
        for request in requests:
            servo = by_id.get(request.dxl_id)
            answer = servo.answer_block(request.address, request.length) if servo else None
            if servo is not None and answer is not None:
                line.send(servo.return_delay_s, encode_status(answer))
            elif self._skip_missing:
                line.skip(0.0, _STATUS_BYTES + request.length)
            else:
                return


def _answer(servo: EmulatedServo, packet: InstructionPacket, line: _HalfDuplexWire) -> None:
    answer = servo.handle(packet)
    if answer is not None:
        line.send(servo.return_delay_s, encode_status(answer))


def _read_fast(
    requests: Sequence[ReadRequest], by_id: dict[int, EmulatedServo], line: _HalfDuplexWire
) -> None:
    """One frame without pauses: the manual shows it as if one servo sent it, after its return delay."""
    frame = FastFrame([request.length for request in requests])
    for k, request in enumerate(requests):
        servo = by_id.get(request.dxl_id)
        block = servo.answer_fast(request.address, request.length) if servo else None
        if servo is None or block is None:
            return
        line.send(0.0 if k else servo.return_delay_s, frame.part(block))


def _is_understood(rate: int, baudrate: int) -> bool:
    return abs(rate - baudrate) < _RATE_MARGIN * rate
