"""`palpate scan`: which servos hang on a bus, at which baud rates and ids, and what is wrong with that."""

from collections.abc import Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.cli.terminal import Doing, Terminal
from palpate.config.results import to_json
from palpate.config.rig_tables import BUS_BAUDRATES
from palpate.config.scan_result import ScannedServoOut, ScanOut
from palpate.drivers.dynamixel.bus_scan import ALL_IDS, FoundServo, Scan, model_name, scan
from palpate.drivers.dynamixel.models import models_known
from palpate.drivers.dynamixel.packet import MAX_ID
from palpate.drivers.transport.port import has_baudrate
from palpate.errors import InputError, counted
from palpate.rig.diagnostics.bus_selection import BusEndpoint, RigServo, find_endpoint, list_servos

__all__ = ["ids_of", "run_scan"]

_FACTORY_BAUDRATE = 57_600
_USUAL_BAUDRATE = 1_000_000


def run_scan(
    *, rig: Path | None, port: str | None, baudrates: Sequence[int], ids: str | None, json: bool
) -> int:
    """Scan and show; returns the exit code: 3 if nothing answers, or not as the rig file says."""
    wanted = ALL_IDS if ids is None else ids_of(ids)
    _check_rates(baudrates)
    place = find_endpoint(rig, port)
    rates = _rates(baudrates, place)
    console = Terminal(stderr=True, soft_wrap=True)
    with Doing(console, f"scanning {place.port}") as doing:

        def tell(baudrate: int, dxl_id: int | None) -> None:
            doing.now(
                f"scanning {place.port} at {baudrate} baud" + ("" if dxl_id is None else f", id {dxl_id}")
            )

        found = scan(place.open, place.clock, rates, wanted, latency_s=place.latency_s, tell=tell)
    out = scan_out(place, found, rates, wanted)
    if json:
        typer.echo(to_json(out))
    show(out, console if json else Terminal(soft_wrap=True), console)
    return 0 if _is_well(out, list_servos(place.rig), place.baudrate) else 3


def ids_of(text: str) -> list[int]:
    """The ids of "1-20", "1,2,11-16" and the like, in order. Raises InputError."""
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise InputError(
                f'--ids "{text}": "{part}" is neither an id nor a range; write them as 1-20 or 1,5'
            )
        low, high = int(first), int(last or first)
        if not low <= high <= MAX_ID:
            raise InputError(f'--ids "{text}": "{part}" is not a range within 0-{MAX_ID}')
        found.update(range(low, high + 1))
    return sorted(found)


def scan_out(place: BusEndpoint, found: Scan, rates: Sequence[int], ids: Sequence[int]) -> ScanOut:
    """What was found beside what the rig file says."""
    owned = {servo.dxl_id: servo for servo in list_servos(place.rig)}
    servos = tuple(_servo_out(item, owned) for item in found.found)
    warnings = [
        *(f"{rate} baud could not be tried: {reason}" for rate, reason in found.refused.items()),
        *_servo_warnings(servos),
        *_rig_warnings(servos, [owned[i] for i in sorted(owned) if i in ids], place.baudrate),
    ]
    return ScanOut(
        port=place.port,
        emulated=place.emulated,
        baudrates_bps=tuple(rate for rate in rates if rate not in found.refused),
        ids=tuple(ids),
        servos=servos,
        warnings=tuple(warnings),
    )


def show(out: ScanOut, console: Console, warn: Console) -> None:
    """The table for a person; warnings below it."""
    if out.servos:
        console.print(_table(out))
    rates = counted(len(out.baudrates_bps), "baud rate", "baud rates")
    ids = f"id {out.ids[0]}" if len(out.ids) == 1 else f"ids {out.ids[0]} to {out.ids[-1]}"
    count = counted(len(out.servos), "servo", "servos") if out.servos else "no servo"
    emulated = " (emulated)" if out.emulated else ""
    console.print(f"{count} on {escape(out.port)}{emulated}; {rates}, {ids}", highlight=False)
    if not out.servos:
        warn.print("nothing answers: check the servos' power, the cable, and the port (`palpate find-port`)")
    for warning in out.warnings:
        warn.print(f"[yellow]warning:[/] {escape(warning)}", highlight=False)


def _table(out: ScanOut) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("baud", "id"):
        table.add_column(name, justify="right")
    table.add_column("model")
    table.add_column("firmware", justify="right")
    table.add_column("in the rig file" if any(servo.owner for servo in out.servos) else "")
    for servo in out.servos:
        model = servo.model or ("?" if servo.model_number is None else f"unknown ({servo.model_number})")
        table.add_row(
            str(servo.baudrate_bps),
            str(servo.id),
            model + (" [red](several?)[/]" if servo.crowded else ""),
            "?" if servo.firmware is None else str(servo.firmware),
            escape(servo.owner or ""),
        )
    return table


def _check_rates(given: Sequence[int]) -> None:
    for rate in given:
        if rate <= 0:
            raise InputError(f"--baud {rate}: a baud rate is positive, such as {_FACTORY_BAUDRATE}")


def _rates(given: Sequence[int], place: BusEndpoint) -> Sequence[int]:
    """Baud rates to try. Where the port has none of its own, every servo would be found at each of them."""
    if given:
        return list(dict.fromkeys(given))
    return BUS_BAUDRATES if has_baudrate(place.port) else [place.baudrate or _USUAL_BAUDRATE]


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


def _is_well(out: ScanOut, owned: Sequence[RigServo], baudrate: int | None) -> bool:
    """Whether something answers, nobody shares an id, and the rig's servos are there as they should be."""
    models = {servo.id: servo.model for servo in out.servos if servo.baudrate_bps == baudrate}
    return (
        bool(out.servos)
        and not any(servo.crowded for servo in out.servos)
        and all(models.get(servo.dxl_id) == servo.model for servo in owned if servo.dxl_id in out.ids)
    )
