"""The result of a scan, for the terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.base.errors import counted
from palpate.config.scan_result import ScanOut
from palpate.views.tables import folded, table

__all__ = ["show"]


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
