"""Several emulated servos on one half-duplex wire: who answers which packet, and when.

A `Device` for any wire (in process or pty). Before it looks at bytes it lets the world's physics catch up, so
that a servo is read as it stands at the instant at which the instruction arrived.

Damaged packets are ignored, as real servos do on a shared wire (they cannot know that they were meant). In a
sync or bulk read every servo waits for the answer of the one before it: behind a missing servo all remain
silent. The manual does not say so; it is the stricter of the two readings, and hosts must cope with it.
"""

from collections.abc import Callable, Iterator, Sequence

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    Parser,
    StatusPacket,
    encode_status,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.wire import Emission, wire_time_s

__all__ = ["ServoChain"]

_PACKET_GAP_S = 0.02  # a packet interrupted for longer than this is given up


class ServoChain:
    """Servos sharing a wire."""

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        advance: Callable[[float], None],
        *,
        baudrate: int = 1_000_000,
    ) -> None:
        """`advance(now)` brings the physics, and with it every servo, up to `now` (s)."""
        self._servos = list(servos)
        self._advance = advance
        self._baudrate = baudrate
        self._parser = Parser()
        self._last_s = 0.0

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes whose last bit arrived at `now`; return the servos' answers."""
        self._advance(now)
        if now - self._last_s > _PACKET_GAP_S:
            self._parser.reset()
        self._last_s = now
        emissions: list[Emission] = []
        for packet in self._parser.feed(data):
            if isinstance(packet, InstructionPacket):
                self._dispatch(packet, now, emissions)
        return emissions

    def poll(self, now: float) -> list[Emission]:
        """Let the physics catch up; servos never speak unasked."""
        self._advance(now)
        return []

    def next_due(self) -> float | None:
        """Servos never speak unasked."""
        return None

    def _dispatch(self, packet: InstructionPacket, now: float, emissions: list[Emission]) -> None:
        listening = sorted((s for s in self._servos if s.listening), key=lambda servo: servo.dxl_id)
        for servo in listening:
            servo.heard()
        for servo, answer in self._answers(packet, listening):
            if answer is not None:
                data = encode_status(answer)
                start = now + servo.return_delay_s
                emissions.append((start, data))
                now = start + wire_time_s(len(data), self._baudrate)

    def _answers(
        self, packet: InstructionPacket, listening: list[EmulatedServo]
    ) -> Iterator[tuple[EmulatedServo, StatusPacket | None]]:
        if packet.dxl_id != BROADCAST_ID:
            for servo in listening:
                if servo.dxl_id == packet.dxl_id:
                    yield servo, servo.handle(packet)
            return
        by_id = {servo.dxl_id: servo for servo in listening}
        match packet.instruction:
            case Instruction.SYNC_READ | Instruction.BULK_READ:
                for dxl_id, address, length in _read_requests(packet):
                    reader = by_id.get(dxl_id)
                    answer = reader.answer_block(address, length) if reader else None
                    if reader is None or answer is None:
                        return
                    yield reader, answer
            case Instruction.SYNC_WRITE | Instruction.BULK_WRITE:
                for dxl_id, address, data in _write_requests(packet):
                    if dxl_id in by_id:
                        by_id[dxl_id].take_block(address, data)
            case Instruction.READ | Instruction.FAST_SYNC_READ | Instruction.FAST_BULK_READ:
                return
            case _:
                for servo in listening:
                    yield servo, servo.handle(packet)


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


def _read_requests(packet: InstructionPacket) -> list[tuple[int, int, int]]:
    """(id, address, length) of a sync or bulk read; none if the packet is cut short."""
    params = packet.params
    if packet.instruction == Instruction.SYNC_READ:
        if len(params) < 5:
            return []
        return [(dxl_id, _word(params, 0), _word(params, 2)) for dxl_id in params[4:]]
    return [(params[i], _word(params, i + 1), _word(params, i + 3)) for i in range(0, len(params) - 4, 5)]


def _write_requests(packet: InstructionPacket) -> Iterator[tuple[int, int, bytes]]:
    """(id, address, data) of a sync or bulk write, up to where the packet is cut short."""
    params = packet.params
    if packet.instruction == Instruction.SYNC_WRITE:
        if len(params) < 5:
            return
        address, length = _word(params, 0), _word(params, 2)
        for at in range(4, len(params) - length, length + 1):
            yield params[at], address, params[at + 1 : at + 1 + length]
        return
    at = 0
    while at + 5 <= len(params):
        length = _word(params, at + 3)
        if at + 5 + length > len(params):
            return
        yield params[at], _word(params, at + 1), params[at + 5 : at + 5 + length]
        at += 5 + length
