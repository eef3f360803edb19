"""Monitor: continuous reading of tactile arrays, live or recorded, and the log for a live view of it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from palpate.base.errors import DeviceError
from palpate.config import RigFile, RigOnBench
from palpate.drivers.transport import Clock
from palpate.jobs.files import check_arguments
from palpate.rig.array_monitor import FingerView, MonitoredFinger
from palpate.rig.session.log import SessionLog
from palpate.rig.session.recorded_session import keep_rig

_POLL_S = 0.01  # a terminal's buffer holds 4 kB, a dozen frames of 8 x 20
_MAX_SILENCE_S = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class Monitor:
    """Arrays of some fingers, streaming. `stage`: what a recorded run did then; `notes`: for the operator."""

    rig: RigFile
    session: Path | None
    fingers: Sequence[MonitoredFinger]
    clock: Clock
    goes_on: Callable[[], bool]
    stage: Callable[[], str]
    notes: tuple[str, ...]

    @check_arguments
    def updates(
        self,
        interval_s: float = 0.05,
        *,
        seconds: float | None = None,
        goes_on: Callable[[], bool] = lambda: True,
    ) -> Iterator[tuple[FingerView, ...]]:
        """Yield what the fingers' arrays read: every `interval_s` of their clock, and at the end.

        Ends after `seconds`, with the recording, or once `goes_on`, which is asked at every poll, says so.
        Raises DeviceError, which names the finger, if an array is silent.
        """
        begin = self.clock.now()
        due = begin + interval_s
        while self.goes_on() and goes_on():
            self.clock.sleep(_POLL_S)
            for finger in self.fingers:
                finger.poll()
            now = self.clock.now()
            if seconds is not None and now - begin >= seconds:
                break
            if now >= due:
                yield self.views()
                due += interval_s
                if due <= self.clock.now():  # the caller took longer than that: polls come first
                    due = self.clock.now() + interval_s
        yield self.views()

    def views(self) -> tuple[FingerView, ...]:
        """Return what the arrays have read last."""
        return tuple(finger.view() for finger in self.fingers)

    def __repr__(self) -> str:
        names = ", ".join(finger.name for finger in self.fingers)
        return f"<Monitor {self.rig.name if self.session is None else self.session}: {names}>"


def check_streaming(fingers: Sequence[MonitoredFinger], rate_hz: float) -> None:
    """Raise DeviceError, which names the finger, if an array that streams at `rate_hz` has stopped."""
    limit = max(_MAX_SILENCE_S, 5 / rate_hz)
    for finger in fingers:
        if finger.age_s > limit:
            instead = finger.array.silence
            but = "" if instead == "nothing" else f", but {instead}"
            raise DeviceError(
                f"tactile array {finger.name} on {finger.port} sent no frame for {limit:g} s{but}; "
                "check its power and its cable, then watch again"
            )


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
