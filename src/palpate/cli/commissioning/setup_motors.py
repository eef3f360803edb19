"""`palpate setup-motors`: gives each servo of a rig its id, baud rate and limits, one at a time."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption

__all__ = ["setup_motors"]


@if_interrupted("nothing was written")
def setup_motors(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).")],
    dxl_id: Annotated[
        list[int] | None, typer.Option("--id", help="Only this servo of the rig file; may be repeated.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Write to EEPROM without asking.")] = False,
    json: JsonOption = False,
) -> int:
    """Give each servo its id, baud rate and limits, one at a time. Needs a terminal.

    Exit code 1: a servo was skipped. 3: a servo is not done.
    """
    from palpate.cli.commissioning.motor_dialogue import set_up_motors
    from palpate.cli.terminal import check_can_ask, print_notices
    from palpate.config import load_rig
    from palpate.drivers.dynamixel.specifications import supply_warnings
    from palpate.rig.diagnostics.bus_selection import check_dxl_ids, endpoint_of_rig, list_servos

    rig_file = load_rig(rig)
    check_dxl_ids(rig_file, dxl_id or [])
    check_can_ask(
        "servos are connected one after the other", "run it in one (--yes answers only whether to write)"
    )
    print_notices(supply_warnings(servo.model for servo in list_servos(rig_file)))
    return set_up_motors(rig_file, endpoint_of_rig(rig_file), dxl_id or [], yes=yes, json=json)
