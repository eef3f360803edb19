"""A bus of Dynamixel servos: control table items by servo id, and errors that say which servo.

Above: `servo`, in physical units. Below: the vendor's SDK (`sdk`) and a port. A servo that
gives no answer is always an error, never a default value.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from dynamixel_sdk import (
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    INST_PING,
)
from serial.serialutil import SerialBase

from palpate.drivers.dynamixel.control_table import HARDWARE_ERROR_STATUS, ITEMS, HardwareError, Item
from palpate.drivers.dynamixel.failures import (
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    PortFailed,
    StatusError,
)
from palpate.drivers.dynamixel.packet import ALERT_BIT, MAX_ID
from palpate.drivers.dynamixel.sdk import READ_WAIT_S, ClockedPortHandler, StuffingPacketHandler
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.port import PORT_ERRORS

__all__ = ["Bus", "Ping"]

_QUIET_S = 0.01  # a wire with nothing on it for so long will carry no late answer any more
_ID, _ERROR, _PARAMS = 4, 8, 9  # where the SDK's packet lists have them


@dataclass(frozen=True, slots=True)
class Ping:
    """What a servo tells about itself."""

    model_number: int
    firmware: int


class Bus:
    """One wire with servos. Not for use from two threads at once."""

    def __init__(self, port: SerialBase, clock: Clock, baudrate: int) -> None:
        """Take over an open port; `clock` is the one on which answers time out.

        Raises PortFailed if the port cannot be set up.
        """
        self.port_name = port.port or "(unnamed port)"
        self._port = port
        self._handler = ClockedPortHandler(port, clock, baudrate)
        self._packets = StuffingPacketHandler()
        with self._port_errors():
            self._handler.openPort()

    def close(self) -> None:
        """Close the port; closing twice is harmless."""
        self._port.close()

    def ping(self, dxl_id: int) -> Ping:
        """Ask a servo for model number and firmware; answered at every Status Return Level."""
        _check_id(dxl_id)
        packet = [0, 0, 0, 0, dxl_id, 3, 0, INST_PING, 0, 0]
        with self._port_errors():
            answer, result, error = self._packets.txRxPacket(self._handler, packet)
        self._check(dxl_id, result, error, "a ping")
        params = bytes(answer[_PARAMS:-2])
        if len(params) != 3:
            raise DamagedAnswer([dxl_id], self.port_name)
        return Ping(int.from_bytes(params[:2], "little"), params[2])

    def read(self, dxl_id: int, item: Item) -> int:
        """Read one item; a servo that keeps silent is asked once more."""
        _check_id(dxl_id)
        with self._port_errors():
            raw, result, error = self._asked_twice(
                lambda: self._packets.readTxRx(self._handler, dxl_id, item.address, item.size)
            )
        self._check(dxl_id, result, error, f"to read {item.name}")
        if len(raw) != item.size:
            raise DamagedAnswer([dxl_id], self.port_name)
        return item.decode(bytes(raw))

    def write(self, dxl_id: int, item: Item, value: int) -> None:
        """Write one item and wait for the servo to confirm. ValueError if the value does not fit the item.

        A servo that keeps silent is told once more: writing the same value twice does no harm.
        """
        _check_id(dxl_id)
        data = list(item.encode(value))
        with self._port_errors():
            result, error = self._asked_twice(
                lambda: self._packets.writeTxRx(self._handler, dxl_id, item.address, item.size, list(data))
            )
        self._check(dxl_id, result, error, f"{value} for {item.name}")

    def reboot(self, dxl_id: int) -> None:
        """Restart a servo: the only way back from a hardware error. It is deaf for a moment afterwards."""
        _check_id(dxl_id)
        with self._port_errors():
            result, error = self._packets.reboot(self._handler, dxl_id)
        self._check(dxl_id, result, error & ~ALERT_BIT, "a reboot")

    def hardware_error(self, dxl_id: int) -> HardwareError:
        """Read Hardware Error Status, which works while the servo is alerting."""
        _check_id(dxl_id)
        item = HARDWARE_ERROR_STATUS
        with self._port_errors():
            raw, result, error = self._packets.readTxRx(self._handler, dxl_id, item.address, item.size)
        self._check(dxl_id, result, error & ~ALERT_BIT, f"to read {item.name}")
        return HardwareError(raw[0])

    def sync_read(self, dxl_ids: Sequence[int], first: Item, last: Item) -> dict[int, dict[Item, int]]:
        """Read all items from `first` to `last` of several servos in one instruction, at one instant.

        Raises NotAnswering with exactly the servos that do not answer a ping either, DamagedAnswer if all do,
        HardwareAlert or StatusError for the first servo that reports one.
        """
        for dxl_id in dxl_ids:
            _check_id(dxl_id)
        size = last.address + last.size - first.address
        with self._port_errors():
            answers = self._exchange_sync_read(dxl_ids, first.address, size)
        lost = [dxl_id for dxl_id in dxl_ids if dxl_id not in answers]
        if lost:
            self._raise_lost(lost)
        block = [item for item in ITEMS if first.address <= item.address <= last.address]
        values: dict[int, dict[Item, int]] = {}
        for dxl_id in dxl_ids:
            error, raw = answers[dxl_id]
            self._check(dxl_id, COMM_SUCCESS, error, f"to read {first.name} to {last.name}")
            if len(raw) != size:
                raise DamagedAnswer([dxl_id], self.port_name)
            values[dxl_id] = {
                item: item.decode(raw[item.address - first.address :][: item.size]) for item in block
            }
        return values

    def sync_write(self, item: Item, values: Mapping[int, int]) -> None:
        """Write one item of several servos in one instruction. Servos do not confirm it."""
        params: list[int] = []
        for dxl_id, value in values.items():
            _check_id(dxl_id)
            params += [dxl_id, *item.encode(value)]
        with self._port_errors():
            result = self._packets.syncWriteTxOnly(
                self._handler, item.address, item.size, params, len(params)
            )
        if result != COMM_SUCCESS:
            raise PortFailed(self.port_name, self._packets.getTxRxResult(result))

    def _exchange_sync_read(
        self, dxl_ids: Sequence[int], address: int, size: int
    ) -> dict[int, tuple[int, bytes]]:
        """Error byte and data of all that answered; the SDK's own group read gives up at the first gap."""
        result = self._packets.syncReadTx(self._handler, address, size, list(dxl_ids), len(dxl_ids), False)
        if result != COMM_SUCCESS:
            raise PortFailed(self.port_name, self._packets.getTxRxResult(result))
        answers: dict[int, tuple[int, bytes]] = {}
        while any(dxl_id not in answers for dxl_id in dxl_ids):
            packet, result = self._packets.rxPacket(self._handler, False)
            if result == COMM_SUCCESS:
                answers[packet[_ID]] = packet[_ERROR], bytes(packet[_PARAMS:-2])
            elif result != COMM_RX_CORRUPT:
                break
        return answers

    def _asked_twice(self, exchange: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
        """Repeat an exchange that nobody answered: a busy computer may take longer than the time-out."""
        answer = exchange()
        if answer[-2] == COMM_RX_TIMEOUT:
            answer = exchange()
            self._drop_late_answers()
        return answer

    def _drop_late_answers(self) -> None:
        # believed to answer the next instruction, a late answer to the last one would be a wrong value
        self._port.timeout = _QUIET_S
        try:
            while self._port.read(256):
                pass
        finally:
            self._port.timeout = READ_WAIT_S

    def _raise_lost(self, lost: Sequence[int]) -> None:
        with self._port_errors():
            self._drop_late_answers()
        # a servo behind a missing one may stay silent in a sync read; asked by itself it answers
        absent = []
        for dxl_id in lost:
            try:
                self.ping(dxl_id)
            except NotAnswering:
                absent.append(dxl_id)
        if absent:
            raise NotAnswering(absent, self.port_name)
        raise DamagedAnswer(lost, self.port_name)

    def _check(self, dxl_id: int, result: int, error: int, doing: str) -> None:
        if result == COMM_RX_TIMEOUT:
            raise NotAnswering([dxl_id], self.port_name)
        if result == COMM_RX_CORRUPT:
            raise DamagedAnswer([dxl_id], self.port_name)
        if result != COMM_SUCCESS:
            raise PortFailed(self.port_name, self._packets.getTxRxResult(result))
        number = error & ~ALERT_BIT
        if error & ALERT_BIT:
            raise HardwareAlert(dxl_id, self.port_name, self._cause(dxl_id), carried_out=number == 0)
        if number:
            raise StatusError(dxl_id, self.port_name, number, doing)

    def _cause(self, dxl_id: int) -> HardwareError | None:
        try:
            return self.hardware_error(dxl_id)
        except (NotAnswering, DamagedAnswer, StatusError):
            return None

    @contextmanager
    def _port_errors(self) -> Iterator[None]:
        try:
            yield
        except PORT_ERRORS as error:
            raise PortFailed(self.port_name, error) from error
        finally:
            # an interrupt may hit between the SDK's own lines; torque must still go off after it
            self._handler.is_using = False


def _check_id(dxl_id: int) -> None:
    if not 0 <= dxl_id <= MAX_ID:
        raise ValueError(f"servo id {dxl_id} is outside 0 … {MAX_ID}")
