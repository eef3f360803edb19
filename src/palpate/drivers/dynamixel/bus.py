"""Bus of Dynamixel servos: access to control table items by servo id, with errors that name the servo.

Above: `servo` and `servo_state`, in physical units. Below: `transceiver`, the vendor's SDK and a port. A
servo that gives no answer is always an error, never a default value. What was lost or damaged is asked again,
and counted. One exchange is finished before another thread's begins.

In a sync or bulk read servos answer one after another. Where one is missing, those behind it may wait for it
for ever (the e-Manual leaves it open), so they are asked again without it: none counts as silent that was
only hidden.
"""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel.control_table import (
    HARDWARE_ERROR_STATUS,
    RETURN_DELAY_TIME,
    RETURN_DELAY_UNIT_S,
    TORQUE_ENABLE,
    HardwareError,
    Item,
)
from palpate.drivers.dynamixel.errors import (
    AnsweringLate,
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    NotConfirmed,
    PortFailed,
    StatusError,
    WrongLength,
    raise_first,
)
from palpate.drivers.dynamixel.exchanges import RETRIES, UNKNOWN_LATENCY_S, TableBlock, Timing, extract_block
from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    MAX_ID,
    Instruction,
    InstructionPacket,
    StatusPacket,
    encode_instruction,
)
from palpate.drivers.dynamixel.transceiver import (
    BusCounts,
    Loss,
    Lost,
    SizeMismatch,
    Transceiver,
    combine_losses,
)
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.ports import PORT_ERRORS

_Answers = dict[int, StatusPacket | Loss]
_NO_ANSWER = (Lost.SILENT, Lost.LATE)


def read_group(
    transceiver: Transceiver,
    blocks: Mapping[int, TableBlock],
    silent: set[int],
    tries: Sequence[bool],
    counts: BusCounts,
    *,
    fast: bool,
) -> _Answers:
    """Read a block of each servo; an answer or what was lost for each.

    `silent`: those that did not answer at all the last time; they are asked once, and last. It is brought
    up to date. All others are asked as often as there are `tries`, patiently where that is True. `fast`:
    the first try is a fast read, and what is missing in it is read plainly, at least once: a servo that has
    fallen silent is noticed no later than by servos that know no fast reads.
    """
    found: _Answers = _read_fast(transceiver, blocks, silent) if fast else {}
    left = {dxl_id: block for dxl_id, block in blocks.items() if dxl_id not in found}
    counts.retries += bool(fast and left.keys() - silent)
    plain = tries[1:] if fast and len(tries) > 1 else tries
    heard = {dxl_id: blocks[dxl_id] for dxl_id in list(found)[:1]}
    found.update(_read_plain(transceiver, left, silent, plain, counts, heard))
    gone = {dxl_id for dxl_id, answer in found.items() if answer is Lost.SILENT}
    silent -= found.keys() - gone
    silent |= gone
    return found


def _read_fast(transceiver: Transceiver, blocks: Mapping[int, TableBlock], silent: set[int]) -> _Answers:
    some = {dxl_id: block for dxl_id, block in blocks.items() if dxl_id not in silent}
    wide = transceiver.wider(some, fast=True) if some else {}
    answers = transceiver.read_group_fast(wide) if some else {}
    return {
        dxl_id: _cut_to_block(answer, wide[dxl_id], some[dxl_id])
        for dxl_id, answer in answers.items()
        if isinstance(answer, StatusPacket)
    }


