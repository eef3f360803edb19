"""`palpate init`: a commented rig file for the servos and arrays that answer."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["init"]


def init(
    port: Annotated[str, typer.Option("--port", help="Port of the servos' bus.", show_default=False)],
    array: Annotated[
        list[str] | None, typer.Option("--array", help="Port of a tactile array; once for each finger.")
    ] = None,
    baud: Annotated[
        list[int] | None, typer.Option("--baud", help="Only at this baud rate; may be repeated.")
    ] = None,
    max_id: Annotated[int, typer.Option("--max-id", min=0, max=252, help="Largest id to ask.")] = 252,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The rig file.")] = Path("rig.toml"),
) -> int:
    """Write a commented rig file for the servos and arrays that answer, and its schema. Moves nothing.

    Servos are paired in order of their ids, the one next to the base first. What must be measured is marked
    MEASURE in the file; then `palpate check --rig FILE` says what is wrong.
    """
    from palpate.api import bus
    from palpate.cli.terminal import Terminal
    from palpate.config.schema import schema_text
    from palpate.errors import DeviceError, InputError, counted
    from palpate.files.writing import check_place, write_text
    from palpate.rig.commissioning.new_rig import FoundArray, describe_array, rig_text

    if out.exists():
        raise InputError(f"{out} is there already: choose another with --out, or remove it")
    check_place(out)
    terminal = Terminal(stderr=True, highlight=False, markup=False)
    with terminal.status(f"asking servos on {port}"):
        found = bus.scan(port=port, baudrates=baud or (), ids=range(max_id + 1))
    arrays: list[FoundArray | str] = []
    for place in array or ():
        try:
            arrays.append(describe_array(place))
        except DeviceError as error:
            terminal.print(f"array: {error}")
            arrays.append(place)
    text = rig_text(out.stem, port, found.servos, arrays)
    write_text(out, text)
    schema = out.with_name("rig.schema.json")
    write_text(schema, schema_text("rig"))
    fingers = counted(text.count("[[fingers]]"), "finger", "fingers")
    marks = sum("MEASURE" in line or "CHANGE" in line for line in text.splitlines()[5:])
    typer.echo(f"{out}: {fingers}, {marks} values to measure or change; schema for editors in {schema}")
    typer.echo(f"then: palpate check --rig {out}")
    return 0
