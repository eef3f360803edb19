"""`palpate watch`: what the fingers feel, live or from a recorded session. Moves nothing."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import InputError
from palpate.cli.interruption import if_interrupted
from palpate.cli.options import VIEW_PORT, NoCalibrationOption, RigOption, ViewOption, ViewPortOption

__all__ = ["watch"]


@if_interrupted("nothing was moved")
def watch(
    rig: RigOption = None,
    session: Annotated[
        Path | None,
        typer.Option("--session", help="Play a recorded session (its folder, or its log) instead of a rig."),
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
    no_calibration: NoCalibrationOption = False,
    view: ViewOption = False,
    view_port: ViewPortOption = VIEW_PORT,
) -> None:
    """Show what the arrays feel, live: taxels, force, contact, frames. Moves nothing.

    Keys: q ends, t tares, r resets the counts. Exit code 3: an array is missing or goes away.
    """
    from palpate.base.files.writing import check_places
    from palpate.cli.monitor.display import forget_stdout, how_to_show, write_picture
    from palpate.cli.monitor.keys import Keys
    from palpate.cli.monitor.updates import show_updates
    from palpate.cli.output_places import rig_files, session_files
    from palpate.cli.view_process import view_starter
    from palpate.jobs.rig import open_rig
    from palpate.jobs.session import open_session

    own = rig is None and rate is None and tare and not no_calibration
    if session is None and speed is not None:
        raise InputError("--speed is for --session; arrays sample in their own time")
    if session is not None and not own:
        raise InputError(
            "--session excludes --rig, --no-calibration, --rate and --no-tare: the session has its own"
        )
    if session is not None and view:
        raise InputError(f"--view is for arrays; palpate view {session} shows a session, with a slider")
    for name, value in (("--rate", rate), ("--for", seconds), ("--speed", speed)):
        if value is not None and not 0 < value < 1e6:
            raise InputError(f"{name} {value:g}: must be above 0 and below a million")
    check_places({"--picture": picture}, rig_files(rig) | session_files(session))
    how, fingers = how_to_show(json=json), finger or []
    with ExitStack() as ways_out:
        if session is not None:
            recorded = open_session(session)
            monitor = ways_out.enter_context(recorded.watch(fingers, speed=speed or 1.0))
        else:
            opened = open_rig(rig, calibration=not no_calibration)
            pace = 1.0 if how.screen or seconds is None else None
            shows = view_starter(view_port) if view else None
            monitor = ways_out.enter_context(
                opened.watch(fingers, rate_hz=rate, tare=tare, speed=pace, on_session=shows)
            )
        keys = ways_out.enter_context(Keys())
        how.say(monitor.notes)
        try:
            shown = show_updates(monitor, how, keys, seconds)
        except BrokenPipeError:  # of stdout: ports' own errors are DeviceErrors
            forget_stdout()
            return
    if picture is not None:
        write_picture(picture, shown)
    how.sum_up(shown)
