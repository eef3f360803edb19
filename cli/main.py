"""The command line: `identify`, `replay`, `recognize`, `plan`, `emulate`; more in `devices` and `objects`.

Errors become one line and an exit code. Results go to stdout (with `--json` one object), everything for
people while it works to stderr. Exit codes: 0 done, 1 not resolved, 2 usage or configuration, 3 device,
4 safety stop, 5 log or disk failed, 129 terminal closed, 130 interrupted, 143 terminated.
"""

import errno
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from typer.exceptions import TyperException

from palpate.cli import devices, objects
from palpate.errors import DeviceError, OutputError, PalpateError, SafetyStop, printable
from palpate.rig.session.signals import INTERRUPTS, Interrupted
from palpate.vocabulary import Strategy

__all__ = ["ExitCode", "app", "main"]

app = typer.Typer(
    name="palpate",
    help="Identifies the known object on a table, its stable state and its exact place, from a few touches.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class ExitCode(IntEnum):
    """How a command ended. A signal's code is 128 + its number, as shells have it."""

    DONE = 0
    NOT_RESOLVED = 1
    INPUT = 2
    DEVICE = 3
    SAFETY = 4
    OUTPUT = 5
    HUNG_UP = 128 + signal.SIGHUP
    INTERRUPTED = 128 + signal.SIGINT
    TERMINATED = 128 + signal.SIGTERM


RigOption = Annotated[
    Path | None, typer.Option("--rig", help="Rig file (TOML); without it, the shipped emulated rig.")
]
NoCalibrationOption = Annotated[
    bool, typer.Option("--no-calibration", help="As if no calibration lay beside the rig file.")
]
ObjectsOption = Annotated[
    Path | None, typer.Option("--objects", help="Object models (JSON); without it, the six shipped ones.")
]
SceneOption = Annotated[
    Path | None, typer.Option("--scene", help="What lies on the table of an emulated rig (JSON).")
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Draws the scene and the emulated devices' errors.")
]
ContactsOption = Annotated[Path, typer.Option("--contacts", help="Contacts so far (JSON).")]
StrategyOption = Annotated[
    Strategy,
    typer.Option(
        "--strategy",
        help="How grips are chosen: to distinguish most, at random, or beside the last touches.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
PictureOption = Annotated[Path | None, typer.Option("--picture", help="Also write a picture (SVG) here.")]


_KINDS: dict[type[PalpateError], tuple[str, ExitCode]] = {
    DeviceError: ("device error", ExitCode.DEVICE),
    SafetyStop: ("safety stop", ExitCode.SAFETY),
    OutputError: ("output error", ExitCode.OUTPUT),
    PalpateError: ("error", ExitCode.INPUT),
}


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"palpate {installed('palpate')}")
        raise typer.Exit


@app.command()
def identify(
    rig: RigOption = None,
    objects: ObjectsOption = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
    picture: PictureOption = None,
    strategy: StrategyOption = Strategy.PLANNED,
    sessions: Annotated[Path, typer.Option("--sessions", help="Folder for session logs.")] = Path(
        "palpate-sessions"
    ),
    no_calibration: NoCalibrationOption = False,
) -> None:
    """Touch what lies on the table until it is known which object it is and where."""
    from palpate.cli.identify import run_identify

    raise typer.Exit(
        run_identify(
            rig=rig,
            objects=objects,
            scene=scene,
            seed=seed,
            json=json,
            picture=picture,
            sessions=sessions,
            strategy=strategy.value,
            calibration=not no_calibration,
        )
    )


@app.command()
def replay(
    session: Annotated[Path, typer.Argument(help="A session's folder.", show_default=False)],
    json: JsonOption = False,
) -> None:
    """Run a recorded session again, against what was recorded; no device is needed, nothing moves.

    Exit code 0: every byte sent and the result are as recorded, 1: something differs, 2: not a whole session.
    """
    from palpate.cli.replay import run_replay

    raise typer.Exit(run_replay(session, json=json))


@app.command()
def recognize(
    objects: Annotated[Path, typer.Option("--objects", help="Object models (JSON).")],
    contacts: ContactsOption,
    json: JsonOption = False,
    picture: PictureOption = None,
    max_spurious: Annotated[
        int, typer.Option("--max-spurious", min=0, help="As many contacts need not be the object's.")
    ] = 0,
    why: Annotated[
        str | None,
        typer.Option("--why", metavar="OBJECT[/STATE]", help="Also say why this object was ruled out."),
    ] = None,
    statistics: Annotated[
        bool, typer.Option("--statistics", help="Also count interpretations as the memo's tables do.")
    ] = False,
) -> None:
    """Say which objects, states and configurations agree with a file of contacts."""
    from palpate.cli.recognize import run_recognize

    raise typer.Exit(
        run_recognize(
            objects=objects,
            contacts=contacts,
            json=json,
            picture=picture,
            max_spurious=max_spurious,
            asked=why,
            statistics=statistics,
        )
    )


@app.command()
def plan(
    contacts: ContactsOption,
    rig: RigOption = None,
    objects: ObjectsOption = None,
    strategy: StrategyOption = Strategy.PLANNED,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws the grip of --strategy random.")] = 0,
    json: JsonOption = False,
    picture: PictureOption = None,
    no_calibration: NoCalibrationOption = False,
) -> None:
    """Plan the next grip, and say what each hypothesis predicts of it.

    Exit code 1: nothing fits, or nothing within reach tells apart what does.
    """
    from palpate.cli.plan import run_plan

    raise typer.Exit(
        run_plan(
            rig=rig,
            objects=objects,
            contacts=contacts,
            strategy=strategy.value,
            seed=seed,
            json=json,
            picture=picture,
            calibration=not no_calibration,
        )
    )


@app.command()
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
    seconds: Annotated[
        float | None, typer.Option("--for", min=0.0, help="End after this many seconds.")
    ] = None,
    rig_out: Annotated[
        Path | None, typer.Option("--rig-out", help="Write a rig file that uses the served ports.")
    ] = None,
) -> None:
    """Serve the emulated devices to other programs; print the ports as JSON, then serve until interrupted."""
    from palpate.cli.emulate import run_emulate

    raise typer.Exit(
        run_emulate(
            rig=rig,
            objects=objects,
            scene=scene,
            seed=seed,
            seconds=seconds,
            rig_out=rig_out,
            pty=pty,
            tcp_port=tcp_port,
        )
    )


devices.add_to(app)
objects.add_to(app)


def main() -> None:
    """Run the command line; ends the process with an `ExitCode`."""
    _fill_closed_streams()
    for number in INTERRUPTS:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
            signal.signal(number, _interrupt)
    sys.exit(_guarded())


def _fill_closed_streams() -> None:
    """Open what the caller has closed of the standard streams: no port or log may get their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one


def _guarded() -> int:
    try:
        # In its own "standalone" mode typer would print several lines for an error.
        return _flushed(int(app(standalone_mode=False) or 0))
    except typer.Exit as end:
        return _flushed(int(end.exit_code))
    except TyperException as error:
        problem = error.format_message()  # empty where no command was given, and the help has been shown
        return _say(f"error: {problem}", ExitCode.INPUT) if problem else _flushed(ExitCode.INPUT)
    except (Interrupted, PalpateError, MemoryError) as error:
        return _report(error)
    except OSError as error:
        return _unprinted(error)


def _report(error: Interrupted | PalpateError | MemoryError) -> int:
    """Say what ended the command."""
    match error:
        case Interrupted():
            return _say("interrupted", ExitCode(128 + error.signal), _notes(error))
        case MemoryError():
            return _say("error: out of memory", ExitCode.OUTPUT, _notes(error))
    word, code = next(found for kind, found in _KINDS.items() if isinstance(error, kind))
    return _say(f"{word}: {error}", code, _notes(error))


def _flushed(code: int) -> int:
    try:
        if sys.stdout is not None:  # it is None if the caller has closed it
            sys.stdout.flush()
    except OSError as error:
        return _unprinted(error)
    return code


def _unprinted(error: OSError) -> int:
    """What a command ends with whose standard output, or error output, takes nothing more."""
    with suppress(OSError):  # or the interpreter tries once more, and complains
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if error.errno == errno.EPIPE:
        return ExitCode.OUTPUT  # whoever read it has heard enough
    return _say(f"error: the output cannot be written: {error.strerror or error}", ExitCode.OUTPUT)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Unwind once; further signals wait until torque is off."""
    del frame
    for other in INTERRUPTS:
        signal.signal(other, signal.SIG_IGN)
    raise Interrupted(signal.Signals(number))


def _notes(error: BaseException) -> list[str]:
    return getattr(error, "__notes__", [])


def _say(message: str, code: int, notes: Sequence[str] = ()) -> int:
    with suppress(OSError):
        for line in (message, *notes):
            typer.echo(printable(line), err=True)
    return code
