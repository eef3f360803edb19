"""Servo bus of a rig: its port, the servos that answer on it, and torque off for all of them.

A bus is that of a port by name, of a rig file, or of the emulated bench. A scan says which servos answer,
at which baud rates and ids, and how the rig file differs. The emergency stop works beside a program that is
using the port; nothing here may import what takes long.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, InputError
from palpate.config import RigFile, RigServo, load_rig, shipped_rig
from palpate.config.commissioning_results import (
    RebootedServoOut,
    RebootOut,
    ScannedServoOut,
    ScanOut,
    StopOut,
    StoppedServoOut,
)
from palpate.drivers.dynamixel import (
    ALL_IDS,
    BAUD_RATES,
    Bus,
    FoundServo,
    HardwareError,
    Scan,
    Servo,
    broadcast_torque_off,
    confirm_torque_off,
    disable_torque,
    error_names,
    known_models,
    model_name,
    scan,
    supply_warnings,
)
from palpate.drivers.transport import (
    Clock,
    MonotonicClock,
    PortSharing,
    PortTaken,
    connection_of,
    has_baudrate,
    open_port,
)
from palpate.rig.contact_peak import bus_latency_s, port_latency_s


@dataclass(frozen=True, eq=False)
class BusEndpoint:
    """A bus: its port as people call it, how to open it, and what is known of it.

    `rig` is None if only a port was named. `urls`: where ports of an emulated rig really are. `devices`: what
    hangs on them, which lives as long as it is referenced.
    """

    port: str
    clock: Clock
    latency_s: float
    baudrate: int | None = None
    rig: RigFile | None = None
    urls: Callable[[str], str] = str
    devices: object = None
    _sharing: PortSharing = field(default_factory=lambda: PortSharing(open_port), repr=False)

    @property
    def emulated(self) -> bool:
        """True if nothing real hangs on it, as far as the host can tell."""
        return self.port.startswith("mock://")

    def open(self, baudrate: int, *, shared: bool = False) -> SerialBase:
        """Open the bus's port; raises DeviceError naming it."""
        return open_port(self.urls(self.port), baudrate, shared=shared)

    def open_other(self, port: str, baudrate: int) -> SerialBase:
        """Open another port of the rig; raises DeviceError naming it."""
        connection = connection_of(port)
        return self._sharing.open(self.urls(connection) + port.removeprefix(connection), baudrate)


def find_endpoint(rig: Path | None, port: str | None) -> BusEndpoint:
    """The bus of a rig file or of a port; without both, that of the shipped emulated rig.

    Raises InputError if both are given.
    """
    if port is None:
        return endpoint_of_rig(load_rig(rig or shipped_rig()))
    if rig is not None:
        raise InputError("a port and a rig exclude each other: the rig file names its port")
    return BusEndpoint(port, MonotonicClock(), port_latency_s(port))


def endpoint_of_rig(rig: RigFile, seed: int = 0) -> BusEndpoint:
    """The bus of a rig; that of an emulated rig is emulated from now on, with devices drawn by `seed`."""
    latency, baudrate = bus_latency_s(rig), rig.bus.baudrate_bps
    if not rig.emulated:
        return BusEndpoint(rig.bus.port, MonotonicClock(), latency, baudrate, rig)
    # half a second of imports, for which an emergency stop of a real rig must not wait
    from palpate.rig.bench import set_up  # noqa: PLC0415

    bench = set_up(rig, (), seed)
    return BusEndpoint(rig.bus.port, bench.clock, latency, baudrate, rig, bench.urls, bench)


def list_servos(rig: RigFile | None) -> tuple[RigServo, ...]:
    """All servos of a rig; none without one."""
    return () if rig is None else rig.servos


def check_dxl_ids(rig: RigFile, dxl_ids: Sequence[int]) -> None:
    """Raise InputError for an id that is no servo's of the rig file."""
    known = sorted(servo.dxl_id for servo in list_servos(rig))
    for dxl_id in dxl_ids:
        if dxl_id not in known:
            raise InputError(
                f"the rig file has no servo with id {dxl_id}; it has {', '.join(map(str, known))}"
            )


