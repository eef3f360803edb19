"""`palpate watch`: what the fingers feel, live or from a recorded session. Moves nothing."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from palpate.api.monitor import Monitor
from palpate.api.rig import open_rig
from palpate.api.session import open_session
from palpate.cli.monitor.display import How, Shown, forget_stdout, how_to_show, shown_on, write_picture
from palpate.cli.monitor.keys import Keys
from palpate.drivers.transport.clock import Clock, MonotonicClock
from palpate.errors import InputError
from palpate.rig.monitor.finger_monitor import FingerView, MonitoredFinger
from palpate.rig.monitor.paced_clock import PacedClock

__all__ = ["run_watch"]


def run_watch(
    *,
    rig: Path | None = None,
    session: Path | None = None,
    fingers: Sequence[str] = (),
    rate_hz: float | None = None,
    seconds: float | None = None,
    speed: float | None = None,
    json: bool = False,
    tare: bool = True,
    picture: Path | None = None,
    wall: Clock | None = None,
    calibration: bool = True,
) -> int:
    """Watch until q, for `seconds`, to the end of a session, or until nobody reads stdout any more.

    Returns the exit code. `wall`: for tests. Raises DeviceError naming an array that is missing or goes
    away, InputError for options that do not go together, or arrays that the calibration is not of.
    """
    _check(rig, session, rate_hz, seconds, speed, tare=tare, calibration=calibration)
    how = how_to_show(json=json)
    wall = wall or MonotonicClock()
    with ExitStack() as ways_out:
        if session is not None:
            recorded = open_session(session)
            monitor = ways_out.enter_context(recorded.watch(fingers, pace=PaceOf(wall, speed or 1.0).on))
        else:
            opened = open_rig(rig, calibration=calibration)
            paced = opened.emulated and (how.screen or seconds is None)
            pace = PaceOf(wall, 1.0 if paced else None).on
            monitor = ways_out.enter_context(opened.watch(fingers, rate_hz=rate_hz, tare=tare, pace=pace))
        keys = ways_out.enter_context(Keys())
        how.say(monitor.notes)
        try:
            shown = _watch(monitor, how, keys, seconds)
        except BrokenPipeError:  # of stdout: ports' own errors are DeviceErrors
            forget_stdout()
            return 0
    if picture is not None:
        write_picture(picture, shown)
    how.sum_up(shown)
    return 0


@dataclass(frozen=True)
class PaceOf:
    """How fast virtual time may pass: `speed` times the wall's; None: as fast as it is computed."""

    wall: Clock
    speed: float | None

    def on(self, clock: Clock) -> Clock:
        """The clock, held back."""
        return clock if self.speed is None else PacedClock(clock, self.wall, self.speed)


def _check(
    rig: Path | None,
    session: Path | None,
    rate_hz: float | None,
    seconds: float | None,
    speed: float | None,
    *,
    tare: bool,
    calibration: bool,
) -> None:
    if session is None and speed is not None:
        raise InputError("--speed is for --session; arrays sample in their own time")
    own = rig is None and rate_hz is None and tare and calibration
    if session is not None and not own:
        raise InputError(
            "--session excludes --rig, --no-calibration, --rate and --no-tare: the session has its own"
        )
    for name, value in (("--rate", rate_hz), ("--for", seconds), ("--speed", speed)):
        if value is not None and not 0 < value < 1e6:
            raise InputError(f"{name} {value:g}: must be above 0 and below a million")


def _watch(monitor: Monitor, how: How, keys: Keys, seconds: float | None) -> Shown:
    """Show updates until the end; returns what was shown last."""
    begin = 0.0 if monitor.session is not None else monitor.clock.now()

    def seen(views: Sequence[FingerView]) -> Shown:
        return Shown(
            rig=monitor.rig,
            session=monitor.session,
            t_s=monitor.clock.now() - begin,
            doing=monitor.stage(),
            notes=monitor.notes,
            views=tuple(views),
            keys=keys.there,
        )

    last = seen(monitor.views())
    with shown_on(how) as show:
        for views in monitor.updates(
            how.interval_s, seconds=seconds, goes_on=lambda: obey(keys.typed(), monitor.fingers)
        ):
            last = seen(views)
            show(last)
    return last


def obey(typed: str, fingers: Sequence[MonitoredFinger]) -> bool:
    """Do what was typed: t tares, r resets the counters; returns False for q."""
    for key in typed.lower():
        if key == "q":
            return False
        for finger in fingers:
            if key == "t":
                finger.tare()
            elif key == "r":
                finger.reset_counters()
    return True
