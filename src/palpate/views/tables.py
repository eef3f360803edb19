"""Tables on the terminal: their common style, without frames; the servos of a bus, and serial ports.

Without frames piped output is plain columns.
"""

from collections.abc import Collection, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from palpate.base.errors import quantity
from palpate.config.commissioning_results import RebootOut, ScanOut, StopOut
from palpate.drivers.transport import SerialPort
from palpate.rig.diagnostics.host_ports import Computer, is_timer_long, usb_id


def table(*columns: str | Column, numbers: Collection[str] = ()) -> Table:
    """A table without rows; columns in `numbers` are aligned right. On a narrow terminal cells are broken."""
    made = [_column(item, numbers) if isinstance(item, str) else item for item in columns]
    return Table(*made, box=None, pad_edge=False, header_style="bold")


def folding_column(name: str, width: int | None = None) -> Column:
    """A column of text that may be long: it is broken into lines, and never cut."""
    return Column(name, overflow="fold", width=width)


def _column(name: str, numbers: Collection[str]) -> Column:
    # Not no_wrap: for such columns rich takes the room of others, of marks and names first.
    return Column(name, justify="right" if name in numbers else "left", overflow="fold")


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


def show_reboot(out: RebootOut, console: Console) -> None:
    """Say of each servo what it had latched and whether it is back, and what its restart has cost."""
    for servo in out.servos:
        had = f"had latched {' and '.join(servo.latched)}" if servo.latched else "had latched no error"
        end, style = "has restarted, torque off", "green"
        if servo.problem is not None:
            end, style = f"NOT confirmed that it is back with torque off: {servo.problem}", "bold red"
        elif servo.again:
            end, style = f"reports {' and '.join(servo.again)} again: remove the cause first", "bold red"
        text = f"servo {servo.id} ({servo.owner}): {had}; {end}"
        console.print(text, style=style, highlight=False, markup=False)
    console.print(
        "turns are forgotten: the next run, or palpate home, homes slides with stops_mm; push others "
        "back by hand until they are retracted",
        highlight=False,
    )


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