_USUAL_BAUDRATE_BPS = 1_000_000


def scan_bus(
    place: BusEndpoint,
    baudrates: Sequence[int] = (),
    ids: Sequence[int] = ALL_IDS,
    tell: Callable[[int, int | None], None] = lambda *_: None,
) -> ScanOut:
    """Ping all ids at all baud rates, `usual_baudrates` if none are given.

    `tell` is called with every rate, and with every id where single ones are asked. Raises DeviceError if the
    port is missing or fails.
    """
    rates = list(dict.fromkeys(baudrates)) or baudrates_to_try(place)
    return scan_result(
        place, scan(place.open, place.clock, rates, ids, latency_s=place.latency_s, tell=tell), rates, ids
    )


def baudrates_to_try(place: BusEndpoint) -> Sequence[int]:
    """Baud rates to try on a bus: one where the port has none of its own, and all would find the same."""
    return BAUD_RATES if has_baudrate(place.port) else [place.baudrate or _USUAL_BAUDRATE_BPS]


def scan_result(place: BusEndpoint, found: Scan, rates: Sequence[int], ids: Sequence[int]) -> ScanOut:
    """Result of a scan: what was found beside what the rig file says."""
    owned = {servo.dxl_id: servo for servo in list_servos(place.rig)}
    servos = tuple(_servo_out(item, owned) for item in found.found)
    warnings = [
        *(f"{rate} baud could not be tried: {reason}" for rate, reason in found.refused.items()),
        *_scan_warnings(servos),
        *supply_warnings(servo.model for servo in servos if servo.model is not None),
        *_rig_warnings(servos, [owned[i] for i in sorted(owned) if i in ids], place.baudrate),
    ]
    return ScanOut.of(
        place,
        baudrates_bps=tuple(rate for rate in rates if rate not in found.refused),
        ids=tuple(ids),
        servos=servos,
        warnings=tuple(warnings),
    )


def is_scan_well(out: ScanOut, place: BusEndpoint) -> bool:
    """Return whether servos answer, each by an id of its own, and those of the rig as its file says."""
    models = {servo.id: servo.model for servo in out.servos if servo.baudrate_bps == place.baudrate}
    return (
        bool(out.servos)
        and not any(servo.crowded for servo in out.servos)
        and all(
            models.get(servo.dxl_id) == servo.model
            for servo in list_servos(place.rig)
            if servo.dxl_id in out.ids
        )
    )


def _servo_out(found: FoundServo, owned: dict[int, RigServo]) -> ScannedServoOut:
    owner = owned.get(found.dxl_id)
    return ScannedServoOut(
        baudrate_bps=found.baudrate,
        id=found.dxl_id,
        model=model_name(found.ping),
        model_number=None if found.ping is None else found.ping.model_number,
        firmware=None if found.ping is None else found.ping.firmware,
        crowded=found.crowded,
        owner=None if owner is None else owner.owner,
    )


def _scan_warnings(servos: Sequence[ScannedServoOut]) -> list[str]:
    crowded = [
        f"two servos or more seem to have id {servo.id} at {servo.baudrate_bps} baud: connect one at a time "
        "and give each its own (`palpate setup-motors`)"
        for servo in servos
        if servo.crowded
    ]
    unknown = [
        f"servo {servo.id} has model number {servo.model_number}, which is none of the {len(known_models())} "
        "that palpate knows"
        for servo in servos
        if servo.model is None and servo.model_number is not None
    ]
    return [*crowded, *unknown]


def _rig_warnings(
    servos: Sequence[ScannedServoOut], owned: Sequence[RigServo], baudrate: int | None
) -> list[str]:
    """Warnings of what the rig file has otherwise."""
    warnings = []
    for wanted in owned:
        there = [servo for servo in servos if servo.id == wanted.dxl_id]
        right = [servo for servo in there if servo.baudrate_bps == baudrate]
        name = f"servo {wanted.dxl_id} ({wanted.owner})"
        if not there:
            warnings.append(f"{name} of the rig file does not answer: check its cable, or set it up")
        elif not right:
            warnings.append(
                f"{name} answers at {there[0].baudrate_bps} baud, not at the rig file's {baudrate}: "
                "`palpate setup-motors` sets it"
            )
        elif right[0].model_number is not None and right[0].model != wanted.model:
            found = right[0].model or f"model number {right[0].model_number}"
            warnings.append(f"{name} is a {found}, not the rig file's {wanted.model}")
    strangers = [servo for servo in servos if owned and servo.owner is None]
    warnings += [
        f"servo {servo.id} at {servo.baudrate_bps} baud is not in the rig file" for servo in strangers
    ]
    return warnings


