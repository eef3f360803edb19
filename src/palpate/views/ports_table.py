"""Serial ports for the terminal: which there are, and what to write into the rig file.

By itself: pyserial's list of ports takes 20 ms, which neither `scan` nor `stop` should wait for.
"""

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape

from palpate.drivers.transport import SerialPort
from palpate.rig.diagnostics.host_ports import Computer, is_timer_long, usb_id
from palpate.views.tables import folding_column, table


def show_unplugged(found: Sequence[SerialPort], console: Console) -> None:
    """Say what to write into the rig file, and what to set."""
    if not found:
        console.print("nothing was unplugged")
    for port in found:
        console.print(
            f"\n{port.kind or 'it'} is {port.device}; in the rig file:\n", highlight=False, markup=False
        )
        console.print(f'    port = "{port.name}"\n', highlight=False, markup=False)
        if port.latency_timer_s is not None and is_timer_long(port.latency_timer_s):
            console.print(
                f"the adapter holds every answer back for up to {port.latency_timer_s * 1e3:g} ms (its "
                "latency timer); 1 ms is set until it is unplugged by: echo 1 | sudo tee "
                f"{Computer().latency_timer_path(port.device)}",
                highlight=False,
                markup=False,
            )


def show_ports(ports: Sequence[SerialPort], console: Console) -> None:
    """The table of all ports, and what to write into a rig file for each."""
    if not ports:
        console.print("no serial port: plug in the adapter, and check its cable (some carry no data)")
        return
    names = "port", "what", "USB id", "serial number", "latency timer", "used by"
    rows = table(*map(folding_column, names))
    for port in ports:
        timer = "" if port.latency_timer_s is None else f"{port.latency_timer_s * 1e3:g} ms"
        slow = is_timer_long(port.latency_timer_s)
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
