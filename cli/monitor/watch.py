"""`palpate watch`: what the fingers feel, live or from a recorded session. Moves nothing."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from palpate.cli.monitor.display import How, Shown, forget_stdout, how_to_show, shown_on, write_picture
from palpate.cli.monitor.keys import Keys
from palpate.cli.monitor.loop import end_if_silent, obey, watch
from palpate.config import RigFile
from palpate.drivers.transport.clock import Clock, MonotonicClock
from palpate.errors import InputError
from palpate.rig.calibrated_rig import RigOnBench, load_calibrated
from palpate.rig.monitor.arrays import find_array_ports, select_fingers, stream_arrays
from palpate.rig.monitor.finger_monitor import FingerView, MonitoredFinger
from palpate.rig.monitor.paced_clock import PacedClock
from palpate.rig.monitor.recorded_arrays import open_recorded_arrays
from palpate.rig.motion.calibrated_devices import check_arrays

__all__ = ["run_watch"]

_NOTHING_TOUCHES = "emulated: nothing touches; try --session"
_TARING = "tared at the start: nothing may touch the tips then"
_NOT_TARED = "not tared: forces need it; press t with nothing touching the tips"


@dataclass(frozen=True, eq=False)
class _Watched:
    """Something that can be watched, opened."""

    rig: RigFile
    session: Path | None
    fingers: Sequence[MonitoredFinger]
    clock: Clock
    goes_on: Callable[[], bool]
    doing: Callable[[], str]
    notes: tuple[str, ...]


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
            watched = _session(session, fingers, PaceOf(wall, speed or 1.0))
        else:
            paced = how.screen or seconds is None
            on_bench = load_calibrated(rig, calibration=calibration)
            watched = ways_out.enter_context(
                _live(on_bench, fingers, rate_hz, tare=tare, pace=PaceOf(wall, 1.0 if paced else None))
            )
        keys = ways_out.enter_context(Keys())
        how.say(watched.notes)
        try:
            shown = _watch(watched, how, keys, seconds)
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


@contextmanager
def _live(
    on_bench: RigOnBench, names: Sequence[str], rate_hz: float | None, *, tare: bool, pace: PaceOf
) -> Iterator[_Watched]:
    file = on_bench.rig
    specs = select_fingers(file, names)
    rate = rate_hz or file.closing.sample_rate_hz
    place = find_array_ports(on_bench.described)
    clock = pace.on(place.clock) if file.emulated else place.clock
    with stream_arrays(file, specs, place, clock, rate) as fingers:
        uids = {finger.name: finger.array.description.unique_id.hex() for finger in fingers}
        check_arrays(on_bench.calibration, uids)
        for finger in fingers if tare else ():
            finger.tare()

        def goes_on() -> bool:
            end_if_silent(fingers, rate)
            return True

        notes = (_TARING if tare else _NOT_TARED, *((_NOTHING_TOUCHES,) if file.emulated else ()))
        yield _Watched(file, None, fingers, clock, goes_on, lambda: "", notes)


def _session(session: Path, names: Sequence[str], pace: PaceOf) -> _Watched:
    found = open_recorded_arrays(session, names)

    def goes_on() -> bool:
        found.tare_when_started()
        return not found.ended

    notes = [f"recorded, {found.end_s:.1f} s; tared at each start of the arrays, as the run did"]
    if found.changed_line is not None:
        line = found.changed_line
        notes.append(f"line {line} of the log is not as it was written: its check sum is wrong")
    clock = pace.on(found.clock)
    return _Watched(
        rig=found.rig,
        session=found.folder,
        fingers=found.fingers,
        clock=clock,
        goes_on=goes_on,
        doing=lambda: found.doing,
        notes=tuple(notes),
    )


def _watch(watched: _Watched, how: How, keys: Keys, seconds: float | None) -> Shown:
    """Run the loop; returns what was shown last."""
    begin = 0.0 if watched.session is not None else watched.clock.now()

    def seen(views: Sequence[FingerView]) -> Shown:
        return Shown(
            rig=watched.rig,
            session=watched.session,
            t_s=watched.clock.now() - begin,
            doing=watched.doing(),
            notes=watched.notes,
            views=tuple(views),
            keys=keys.there,
        )

    last = seen([finger.view() for finger in watched.fingers])
    with shown_on(how) as show:

        def note(views: Sequence[FingerView]) -> None:
            nonlocal last
            last = seen(views)
            show(last)

        watch(
            watched.fingers,
            watched.clock,
            note,
            interval_s=how.interval_s,
            goes_on=lambda: watched.goes_on() and obey(keys.typed(), watched.fingers),
            seconds=seconds,
        )
    return last