_TORQUE_OFF_BROADCASTS = 10  # in a row, before any servo is asked
_PORT_TIMEOUT_S = 3.0  # for another program to give up the port


def stop_all(place: BusEndpoint, baudrate: int) -> StopOut:
    """Broadcast torque off, then confirm it with every servo; DeviceError if the port cannot be opened."""
    begin = place.clock.now()
    told = 0
    while True:
        with closing(_bus(place, baudrate, shared=True)) as bus:
            broadcast_torque_off(bus, place.clock, _TORQUE_OFF_BROADCASTS)
            told += _TORQUE_OFF_BROADCASTS
        try:
            bus = _bus(place, baudrate, shared=False)
        except PortTaken:
            if place.clock.now() - begin < _PORT_TIMEOUT_S:
                continue
            return _stop_result(place, baudrate, told, None)
        with closing(bus):
            owned = [servo.dxl_id for servo in list_servos(place.rig)]
            return _stop_result(
                place, baudrate, told, confirm_torque_off(bus, sorted({*owned, *bus.broadcast_ping()}))
            )


_BOOT_S = 1.0  # a servo answers again by then


def reboot_all(place: BusEndpoint, rig: RigFile, dxl_ids: Sequence[int] = ()) -> RebootOut:
    """Restart servos of a rig, all or some, torque off; DeviceError if the port cannot be opened."""
    rate = rig.bus.baudrate_bps
    with closing(_bus(place, rate, shared=False)) as bus:
        chosen = [servo for servo in rig.servos if not dxl_ids or servo.dxl_id in dxl_ids]
        servos = tuple(_reboot(bus, place.clock, servo) for servo in chosen)
    well = all(servo.problem is None and not servo.again for servo in servos)
    return RebootOut.of(place, baudrate_bps=rate, well=well, servos=servos)


def _reboot(bus: Bus, clock: Clock, spec: RigServo) -> RebootedServoOut:
    latched = again = HardwareError(0)
    problem: str | None = None
    servo = Servo(bus, spec.dxl_id, spec.model)
    try:
        servo.check()
        latched = bus.hardware_error(spec.dxl_id)
        bus.reboot(spec.dxl_id)
        clock.sleep(_BOOT_S)
        again = bus.hardware_error(spec.dxl_id)
    except DeviceError as error:
        problem = str(error)
    # one that switches torque on as it starts is stopped here
    problem = next((str(error) for error in disable_torque(bus, [servo])), problem)
    return RebootedServoOut(
        id=spec.dxl_id,
        owner=spec.owner,
        latched=error_names(latched),
        again=error_names(again),
        problem=problem,
    )


def _bus(place: BusEndpoint, baudrate: int, *, shared: bool) -> Bus:
    return Bus(place.open(baudrate, shared=shared), place.clock, baudrate, latency_s=place.latency_s)


def _stop_result(
    place: BusEndpoint, baudrate: int, told: int, problems: Mapping[int, DeviceError | None] | None
) -> StopOut:
    owners = {servo.dxl_id: servo.owner for servo in list_servos(place.rig)}
    servos = tuple(
        StoppedServoOut(
            id=dxl_id,
            owner=owners.get(dxl_id),
            off=problem is None,
            problem=None if problem is None else str(problem),
        )
        for dxl_id, problem in (problems or {}).items()
    )
    return StopOut.of(
        place,
        baudrate_bps=baudrate,
        told=told,
        taken=problems is None,
        confirmed=bool(servos) and all(servo.off for servo in servos),
        servos=servos,
    )