def _read_plain(
    transceiver: Transceiver,
    blocks: Mapping[int, TableBlock],
    silent: set[int],
    tries: Sequence[bool],
    counts: BusCounts,
    heard: Mapping[int, TableBlock],
) -> _Answers:
    """`heard`: one that has answered a fast read, with its block; nothing if none has."""
    found: _Answers = {}
    tried = dict.fromkeys(blocks, 0)
    waiting = sorted(blocks, key=silent.__contains__)
    wide = transceiver.wider({**heard, **blocks}) if blocks else {}
    while waiting:
        patient = tries[max(tried[dxl_id] for dxl_id in waiting)]
        # one that has answered is asked along, and first: if it is prompt, silence is the others' own
        answered = [dxl_id for dxl_id, answer in found.items() if isinstance(answer, StatusPacket)]
        witness = [*heard, *answered][:1]
        asked = [*witness, *waiting] if patient else waiting
        answers = transceiver.read_group({dxl_id: wide[dxl_id] for dxl_id in asked}, patient=patient)
        hiding = next((dxl_id for dxl_id in waiting if answers[dxl_id] in _NO_ANSWER), None)
        for dxl_id in waiting:
            answer = answers[dxl_id]
            if answer in _NO_ANSWER and dxl_id != hiding:
                continue  # perhaps only hidden
            before = found.get(dxl_id)
            if not isinstance(answer, StatusPacket) and not isinstance(before, StatusPacket):
                answer = combine_losses(before, answer)
            found[dxl_id] = _cut_to_block(answer, wide[dxl_id], blocks[dxl_id])
            tried[dxl_id] += 1
            if not isinstance(answer, StatusPacket):
                counts.count_loss(silent=answer in _NO_ANSWER)
        left = [
            dxl_id
            for dxl_id in waiting
            if not isinstance(answers[dxl_id], StatusPacket)
            and tried[dxl_id] < (1 if dxl_id in silent else len(tries))
        ]
        waiting = sorted(left, key=tried.__getitem__)
        counts.retries += bool(waiting)
    return found


def _cut_to_block(answer: StatusPacket | Loss, wide: TableBlock, block: TableBlock) -> StatusPacket | Loss:
    """An answer without what was read besides the block."""
    if isinstance(answer, StatusPacket) and wide != block:
        return StatusPacket(answer.dxl_id, answer.error, extract_block(answer.params, wide, block))
    return answer


_T = TypeVar("_T")

_MAX_ITEM_BYTES = 4  # bytes of the longest single item
_MAX_WRITES = 3  # how often an item is written that reads otherwise afterwards
_TABLE_BEGINNING = (0, 1)  # what a reboot changes, by its beginning


@dataclass(frozen=True, slots=True)
class Ping:
    """Answer of a servo to a ping."""

    model_number: int
    firmware: int


@dataclass(frozen=True, slots=True)
class GroupRead(Generic[_T]):
    """Answers of several servos: for each id what was read, or an error.

    A servo that reports a hardware error is in both: what it measured holds, and its error is a
    HardwareAlert.
    """

    values: Mapping[int, _T]
    errors: Mapping[int, DeviceError]

    def all(self) -> dict[int, _T]:
        """Answer of every servo. Raises NotAnswering for all silent ones, or the first other error."""
        raise_first(tuple(self.errors.values()))
        return dict(self.values)


