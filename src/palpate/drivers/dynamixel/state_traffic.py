"""State traffic: servo states found in recorded bytes of a bus, without a port.

Pairs each group read whose blocks hold a state (`state`) with its answer. Sans-IO: fed with what was sent and
received, in the order of the recording.
"""

import struct
from collections.abc import Iterator, Mapping

from palpate.drivers.dynamixel.models import Model, model_named
from palpate.drivers.dynamixel.packet import (
    Instruction,
    InstructionPacket,
    Parser,
    StatusPacket,
    parse_fast_status,
)
from palpate.drivers.dynamixel.pending import Block, part
from palpate.drivers.dynamixel.state import STATE_BYTES, ServoState, state_in
from palpate.drivers.dynamixel.turn_mark import mark_item, turns_in

__all__ = ["StateTraffic"]

_SYNC = struct.Struct("<HH")  # address and length, before the IDs
_BULK = struct.Struct("<BHH")  # ID, address and length of each
_PING = struct.Struct("<HB")  # model number and firmware
_WORD = struct.Struct("<H")
_FAST_HEAD = 8
_FAST_FRAME = 4  # bytes of an answer to a fast read that come with each servo's


class StateTraffic:
    """Finds states of servos, whose models are given by their IDs, in the traffic of one bus."""

    def __init__(self, models: Mapping[int, Model]) -> None:
        self._models = dict(models)
        self._sent, self._received = Parser(), Parser()
        self._asked: Mapping[int, Block] = {}
        self._is_ping = False
        self._is_fast = False
        self._turns: dict[int, int] = {}
        self._mark: tuple[int, Block, Block] | None = None
        self._answer = bytearray()

    def sent(self, data: bytes) -> None:
        """What the host has sent."""
        for packet in self._sent.feed(data):
            if isinstance(packet, InstructionPacket):
                self._begin(packet)

    def received(self, data: bytes) -> Iterator[tuple[int, ServoState]]:
        """What the host has received: ID and state of every servo whose answer is whole with it."""
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
        if len(self._answer) >= _FAST_HEAD + sum(sizes) + _FAST_FRAME * len(sizes):
            blocks = parse_fast_status(bytes(self._answer), sizes)
            self._answer.clear()
            for block in blocks:
                if block is not None:
                    yield from self._state(block)

    def _begin(self, packet: InstructionPacket) -> None:
        """What is answered next."""
        self._received.reset()
        self._answer.clear()
        self._is_ping = packet.instruction == Instruction.PING
        self._is_fast = packet.instruction in (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
        self._asked = _asked_blocks(packet)
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
            if params[: _WORD.size] == _WORD.pack(item.address):
                self._note_mark(packet.dxl_id, params[_WORD.size :])
        elif len(params) == _SYNC.size:
            first, size = _SYNC.unpack(params)
            if first <= item.address and item.address + item.size <= first + size:
                self._mark = (packet.dxl_id, (first, size), (item.address, item.size))

    def _note_mark(self, dxl_id: int, mark: bytes) -> None:
        self._turns[dxl_id] = turns_in(int.from_bytes(mark, "little")) or 0

    def _note_read_mark(self, answer: StatusPacket) -> None:
        """The mark in an answer, which may hold more, see `pending`."""
        assert self._mark is not None
        dxl_id, wide, place = self._mark
        if answer.dxl_id == dxl_id and not answer.error_number and len(answer.params) == wide[1]:
            self._note_mark(dxl_id, part(answer.params, wide, place))

    def _note_firmware(self, answer: StatusPacket) -> None:
        """Where the state lies depends on the firmware."""
        model = self._models.get(answer.dxl_id)
        if model is None or len(answer.params) != _PING.size:
            return
        number, firmware = _PING.unpack(answer.params)
        if number == model.number:
            self._models[answer.dxl_id] = model_named(model.name, firmware)

    def _state(self, packet: StatusPacket) -> Iterator[tuple[int, ServoState]]:
        """The state in an answer; the bus asks for more than that in turn, see `pending`."""
        model, wide = self._models.get(packet.dxl_id), self._asked.get(packet.dxl_id)
        if model is None or model.indirect is None or wide is None or packet.error_number:
            return
        place = (model.indirect.data, STATE_BYTES)
        is_within = wide[0] <= place[0] and place[0] + STATE_BYTES <= wide[0] + wide[1]
        if not is_within or len(packet.params) != wide[1]:
            return
        state = state_in(model, part(packet.params, wide, place), self._turns.get(packet.dxl_id, 0))
        if state is not None:
            yield packet.dxl_id, state


def _asked_blocks(packet: InstructionPacket) -> Mapping[int, Block]:
    """The block that each servo is asked for; none if the packet is no group read."""
    params = packet.params
    if (
        packet.instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)
        and len(params) >= _SYNC.size
    ):
        first, size = _SYNC.unpack_from(params)
        return dict.fromkeys(params[_SYNC.size :], (first, size))
    if packet.instruction in (Instruction.BULK_READ, Instruction.FAST_BULK_READ):
        whole = params[: len(params) // _BULK.size * _BULK.size]
        return {dxl_id: (first, size) for dxl_id, first, size in _BULK.iter_unpack(whole)}
    return {}
