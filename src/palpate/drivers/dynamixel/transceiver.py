"""Transactions: one instruction and its answer, through the vendor's SDK; counts of losses.

Nothing here is repeated and nothing raised but the port's own errors: an answer is a status packet, or it is
`Lost`, or a `SizeMismatch`. The `bus` decides what a loss means, and whether to repeat a request.
`BusCounts` are the statistics of a bad wire; `rig` shows them.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS
from serial.serialutil import SerialBase

from palpate.drivers.dynamixel.exchanges import (
    ACK_PARAMS,
    LONGEST_RETURN_DELAY_S,
    PING_PARAMS,
    PendingAnswers,
    Query,
    TableBlock,
    Timing,
    fast_frame_size,
    queries,
)
from palpate.drivers.dynamixel.packet import (
    ALERT_BIT,
    BROADCAST_ID,
    Instruction,
    StatusErrorCode,
    StatusPacket,
    parse_fast_status,
)
from palpate.drivers.dynamixel.sdk import ClockedPortHandler, StuffingPacketHandler
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import wire_time_s


@dataclass(slots=True)
class BusCounts:
    """Counts of events since the port was opened.

    `instructions`: packets sent. `silent`: answers that did not come in time. `damaged`: answers that came
    broken. `retries`: instructions that were sent once more because of it. `alerts`: answers of servos that
    report a hardware error. `reconnects`: ports opened again. `stale`: answers that came late or twice and
    were dropped, because they answered what had been asked before.
    """

    instructions: int = 0
    silent: int = 0
    damaged: int = 0
    retries: int = 0
    alerts: int = 0
    reconnects: int = 0
    stale: int = 0

    def count_loss(self, *, silent: bool) -> None:
        """Count an answer that did not come, or came broken."""
        if silent:
            self.silent += 1
        else:
            self.damaged += 1

    def as_dict(self) -> dict[str, int]:
        """The numbers by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


_STATUS_BYTES = 11  # bytes of a status packet without parameters
_ID_INDEX, _ERROR_INDEX, _PARAMS_INDEX = 4, 8, 9  # where the SDK's packet lists have them
_PING_SLOT_S = 3e-3  # the SDK allows as much for each ID when all servos answer one ping
_MAX_READ_BYTES = 256
_SILENT_BYTES = 3  # a wire with nothing on it for so many byte times is free
_MAX_WIDTHS, _MAX_WIDTHS_TROUBLED = 2, 24  # lengths of answers that the same question takes in turn
_MAX_SILENCE_CHECKS = 500  # one that never is, is full of noise, and CRCs have to deal with it


class Lost(Enum):
    """Why there is no answer."""

    SILENT = "nothing came"
    LATE = "answers came to what was asked before, none to this"
    DAMAGED = "what came was broken"


@dataclass(frozen=True, slots=True)
class SizeMismatch:
    """An answer of another length than asked for, and not to anything that was asked before."""

    size: int
    wanted: int


Loss = Lost | SizeMismatch


def combine_losses(before: Loss | None, loss: Loss) -> Loss:
    """Combine two tries at one question: an answer after silence is late rather than misfit."""
    return Lost.LATE if isinstance(loss, SizeMismatch) and before in (Lost.SILENT, Lost.LATE) else loss


