"""One instruction and what comes back, through the vendor's SDK. Between `bus` and the port.

Nothing here is repeated and nothing raised but the port's own errors: an answer is a status packet, or it is
`Lost`. What a loss means, and whether to ask again, is for the `bus`.
"""

from collections.abc import Mapping, Sequence
from enum import Enum

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS
from serial.serialutil import SerialBase

from palpate.drivers.dynamixel.counts import BusCounts
from palpate.drivers.dynamixel.late_answers import LateAnswers, Question
from palpate.drivers.dynamixel.packet import (
    ALERT_BIT,
    BROADCAST_ID,
    Instruction,
    StatusErrorCode,
    StatusPacket,
    parse_fast_status,
)
from palpate.drivers.dynamixel.sdk import ClockedPortHandler, StuffingPacketHandler
from palpate.drivers.dynamixel.timing import LONGEST_RETURN_DELAY_S, Timing, fast_frame_size
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import wire_time_s

__all__ = ["Block", "Exchange", "Lost"]

Block = tuple[int, int]
"""First address and number of bytes of a part of the control table."""

_STATUS_SIZE = 11  # bytes of a status packet without parameters
_ID, _ERROR, _PARAMS = 4, 8, 9  # where the SDK's packet lists have them
_PING_SLOT_S = 3e-3  # the SDK allows as much for each ID when all servos answer one ping
_LARGEST_READ = 256
_SILENT_BYTES = 3  # a wire with nothing on it for so many byte times is free
_SILENCE_LOOKS = 500  # one that never is, is full of noise, and CRCs have to deal with it

_PINGING: Question = (Instruction.PING, b"")


class Lost(Enum):
    """Why there is no answer."""

    SILENT = "nothing came"
    DAMAGED = "what came was broken"


