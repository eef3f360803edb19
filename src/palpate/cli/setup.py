"""Commands that set up a rig: rig file and schema, ports, servos, torque off, and emulated devices."""

import json
from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import InputError
from palpate.cli.terminal import (
    JsonOption,
    ObjectsOption,
    PortOption,
    RigOption,
    SceneOption,
    SeedOption,
    note_on_interruption,
)


@note_on_interruption("nothing was changed")
def find_port(
    only_list: Annotated[bool, typer.Option("--list", help="Only list the ports; ask nothing.")] = False,
    json: JsonOption = False,
) -> int:
    """List serial ports; find out which is yours by unplugging it.

    Without a terminal it only lists. Exit code 3: there is no port.
    """
    from palpate.cli.terminal import Terminal, can_ask
    from palpate.config.fields import to_json
    from palpate.drivers.transport import MonotonicClock, serial_ports
    from palpate.rig.diagnostics.host_ports import find_unplugged, ports_out
    from palpate.views.tables import show_ports, show_unplugged

    console = Terminal(stderr=json, soft_wrap=True)
    ports = serial_ports()
    show_ports(ports, console)
    asks = ports and not only_list and can_ask()
    found = find_unplugged(serial_ports, _ask_to_unplug, MonotonicClock()) if asks else ()
    if asks:
        show_unplugged(found, console)
    if json:
        typer.echo(to_json(ports_out(ports, found[0] if found else None)))
    return 0 if ports else 3


def _ask_to_unplug(what: str) -> bool:
    try:
        text = typer.prompt(f"{what}, then press Enter (q ends)", default="", show_default=False, err=True)
    except typer.Abort:
        return False
    return not str(text).strip().lower().startswith("q")


_FACTORY_BAUDRATE = 57_600


@note_on_interruption("nothing was written")
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
    from palpate.cli.terminal import StatusLine, Terminal
    from palpate.config.fields import to_json
    from palpate.drivers.dynamixel import ALL_IDS
    from palpate.rig.diagnostics.servo_bus import find_endpoint, is_scan_well, scan_bus
    from palpate.views.tables import show_scan

    wanted = ALL_IDS if ids is None else parse_ids(ids)
    for rate in baud or ():
        if rate <= 0:
            raise InputError(f"--baud {rate}: a baud rate is positive, such as {_FACTORY_BAUDRATE}")
    place = find_endpoint(rig, port)
    console = Terminal(stderr=True, soft_wrap=True)
    with StatusLine(console, f"scanning {place.port}") as doing:

        def tell(baudrate: int, dxl_id: int | None) -> None:
            doing.now(
                f"scanning {place.port} at {baudrate} baud" + ("" if dxl_id is None else f", id {dxl_id}")
            )

        out = scan_bus(place, baud or [], wanted, tell)
    if json:
        typer.echo(to_json(out))
    show_scan(out, console if json else Terminal(soft_wrap=True), console)
    return 0 if is_scan_well(out, place) else 3


def parse_ids(text: str) -> list[int]:
    """The ids of "1-20", "1,2,11-16" and the like, in order. Raises InputError."""
    from palpate.drivers.dynamixel import MAX_ID

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


@note_on_interruption("NOT confirmed that torque is off")
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
    from palpate.config.fields import to_json
    from palpate.jobs import bus
    from palpate.views.tables import show_stop

    out = bus.stop(port=port, rig=rig, baudrate=baud)
    if json:
        typer.echo(to_json(out))
    show_stop(out, Terminal(stderr=json, soft_wrap=True))
    return 0 if out.confirmed else 3


@note_on_interruption("servos may have restarted; torque is off in those")
def reboot(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).", show_default=False)],
    dxl_id: Annotated[
        list[int] | None, typer.Option("--id", help="Only this servo of the rig file; may be repeated.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Restart them without asking.")] = False,
    json: JsonOption = False,
) -> int:
    """Restart servos, which clears latched hardware errors. Torque goes off, and turn counts are lost.

    Exit code 3: a servo is not back, or reports an error again.
    """
    from palpate.cli.terminal import Terminal, check_can_ask
    from palpate.config.fields import to_json
    from palpate.jobs import bus
    from palpate.views.tables import show_reboot

    if not yes:
        check_can_ask("servos are going to restart", "say --yes if they may")
        which = "all servos" if not dxl_id else f"servo {', '.join(map(str, dxl_id))}"
        if not typer.confirm(f"restart {which}? torque goes off, and what they hold up falls", err=True):
            raise InputError("nothing was restarted: the question was not answered with yes")
    out = bus.reboot(rig=rig, ids=dxl_id or ())
    if json:
        typer.echo(to_json(out))
    show_reboot(out, Terminal(stderr=json, soft_wrap=True))
    return 0 if out.well else 3


_LOOPBACK = "127.0.0.1"
_SERVED_LATENCY_MS = 100  # two processes share the computer: the devices' may have to wait for its turn


def emulate(
    rig: RigOption = None,
    objects: ObjectsOption = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    pty: Annotated[
        bool,
        typer.Option("--pty/--tcp", help="Serve on pseudo-terminals, or on TCP ports of this computer."),
    ] = True,
    tcp_port: Annotated[
        int | None,
        typer.Option(
            "--tcp-port", min=1, max=65535, help="With --tcp: the first port; any free ones without it."
        ),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option("--host", help="With --tcp: this computer's address to serve on; 127.0.0.1 without it."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--for", min=0.0, help="End after this many seconds.")
    ] = None,
    rig_out: Annotated[
        Path | None, typer.Option("--rig-out", help="Write a rig file that uses the served ports.")
    ] = None,
) -> None:
    """Serve the emulated devices to other programs; print the ports as JSON, then serve until interrupted."""
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import rig_files, scene_files
    from palpate.config import shipped_rig
    from palpate.jobs.rig import open_rig

    if pty and tcp_port is not None:
        raise InputError("--tcp-port is for --tcp; pseudo-terminals have no port numbers")
    if pty and host is not None:
        raise InputError("--host is for --tcp; pseudo-terminals have no address")
    if host is not None and not host.startswith("127."):
        typer.echo(
            f"warning: whoever reaches {host} over the network can drive these devices, unasked",
            err=True,
        )
    opened = open_rig(rig, seed=seed, calibration=False)
    check_places({"--rig-out": rig_out}, {**rig_files(rig), "--objects": objects, **scene_files(scene)})
    served = opened.serve(objects, scene=scene, pty=pty, tcp_port=tcp_port or 0, host=host or _LOOPBACK)
    with served as service:
        if rig_out is not None:
            text = (rig or shipped_rig()).read_text(encoding="utf-8")
            write_text(rig_out, _replace_ports(text, service.paths))
        typer.echo(json.dumps({"format": "palpate/ports@1", "ports": service.paths}))
        service.wait(seconds)


def _replace_ports(text: str, paths: dict[str, str]) -> str:
    """The rig file with its mock ports replaced and without its emulation table; comments are kept."""
    import tomlkit

    from palpate.drivers.transport import connection_of

    document = tomlkit.parse(text)
    document.pop("emulation", None)
    bus = document["bus"]
    bus["latency_ms"] = _SERVED_LATENCY_MS
    bus["port"] = paths[str(bus["port"])]
    for finger in document["fingers"]:
        port = str(finger["array"].get("port", ""))
        connection = connection_of(port)
        if connection in paths:  # a finger that senses by Present Current has no array
            finger["array"]["port"] = paths[connection] + port.removeprefix(connection)
    return tomlkit.dumps(document)


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
