"""`palpate find-port`: which serial port is the adapter on the table, and what to write into the rig file."""

from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption

__all__ = ["find_port"]


@if_interrupted("nothing was changed")
def find_port(
    only_list: Annotated[bool, typer.Option("--list", help="Only list the ports; ask nothing.")] = False,
    json: JsonOption = False,
) -> int:
    """List serial ports; find out which is yours by unplugging it.

    Without a terminal it only lists. Exit code 3: there is no port.
    """
    from palpate.cli.terminal import Terminal, can_ask
    from palpate.config.results import to_json
    from palpate.drivers.transport.clock import MonotonicClock
    from palpate.drivers.transport.serial_ports import serial_ports
    from palpate.rig.diagnostics.port_search import find_unplugged, ports_out
    from palpate.views.ports_table import show, show_unplugged

    console = Terminal(stderr=json, soft_wrap=True)
    ports = serial_ports()
    show(ports, console)
    asks = ports and not only_list and can_ask()
    found = find_unplugged(serial_ports, _ask, MonotonicClock()) if asks else ()
    if asks:
        show_unplugged(found, console)
    if json:
        typer.echo(to_json(ports_out(ports, found[0] if found else None)))
    return 0 if ports else 3


def _ask(what: str) -> bool:
    try:
        text = typer.prompt(f"{what}, then press Enter (q ends)", default="", show_default=False, err=True)
    except typer.Abort:
        return False
    return not str(text).strip().lower().startswith("q")
