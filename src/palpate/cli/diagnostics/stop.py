"""`palpate stop`: torque off on every servo, now, also beside a palpate that is using the port."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, PortOption

__all__ = ["stop"]


@if_interrupted("NOT confirmed that torque is off")
def stop(
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file (TOML).")] = None,
    port: PortOption = None,
    baud: Annotated[
        int | None, typer.Option("--baud", help="Baud rate, with --port; 1000000 if left out.")
    ] = None,
    json: JsonOption = False,
) -> int:
    """Switch torque off on every servo, now, beside whatever runs.

    Exit code 0 only if every servo has confirmed it. No substitute for a switch that cuts the power.
    """
    from palpate.cli.terminal import Terminal
    from palpate.config.results import to_json
    from palpate.jobs import bus
    from palpate.views.stop_text import show

    out = bus.stop(port=port, rig=rig, baudrate=baud)
    if json:
        typer.echo(to_json(out))
    show(out, Terminal(stderr=json, soft_wrap=True))
    return 0 if out.confirmed else 3
