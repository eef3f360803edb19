"""`palpate scan`: which servos hang on a bus, at which baud rates and ids, and what is wrong with that."""

from collections.abc import Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.cli.terminal import Doing, Terminal
from palpate.config.results import to_json
from palpate.config.scan_result import ScanOut
from palpate.drivers.dynamixel.bus_scan import ALL_IDS
from palpate.drivers.dynamixel.packet import MAX_ID
from palpate.errors import InputError, counted
from palpate.rig.diagnostics.bus_selection import find_endpoint
from palpate.rig.diagnostics.scan_check import is_well, scan_bus
from palpate.views.tables import folded, table

__all__ = ["ids_of", "run_scan"]

_FACTORY_BAUDRATE = 57_600


def run_scan(
    *, rig: Path | None, port: str | None, baudrates: Sequence[int], ids: str | None, json: bool
) -> int:
    """Scan and show; returns the exit code: 3 if nothing answers, or not as the rig file says."""
    wanted = ALL_IDS if ids is None else ids_of(ids)
    _check_rates(baudrates)
    place = find_endpoint(rig, port)
    console = Terminal(stderr=True, soft_wrap=True)
    with Doing(console, f"scanning {place.port}") as doing:

        def tell(baudrate: int, dxl_id: int | None) -> None:
            doing.now(
                f"scanning {place.port} at {baudrate} baud" + ("" if dxl_id is None else f", id {dxl_id}")
            )

        out = scan_bus(place, baudrates, wanted, tell)
    if json:
        typer.echo(to_json(out))
    show(out, console if json else Terminal(soft_wrap=True), console)
    return 0 if is_well(out, place) else 3


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
    owner = folded("in the rig file" if any(servo.owner for servo in out.servos) else "")
    numbers = "baud", "id", "firmware"
    rows = table("baud", "id", folded("model"), "firmware", owner, numbers=numbers)
    for servo in out.servos:
        model = servo.model or ("?" if servo.model_number is None else f"unknown ({servo.model_number})")
        rows.add_row(
            str(servo.baudrate_bps),
            str(servo.id),
            model + (" [red](several?)[/]" if servo.crowded else ""),
            "?" if servo.firmware is None else str(servo.firmware),
            escape(servo.owner or ""),
        )
    return rows


def _check_rates(given: Sequence[int]) -> None:
    for rate in given:
        if rate <= 0:
            raise InputError(f"--baud {rate}: a baud rate is positive, such as {_FACTORY_BAUDRATE}")
