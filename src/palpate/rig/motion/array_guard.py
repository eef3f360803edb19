"""Guard over the streaming tactile arrays: excessive force or silence ends all motion.

The hand looks through it wherever time passes with torque on, so that no motion can leave it out. Frames
come late, some later than others: an adapter or a hub holds them back. An array's own time stamps say how
much: by how little any frame is behind its stamp shows how far the two clocks are apart at most; and that no
frame was sampled before the stream was asked for, how far they are apart at least (`SampleTimes`).

*Device loss.* Torque goes off on every servo, whatever interrupts it and wherever the bus's adapter is by
then. An array that was lost is looked for, and connected again. What is said beside an error (whose it is,
what else it may be due to) is here, too.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, SafetyStop
from palpate.config import ClosingConfig, FingerConfig, RigFile
from palpate.drivers.dynamixel import (
    Bus,
    DamagedAnswer,
    NotAnswering,
    PortFailed,
    Servo,
    ServoError,
    WatchdogTripped,
    disable_torque,
)
from palpate.drivers.tactile import (
    ArrayDriver,
    ArrayLost,
    ArraySilent,
    Description,
    TactileFrame,
    count_repeats,
    is_new,
)
from palpate.drivers.transport import Clock, ReopenedPort, describe_renaming
from palpate.rig.arrays import array_of
from palpate.rig.fingers import HostFinger
from palpate.rig.motion.load_meter import LoadMeter

_INITIAL_FRAMES = 48  # frames: fewer than a tare takes
_SHORT_WINDOW_FRAMES = 128  # frames, in which no two clocks run apart by much
_LONG_WINDOW_FRAMES = 1024  # frames, in which good clocks do not either


class SampleTimes:
    """Bounds on when each frame of one stream was sampled.

    They hold if among any 1024 frames one comes about as soon, but for a period, as the soonest of the first
    48 did. A clock that is slow by a share r shifts them by r times the duration of 128 frames, one that is
    fast by up to that of 1024. Frames that no clock stamped say themselves how old they are at most.
    """

    def __init__(self, asked_s: float) -> None:
        """`asked_s`: the instant (s, host's clock) before which the stream was not asked for."""
        self._asked_s = asked_s
        self._soonest, self._lately = (
            _SlidingMinimum(_LONG_WINDOW_FRAMES),
            _SlidingMinimum(_SHORT_WINDOW_FRAMES),
        )
        self._first = 0
        self._apart_s = math.nan  # at least, at the first frame
        self._delay_s = math.inf  # of the soonest frame, at most
        self.spread_s = math.inf
        """By how much a frame may be older than the latest instant at which it can have been sampled."""
        self.sampled_s = -math.inf
        """Up to when, at least, everything has been read that was sampled."""

    def latest_s(self, frames: Sequence[TactileFrame]) -> list[float]:
        """The latest instants at which frames (one or more) that come next can have been sampled."""
        if frames[-1].age_s is not None:
            return self._unstamped_s(frames)
        stamps = [frame.device_time_s for frame in frames]
        if not self._first:
            self._apart_s = self._asked_s - stamps[0]
        for frame in frames:
            behind = frame.host_time_s - frame.device_time_s
            soonest, lately = self._soonest.add(behind), self._lately.add(behind)
        if self._first < _INITIAL_FRAMES:
            self._first += len(frames)
            self._delay_s = max(soonest - self._apart_s, 0.0)
        # Where the last few are all later than others before, delays have grown, or the clock is slow.
        # Stamps may be off: that of the soonest frame, that of the first one, and that of the frame itself.
        off_s = max(frame.contact.time_bound_s if frame.contact else 0.0 for frame in frames)
        latest = [stamp + lately + 2 * off_s for stamp in stamps]
        self.spread_s = self._delay_s + lately - soonest + 4 * off_s
        self.sampled_s = max(self.sampled_s, latest[-1] - self.spread_s)
        return latest

    def _unstamped_s(self, frames: Sequence[TactileFrame]) -> list[float]:
        """The same of frames without stamps."""
        self.spread_s = max(frame.age_s or 0.0 for frame in frames)
        self.sampled_s = max(self.sampled_s, frames[-1].host_time_s - self.spread_s)
        return [frame.host_time_s for frame in frames]


class _SlidingMinimum:
    """The least of the last `size` values: this is asked for at each look at an array."""

    def __init__(self, size: int) -> None:
        self._size, self._count = size, 0
        self._left: deque[tuple[int, float]] = deque()  # that may be least yet, the oldest and least first

    def add(self, value: float) -> float:
        """Take one more; the least now."""
        while self._left and self._left[-1][1] >= value:
            self._left.pop()
        self._left.append((self._count, value))
        self._count += 1
        if self._left[0][0] < self._count - self._size:
            self._left.popleft()
        return self._left[0][1]


_LEAST_RATE_SHARE = 0.9  # of the samples that were asked for
_MIN_STUCK_REPEATS = 3  # readings in a row as the one before; fewer are the beat of two clocks
_STUCK_CHANCE = 1e-12  # of as many repeats in a row at any frame, by the tare's noise and repeats


class _Repeats:
    """Readings of one array that are as the one before, against those of its tare.

    `age_s`: by how much a reading was older than its frame, at most so far.
    """

    def __init__(self, finger: HostFinger, frames: Sequence[TactileFrame], asked_hz: float) -> None:
        """`frames`: of the tare. Raises DeviceError for an array that hangs or samples too slowly."""
        taxels, where = finger.spec.array.taxels, f"array {finger.name} on {finger.spec.array.port}"
        seen = count_repeats(frames, 0.0 if taxels is None else taxels.noise_counts)
        if seen.repeated == seen.frames and (seen.certain or not finger.extractor.baseline.usable.any()):
            raise DeviceError(
                f"{where} has sent one and the same reading {len(frames)} times: its sensor hangs; power it "
                "off and on"
            )
        if seen.certain and seen.rate_hz < _LEAST_RATE_SHARE * asked_hz:
            raise DeviceError(
                f"{where} repeats its readings: only {seen.rate_hz:.0f} of {asked_hz:g} a second are new; "
                f"let its firmware sample as fast as it sends, or lower sample_rate_hz to "
                f"{max(math.floor(_LEAST_RATE_SHARE * seen.rate_hz), 1)}"
            )
        self._where, self._seen, self._max_count = where, seen, finger.array.description.max_count
        chance = max(seen.chance, seen.repeated / seen.frames, 1e-300)
        most = math.inf if chance >= 1 else math.log(_STUCK_CHANCE) / math.log(chance)
        self._most_in_a_row = max(most, _MIN_STUCK_REPEATS)
        self._last, self._new_s, self._in_a_row = frames[-1], frames[-1].device_time_s, 0
        self.age_s = 0.0

    def follow(self, frames: Sequence[TactileFrame]) -> None:
        """Look at frames that come next; raises DeviceError once more repeat than chance lets them."""
        for frame, new in zip(frames, is_new(frames, self._last), strict=True):
            if new or frame.counts.max() >= self._max_count:  # what is at its end does not move
                self._in_a_row, self._new_s = 0, frame.device_time_s
                continue
            self._in_a_row += 1
            if self._in_a_row >= self._most_in_a_row:
                what, cause = "one reading", "its sensor hangs"
                if not frame.counts.any():
                    what, cause = (
                        "0 of all taxels",
                        "its zeros have drifted below what it can read, or it hangs",
                    )
                raise DeviceError(
                    f"{self._where} repeats {what}: {cause}; fingers were stopped; power it off and on, then "
                    "run palpate doctor"
                )
            if self._seen.are_stuck(self._in_a_row):
                self.age_s = max(self.age_s, frame.device_time_s - self._new_s)
        self._last = frames[-1]


_MAX_SILENCE_S = 0.15
_MAX_SILENCE_FRAMES = 3  # that long at least, for slow arrays


class ArrayReading(NamedTuple):
    """Reading of an array since the look before: frames, oldest first, and the newest one's force."""

    frames: Sequence[TactileFrame]
    force_n: float


_NO_READING = ArrayReading((), 0.0)


class ArrayGuard:
    """Looks at all arrays that stream."""

    def __init__(self, clock: Clock, closing: ClosingConfig) -> None:
        """`closing`: the rig file's limits and sample rate."""
        self._clock, self._closing = clock, closing
        self.meters: dict[HostFinger, LoadMeter] = {}
        self._heard_s: dict[HostFinger, float] = {}
        self._readings: dict[HostFinger, ArrayReading] = {}
        self._times: dict[HostFinger, SampleTimes] = {}
        self._repeats: dict[HostFinger, _Repeats] = {}
        self.seen: dict[HostFinger, list[TactileFrame]] = {}
        """Frames of each array since it was started."""

    def start(self, fingers: Sequence[HostFinger]) -> None:
        """Let arrays stream; from now on their silence counts."""
        for finger in fingers:
            if finger not in self._times:  # of one that streams already, frames may be under way
                self._times[finger] = SampleTimes(self._clock.now())
            finger.array.start(self._closing.sample_rate_hz)
        self.note_heard(fingers)

    def stop(self, fingers: Sequence[HostFinger]) -> None:
        """Let arrays rest; unread frames are dropped."""
        self._heard_s, self._readings, self.meters, self._times, self._repeats = {}, {}, {}, {}, {}
        self.seen = {}
        for finger in fingers:
            finger.array.stop()
            finger.array.frames()

    def tare(self, finger: HostFinger, frames: Sequence[TactileFrame]) -> None:
        """Take frames as those of an untouched tip. Raises DeviceError for readings that repeat."""
        finger.extractor.tare(frames)
        self._repeats[finger] = _Repeats(finger, frames, self._closing.sample_rate_hz)

    def note_heard(self, fingers: Sequence[HostFinger]) -> None:
        """Note that these have sent something just now."""
        self._heard_s |= dict.fromkeys(fingers, self._clock.now())

    def forget(self) -> None:
        """Discard readings: what was measured so far is out of date."""
        self._readings = {}

    def look(self) -> None:
        """Look at every array that streams.

        Raises SafetyStop for a force above max_force_n, and DeviceError for an array that has fallen silent.
        """
        # A port that is not read keeps its oldest frames for up to a second: they would pass for new.
        self._readings = {finger: self._since(finger) for finger in self._heard_s}

    def reading(self, finger: HostFinger) -> ArrayReading:
        """Reading of a finger's array since `forget`."""
        return self._readings.get(finger, _NO_READING)

    def take(self, finger: HostFinger) -> ArrayReading:
        """Frames that were not taken before, up to now: for what belongs to a read just made."""
        felt = self._since(finger)
        self._readings[finger] = _NO_READING
        return felt

    def _since(self, finger: HostFinger) -> ArrayReading:
        before, now = self._readings.get(finger, _NO_READING), self._sensed(finger)
        if not before.frames:
            return now if now.frames else before
        return ArrayReading((*before.frames, *now.frames), now.force_n if now.frames else before.force_n)

    def _sensed(self, finger: HostFinger) -> ArrayReading:
        frames, now = finger.array.frames(), self._clock.now()
        if not frames:
            self._check_heard(finger, now)
            return _NO_READING
        self._heard_s[finger] = now
        if finger.extractor.follows:
            meter, begun_s = self.meters.get(finger), self._times[finger].sampled_s
            finger.extractor.follow(frames, may_touch=meter is not None and meter.may_touch(begun_s))
        force = self.feel(finger, frames)
        self._check_force(finger, force)
        return ArrayReading(frames, force)

    def sampled_s(self, finger: HostFinger) -> float:
        """Instant up to which, at least, all has been read that a finger's array has sampled."""
        return self._times[finger].sampled_s - self._age_s(finger)

    def _age_s(self, finger: HostFinger) -> float:
        return self._repeats[finger].age_s if finger in self._repeats else 0.0

    def feel(self, finger: HostFinger, frames: Sequence[TactileFrame]) -> float:
        """The newest frame's force (N); what each of them adds to the load on the part is metered."""
        meter, extractor, times, force = self.meters.get(finger), finger.extractor, self._times[finger], 0.0
        latest = times.latest_s(frames)
        self.seen.setdefault(finger, []).extend(frames)
        if finger in self._repeats:
            self._repeats[finger].follow(frames)
        if meter is not None:
            meter.late_by(times.spread_s + self._age_s(finger) + finger.spec.array.lag_s)
        for frame, at in zip(frames, latest, strict=True):
            force, readings = extractor.sense(frame)
            if meter is not None:
                steady = dragging = 0.0
                if quiet := meter.quiet_mean(readings, force):
                    steady = extractor.steady_force_n(*quiet)
                    dragging = meter.steady_dragging_n(extractor, *quiet) if steady else 0.0
                else:
                    dragging = meter.dragging_n(extractor, frame, readings)
                meter.feel(force, at, steady, extractor.zero_doubt_n, dragging)
        return force

    def _check_force(self, finger: HostFinger, force_n: float) -> None:
        hard = self._closing.max_force_n
        if force_n > hard:
            raise SafetyStop(
                f"finger {finger.name} felt {force_n:.1f} N, above max_force_n = {hard:g} N; fingers were "
                "stopped; look at what presses on its tip: if nothing, palpate check --press shows whose "
                "array it is; a part met at speed needs a lower approach_speed_mm_s"
            )

    def _check_heard(self, finger: HostFinger, now: float) -> None:
        allowed = max(_MAX_SILENCE_S, _MAX_SILENCE_FRAMES / self._closing.sample_rate_hz)
        if now - self._heard_s[finger] > allowed:
            raise ArrayLost(
                finger.name,
                f"tactile array {finger.name} on {finger.spec.array.port} has sent {finger.array.silence} "
                f"for {allowed:g} s while fingers moved; fingers were stopped; check its cable",
            )


_REPLUG_S = 20.0  # how long to wait for an adapter that was unplugged while torque was on
_REPLUG_POLL_S = 0.25
_MAX_SWITCH_OFF_TRIES = 3  # whatever interrupts switching off, it is done again


def despite_interruptions(switch_off: Callable[[], list[DeviceError]]) -> list[DeviceError]:
    """Switch off; what interrupts it, such as a signal or lack of memory, is raised once it is done."""
    interruption: BaseException | None = None
    for _ in range(_MAX_SWITCH_OFF_TRIES):
        try:
            failed = switch_off()
        except BaseException as error:
            interruption = interruption or error
            continue
        if interruption is None:
            return failed
        note_what_is_on(interruption, failed)
        break
    else:
        assert interruption is not None
        interruption.add_note("warning: torque may be on; cut the power before you reach in")
    raise interruption


def switch_off(
    bus: Bus, servos: Sequence[Servo], clock: Clock, notice: Callable[[str], None]
) -> list[DeviceError]:
    """Switch torque off, also if the bus's adapter has to be plugged in again for that.

    Returns what could not be switched off. `bus` may be on a port of another name afterwards.
    """
    failed = disable_torque(bus, servos)
    if not any(isinstance(error, PortFailed) for error in failed):
        return failed
    notice(
        f"{bus.port_name} is gone and torque may be on: plug it in again within {_REPLUG_S:g} s, "
        "or cut the servos' power"
    )
    deadline = clock.now() + _REPLUG_S
    while clock.now() < deadline:
        clock.sleep(_REPLUG_POLL_S)
        try:
            bus.reconnect()
        except DeviceError:
            continue
        failed = disable_torque(bus, servos)
        if not any(isinstance(error, PortFailed) for error in failed):
            break
    return failed


def note_what_is_on(error: BaseException, failed: Sequence[DeviceError]) -> None:
    """Add to what ends the run that some torque may still be on."""
    if failed:
        servos = "one servo" if len(failed) == 1 else f"{len(failed)} servos"
        error.add_note(
            f"warning: {servos} did not confirm that torque is off ({failed[0]}); "
            "cut the power before you reach in"
        )


def name_owners(error: BaseException, rig: RigFile) -> None:
    """Put before a servo's error whose joint it is, as "f1 slide: servo 12 on …"."""
    if not isinstance(error, ServoError | WatchdogTripped):
        return
    owners = {servo.dxl_id: servo.owner for servo in rig.servos}
    named = [owners[dxl_id] for dxl_id in error.dxl_ids if dxl_id in owners]
    if named:
        error.args = (f"{', '.join(named)}: {error}",)


def note_other_causes(error: BaseException) -> None:
    """Add to a device's silence what else it may be due to."""
    if isinstance(error, NotAnswering | DamagedAnswer | ArraySilent | ArrayLost):
        error.add_note(
            "palpate doctor looks for the reason, from plugs to other programs that have the port open"
        )


_RECONNECT_POLL_S = 0.25
_RECONNECT_TIMEOUT_S = 4.0  # how long to wait for an array that was lost, with fingers stopped and torque on
_MAX_RECONNECTS = 3  # in a run; more often, something is wrong that needs a person


class HandArrays:
    """Arrays that are open, by the names of their fingers."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ports: dict[str, ReopenedPort] = {}
        self._arrays: list[ArrayDriver] = []
        self._reconnected = 0

    def open(self, spec: FingerConfig, open_port: Callable[[str, int], SerialBase]) -> ArrayDriver:
        """The array of a finger on its port, which is opened; nothing is asked of it yet."""
        port = ReopenedPort(lambda: open_port(spec.array.port, spec.array.baudrate_bps))
        self._ports[spec.name] = port
        array = array_of(spec, port, self._clock)
        self._arrays.append(array)
        return array

    def stop(self) -> None:
        """Let all arrays rest that can be reached: one that is gone moves nothing."""
        for array in self._arrays:
            with suppress(Exception):
                array.stop()

    def close(self) -> None:
        """Close every port, as often as it is asked."""
        for port in self._ports.values():
            port.close()
        self._ports, self._arrays = {}, []

    def reconnect(self, finger: HostFinger, lost: ArrayLost) -> str | None:
        """Wait for an array that was lost; returns what to say if its port has another name now.

        Raises `lost` if it does not come back or was lost too often in this run, DeviceError if another
        array is there.
        """
        self._reconnected += 1
        if self._reconnected > _MAX_RECONNECTS:
            raise lost
        before, known = self._ports[finger.name].port, finger.array.description
        if self._found_again(finger, lost).unique_id != known.unique_id:
            raise DeviceError(f"{lost}; another array answers there now: plug the arrays as they were")
        now_at = self._ports[finger.name].port
        return describe_renaming(before, now_at) if before and now_at and now_at != before else None

    def _found_again(self, finger: HostFinger, lost: ArrayLost) -> Description:
        """Description of an array that answers again; raises `lost` if it does not."""
        deadline = self._clock.now() + _RECONNECT_TIMEOUT_S
        while self._clock.now() < deadline:
            try:
                return finger.array.connect()
            except ArrayLost:
                self._clock.sleep(_RECONNECT_POLL_S)
            except DeviceError:
                continue
            with suppress(DeviceError):
                self._ports[finger.name].reopen()
        raise lost
