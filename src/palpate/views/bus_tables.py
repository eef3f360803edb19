"""Servos of a bus for the terminal: those that answered a scan, and those that confirmed a stop."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.base.errors import quantity
from palpate.config.commissioning_results import ScanOut, StopOut
from palpate.views.tables import folding_column, table


def show_scan(out: ScanOut, console: Console, warn: Console) -> None:
    """The table for a person; warnings below it."""
    if out.servos:
        console.print(_servo_table(out))
    rates = quantity(len(out.baudrates_bps), "baud rate", "baud rates")
    ids = f"id {out.ids[0]}" if len(out.ids) == 1 else f"ids {out.ids[0]} to {out.ids[-1]}"
    count = quantity(len(out.servos), "servo", "servos") if out.servos else "no servo"
    emulated = " (emulated)" if out.emulated else ""
    console.print(f"{count} on {escape(out.port)}{emulated}; {rates}, {ids}", highlight=False)
    if not out.servos:
        warn.print("nothing answers: check the servos' power, the cable, and the port (`palpate find-port`)")
    for warning in out.warnings:
        warn.print(f"[yellow]warning:[/] {escape(warning)}", highlight=False)


def _servo_table(out: ScanOut) -> Table:
    owner = folding_column("in the rig file" if any(servo.owner for servo in out.servos) else "")
    numbers = "baud", "id", "firmware"
    rows = table("baud", "id", folding_column("model"), "firmware", owner, numbers=numbers)
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


def show_stop(out: StopOut, console: Console) -> None:
    """Say which servos have confirmed that torque is off, and what to do about the others."""

    def say(text: str, style: str) -> None:
        console.print(text, style=style, highlight=False, markup=False)

    where = f"on {out.port} at {out.baudrate_bps} baud{' (emulated)' if out.emulated else ''}"
    off = [servo for servo in out.servos if servo.off]
    ids = ", ".join(str(servo.id) for servo in off)
    if off:
        say(f"torque is off, confirmed: {quantity(len(off), 'servo', 'servos')} {where} ({ids})", "green")
    for servo in out.servos:
        if not servo.off:
            name = f"servo {servo.id}" + (f" ({servo.owner})" if servo.owner else "")
            say(f"NOT confirmed: {name}: {servo.problem}", "bold red")
    if out.taken:
        say(
            f"NOT confirmed: another program is using {out.port}; every servo {where} was sent "
            f"Torque Enable = 0 {out.told} times",
            "bold red",
        )
    elif not out.servos:
        say(f"NOT confirmed: no servo answers {where}; is it the right port and baud rate?", "bold red")
    if not out.confirmed:
        say("if anything may still move, cut the servos' power", "bold red")