class Exchange:
    """The port, the SDK's handlers on it, and how long each servo may take to answer."""

    def __init__(self, port: SerialBase, clock: Clock, timing: Timing, counts: BusCounts) -> None:
        self._port = port
        self._clock = clock
        self._timing = timing
        self._counts = counts
        self._packets = StuffingPacketHandler()
        self._handler = ClockedPortHandler(port, clock, timing)
        self._delays_s: dict[int, float] = {}
        self._heard = False
        self._late = LateAnswers(timing.quiet_s)
        self._handler.openPort()

    def set_return_delay(self, dxl_id: int, seconds: float) -> None:
        """Note how long a servo waits before it answers; the longest possible is assumed otherwise."""
        self._delays_s[dxl_id] = seconds

    def release(self) -> None:
        """Make the SDK's handler usable again after whatever interrupted it."""
        self._handler.is_using = False

    def tell(self, dxl_id: int, instruction: int, params: bytes = b"") -> None:
        """Send an instruction that is not answered."""
        self._send(dxl_id, instruction, params)
        self._late.outdate()

    def ask(
        self, dxl_id: int, instruction: int, params: bytes = b"", size: int = 0, *, patient: bool = False
    ) -> StatusPacket | Lost:
        """Send an instruction and wait for the servo's answer with `size` bytes of parameters.

        `patient`: wait for a late answer, too, that of an earlier try at the same question included.
        """
        question = (instruction, params)
        self._let_late_answers_pass({dxl_id: question})
        self._send(dxl_id, instruction, params)
        self._expect(_STATUS_SIZE + size, self._delay_s([dxl_id]) + self._patience_s(patient))
        while True:
            answer = self._receive()
            if isinstance(answer, Lost):
                if answer is Lost.SILENT:
                    self._may_be_late(dxl_id, question)
                return answer
            if answer.dxl_id != dxl_id:
                if self._handler.isPacketTimeout():  # somebody else on the wire may go on talking for ever
                    self._may_be_late(dxl_id, question)
                    return Lost.SILENT
                continue
            if not _fits(answer, size):
                self._may_be_late(dxl_id, None)  # that was the answer to something else
                return Lost.DAMAGED
            self._let_second_answers_pass({dxl_id: (0, size)})
            return answer

    def ask_group(
        self, blocks: Mapping[int, Block], *, patient: bool = False
    ) -> dict[int, StatusPacket | Lost]:
        """Read a block of each servo with one sync read, or one bulk read if the blocks differ.

        The result is in the order in which they were asked. After the first that stays silent nobody is
        waited for: where the servos wait for each other, all behind it are silent, too.
        """
        self._let_late_answers_pass({dxl_id: _reading(block) for dxl_id, block in blocks.items()})
        self._send_group(blocks, Instruction.SYNC_READ, Instruction.BULK_READ)
        found: dict[int, StatusPacket | Lost] = dict.fromkeys(blocks, Lost.SILENT)
        waiting = dict(blocks)
        awaited = len(waiting) + 1
        while waiting:
            nearest = next(iter(waiting))
            if len(waiting) < awaited:  # only an answer that was asked for gives the next one its time
                awaited = len(waiting)
                delay = self._delay_s([nearest]) + self._patience_s(patient)
                self._expect(_STATUS_SIZE + blocks[nearest][1], delay)
            elif self._handler.isPacketTimeout():
                break
            answer = self._receive()
            if answer is Lost.DAMAGED:
                found[nearest] = answer  # the next in order, as likely as not; if not, it is asked again
                del waiting[nearest]
            elif isinstance(answer, Lost):
                break
            elif not isinstance(found.get(answer.dxl_id), Lost):
                continue  # not asked, or twice
            elif _fits(answer, blocks[answer.dxl_id][1]):
                found[answer.dxl_id] = answer
                waiting.pop(answer.dxl_id, None)
            else:
                self._may_be_late(answer.dxl_id, None)  # that was the answer to something else
        for place, dxl_id in enumerate(waiting):
            self._may_be_late(dxl_id, _reading(blocks[dxl_id]), hidden=place > 0)
        self._let_second_answers_pass({i: blocks[i] for i, a in found.items() if isinstance(a, StatusPacket)})
        return found

    def ask_group_fast(self, blocks: Mapping[int, Block]) -> dict[int, StatusPacket | Lost]:
        """The same with a fast read: one answer, made by all servos in turn, with a CRC after each part."""
        self._let_late_answers_pass({dxl_id: _reading(block) for dxl_id, block in blocks.items()})
        self._send_group(blocks, Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
        sizes = [size for _, size in blocks.values()]
        self._expect(fast_frame_size(sizes), self._delay_s(list(blocks)))
        frame, _ = self._packets.rxPacket(self._handler, True)
        self._heard = True
        parts = parse_fast_status(bytes(frame), sizes)
        found: dict[int, StatusPacket | Lost] = dict.fromkeys(
            blocks, Lost.SILENT if not frame else Lost.DAMAGED
        )
        for dxl_id, part in zip(blocks, parts, strict=True):
            if part is not None and part.dxl_id == dxl_id:
                found[dxl_id] = StatusPacket(dxl_id, part.error, part.params)
            elif not frame:
                self._may_be_late(dxl_id, _reading(blocks[dxl_id]))
        return found

    def ping_all(self, wanted: Sequence[int]) -> list[StatusPacket]:
        """One ping to all: the answers until all `wanted` are there, or the highest of them is overdue."""
        self._let_late_answers_pass(dict.fromkeys(wanted, _PINGING))
        self._send(BROADCAST_ID, Instruction.PING, b"")
        found: list[StatusPacket] = []
        missing = set(wanted)
        awaited = len(missing) + 1
        while missing:
            if len(missing) < awaited:
                awaited = len(missing)
                slots = max(missing) + 1 - (found[-1].dxl_id if found else 0)
                self._expect(_STATUS_SIZE + 3, max(slots, 1) * _PING_SLOT_S + LONGEST_RETURN_DELAY_S)
            elif self._handler.isPacketTimeout():
                break
            answer = self._receive()
            if answer is Lost.SILENT:
                break
            if answer is Lost.DAMAGED:
                self._counts.lost(silent=False)
            elif isinstance(answer, StatusPacket):
                found.append(answer)
                missing.discard(answer.dxl_id)
        for dxl_id in missing:
            self._may_be_late(dxl_id, _PINGING)
        return found

    def _send(self, dxl_id: int, instruction: int, params: bytes) -> None:
        self._wait_for_silence()
        length = len(params) + 3
        head = [0, 0, 0, 0, dxl_id, length & 0xFF, length >> 8, int(instruction)]
        self._handler.is_using = False
        result = self._packets.txPacket(self._handler, [*head, *params, 0, 0])
        self._handler.is_using = False
        if result != COMM_SUCCESS:
            raise OSError(self._packets.getTxRxResult(result))
        self._counts.instructions += 1

    def _wait_for_silence(self) -> None:
        """Let whoever speaks finish, and drop what is heard meanwhile.

        The wire is half duplex, and an answer that comes twice must not be believed to answer the next
        question.
        """
        if not self._heard:
            return
        self._heard = False
        for _ in range(_SILENCE_LOOKS):
            self._clock.sleep(wire_time_s(_SILENT_BYTES, self._timing.baudrate))
            waiting = self._handler.getBytesAvailable()
            if not waiting:
                return
            self._port.read(waiting)

    def _send_group(self, blocks: Mapping[int, Block], sync: Instruction, bulk: Instruction) -> None:
        if len(set(blocks.values())) == 1:
            address, size = next(iter(blocks.values()))
            self._send(BROADCAST_ID, sync, _words(address, size) + bytes(blocks))
        else:
            params = b"".join(bytes([dxl_id]) + _words(*block) for dxl_id, block in blocks.items())
            self._send(BROADCAST_ID, bulk, params)

    def _receive(self) -> StatusPacket | Lost:
        packet, result = self._packets.rxPacket(self._handler, False)
        self._heard = True
        if result == COMM_SUCCESS:
            # an instruction that reached the servo damaged is as good as a damaged answer: nothing was done
            if packet[_ERROR] & ~ALERT_BIT == StatusErrorCode.CRC_ERROR:
                return Lost.DAMAGED
            return StatusPacket(packet[_ID], packet[_ERROR], bytes(packet[_PARAMS:-2]))
        return Lost.SILENT if result == COMM_RX_TIMEOUT else Lost.DAMAGED

    def _expect(self, size: int, return_delay_s: float) -> None:
        self._handler.return_delay_s = return_delay_s
        self._handler.setPacketTimeout(size)

    def _patience_s(self, patient: bool) -> float:
        return self._timing.quiet_s if patient else 0.0

    def _delay_s(self, dxl_ids: Sequence[int]) -> float:
        return max(self._delays_s.get(dxl_id, LONGEST_RETURN_DELAY_S) for dxl_id in dxl_ids)

    def _may_be_late(self, dxl_id: int, question: Question | None, *, hidden: bool = False) -> None:
        self._late.expect(dxl_id, question, self._clock.now(), hidden=hidden)

    def _let_late_answers_pass(self, questions: Mapping[int, Question]) -> None:
        """Wait where a late answer could be taken for the answer to one of these questions, and drop it."""
        self._drop_until(self._late.clear_at(questions, self._clock.now()))

    def _let_second_answers_pass(self, answered: Mapping[int, Block]) -> None:
        """Where a servo was asked again and has answered, drop its answer to the other try.

        Otherwise that one would be believed to answer the next try, and so on, always one behind.
        """
        again = self._late.pending(answered, self._clock.now())
        if again:
            size = _STATUS_SIZE + max(answered[dxl_id][1] for dxl_id in again)
            self._drop_until(self._clock.now() + self._timing.timeout_s(0, size, self._delay_s(again)))
            self._late.renew(again, self._clock.now())

    def _drop_until(self, instant: float) -> None:
        while self._clock.now() < instant:
            self._port.read(_LARGEST_READ)


def _fits(answer: StatusPacket, size: int) -> bool:
    return answer.error_number != 0 or len(answer.params) == size


def _reading(block: Block) -> Question:
    return Instruction.READ, _words(*block)


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)