class Transceiver:
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
        self._pending = PendingAnswers(timing.horizon_s)
        self._troubled_until_s = 0.0
        self._handler.openPort()

    def set_return_delay(self, dxl_id: int, seconds: float) -> None:
        """Note how long a servo waits before it answers; the longest possible is assumed otherwise."""
        self._delays_s[dxl_id] = seconds

    def release(self) -> None:
        """Make the SDK's handler usable again after whatever interrupted it."""
        self._handler.is_using = False

    def wider(self, blocks: Mapping[int, TableBlock], *, fast: bool = False) -> Mapping[int, TableBlock]:
        """Blocks to read instead of `blocks`, so that no other answer can be taken for theirs.

        The same question takes lengths in turn, more of them while answers get lost or come late or twice.
        Where no length is free it waits until one is.
        """
        now = self._clock.now()
        variants = _MAX_WIDTHS_TROUBLED if now < self._troubled_until_s else _MAX_WIDTHS
        found = self._pending.wider(blocks, now, variants=variants, fast=fast)
        if found is None:
            self.settle([BROADCAST_ID] if fast else blocks)
            return blocks
        return found

    def may_be_stale(self, dxl_id: int, size: int = ACK_PARAMS) -> bool:
        """True if an answer of this length may be to something that was asked before."""
        return self._pending.expects(dxl_id, size, self._clock.now())

    def settle(self, dxl_ids: Iterable[int]) -> None:
        """Wait until nothing that servos were asked before can be answered any more, and drop what comes."""
        instant = max(self._pending.clear_at(dxl_id) for dxl_id in dxl_ids)
        while self._clock.now() < instant:
            self._port.read(_MAX_READ_BYTES)

    def tell(self, dxl_id: int, params: bytes, written: TableBlock) -> None:
        """Write without waiting for a confirmation, which may come; to one servo or all (`BROADCAST_ID`)."""
        self._send(dxl_id, Instruction.WRITE, params)
        self._pending.outdate(None if dxl_id == BROADCAST_ID else [dxl_id], written)
        if dxl_id != BROADCAST_ID:
            self._note({(dxl_id, ACK_PARAMS): None})

    def tell_group(self, dxl_ids: Collection[int], params: bytes, written: TableBlock) -> None:
        """Send a sync write, which is not confirmed."""
        self._send(BROADCAST_ID, Instruction.SYNC_WRITE, params)
        self._pending.outdate(dxl_ids, written)

    def read(self, dxl_id: int, block: TableBlock, *, patient: bool = False) -> StatusPacket | Loss:
        """Read a block of one servo."""
        self._note(queries({dxl_id: block}))
        return self._ask(dxl_id, Instruction.READ, _words(*block), block[1], patient)

    def ping(self, dxl_id: int, *, patient: bool = False) -> StatusPacket | Loss:
        """Ping one servo."""
        self._note({(dxl_id, PING_PARAMS): None})
        return self._ask(dxl_id, Instruction.PING, b"", PING_PARAMS, patient)

    def change(
        self, dxl_id: int, instruction: int, params: bytes, written: TableBlock, *, patient: bool = False
    ) -> StatusPacket | Loss:
        """Send an instruction that changes a servo, and wait for its confirmation.

        All confirmations are alike: this may be an earlier one's if `may_be_stale` said so before.
        """
        self._pending.outdate([dxl_id], written)
        self._note({(dxl_id, ACK_PARAMS): None})
        return self._ask(dxl_id, instruction, params, ACK_PARAMS, patient)

    def _ask(
        self, dxl_id: int, instruction: int, params: bytes, size: int, patient: bool
    ) -> StatusPacket | Loss:
        """The servo's answer with `size` bytes of parameters, or a refusal without any.

        `patient`: wait for a late answer, too, that of an earlier try at the same question included.
        """
        self._send(dxl_id, instruction, params)
        self._expect(_STATUS_BYTES + size, self._delay_s([dxl_id]) + self._patience_s(patient))
        lost = Lost.SILENT
        while True:
            answer = self._receive()
            if isinstance(answer, Lost):
                return lost if answer is Lost.SILENT else answer
            if answer.dxl_id == dxl_id:
                if _fits(answer, size):
                    return answer
                if not self._is_stale(answer):
                    return SizeMismatch(len(answer.params), size)
                lost = Lost.LATE
            if self._handler.isPacketTimeout():  # somebody else on the wire may go on talking for ever
                return lost

    def read_group(
        self, blocks: Mapping[int, TableBlock], *, patient: bool = False
    ) -> dict[int, StatusPacket | Loss]:
        """Read a block of each servo with one sync read, or one bulk read if the blocks differ.

        The result is in the order in which they were asked. After the first that stays silent none is
        waited for: where the servos wait for each other, all behind it are silent, too. `patient`: as long as
        none has answered. If one has, it is not the computer that is late.
        """
        self._note(queries(blocks))
        self._send_group(blocks, Instruction.SYNC_READ, Instruction.BULK_READ)
        found: dict[int, StatusPacket | Loss] = dict.fromkeys(blocks, Lost.SILENT)
        waiting = dict(blocks)
        awaited = len(waiting) + 1
        while waiting:
            nearest = next(iter(waiting))
            if len(waiting) < awaited:  # only an answer that was asked for gives the next one its time
                awaited = len(waiting)
                none_answered = len(waiting) == len(blocks)
                delay = self._delay_s([nearest]) + self._patience_s(patient and none_answered)
                self._expect(_STATUS_BYTES + blocks[nearest][1], delay)
            elif self._handler.isPacketTimeout():
                break
            answer = self._receive()
            if answer is Lost.DAMAGED:
                found[nearest] = answer  # the next in order, as likely as not; if not, it is asked again
                del waiting[nearest]
            elif isinstance(answer, Lost):
                break
            elif isinstance(found.get(answer.dxl_id), Lost):  # otherwise not asked, or answered already
                found[answer.dxl_id] = self._judge(answer, blocks[answer.dxl_id][1])
                if found[answer.dxl_id] is not Lost.LATE:
                    waiting.pop(answer.dxl_id, None)
        return found

    def read_group_fast(self, blocks: Mapping[int, TableBlock]) -> dict[int, StatusPacket | Loss]:
        """The same with a fast read: one answer, made by all servos in turn, with a CRC after each part."""
        self._note(queries(blocks, fast=True))
        self._send_group(blocks, Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
        sizes = [size for _, size in blocks.values()]
        self._expect(fast_frame_size(sizes), self._delay_s(list(blocks)))
        while True:
            frame, result = self._packets.rxPacket(self._handler, True)
            self._heard = True
            parts = parse_fast_status(bytes(frame), sizes)
            # a whole packet that has nothing of what was asked for is the answer to something else
            if any(parts) or result != COMM_SUCCESS or self._handler.isPacketTimeout():
                break
            self._counts.stale += 1
            self._note_trouble()
        if result != COMM_SUCCESS:
            self._note_trouble()
        lost = Lost.DAMAGED if frame else Lost.SILENT
        return {
            dxl_id: part if part is not None and part.dxl_id == dxl_id else lost
            for dxl_id, part in zip(blocks, parts, strict=True)
        }

    def broadcast_ping(self, wanted: Sequence[int]) -> list[StatusPacket]:
        """One ping to all: the answers until all `wanted` are there, or the highest of them is overdue."""
        self._note({(dxl_id, PING_PARAMS): None for dxl_id in wanted})
        self._send(BROADCAST_ID, Instruction.PING, b"")
        found: list[StatusPacket] = []
        missing = set(wanted)
        awaited = len(missing) + 1
        while missing:
            if len(missing) < awaited:
                awaited = len(missing)
                slots = max(missing) + 1 - (found[-1].dxl_id if found else 0)
                self._expect(_STATUS_BYTES + 3, max(slots, 1) * _PING_SLOT_S + LONGEST_RETURN_DELAY_S)
            elif self._handler.isPacketTimeout():
                break
            answer = self._receive()
            if answer is Lost.SILENT:
                break
            if answer is Lost.DAMAGED:
                self._counts.count_loss(silent=False)
            elif isinstance(answer, StatusPacket):
                found.append(answer)
                missing.discard(answer.dxl_id)
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
        if self._handler.dropped:
            self._note_trouble()
        self._counts.instructions += 1

    def _wait_for_silence(self) -> None:
        """Let whoever speaks finish, and drop what is heard meanwhile.

        The wire is half duplex, and an answer that comes twice must not be believed to answer the next
        question.
        """
        if not self._heard:
            return
        self._heard = False
        for _ in range(_MAX_SILENCE_CHECKS):
            self._clock.sleep(wire_time_s(_SILENT_BYTES, self._timing.baudrate))
            waiting = self._handler.getBytesAvailable()
            if not waiting:
                return
            self._port.read(waiting)
            self._note_trouble()

    def _send_group(self, blocks: Mapping[int, TableBlock], sync: Instruction, bulk: Instruction) -> None:
        if len(set(blocks.values())) == 1:
            address, size = next(iter(blocks.values()))
            self._send(BROADCAST_ID, sync, _words(address, size) + bytes(blocks))
        else:
            params = b"".join(bytes([dxl_id]) + _words(*block) for dxl_id, block in blocks.items())
            self._send(BROADCAST_ID, bulk, params)

    def _receive(self) -> StatusPacket | Lost:
        packet, result = self._packets.rxPacket(self._handler, False)
        self._heard = True
        if result != COMM_SUCCESS:
            self._note_trouble()
        else:
            # an instruction that reached the servo damaged is as good as a damaged answer: nothing was done
            if packet[_ERROR_INDEX] & ~ALERT_BIT == StatusErrorCode.CRC_ERROR:
                return Lost.DAMAGED
            return StatusPacket(packet[_ID_INDEX], packet[_ERROR_INDEX], bytes(packet[_PARAMS_INDEX:-2]))
        return Lost.SILENT if result == COMM_RX_TIMEOUT else Lost.DAMAGED

    def _expect(self, size: int, return_delay_s: float) -> None:
        self._handler.return_delay_s = return_delay_s
        self._handler.setPacketTimeout(size)

    def _patience_s(self, patient: bool) -> float:
        return max(0.0, self._timing.patience_s - self._timing.latency_s) if patient else 0.0

    def _delay_s(self, dxl_ids: Sequence[int]) -> float:
        return max(self._delays_s.get(dxl_id, LONGEST_RETURN_DELAY_S) for dxl_id in dxl_ids)

    def _note(self, asked: Mapping[tuple[int, int], Query | None]) -> None:
        now = self._clock.now()
        for (dxl_id, size), question in asked.items():
            self._pending.note(dxl_id, size, question, now)

    def _note_trouble(self) -> None:
        self._troubled_until_s = self._clock.now() + self._timing.horizon_s

    def _judge(self, answer: StatusPacket, size: int) -> StatusPacket | Loss:
        if _fits(answer, size):
            return answer
        return Lost.LATE if self._is_stale(answer) else SizeMismatch(len(answer.params), size)

    def _is_stale(self, answer: StatusPacket) -> bool:
        """True if an answer that does not fit is to something that was asked before; counted."""
        stale = self.may_be_stale(answer.dxl_id, len(answer.params))
        self._counts.stale += stale
        self._note_trouble()
        return stale


def _fits(answer: StatusPacket, size: int) -> bool:
    """True if it is an answer with `size` bytes, or a refusal, which has none; no servo refuses a ping."""
    return len(answer.params) == (ACK_PARAMS if answer.error_number and size != PING_PARAMS else size)


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)
