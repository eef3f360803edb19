"""`palpate find-port`: which serial port is the adapter on the table, and what to write into the rig file."""

import sys
from collections.abc import Sequence

import typer
from rich.console import Console
from rich.markup import escape

from palpate.cli.terminal import Terminal
from palpate.config.results import to_json
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.serial_ports import SerialPort, serial_ports
from palpate.rig.diagnostics.latency_timer import timer_warnings
from palpate.rig.diagnostics.port_search import find_unplugged, ports_out, usb_id
from palpate.views.tables import folded, table

__all__ = ["run_find_port", "tell_found"]


def run_find_port(*, only_list: bool, json: bool) -> int:
    """List the ports, on a terminal also find one; returns the exit code: 3 if there is none."""
    console = Terminal(stderr=json, soft_wrap=True)
    ports = serial_ports()
    _show(ports, console)
    found: Sequence[SerialPort] = ()
    if ports and not only_list and sys.stdin.isatty():
        found = find_unplugged(serial_ports, _ask, MonotonicClock())
        tell_found(found, console)
    if json:
        typer.echo(to_json(ports_out(ports, found[0] if found else None)))
    return 0 if ports else 3


def tell_found(found: Sequence[SerialPort], console: Console) -> None:
    """What to write into the rig file, and what to set."""
    if not found:
        console.print("nothing was unplugged")
    for port in found:
        console.print(
            f"\n{port.kind or 'it'} is {port.device}; in the rig file:\n", highlight=False, markup=False
        )
        console.print(f'    port = "{port.name}"\n', highlight=False, markup=False)
        for warning in timer_warnings(port.device, port.latency_timer_s):
            console.print(warning, highlight=False, markup=False)


def _show(ports: Sequence[SerialPort], console: Console) -> None:
    if not ports:
        console.print("no serial port: plug in the adapter, and check its cable (some carry no data)")
        return
    names = "port", "what", "USB id", "serial number", "latency timer", "used by"
    rows = table(*map(folded, names))
    for port in ports:
        timer = "" if port.latency_timer_s is None else f"{port.latency_timer_s * 1e3:g} ms"
        slow = bool(timer_warnings(port.device, port.latency_timer_s))
        rows.add_row(
            escape(port.device) + ("" if port.permitted else " [red](not permitted)[/]"),
            escape(port.kind or ""),
            usb_id(port) or "",
            escape(port.serial_number or ""),
            f"[yellow]{timer}[/]" if slow else timer,
            escape(port.used_by or ""),
        )
    console.print(rows)
    for port in ports:
        if port.by_id is not None:
            console.print(
                f'{port.device} in a rig file: port = "{port.by_id}"', highlight=False, markup=False
            )
    if not all(port.permitted for port in ports):
        console.print("for ports that are not permitted: sudo usermod -aG dialout $USER, then log in again")


def _ask(what: str) -> bool:
    try:
        text = typer.prompt(f"{what}, then press Enter (q ends)", default="", show_default=False, err=True)
    except typer.Abort:
        return False
    return not str(text).strip().lower().startswith("q")
