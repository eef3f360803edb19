"""State traffic: servo states found in recorded bytes of a bus, without a port.

Pairs each group read of state blocks (`state`) with its answer. Sans-IO: fed with what was sent and
received, in the order of the recording.
"""

import struct
from collections.abc import Iterator, Mapping

from palpate.drivers.dynamixel.models import Model
from palpate.drivers.dynamixel.packet import (
    Instruction,
    InstructionPacket,
    Parser,
    StatusPacket,
    parse_fast_status,
)
from palpate.drivers.dynamixel.state import STATE_BYTES, ServoState, state_in

__all__ = ["StateTraffic"]

_GROUP = struct.Struct("<HH")  # address and length, before the IDs
_FAST_BLOCK = 4 + STATE_BYTES
_FAST_HEAD = 8


class StateTraffic:
    """Finds states of servos, whose models are given by their IDs, in the traffic of one bus."""

    def __init__(self, models: Mapping[int, Model]) -> None:
        self._models = models
        self._sent, self._received = Parser(), Parser()
        self._asked: tuple[int, ...] = ()
        self._is_fast = False
        self._answer = bytearray()

    def sent(self, data: bytes) -> None:
        """What the host has sent."""
        for packet in self._sent.feed(data):
            if isinstance(packet, InstructionPacket):
                self._begin(packet)

    def received(self, data: bytes) -> Iterator[tuple[int, ServoState]]:
        """What the host has received: ID and state of every servo whose answer is whole with it."""
        if not self._asked:
            return
        if not self._is_fast:
            for packet in self._received.feed(data):
                if isinstance(packet, StatusPacket):
                    yield from self._state(packet)
            return
        self._answer += data
        if len(self._answer) >= _FAST_HEAD + _FAST_BLOCK * len(self._asked):
            blocks = parse_fast_status(bytes(self._answer), [STATE_BYTES] * len(self._asked))
            self._answer.clear()
            for block in blocks:
                if block is not None:
                    yield from self._state(block)

    def _begin(self, packet: InstructionPacket) -> None:
        """What is answered next."""
        self._received.reset()
        self._answer.clear()
        self._is_fast = packet.instruction == Instruction.FAST_SYNC_READ
        is_group = self._is_fast or packet.instruction == Instruction.SYNC_READ
        self._asked = ()
        if is_group and len(packet.params) >= _GROUP.size:
            _, length = _GROUP.unpack_from(packet.params)
            if length == STATE_BYTES:
                self._asked = tuple(packet.params[_GROUP.size :])

    def _state(self, packet: StatusPacket) -> Iterator[tuple[int, ServoState]]:
        model = self._models.get(packet.dxl_id)
        if model is None or packet.dxl_id not in self._asked or packet.error_number:
            return
        state = state_in(model, packet.params)
        if state is not None:
            yield packet.dxl_id, state
