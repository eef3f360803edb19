"""`palpate view`: a session on a page in the browser, recorded or while it is being recorded."""

import os
import signal
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.cli.options import VIEW_PORT, SessionArgument

if TYPE_CHECKING:
    from palpate.config import RigFile

__all__ = ["view"]

_LAST_FRAMES_S = 0.5


def view(
    session: SessionArgument,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Port on this computer.")] = VIEW_PORT,
    run: Annotated[int | None, typer.Option("--run", hidden=True)] = None,
) -> int:
    """Show a session on a page in the browser: the table from above, taxels, contacts, hypotheses, plan.

    A recorded session has a slider; one that is being recorded is followed. The page is served on this
    computer only. Needs the extra `view`.
    """
    from palpate.base.errors import InputError
    from palpate.config import load_rig
    from palpate.rig.session.log_file import session_of
    from palpate.views.live.feed import SessionFeed
    from palpate.views.live.server import LiveView, serve

    folder = session_of(session)
    feed = SessionFeed(folder)
    lifetime = None if run is None else _Lifetime(run)

    def update() -> None:
        feed.update()
        if lifetime is not None:
            lifetime.check()

    stop = None if lifetime is None else _stopper(lifetime, load_rig(folder / "rig.toml"))
    shown = LiveView(feed.store, feed.setting, update, stop)
    try:
        serve(shown, port, lambda address: typer.echo(f"{address} shows {folder}; Ctrl-C ends", err=True))
    except OSError as error:
        raise InputError(
            f"port {port} cannot be served: {os.strerror(error.errno or 0)}; choose another with --port"
        ) from None
    return 0


class _Lifetime:
    """Ends this process with the run that started it, but not while it stops servos."""

    def __init__(self, run: int) -> None:
        self.run = run
        self.is_stopping = False
        self._idle_since_s: float | None = None

    @property
    def has_run(self) -> bool:
        """Whether the run is still there."""
        return os.getppid() == self.run

    def check(self) -> None:
        """End the process if nothing is left to show or to do: the next run wants its port."""
        if self.has_run or self.is_stopping:
            self._idle_since_s = None
            return
        now = time.monotonic()
        self._idle_since_s = now if self._idle_since_s is None else self._idle_since_s
        if now - self._idle_since_s > _LAST_FRAMES_S:
            os._exit(0)


def _stopper(lifetime: _Lifetime, rig: "RigFile") -> Callable[[], Mapping[str, object]]:
    """Ends the run as Ctrl-C does, and on real ports sends what `palpate stop` sends as well."""

    def stop() -> Mapping[str, object]:
        lifetime.is_stopping = True
        try:
            return _stopped(lifetime, rig)
        finally:
            lifetime.is_stopping = False

    return stop


def _stopped(lifetime: _Lifetime, rig: "RigFile") -> Mapping[str, object]:
    from palpate.base.errors import PalpateError
    from palpate.rig.diagnostics.bus_selection import endpoint_of_rig
    from palpate.rig.diagnostics.emergency_stop import stop_all

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
