"""`palpate init`: a commented rig file for the servos and arrays that answer."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.options import PortOption

__all__ = ["init"]

_SHIPPED_SCHEMA = "../schemas/rig.schema.json"


def init(
    port: PortOption = None,
    array: Annotated[
        list[str] | None, typer.Option("--array", help="Port of a tactile array; once for each finger.")
    ] = None,
    baud: Annotated[
        list[int] | None, typer.Option("--baud", help="Only at this baud rate; may be repeated.")
    ] = None,
    max_id: Annotated[int, typer.Option("--max-id", min=0, max=252, help="Largest id to ask.")] = 252,
    bench: Annotated[
        str | None,
        typer.Option(
            "--bench", help="Copy a rig that ships with palpate instead: bench, xm430-bench or xl330-bench."
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The rig file.")] = Path("rig.toml"),
) -> int:
    """Write a commented rig file for the servos and arrays that answer, and its schema. Moves nothing.

    Or, without hardware, a copy of one that ships with palpate (--bench).

    Servos are paired in order of their ids, the one next to the base first. What must be measured is marked
    MEASURE in the file; then `palpate check --rig FILE` says what is wrong.
    """
    from palpate.base.errors import DeviceError, InputError, counted
    from palpate.base.files.writing import check_places
    from palpate.cli.terminal import Terminal, print_notices
    from palpate.config.shipped import SHIPPED_RIGS, shipped_rig
    from palpate.drivers.dynamixel.specifications import supply_warnings
    from palpate.jobs import bus
    from palpate.rig.commissioning.new_rig import FoundArray, describe_array, rig_text

    if (port is None) == (bench is None):
        raise InputError("give --port, whose servos are asked, or --bench, a rig to be copied")
    if bench is not None and (array or baud):
        raise InputError("--array and --baud are for --port: a copied rig has its own")
    if bench is not None and bench not in SHIPPED_RIGS:
        raise InputError(f"--bench {bench}: palpate ships {', '.join(SHIPPED_RIGS)}")
    if out.exists():
        raise InputError(f"{out} is there already: choose another with --out, or remove it")
    schema = out.with_name("rig.schema.json")
    check_places({"--out": out, "the schema beside it": schema}, {})
    if bench is not None:
        text = shipped_rig(bench).read_text(encoding="utf-8").replace(_SHIPPED_SCHEMA, f"./{schema.name}")
        _write(out, text, schema)
        typer.echo(f"{out}: a copy of {bench}, whose devices are emulated; schema for editors in {schema}")
        typer.echo(f"then: palpate identify --rig {out}")
        return 0
    assert port is not None
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
    print_notices(supply_warnings(servo.model for servo in found.servos if servo.model is not None))
    text = rig_text(out.stem, port, found.servos, arrays)
    _write(out, text, schema)
    fingers = counted(text.count("[[fingers]]"), "finger", "fingers")
    marks = sum("MEASURE" in line or "CHANGE" in line for line in text.splitlines()[5:])
    typer.echo(f"{out}: {fingers}, {marks} values to measure or change; schema for editors in {schema}")
    typer.echo(f"then: palpate check --rig {out}")
    return 0


def _write(out: Path, text: str, schema: Path) -> None:
    from palpate.base.files.writing import write_text
    from palpate.config.schema import schema_text

    write_text(out, text)
    write_text(schema, schema_text("rig"))
