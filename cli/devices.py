"""The commands for people who set a rig up: `find-port`, `scan`, `setup-motors`, `check`, `calibrate`,
`watch`, `stop`.

Registered on the command line's app by `add_to`.
"""

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted

__all__ = ["add_to"]

_RigOption = Annotated[
    Path | None, typer.Option("--rig", help="Rig file (TOML); without it, the shipped emulated rig.")
]
_PortOption = Annotated[str | None, typer.Option("--port", help="Port of the servos' bus.")]
_JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


_NoCalibrationOption = Annotated[
    bool, typer.Option("--no-calibration", help="As if no calibration lay beside the rig file.")
]
_PANEL = "Setting up a rig"


class _What(Enum):
    """What `calibrate` measures."""

    ALL = "all"
    TACTILE = "tactile"
    ACTUATORS = "actuators"
    FINGERS = "fingers"


def add_to(app: typer.Typer) -> None:
    """Add the commands to the app."""
    commands: dict[str, Callable[..., None]] = {
        "find-port": _find_port,
        "scan": _scan,
        "setup-motors": _setup,
        "check": _check,
        "calibrate": _calibrate,
        "watch": _watch,
        "stop": _stop,
    }
    for name, command in commands.items():
        app.command(name, rich_help_panel=_PANEL)(command)


def _scan(
    port: _PortOption = None,
    rig: _RigOption = None,
    baud: Annotated[
        list[int] | None, typer.Option("--baud", help="Try this baud rate only; may be repeated.")
    ] = None,
    ids: Annotated[
        str | None,
        typer.Option("--ids", metavar="IDS", help="Look for these only, such as 1-20 or 1,5."),
    ] = None,
    json: _JsonOption = False,
) -> None:
    """Find servos at every baud rate and id. Moves nothing.

    Exit code 3: nothing answers, two servos share an id, or the rig file says otherwise.
    """
    from palpate.cli.diagnostics.scan import run_scan

    with if_interrupted("nothing was written"):
        raise typer.Exit(run_scan(rig=rig, port=port, baudrates=baud or [], ids=ids, json=json))


def _check(
    rig: _RigOption = None,
    json: _JsonOption = False,
    no_calibration: _NoCalibrationOption = False,
    touch: Annotated[
        bool,
        typer.Option("--touch", help="Fingers move: touch a disc, and see if the calibration still holds."),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --touch: fingers may move, do not ask.")] = False,
    references: Annotated[
        Path | None, typer.Option("--references", help="With --touch: the disc (TOML); without it, 50 mm.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices.")] = 0,
) -> None:
    """Look at every servo, array and the bus of a rig. Moves nothing without --touch.

    Exit code 3: something is wrong, or touches do not agree with the calibration. Warnings alone: 0.
    """
    from palpate.cli.diagnostics.check import Touching, run_check

    wanted = Touching(references, yes=yes) if touch else None
    with if_interrupted("torque is off" if touch else "torque was left as it was"):
        raise typer.Exit(
            run_check(rig=rig, json=json, calibration=not no_calibration, touching=wanted, seed=seed)
        )


def _calibrate(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).", show_default=False)],
    what: Annotated[
        _What, typer.Argument(help="What to measure; what is not measured stays as it was.")
    ] = _What.ALL,
    references: Annotated[
        Path | None,
        typer.Option("--references", help="Disc and plate (TOML); without it, 50 mm and 80 mm square."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Fingers may move: do not ask.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and end.")] = False,
    restart: Annotated[
        bool, typer.Option("--restart", help="Forget a calibration that was begun before.")
    ] = False,
    json: _JsonOption = False,
) -> None:
    """Measure a rig and write its calibration beside the rig file. Fingers move.

    One that was interrupted is taken up where it ended.
    """
    from palpate.cli.commissioning.calibrate import run_calibrate
    from palpate.rig.commissioning.calibration import STEPS

    with if_interrupted("what was done is kept; the same command goes on from there"):
        raise typer.Exit(
            run_calibrate(
                rig=rig,
                steps=STEPS if what is _What.ALL else (what.value,),
                references=references,
                seed=seed,
                yes=yes,
                dry_run=dry_run,
                restart=restart,
                json=json,
            )
        )


def _watch(
    rig: _RigOption = None,
    session: Annotated[
        Path | None, typer.Option("--session", help="Play a recorded session's folder instead of a rig.")
    ] = None,
    finger: Annotated[
        list[str] | None, typer.Option("--finger", help="Only this finger of the rig; may be repeated.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", help="Frames a second; the rig file's sample_rate_hz if left out."),
    ] = None,
    seconds: Annotated[float | None, typer.Option("--for", help="End after this many seconds.")] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", help="With --session: so many times as fast as it was.")
    ] = None,
    tare: Annotated[
        bool,
        typer.Option("--tare/--no-tare", help="Take what arrays read at the start as nothing touched."),
    ] = True,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Also write what was shown last as a picture (SVG) here."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object a line on stdout.")] = False,
    no_calibration: _NoCalibrationOption = False,
) -> None:
    """Show what the arrays feel, live: taxels, force, contact, frames. Moves nothing.

    Keys: q ends, t tares, r resets the counts. Exit code 3: an array is missing or goes away.
    """
    from palpate.cli.monitor.watch import run_watch

    with if_interrupted("nothing was moved"):
        raise typer.Exit(
            run_watch(
                rig=rig,
                session=session,
                fingers=finger or [],
                rate_hz=rate,
                seconds=seconds,
                speed=speed,
                json=json,
                tare=tare,
                picture=picture,
                calibration=not no_calibration,
            )
        )


def _setup(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).")],
    dxl_id: Annotated[
        list[int] | None, typer.Option("--id", help="Only this servo of the rig file; may be repeated.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Write to EEPROM without asking.")] = False,
    json: _JsonOption = False,
) -> None:
    """Give each servo its id, baud rate and limits, one at a time.

    Exit code 1: a servo was skipped. 3: a servo is not done.
    """
    from palpate.cli.commissioning.setup_motors import run_setup

    with if_interrupted("nothing was written"):
        raise typer.Exit(run_setup(rig=rig, dxl_ids=dxl_id or [], yes=yes, json=json))


def _stop(
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file (TOML).")] = None,
    port: _PortOption = None,
    baud: Annotated[
        int | None, typer.Option("--baud", help="Baud rate, with --port; 1000000 if left out.")
    ] = None,
    json: _JsonOption = False,
) -> None:
    """Switch torque off on every servo, now, beside whatever runs.

    Exit code 0 only if every servo has confirmed it. No substitute for a switch that cuts the power.
    """
    from palpate.cli.diagnostics.stop import run_stop

    with if_interrupted("NOT confirmed that torque is off"):
        raise typer.Exit(run_stop(rig=rig, port=port, baudrate=baud, json=json))


def _find_port(
    only_list: Annotated[bool, typer.Option("--list", help="Only list the ports; ask nothing.")] = False,
    json: _JsonOption = False,
) -> None:
    """List serial ports; find out which is yours by unplugging it.

    Without a terminal it only lists. Exit code 3: there is no port.
    """
    from palpate.cli.diagnostics.find_port import run_find_port

    with if_interrupted("nothing was changed"):
        raise typer.Exit(run_find_port(only_list=only_list, json=json))
