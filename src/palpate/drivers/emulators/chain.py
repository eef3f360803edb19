"""Several emulated servos on one half-duplex wire: who answers which packet, and when.

A `Device` for any wire (in process or pty), and one that knows rates. Before it looks at bytes it lets the
world's physics catch up, so that a servo is read as it stands at the instant at which the instruction came.

A packet whose CRC is wrong is answered with CRC Error by the servo whose ID stands in it. The manual lists
that error and does not say when it is sent; in no other way could a controller ever see it. Nobody answers a
damaged packet to all.

In a sync or bulk read every servo waits for the answer of the one before it. Behind a missing servo all
remain silent, unless `skip_missing` is given: then the next one answers once the missing answer's time is
over. The manual does not say which; silence is the stricter of the two readings, and hosts must cope with it.
A fast read breaks off at a missing servo either way: its CRCs go on from the servo before.
"""

from collections.abc import Callable, Sequence
from operator import itemgetter

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    DamagedPacket,
    Instruction,
    InstructionPacket,
    Parser,
    encode_status,
)
from palpate.drivers.emulators.group_packets import FastFrame, ReadRequest, read_requests, write_requests
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.wire import Emission, wire_time_s

__all__ = ["ServoChain"]

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
            if not _understood(rate, baudrate):
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
        """Those that understand the rate and their IDs, in order of these."""
        hearing = [s for s in self._servos if s.listening and _understood(s.baudrate, baudrate)]
        return sorted(((servo.dxl_id, servo) for servo in hearing), key=itemgetter(0))

    def _answer_damaged(self, dxl_id: int, line: _HalfDuplexWire) -> None:
        for own_id, servo in self._listening(line.baudrate):
            answer = servo.answer_damaged() if own_id == dxl_id else None
            if answer is not None:
                line.send(servo.return_delay_s, encode_status(answer))

    def _dispatch(self, packet: InstructionPacket, line: _HalfDuplexWire) -> None:
        listening = self._listening(line.baudrate)
        for _, servo in listening:
            servo.heard()
        if packet.dxl_id != BROADCAST_ID:
            for _, servo in listening:
                _answer(servo, packet, line)
            return
        by_id = dict(listening)
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
                for _, servo in listening:
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


def _understood(rate: int, baudrate: int) -> bool:
    return abs(rate - baudrate) < _RATE_MARGIN * rate
