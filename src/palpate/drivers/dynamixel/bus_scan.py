"""Scan of a bus for servos of which nothing is known, at every baud rate and id. Above `bus`.

One ping to all finds in a fraction of a second what answers in turn. Where answers came broken, each id is
asked by itself: two servos with one id speak at once and spoil each other's answers. Where both happen to say
the same, reading what differs between any two servos (angle, voltage, clock) tells them apart.
"""

import contextlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.control_table import Item
from palpate.drivers.dynamixel.errors import DamagedAnswer, NotAnswering, StatusError
from palpate.drivers.dynamixel.models import model_by_number
from palpate.drivers.dynamixel.packet import MAX_ID
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
            found += scan_rate(port, clock, baudrate, dxl_ids, latency_s=latency_s, tell=tell)
        finally:
            port.close()
    if reasons and len(reasons) == tried:
        raise reasons[0]
    return Scan(tuple(found), refused)


def scan_rate(
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
