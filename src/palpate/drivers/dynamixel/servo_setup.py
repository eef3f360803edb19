"""Set-up of one servo that is alone on the wire: find it, compare, write, read back. Above `bus_scan`.

Everything but id and baud rate is written first, under the id and at the rate at which the servo was found;
then the id; the rate last. If it ends anywhere in between, the servo answers at one of these, and setting it
up again goes on from there.
"""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.bus_scan import FoundServo, Scan, model_name
from palpate.drivers.dynamixel.control_table import BAUD_RATES
from palpate.drivers.dynamixel.errors import DamagedAnswer, NotAnswering, NotConfirmed
from palpate.drivers.dynamixel.models import Model
from palpate.drivers.dynamixel.servo import Servo, read_items
from palpate.drivers.transport.clock import Clock

_MAX_WRITES = 3
_SETTLE_S = 0.1  # a servo that has changed id or rate listens again by then


@dataclass(frozen=True, slots=True)
class ItemChange:
    """An item that is not as it should be."""

    item: str
    found: int
    wanted: int


@dataclass(frozen=True, eq=False)
class ServoPort:
    """Way to open the port that leads to the servo."""

    open_port: Callable[[int], SerialBase]
    clock: Clock
    latency_s: float

    def bus(self, baudrate: int) -> Bus:
        """The bus at a baud rate; to be closed. Raises DeviceError."""
        return Bus(self.open_port(baudrate), self.clock, baudrate, latency_s=self.latency_s)


def setup_items(dxl_id: int, baudrate: int, eeprom: Mapping[str, int]) -> dict[str, int]:
    """All items that a servo should hold, in the order in which they are written."""
    return {
        "Status Return Level": ct.ANSWERS_ALL,  # lives in RAM: looked at, and written on every start
        **eeprom,
        ct.ID.name: dxl_id,
        ct.BAUD_RATE.name: BAUD_RATES.index(baudrate),
    }


def only_servo(found: Scan, model: Model, port: str) -> FoundServo:
    """The one servo that was found, of the right model. Raises DeviceError if it is not so."""
    servos = found.found
    if not servos:
        raise DeviceError(f"no servo answers on {port}; check its power and its cable")
    if len(servos) > 1 or servos[0].crowded:
        places = ", ".join(f"id {item.dxl_id} at {item.baudrate} baud" for item in servos)
        count = f"{len(servos)} servos answer" if len(servos) > 1 else "more than one servo seems to answer"
        raise DeviceError(f"{count} on {port} ({places}); connect only the one to set up")
    (only,) = servos
    name = model_name(only.ping)
    if name != model.name:
        number = None if only.ping is None else only.ping.model_number
        raise DeviceError(
            f"the servo on {port} (id {only.dxl_id}) is a {name or f'model number {number}'}, "
            f"not a {model.name}; connect the right one, or correct `model` in the rig file"
        )
    return only


def find_changes(
    wire: ServoPort, at: FoundServo, model: Model, wanted: Mapping[str, int]
) -> list[ItemChange]:
    """Differences from `wanted` of the servo found at `at`. Raises what the bus raises."""
    with closing(wire.bus(at.baudrate)) as bus:
        servo = Servo(bus, at.dxl_id, model.name)
        servo.check()
        found = read_items(bus, servo, wanted)
    return [ItemChange(name, found[name], value) for name, value in wanted.items() if found[name] != value]


def apply_changes(
    wire: ServoPort,
    at: FoundServo,
    model: Model,
    changes: list[ItemChange],
    written: Callable[[ItemChange], None],
) -> FoundServo:
    """Switch torque off and write the changes; returns where the servo answers now.

    `written` hears of each change once it is confirmed. Raises what the bus raises, and DeviceError for an
    item that does not stay written.
    """
    plain = [change for change in changes if change.item not in (ct.ID.name, ct.BAUD_RATE.name)]
    moves = {change.item: change for change in changes if change not in plain}
    now_at = at
    with closing(wire.bus(at.baudrate)) as bus:
        servo = Servo(bus, at.dxl_id, model.name)
        servo.check()
        servo.disable_torque()
        for change in plain:
            servo.ensure(change.item, change.wanted)
            written(change)
        if ct.ID.name in moves:
            change = moves[ct.ID.name]
            _change_id(bus, wire.clock, at.dxl_id, change.wanted)
            now_at = FoundServo(at.baudrate, change.wanted, at.ping)
            written(change)
    if ct.BAUD_RATE.name in moves:
        change = moves[ct.BAUD_RATE.name]
        _change_rate(wire, now_at, change.wanted)
        now_at = FoundServo(BAUD_RATES[change.wanted], now_at.dxl_id, at.ping)
        written(change)
    return now_at


def _change_id(bus: Bus, clock: Clock, old: int, new: int) -> None:
    """Write the id; the manual does not say under which one the servo confirms it."""
    for _ in range(_MAX_WRITES):
        bus.write_unconfirmed(old, ct.ID, new)
        clock.sleep(_SETTLE_S)
        try:
            bus.ping(new)
        except (NotAnswering, DamagedAnswer):
            continue
        return
    raise NotConfirmed([old], bus.port_name, [f"ID {new}"])


def _change_rate(wire: ServoPort, at: FoundServo, code: int) -> None:
    """Write the baud rate; nor at which rate."""
    port = ""
    for _ in range(_MAX_WRITES):
        with closing(wire.bus(at.baudrate)) as bus:
            port = bus.port_name
            bus.write_unconfirmed(at.dxl_id, ct.BAUD_RATE, code)
            wire.clock.sleep(_SETTLE_S)
        with closing(wire.bus(BAUD_RATES[code])) as bus:
            try:
                bus.ping(at.dxl_id)
            except (NotAnswering, DamagedAnswer):
                continue
        return
    raise NotConfirmed([at.dxl_id], port, [f"Baud Rate {BAUD_RATES[code]}"])