class Bus:
    """One wire with servos."""

    def __init__(
        self,
        port: SerialBase,
        clock: Clock,
        baudrate: int,
        *,
        latency_s: float = UNKNOWN_LATENCY_S,
        retries: int = RETRIES,
        reopen: Callable[[], SerialBase] | None = None,
    ) -> None:
        """Take over an open port; `clock` is the one on which answers time out.

        `latency_s`: what adapter and system may add to an answer's wire time and return delay. `retries`: how
        often a lost or damaged answer is asked for again. `reopen`: opens the port anew after an unplug.
        Raises PortFailed if the port cannot be set up.
        """
        self.port_name: str
        self.timing = Timing(baudrate, latency_s)
        self.counts = BusCounts()
        self._clock = clock
        self._retries = retries
        self._reopen = reopen
        self._lock = threading.RLock()
        self._silent: set[int] = set()
        self._use(port)

    def close(self) -> None:
        """Close the port; closing twice is harmless."""
        self._port.close()

    def reconnect(self) -> None:
        """Close the port and open it again, as after an unplug.

        Raises PortFailed or DeviceError if it is not there, PortFailed without a way to open it.
        """
        if self._reopen is None:
            raise PortFailed(self.port_name, "it cannot be opened again")
        with self._lock:
            self._port.close()
            self._use(self._reopen())
            self.counts.reconnects += 1

    def ping(self, dxl_id: int, *, retries: int | None = None) -> Ping:
        """Ask a servo for model number and firmware; answered at every Status Return Level."""
        _check_id(dxl_id)
        with self._exchanging():
            answer = self._ask(dxl_id, self._transceiver.ping, retries)
            self._check(answer, "a ping", alert=False)
        return _ping_of(answer)

    def broadcast_ping(self, wanted: Sequence[int] = range(MAX_ID + 1)) -> dict[int, Ping]:
        """Ping everybody at once. Ends when all `wanted` have answered, or the highest of them is overdue.

        Servos with one id between them damage each other's answers, so that neither may be found.
        """
        with self._exchanging():
            found = self._transceiver.broadcast_ping(wanted)
        return {answer.dxl_id: _ping_of(answer) for answer in found if len(answer.params) == 3}

    def read(self, dxl_id: int, item: Item, *, alert: bool = True) -> int:
        """Read one item. `alert`: raise HardwareAlert if the servo reports a hardware error."""
        _check_id(dxl_id)
        with self._exchanging():
            answer = self._read(dxl_id, (item.address, item.size))
            self._check(answer, f"to read {item.name}", alert=alert)
            value = item.decode(answer.params)
            self._learn(dxl_id, item, value)
        return value

    def write(self, dxl_id: int, item: Item, value: int, *, retries: int | None = None) -> None:
        """Write one item and wait for the servo to confirm. ValueError if the value does not fit the item.

        Where no confirmation comes it is written again: writing the same value twice does no harm. All
        confirmations are alike. Where an earlier one may still be under way, the item is read back, and
        written again if it holds something else; NotConfirmed if it still does.
        """
        _check_id(dxl_id)
        with self._exchanging():
            answer = self._confirm_write(dxl_id, item, item.encode(value), retries)
            self._check(answer, _describe_write(item, value))
            self._learn(dxl_id, item, value)

    def write_unconfirmed(self, dxl_id: int, item: Item, value: int) -> None:
        """Write one item of a servo that may be set not to answer."""
        _check_id(dxl_id)
        with self._exchanging():
            params = _words(item.address) + item.encode(value)
            self._transceiver.tell(dxl_id, params, (item.address, item.size))

    def reboot(self, dxl_id: int) -> None:
        """Restart a servo: the only way back from a hardware error. It is deaf for a moment afterwards.

        Not repeated: a servo that did not hear it is reported as not answering.
        """
        _check_id(dxl_id)
        with self._exchanging():
            if self._transceiver.may_be_stale(dxl_id):
                self._transceiver.settle([dxl_id])

            def reboot(dxl_id: int, *, patient: bool) -> StatusPacket | Loss:
                return self._transceiver.change(
                    dxl_id, Instruction.REBOOT, b"", _TABLE_BEGINNING, patient=patient
                )

            answer = self._ask(dxl_id, reboot, retries=0)
            self._check(answer, "a reboot", alert=False)

    def hardware_error(self, dxl_id: int) -> HardwareError:
        """Read Hardware Error Status, which works while the servo is alerting."""
        return HardwareError(self.read(dxl_id, HARDWARE_ERROR_STATUS, alert=False))

    def sync_read(self, dxl_ids: Sequence[int], item: Item, *, fast: bool = False) -> GroupRead[int]:
        """Read an item of several servos in one instruction, at one instant.

        `fast`: with Fast Sync Read, which all of them must know (`Model.answers_fast`). Raises PortFailed
        only: each servo has a value or an error.
        """
        return self.bulk_read(dict.fromkeys(dxl_ids, item), fast=fast)

    def bulk_read(self, items: Mapping[int, Item], *, fast: bool = False) -> GroupRead[int]:
        """Read an item of its own of each servo in one instruction; otherwise as `sync_read`."""
        blocks = {dxl_id: (item.address, item.size) for dxl_id, item in items.items()}
        values: dict[int, int] = {}
        errors: dict[int, DeviceError] = {}
        for dxl_id, answer in self.read_blocks(blocks, fast=fast).items():
            if isinstance(answer, DeviceError):
                errors[dxl_id] = answer
                continue
            if answer.error_number == 0:
                values[dxl_id] = items[dxl_id].decode(answer.params)
            try:
                with self._exchanging():
                    self._check(answer, f"to read {items[dxl_id].name}")
            except (HardwareAlert, StatusError) as error:
                errors[dxl_id] = error
        return GroupRead(values, errors)

    def read_blocks(
        self, blocks: Mapping[int, TableBlock], *, fast: bool = False
    ) -> dict[int, StatusPacket | DeviceError]:
        """Read a block of bytes of each servo in one instruction; an answer or an error for each id.

        One silent servo costs its own time-out, and hides no other: where others wait for it, they are asked
        again without it. One that stayed silent however often it was asked is asked once, and last, from
        then on.
        """
        for dxl_id in blocks:
            _check_id(dxl_id)
        with self._exchanging():
            tries = self.timing.tries(self._retries)
            found = read_group(self._transceiver, blocks, self._silent, tries, self.counts, fast=fast)
            return {dxl_id: self._or_error(dxl_id, block, found[dxl_id]) for dxl_id, block in blocks.items()}

    def sync_write(self, item: Item, values: Mapping[int, int]) -> None:
        """Write one item of several servos in one instruction. Servos do not confirm it."""
        params = _words(item.address, item.size)
        for dxl_id, value in values.items():
            _check_id(dxl_id)
            params += bytes([dxl_id]) + item.encode(value)
        with self._exchanging():
            self._transceiver.tell_group(values, params, (item.address, item.size))

    def broadcast_torque_off(self) -> None:
        """Tell every servo on the wire, known or not, to switch torque off. Servos do not confirm it."""
        with self._exchanging():
            item = TORQUE_ENABLE
            self._transceiver.tell(BROADCAST_ID, _TORQUE_OFF, (item.address, item.size))

    def _use(self, port: SerialBase) -> None:
        self._port = port
        self.port_name = port.port or "(unnamed port)"
        with self._port_errors():
            self._transceiver = Transceiver(port, self._clock, self.timing, self.counts)

    def _ask(
        self, dxl_id: int, ask: Callable[..., StatusPacket | Loss], retries: int | None = None
    ) -> StatusPacket:
        """The servo's answer, asked for again where it was lost. Raises NotAnswering or DamagedAnswer."""
        lost: Loss | None = None
        tries = self.timing.tries(self._retries if retries is None else retries)
        for attempt, patient in enumerate(tries):
            self.counts.retries += attempt > 0
            answer = ask(dxl_id, patient=patient)
            if isinstance(answer, StatusPacket):
                self._silent.discard(dxl_id)
                return answer
            lost = combine_losses(lost, answer)
            self.counts.count_loss(silent=lost in (Lost.SILENT, Lost.LATE))
        raise self._loss(dxl_id, lost or Lost.SILENT)

    def _read(self, dxl_id: int, block: TableBlock) -> StatusPacket:
        """The answer to a read, without what was read besides. Raises NotAnswering or DamagedAnswer."""
        wide = self._transceiver.wider({dxl_id: block})[dxl_id]
        doubtful = self._transceiver.may_be_stale(dxl_id)
        answer = self._ask(dxl_id, lambda i, *, patient: self._transceiver.read(i, wide, patient=patient))
        if answer.error_number and (doubtful or wide != block):
            # an earlier refusal that came twice, or this servo does not read so far
            self._transceiver.settle([dxl_id])
            wide = block
            answer = self._ask(
                dxl_id, lambda i, *, patient: self._transceiver.read(i, block, patient=patient)
            )
        return StatusPacket(dxl_id, answer.error, extract_block(answer.params, wide, block))

    def _confirm_write(self, dxl_id: int, item: Item, data: bytes, retries: int | None) -> StatusPacket:
        """The answer to a write that cannot be the answer to an earlier one."""
        block = item.address, item.size

        def write(dxl_id: int, *, patient: bool) -> StatusPacket | Loss:
            params = _words(item.address) + data
            return self._transceiver.change(dxl_id, Instruction.WRITE, params, block, patient=patient)

        for _ in range(_MAX_WRITES):
            doubtful = self._transceiver.may_be_stale(dxl_id)
            answer = self._ask(dxl_id, write, retries)
            if not doubtful:
                return answer
            if answer.error_number:
                self._transceiver.settle([dxl_id])
                return self._ask(dxl_id, write, retries)
            if self._read(dxl_id, block).params == data:
                return answer
        raise NotConfirmed([dxl_id], self.port_name, [item.name])

    def _or_error(
        self, dxl_id: int, block: TableBlock, answer: StatusPacket | Loss
    ) -> StatusPacket | DeviceError:
        """Result of a group read, or its error; a servo that refused is asked once more by itself."""
        if not isinstance(answer, StatusPacket):
            return self._loss(dxl_id, answer)
        try:
            return self._read(dxl_id, block) if answer.error_number else answer
        except (NotAnswering, DamagedAnswer) as error:
            return error

    def _loss(self, dxl_id: int, lost: Loss) -> NotAnswering | DamagedAnswer:
        match lost:
            case Lost.SILENT:
                return NotAnswering([dxl_id], self.port_name)
            case Lost.LATE:
                return AnsweringLate([dxl_id], self.port_name)
            case SizeMismatch():
                return WrongLength(dxl_id, self.port_name, lost.size, lost.wanted)
        return DamagedAnswer([dxl_id], self.port_name)

    def _check(self, answer: StatusPacket, doing: str, *, alert: bool = True) -> None:
        self.counts.alerts += answer.alert
        if answer.alert and alert:
            cause = self._cause(answer.dxl_id)
            carried_out = answer.error_number == 0
            raise HardwareAlert(answer.dxl_id, self.port_name, cause, carried_out=carried_out)
        if answer.error_number:
            raise StatusError(answer.dxl_id, self.port_name, answer.error_number, doing)

    def _cause(self, dxl_id: int) -> HardwareError | None:
        try:
            return self.hardware_error(dxl_id)
        except (NotAnswering, DamagedAnswer, StatusError):
            return None

    def _learn(self, dxl_id: int, item: Item, value: int) -> None:
        if item.name == RETURN_DELAY_TIME.name:
            self._transceiver.set_return_delay(dxl_id, value * RETURN_DELAY_UNIT_S)

    @contextmanager
    def _exchanging(self) -> Iterator[None]:
        """One whole exchange, alone on the wire."""
        with self._lock, self._port_errors():
            try:
                yield
            finally:
                # an interrupt may hit between the SDK's own lines; torque must still go off after it
                self._transceiver.release()

    @contextmanager
    def _port_errors(self) -> Iterator[None]:
        try:
            yield
        except PORT_ERRORS as error:
            raise PortFailed(self.port_name, error) from error


def _check_id(dxl_id: int) -> None:
    if not 0 <= dxl_id <= MAX_ID:
        raise ValueError(f"servo id {dxl_id} is outside 0 … {MAX_ID}")


def _describe_write(item: Item, value: int) -> str:
    """A write in the words of an error. Several items in one make a number that says nothing to anybody."""
    return f"{value if item.size <= _MAX_ITEM_BYTES else 'a value'} for {item.name}"


def _ping_of(answer: StatusPacket) -> Ping:
    return Ping(int.from_bytes(answer.params[:2], "little"), answer.params[2])


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


_TORQUE_OFF = _words(TORQUE_ENABLE.address) + TORQUE_ENABLE.encode(0)
TORQUE_OFF_PACKET = encode_instruction(InstructionPacket(BROADCAST_ID, Instruction.WRITE, _TORQUE_OFF))
"""What `Bus.broadcast_torque_off` sends."""
