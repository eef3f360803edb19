"""Log for a live view of work that keeps no session: it lies in a temporary folder while the work goes on."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from palpate.drivers.transport.clock import Clock
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.session.inputs import keep_rig
from palpate.rig.session.log import SessionLog

__all__ = ["view_log"]


@contextmanager
def view_log(
    on_bench: RigOnBench, clock: Clock, command: str, on_session: Callable[[Path], None] | None
) -> Iterator[SessionLog | None]:
    """A log in a folder that is removed at the end; `on_session` is told the folder. None without that.

    Should it fail, the work goes on without it.
    """
    if on_session is None:
        yield None
        return
    header = {
        "palpate": version("palpate"),
        "rig": on_bench.rig.name,
        "command": command,
        "calibration": on_bench.calibration is not None,
        "emulated": on_bench.rig.emulated,
        "started": datetime.now(UTC).replace(microsecond=0).isoformat(),
    }
    with TemporaryDirectory(prefix="palpate-view-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        keep_rig(folder, on_bench)
        with SessionLog(folder, clock, header, needed=False) as log:
            on_session(folder)
            yield log
