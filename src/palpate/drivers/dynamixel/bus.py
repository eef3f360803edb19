"""A bus of Dynamixel servos: control table items by servo id, and errors that say which servo.

Above: `servo` and `state`, in physical units. Below: `transceiver`, the vendor's SDK and a port. A servo that
gives no answer is always an error, never a default value. What was lost or damaged is asked again, and
counted. One exchange is finished before another thread's begins.
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
from palpate.drivers.dynamixel.counts import BusCounts
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
from palpate.drivers.dynamixel.group import read_group
from palpate.drivers.dynamixel.packet import BROADCAST_ID, MAX_ID, Instruction, StatusPacket
from palpate.drivers.dynamixel.pending import Block, part
from palpate.drivers.dynamixel.timing import UNKNOWN_LATENCY_S, Timing
from palpate.drivers.dynamixel.transceiver import Loss, Lost, SizeMismatch, Transceiver, combine_losses
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.port import PORT_ERRORS

__all__ = ["Bus", "GroupRead", "Ping"]

_T = TypeVar("_T")

_LONGEST_NUMBER = 4  # bytes of the longest single item
_WRITES = 3  # how often an item is written that reads otherwise afterwards
_WHOLE_TABLE = (0, 1)  # what a reboot changes, by its beginning


@dataclass(frozen=True, slots=True)
class Ping:
    """What a servo tells about itself."""

    model_number: int
    firmware: int


@dataclass(frozen=True, slots=True)
class GroupRead(Generic[_T]):
    """What several servos answered: for each id what was read, or an error.

    A servo that reports a hardware error is in both: what it measured holds, and its error is a
    HardwareAlert.
    """

    values: Mapping[int, _T]
    errors: Mapping[int, DeviceError]

    def all(self) -> dict[int, _T]:
        """What every servo answered. Raises NotAnswering for all silent ones, or the first other error."""
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
        retries: int = 2,
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
            answer = self._asked(dxl_id, self._transceiver.ping, retries)
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
            answer = self._written(dxl_id, item, item.encode(value), retries)
            self._check(answer, _write_of(item, value))
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
                    dxl_id, Instruction.REBOOT, b"", _WHOLE_TABLE, patient=patient
                )

            answer = self._asked(dxl_id, reboot, retries=0)
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
        self, blocks: Mapping[int, Block], *, fast: bool = False
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
            params = _words(item.address) + item.encode(0)
            self._transceiver.tell(BROADCAST_ID, params, (item.address, item.size))

    def _use(self, port: SerialBase) -> None:
        self._port = port
        self.port_name = port.port or "(unnamed port)"
        with self._port_errors():
            self._transceiver = Transceiver(port, self._clock, self.timing, self.counts)

    def _asked(
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
            self.counts.lost(silent=lost in (Lost.SILENT, Lost.LATE))
        raise self._loss(dxl_id, lost or Lost.SILENT)

    def _read(self, dxl_id: int, block: Block) -> StatusPacket:
        """The answer to a read, without what was read besides. Raises NotAnswering or DamagedAnswer."""
        wide = self._transceiver.wider({dxl_id: block})[dxl_id]
        doubtful = self._transceiver.may_be_stale(dxl_id)
        answer = self._asked(dxl_id, lambda i, *, patient: self._transceiver.read(i, wide, patient=patient))
        if answer.error_number and (doubtful or wide != block):
            # an earlier refusal that came twice, or this servo does not read so far
            self._transceiver.settle([dxl_id])
            wide = block
            answer = self._asked(
                dxl_id, lambda i, *, patient: self._transceiver.read(i, block, patient=patient)
            )
        return StatusPacket(dxl_id, answer.error, part(answer.params, wide, block))

    def _written(self, dxl_id: int, item: Item, data: bytes, retries: int | None) -> StatusPacket:
        """The answer to a write that cannot be the answer to an earlier one."""
        block = item.address, item.size

        def write(dxl_id: int, *, patient: bool) -> StatusPacket | Loss:
            params = _words(item.address) + data
            return self._transceiver.change(dxl_id, Instruction.WRITE, params, block, patient=patient)

        for _ in range(_WRITES):
            doubtful = self._transceiver.may_be_stale(dxl_id)
            answer = self._asked(dxl_id, write, retries)
            if not doubtful:
                return answer
            if answer.error_number:
                self._transceiver.settle([dxl_id])
                return self._asked(dxl_id, write, retries)
            if self._read(dxl_id, block).params == data:
                return answer
        raise NotConfirmed([dxl_id], self.port_name, [item.name])

    def _or_error(self, dxl_id: int, block: Block, answer: StatusPacket | Loss) -> StatusPacket | DeviceError:
        """What a group read found, an error if it is none; a refusal is asked for once more by itself."""
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


def _write_of(item: Item, value: int) -> str:
    """A write in the words of an error. Several items in one make a number that says nothing to anybody."""
    return f"{value if item.size <= _LONGEST_NUMBER else 'a value'} for {item.name}"


def _ping_of(answer: StatusPacket) -> Ping:
    return Ping(int.from_bytes(answer.params[:2], "little"), answer.params[2])


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)
