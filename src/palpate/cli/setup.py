"""Commands that begin a rig: `init` and `schema` write its file and schema, `setup-motors` its servos."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.options import JsonOption, PortOption
from palpate.cli.terminal import note_on_interruption

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
    from palpate.base.errors import DeviceError, InputError, quantity
    from palpate.base.file_io import check_places
    from palpate.cli.terminal import Terminal, print_notices
    from palpate.config.loading import SHIPPED_RIGS, shipped_rig
    from palpate.drivers.dynamixel import supply_warnings
    from palpate.jobs import bus
    from palpate.rig.commissioning.new_rig_file import DescribedArray, describe_array, rig_text

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
        _write_rig_and_schema(out, text, schema)
        typer.echo(f"{out}: a copy of {bench}, whose devices are emulated; schema for editors in {schema}")
        typer.echo(f"then: palpate identify --rig {out}")
        return 0
    assert port is not None
    terminal = Terminal(stderr=True, highlight=False, markup=False)
    with terminal.status(f"asking servos on {port}"):
        found = bus.scan(port=port, baudrates=baud or (), ids=range(max_id + 1))
    arrays: list[DescribedArray | str] = []
    for place in array or ():
        try:
            arrays.append(describe_array(place))
        except DeviceError as error:
            terminal.print(f"array: {error}")
            arrays.append(place)
    print_notices(supply_warnings(servo.model for servo in found.servos if servo.model is not None))
    text = rig_text(out.stem, port, found.servos, arrays)
    _write_rig_and_schema(out, text, schema)
    fingers = quantity(text.count("[[fingers]]"), "finger", "fingers")
    marks = sum("MEASURE" in line or "CHANGE" in line for line in text.splitlines()[5:])
    typer.echo(f"{out}: {fingers}, {marks} values to measure or change; schema for editors in {schema}")
    typer.echo(f"then: palpate check --rig {out}")
    return 0


def _write_rig_and_schema(out: Path, text: str, schema: Path) -> None:
    from palpate.base.file_io import write_text
    from palpate.config.schema import schema_text

    write_text(out, text)
    write_text(schema, schema_text("rig"))


def schema(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Of a format; without it, all names are listed.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write it here instead of printing it.")
    ] = None,
) -> int:
    """Print the JSON Schema of a file format, or write it where an editor finds it.

    A rig file whose first line is `#:schema ./rig.schema.json` is checked and completed by editors that know
    TOML, after `palpate schema rig --out rig.schema.json` beside it.
    """
    from palpate.base.errors import InputError
    from palpate.base.file_io import check_place, write_text
    from palpate.config.schema import FORMATS, schema_text

    if name is None:
        if out is not None:
            raise InputError("--out is for one schema: name it")
        typer.echo("\n".join(sorted(FORMATS)))
        return 0
    if name not in FORMATS:
        raise InputError(f'there is no format "{name}"; there are {", ".join(sorted(FORMATS))}')
    if out is None:
        typer.echo(schema_text(name), nl=False)
        return 0
    check_place(out)
    write_text(out, schema_text(name))
    return 0


@note_on_interruption("nothing was written")
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
    from palpate.cli.motor_dialogue import set_up_motors
    from palpate.cli.terminal import check_can_ask, print_notices
    from palpate.config import load_rig
    from palpate.drivers.dynamixel import supply_warnings
    from palpate.rig.diagnostics.servo_bus import check_dxl_ids, endpoint_of_rig, list_servos

    rig_file = load_rig(rig)
    check_dxl_ids(rig_file, dxl_id or [])
    check_can_ask(
        "servos are connected one after the other", "run it in one (--yes answers only whether to write)"
    )
    print_notices(supply_warnings(servo.model for servo in list_servos(rig_file)))
    return set_up_motors(rig_file, endpoint_of_rig(rig_file), dxl_id or [], yes=yes, json=json)
