"""Frames of taxels, their numbers and times, and `ArrayDriver`: the interface of all drivers of arrays.

`FrameTimes` is for devices that only stamp frames with a counter of 32 bits. Lost frames are estimated there:
a step much longer than usual means that frames are missing. A device that pauses by itself looks the same.
"""

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple, Protocol

from palpate.base.errors import DeviceError
from palpate.base.geometry import Counts
from palpate.drivers.tactile.description import Description


class ArrayLost(DeviceError):
    """An array sends no more, has started anew or is gone. It may come back: asking it again shows."""

    def __init__(self, finger: str, message: str) -> None:
        super().__init__(message)
        self.finger = finger


class ArraySilent(DeviceError):
    """An array does not say what it is, or what comes from its port is no message."""


class ContactReading(NamedTuple):
    """Contact that a device computes by itself, in the tip frame; each value is off by its bound at most.

    `time_s`: when it was sampled, by the device's clock; None: on its arrival, or a while before. `angle_rad`
    points from the tip's axis to what it touches, as in `ContactPatch`, and is nan where the device does not
    know the normal; likewise `height_mm`. `force_n` is 0, within its bound, where nothing touches.
    """

    force_n: float
    force_bound_n: float
    angle_rad: float = math.nan
    angle_half_range_rad: float = math.pi
    height_mm: float = math.nan
    height_bound_mm: float = math.inf
    time_s: float | None = None
    time_bound_s: float = 0.0


class TactileFrame(NamedTuple):
    """One sample of every taxel: `counts` has shape (rows, cols), uint16, lowest row first.

    `device_time_s` is the array's own clock at the sample; `host_time_s` is the host's clock when the frame
    was read from the port, which is later by the time on the wire and by the wait until it was read.
    `tared` says that the array took a zero of its own off, so that counts are not raw. `age_s`, of an array
    that stamps no time: how long before `host_time_s` it was sampled at most; `device_time_s` is the same as
    that then. None: the array's own clock says when. `contact`: of a contact source, whose only taxel is the
    force.
    """

    sequence: int
    device_time_s: float
    host_time_s: float
    counts: Counts
    tared: bool = False
    age_s: float | None = None
    contact: ContactReading | None = None


class DecodedFrame(NamedTuple):
    """Matrix (rows, cols) of a frame; and its stamp by the array's clock, 32 bits, if it has one.

    `contact`: of a contact source. `problem`: why it makes no sense, although no byte of it was damaged.
    `is_other`: it is of another finger on the same connection.
    """

    counts: Counts
    stamp: int | None = None
    contact: ContactReading | None = None
    problem: str | None = None
    is_other: bool = False


class FrameDecoder(Protocol):
    """Codec of a free-running array; it promises what docs/adding-a-device.md asks of codecs."""

    faults: Counter[str]

    def feed(self, data: bytes) -> Sequence[DecodedFrame]:
        """Take bytes as they came; return the frames that they complete."""
        ...


@dataclass(frozen=True)
class ArrayCounters:
    """Counts of faults on this port since it was opened.

    `frames` were taken. `lost` were numbered by the array and never came; `faults` are stretches of the
    stream that were no message; `misshapen` frames made no sense: another size than the array's own, counts
    above its largest, or an impossible time; `dropped` frames came while too many were waiting to be read.
    """

    frames: int
    lost: int
    faults: int
    misshapen: int
    dropped: int


class ArrayDriver(Protocol):
    """A tactile array on a port. Call `connect` first; the verbs may be repeated without harm.

    All of them raise DeviceError, which names the array and says what to do, if it refuses, does not answer
    or is gone.
    """

    @property
    def description(self) -> Description:
        """Description that the array gave; raises DeviceError before `connect`."""
        ...

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        ...

    @property
    def silence(self) -> str:
        """Words for what came since the last frame: "nothing", or what is no frame."""
        ...

    def connect(self) -> Description:
        """Ask the array what it is; a running stream stops."""
        ...

    def start(self, rate_hz: float) -> None:
        """Stream frames at `rate_hz`, or as near to it as the array can.

        Where no stream ran, all frames that are read afterwards were sampled after the call.
        """
        ...

    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""
        ...

    def frames(self) -> list[TactileFrame]:
        """Return every frame that has arrived, oldest first, without waiting.

        Takes a bounded time, whatever arrives. Raises DeviceError if it makes no sense for long.
        """
        ...

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`."""
        ...


_STAMP_RANGE = 1 << 32
_REMEMBERED_STEPS = 16
_MIN_STEPS = 4  # steps, before one may be called long
_LONG_STEP_RATIO = 1.6  # of the usual step
_MAX_STEP_S = 10.0  # no stream pauses for so long: the stamp is damaged, or the device has started anew


@dataclass(frozen=True)
class FrameTime:
    """Place of a frame in the stream: its number, with a gap where frames seem to be missing, and its
    time.
    """

    sequence: int
    time_s: float


class FrameTimes:
    """Unwraps stamps of `tick_s` each and numbers frames; `lost` counts those that seem to be missing."""

    def __init__(self, tick_s: float) -> None:
        self.lost = 0
        self._tick_s = tick_s
        self._sequence = -1
        self._last: int | None = None
        self._ticks = 0
        self._fresh = True
        self._steps: deque[int] = deque(maxlen=_REMEMBERED_STEPS)

    def restart(self) -> None:
        """A new stream begins, maybe at another rate: no frame is missing between the old one and it."""
        self._fresh = True
        self._steps.clear()

    def place(self, stamp: int) -> FrameTime | None:
        """Number and time of the next frame; None if it is repeated or its time is impossible.

        After an impossible one, times go on from it: if it was the damaged one, one more frame is
        refused.
        """
        last, self._last = self._last, stamp
        step = stamp if last is None else (stamp - last) % _STAMP_RANGE
        missing = 0
        if self._fresh:
            self._fresh = False
        elif step == 0 or step * self._tick_s > _MAX_STEP_S:
            return None
        else:
            missing = self._missing(step)
        self._ticks += step
        self.lost += missing
        self._sequence += 1 + missing
        return FrameTime(self._sequence, self._ticks * self._tick_s)

    def _missing(self, step: int) -> int:
        usual = median(self._steps) if len(self._steps) >= _MIN_STEPS else None
        if usual is not None and step > _LONG_STEP_RATIO * usual:
            return round(step / usual) - 1
        self._steps.append(step)
        return 0
