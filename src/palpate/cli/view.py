"""Commands that show arrays and sessions: `palpate watch` and `palpate view`. Neither moves anything."""

import os
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.base.errors import InputError
from palpate.cli.terminal import (
    VIEW_PORT,
    FoxgloveOption,
    NoCalibrationOption,
    RigOption,
    RosOption,
    SessionArgument,
    ViewOption,
    ViewPortOption,
    note_on_interruption,
)

if TYPE_CHECKING:
    from palpate.config import RigFile

_LAST_FRAMES_GRACE_S = 0.5


def view(
    session: SessionArgument,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port on this computer.")] = VIEW_PORT,
    foxglove: FoxgloveOption = False,
    ros: RosOption = None,
    run: Annotated[int | None, typer.Option("--run", hidden=True)] = None,
) -> int:
    """Show a session on a page in the browser: the table from above, taxels, contacts, hypotheses, plan.

    A recorded session has a slider; one that is being recorded is followed. The page is served on this
    computer only, and so is Foxglove's websocket, which takes its place with --foxglove; --ros sends to a
    rosbridge instead. The page needs the extra `view`, Foxglove `export`, ROS `ros`.
    """
    from palpate.base.errors import InputError
    from palpate.config import load_rig
    from palpate.rig.session.log_file import session_of
    from palpate.views.live.frames import SessionFeed
    from palpate.views.live.server import LiveView, serve

    folder = session_of(session)
    if foxglove or ros is not None:
        _publish(folder, port if ros is None else ros)
        return 0
    feed = SessionFeed(folder)
    lifetime = None if run is None else _Lifetime(run)

    def update() -> None:
        feed.update()
        if lifetime is not None:
            lifetime.check()

    stop = None if lifetime is None else _stop_callback(lifetime, load_rig(folder / "rig.toml"))
    shown = LiveView(feed.store, feed.setting, update, stop)
    end = "Ctrl-C ends" if run is None else "ends with the run"
    try:
        serve(shown, port, lambda address: typer.echo(f"{address} shows {folder}; {end}", err=True))
    except OSError as error:
        raise InputError(
            f"port {port} cannot be served: {os.strerror(error.errno or 0)}; choose another with --port"
        ) from None
    return 0


def _publish(folder: Path, where: int | str) -> None:
    """Publish a running session on Foxglove's websocket, on a port, or to a rosbridge."""
    from palpate.views.live.frames import SessionTail
    from palpate.views.live.publishing import foxglove_publisher, publish, rosbridge_publisher

    def ready(address: str) -> None:
        typer.echo(f"{address} has {folder}; ends with the run", err=True)

    make = foxglove_publisher(where, ready) if isinstance(where, int) else rosbridge_publisher(where, ready)
    publish(SessionTail(folder), make)


class _Lifetime:
    """Ends this process with the run that started it, but not while it stops servos."""

    def __init__(self, run: int) -> None:
        self.run = run
        self.is_stopping = False
        self._idle_since_s: float | None = None

    @property
    def has_run(self) -> bool:
        """True if the run is still there."""
        return os.getppid() == self.run

    def check(self) -> None:
        """End the process if nothing is left to show or to do: the next run wants its port."""
        if self.has_run or self.is_stopping:
            self._idle_since_s = None
            return
        now = time.monotonic()
        self._idle_since_s = now if self._idle_since_s is None else self._idle_since_s
        if now - self._idle_since_s > _LAST_FRAMES_GRACE_S:
            os._exit(0)


def _stop_callback(lifetime: _Lifetime, rig: "RigFile") -> Callable[[], Mapping[str, object]]:
    """Ends the run as Ctrl-C does, and on real ports sends what `palpate stop` sends as well."""

    def stop() -> Mapping[str, object]:
        lifetime.is_stopping = True
        try:
            return _stop_run(lifetime, rig)
        finally:
            lifetime.is_stopping = False

    return stop


def _stop_run(lifetime: _Lifetime, rig: "RigFile") -> Mapping[str, object]:
    from palpate.base.errors import PalpateError
    from palpate.rig.diagnostics.servo_bus import endpoint_of_rig, stop_all

    if not lifetime.has_run:
        return {"stopped": False, "words": "the run has ended already"}
    os.kill(lifetime.run, signal.SIGINT)
    if rig.emulated:
        return {"stopped": True, "words": "stopped: the run switches torque off"}
    try:
        confirmed = stop_all(endpoint_of_rig(rig), rig.bus.baudrate_bps).confirmed
    except PalpateError as error:
        return {"stopped": True, "words": f"stop requested; not confirmed: {error}"}
    return {"stopped": True, "words": "torque is off" if confirmed else "stop requested; NOT confirmed"}


@note_on_interruption("nothing was moved")
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
    from palpate.base.file_io import check_places
    from palpate.cli.run_display import view_starter
    from palpate.cli.terminal import rig_files, session_files
    from palpate.cli.watch_display import Keys, choose_display, discard_stdout, show_updates, write_picture
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
    how, fingers = choose_display(json=json), finger or []
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
            discard_stdout()
            return
    if picture is not None:
        write_picture(picture, shown)
    how.sum_up(shown)
