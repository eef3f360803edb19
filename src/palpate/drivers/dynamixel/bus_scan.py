"""Scan of a bus for unknown servos, at every baud rate and id; set-up of one servo.

One ping to all finds in a fraction of a second what answers in turn. Where answers came broken, each id is
asked by itself: two servos with one id speak at once and spoil each other's answers. Where both happen to say
the same, reading what differs between any two servos (angle, voltage, clock) tells them apart.

*Set-up.* Everything but id and baud rate is written first, under the id and at the rate at which the servo
was found; then the id; the rate last. If it ends anywhere in between, the servo answers at one of these, and
setting it up again goes on from there.
"""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.control_table import BAUD_RATES, Item
from palpate.drivers.dynamixel.errors import (
    DamagedAnswer,
    NotAnswering,
    NotConfirmed,
    StatusError,
    raise_first,
)
from palpate.drivers.dynamixel.models import Model, model_by_number
from palpate.drivers.dynamixel.packet import MAX_ID
from palpate.drivers.dynamixel.servo import Servo, disable_torque, read_items
from palpate.drivers.dynamixel.settings import ItemChange, differences, items_to_compare
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.ports import PORT_ERRORS, PortTaken

ALL_IDS = range(MAX_ID + 1)

_PRESENT_VALUES = Item("Realtime Tick to Present Temperature", 120, 27)  # no two servos agree in all of it
_CROWDING_READS = 4
_RESYNC_S = 0.05  # a servo that heard half a packet at another baud rate has forgotten it by then


@dataclass(frozen=True, slots=True)
class FoundServo:
    """Servo that answers to an id at a baud rate.

    `ping` is None if every answer came broken. `crowded`: more than one servo seems to have this id.
    """

    baudrate: int
    dxl_id: int
    ping: Ping | None
    crowded: bool = False


@dataclass(frozen=True, slots=True)
class Scan:
    """Result of a scan: servos by baud rate and id, and the rates that the port refused with the reason."""

    found: tuple[FoundServo, ...]
    refused: dict[int, str]


def scan(
    open_port: Callable[[int], SerialBase],
    clock: Clock,
    baudrates: Iterable[int],
    dxl_ids: Sequence[int] = ALL_IDS,
    *,
    latency_s: float,
    tell: Callable[[int, int | None], None] = lambda _rate, _dxl_id: None,
) -> Scan:
    """Look at every baud rate; `open_port(baudrate)` opens the port anew for each.

    `tell` hears of each baud rate that is begun, and of each id that is asked by itself. Raises DeviceError
    if the port is taken, cannot be opened at any rate, or fails meanwhile.
    """
    found: list[FoundServo] = []
    refused: dict[int, str] = {}
    reasons: list[DeviceError] = []
    tried = 0
    for baudrate in baudrates:
        tried += 1
        tell(baudrate, None)
        try:
            port = open_port(baudrate)
        except PortTaken:
            raise
        except DeviceError as error:
            reasons.append(error)
            refused[baudrate] = str(error)
            continue
        try:
            found += _scan_rate(port, clock, baudrate, dxl_ids, latency_s=latency_s, tell=tell)
        finally:
            port.close()
    if reasons and len(reasons) == tried:
        raise reasons[0]
    return Scan(tuple(found), refused)


def _scan_rate(
    port: SerialBase,
    clock: Clock,
    baudrate: int,
    dxl_ids: Sequence[int],
    *,
    latency_s: float,
    tell: Callable[[int, int | None], None] = lambda _rate, _dxl_id: None,
) -> list[FoundServo]:
    """Look for servos on an open port at one baud rate. Raises PortFailed."""
    bus = Bus(port, clock, baudrate, latency_s=latency_s)
    clock.sleep(_RESYNC_S)
    answers = bus.broadcast_ping(dxl_ids)
    pings: dict[int, Ping | None] = {i: ping for i, ping in answers.items() if i in dxl_ids}
    if bus.counts.damaged:
        for dxl_id in dxl_ids:
            if dxl_id in pings:
                continue
            tell(baudrate, dxl_id)
            try:
                pings[dxl_id] = _ping_alone(bus, dxl_id)
            except NotAnswering:
                continue
    return [
        FoundServo(baudrate, dxl_id, ping, crowded=ping is None or _is_crowded(bus, port, clock, dxl_id))
        for dxl_id, ping in sorted(pings.items())
    ]


def model_name(ping: Ping | None) -> str | None:
    """The name of the model that answered a ping; None if it is unknown."""
    try:
        return None if ping is None else model_by_number(ping.model_number, ping.firmware).name
    except InputError:
        return None


def _ping_alone(bus: Bus, dxl_id: int) -> Ping | None:
    """Ping one id: None if only broken answers come; NotAnswering at once if none does."""
    try:
        return bus.ping(dxl_id, retries=0)
    except DamagedAnswer:
        pass
    try:
        return bus.ping(dxl_id)
    except DamagedAnswer:
        return None


def _is_crowded(bus: Bus, port: SerialBase, clock: Clock, dxl_id: int) -> bool:
    """True if answers to an id keep coming broken, or twice."""
    spoiled = 0
    for _ in range(_CROWDING_READS):
        before = bus.counts.damaged
        with contextlib.suppress(NotAnswering, DamagedAnswer, StatusError):  # damage is counted
            bus.read(dxl_id, _PRESENT_VALUES, alert=False)
        spoiled += bus.counts.damaged > before or _more_arrives(bus, port, clock)
    return spoiled > _CROWDING_READS // 2


def _more_arrives(bus: Bus, port: SerialBase, clock: Clock) -> bool:
    """True if something still comes behind an answer that was complete."""
    clock.sleep(bus.timing.latency_s + bus.timing.timeout_s(0, 2 * _PRESENT_VALUES.size, 0.0))
    try:
        return bool(port.read(1))
    except PORT_ERRORS:
        return False  # the next exchange says what is wrong with the port


_MAX_WRITES = 3
_SETTLE_S = 0.1  # a servo that has changed id or rate listens again by then


@dataclass(frozen=True, eq=False)
class ServoPort:
    """Way to open the port that leads to the servo."""

    open_port: Callable[[int], SerialBase]
    clock: Clock
    latency_s: float

    def bus(self, baudrate: int) -> Bus:
        """The bus at a baud rate; to be closed. Raises DeviceError."""
        return Bus(self.open_port(baudrate), self.clock, baudrate, latency_s=self.latency_s)


def setup_items(servo: Servo, baudrate: int, eeprom: Mapping[str, int]) -> dict[str, int]:
    """All items that a servo should hold, in the order in which they are written."""
    return {
        "Status Return Level": ct.ANSWERS_ALL,  # lives in RAM: looked at, and written on every start
        **eeprom,
        **items_to_compare(servo),
        ct.ID.name: servo.dxl_id,
        ct.BAUD_RATE.name: BAUD_RATES.index(baudrate),
    }


def only_servo(found: Scan, model: Model, port: str, dxl_id: int | None = None) -> FoundServo:
    """The one servo that was found, of the right model. Raises DeviceError if it is not so.

    `dxl_id`: others may answer beside it, if it already has this id.
    """
    servos = found.found
    own = tuple(item for item in servos if item.dxl_id == dxl_id)
    servos = own if len(own) == 1 else servos
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
    return differences(found, wanted)


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
        raise_first(disable_torque(bus, [servo]))
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
