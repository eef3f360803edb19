"""`palpate scan`: which servos hang on a bus, at which baud rates and ids, and what is wrong with that."""

from typing import Annotated

import typer

from palpate.base.errors import InputError
from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, PortOption, RigOption

__all__ = ["ids_of", "scan"]

_FACTORY_BAUDRATE = 57_600


@if_interrupted("nothing was written")
def scan(
    port: PortOption = None,
    rig: RigOption = None,
    baud: Annotated[
        list[int] | None, typer.Option("--baud", help="Try this baud rate only; may be repeated.")
    ] = None,
    ids: Annotated[
        str | None,
        typer.Option("--ids", metavar="IDS", help="Look for these only, such as 1-20 or 1,5."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Find servos at every baud rate and id. Moves nothing.

    Exit code 3: nothing answers, two servos share an id, or the rig file says otherwise.
    """
    from palpate.cli.terminal import Doing, Terminal
    from palpate.config.results import to_json
    from palpate.drivers.dynamixel.bus_scan import ALL_IDS
    from palpate.rig.diagnostics.bus_selection import find_endpoint
    from palpate.rig.diagnostics.scan_check import is_well, scan_bus
    from palpate.views.scan_table import show

    wanted = ALL_IDS if ids is None else ids_of(ids)
    for rate in baud or ():
        if rate <= 0:
            raise InputError(f"--baud {rate}: a baud rate is positive, such as {_FACTORY_BAUDRATE}")
    place = find_endpoint(rig, port)
    console = Terminal(stderr=True, soft_wrap=True)
    with Doing(console, f"scanning {place.port}") as doing:

        def tell(baudrate: int, dxl_id: int | None) -> None:
            doing.now(
                f"scanning {place.port} at {baudrate} baud" + ("" if dxl_id is None else f", id {dxl_id}")
            )

        out = scan_bus(place, baud or [], wanted, tell)
    if json:
        typer.echo(to_json(out))
    show(out, console if json else Terminal(soft_wrap=True), console)
    return 0 if is_well(out, place) else 3


def ids_of(text: str) -> list[int]:
    """The ids of "1-20", "1,2,11-16" and the like, in order. Raises InputError."""
    from palpate.drivers.dynamixel.packet import MAX_ID

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
