"""`palpate view`: a session on a page in the browser, recorded or while it is being recorded."""

import os
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["DEFAULT_PORT", "view"]

DEFAULT_PORT = 8765


def view(
    session: Annotated[Path, typer.Argument(help="A session's folder, or its log.", show_default=False)],
    port: Annotated[
        int, typer.Option("--port", min=1, max=65535, help="Port on this computer.")
    ] = DEFAULT_PORT,
    run: Annotated[int | None, typer.Option("--run", hidden=True)] = None,
) -> int:
    """Show a session on a page in the browser: the table from above, taxels, contacts, hypotheses, plan.

    A recorded session has a slider; one that is being recorded is followed. The page is served on this
    computer only. Needs the extra `view`.
    """
    from palpate.errors import InputError
    from palpate.rig.session.log_file import session_of
    from palpate.views.live.feed import SessionFeed
    from palpate.views.live.server import LiveView, serve

    folder = session_of(session)
    feed = SessionFeed(folder)

    def update() -> None:
        feed.update()
        if run is not None and os.getppid() != run:
            os._exit(0)  # the run was killed: there is nothing to follow, and its port is wanted again

    shown = LiveView(feed.store, feed.setting, update, None if run is None else _stopper(run, folder))
    try:
        serve(shown, port, lambda address: typer.echo(f"{address} shows {folder}; Ctrl-C ends", err=True))
    except OSError as error:
        raise InputError(
            f"port {port} cannot be served: {os.strerror(error.errno or 0)}; choose another with --port"
        ) from None
    return 0


def _stopper(run: int, folder: Path) -> Callable[[], Mapping[str, object]]:
    """Ends the run as Ctrl-C does, and on real ports sends what `palpate stop` sends as well."""

    def stop() -> Mapping[str, object]:
        from palpate.api import bus
        from palpate.config import load_rig
        from palpate.errors import PalpateError

        if os.getppid() != run:
            return {"stopped": False, "words": "the run has ended already"}
        os.kill(run, signal.SIGINT)
        if load_rig(folder / "rig.toml").emulated:
            return {"stopped": True, "words": "stopped: the run switches torque off"}
        try:
            confirmed = bus.stop(rig=folder / "rig.toml").confirmed
        except PalpateError as error:
            return {"stopped": True, "words": f"stop requested; not confirmed: {error}"}
        return {"stopped": True, "words": "torque is off" if confirmed else "stop requested; NOT confirmed"}

    return stop
