"""Scan of a servo bus: which servos answer, at which baud rates and ids, and how the rig file differs."""

from collections.abc import Callable, Sequence

from palpate.config.rig_tables import BUS_BAUDRATES
from palpate.config.scan_result import ScannedServoOut, ScanOut
from palpate.drivers.dynamixel.bus_scan import ALL_IDS, FoundServo, Scan, model_name, scan
from palpate.drivers.dynamixel.models import models_known
from palpate.drivers.dynamixel.specifications import supply_warnings
from palpate.drivers.transport.port import has_baudrate
from palpate.rig.diagnostics.bus_selection import BusEndpoint, RigServo, list_servos

__all__ = ["is_well", "scan_bus", "scan_result", "usual_baudrates"]

_USUAL_BAUDRATE = 1_000_000


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
    rates = list(dict.fromkeys(baudrates)) or usual_baudrates(place)
    return scan_result(
        place, scan(place.open, place.clock, rates, ids, latency_s=place.latency_s, tell=tell), rates, ids
    )


def usual_baudrates(place: BusEndpoint) -> Sequence[int]:
    """Baud rates to try on a bus: one where the port has none of its own, and all would find the same."""
    return BUS_BAUDRATES if has_baudrate(place.port) else [place.baudrate or _USUAL_BAUDRATE]


def scan_result(place: BusEndpoint, found: Scan, rates: Sequence[int], ids: Sequence[int]) -> ScanOut:
    """What was found beside what the rig file says."""
    owned = {servo.dxl_id: servo for servo in list_servos(place.rig)}
    servos = tuple(_servo_out(item, owned) for item in found.found)
    warnings = [
        *(f"{rate} baud could not be tried: {reason}" for rate, reason in found.refused.items()),
        *_servo_warnings(servos),
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


def is_well(out: ScanOut, place: BusEndpoint) -> bool:
    """Whether servos answer, each by an id of its own, and those of the rig are as its file says."""
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


def _servo_warnings(servos: Sequence[ScannedServoOut]) -> list[str]:
    crowded = [
        f"two servos or more seem to have id {servo.id} at {servo.baudrate_bps} baud: connect one at a time "
        "and give each its own (`palpate setup-motors`)"
        for servo in servos
        if servo.crowded
    ]
    unknown = [
        f"servo {servo.id} has model number {servo.model_number}, which is none of the {len(models_known())} "
        "that palpate knows"
        for servo in servos
        if servo.model is None and servo.model_number is not None
    ]
    return [*crowded, *unknown]


def _rig_warnings(
    servos: Sequence[ScannedServoOut], owned: Sequence[RigServo], baudrate: int | None
) -> list[str]:
    """What the rig file has otherwise."""
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
