"""Frames of taxels, and `ArrayDriver`: the interface of every driver of a tactile array."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from palpate.base.errors import DeviceError
from palpate.base.geometry import Counts
from palpate.drivers.tactile.messages import Description

__all__ = ["ArrayCounters", "ArrayDriver", "ArrayLost", "ArraySilent", "TactileFrame"]


class ArrayLost(DeviceError):
    """An array sends no more, has started anew or is gone. It may come back: asking it again shows."""

    def __init__(self, finger: str, message: str) -> None:
        super().__init__(message)
        self.finger = finger


class ArraySilent(DeviceError):
    """An array does not say what it is, or what comes from its port is no message."""


class TactileFrame(NamedTuple):
    """One sample of every taxel: `counts` has shape (rows, cols), uint16, lowest row first.

    `device_time_s` is the array's own clock at the sample; `host_time_s` is the host's clock when the frame
    was read from the port, which is later by the time on the wire and by the wait until it was read.
    `tared` says that the array took a zero of its own off, so that counts are not raw.
    """

    sequence: int
    device_time_s: float
    host_time_s: float
    counts: Counts
    tared: bool = False


@dataclass(frozen=True)
class ArrayCounters:
    """What went wrong on this port since it was opened.

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
        """What the array said of itself; raises DeviceError before `connect`."""
        ...

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        ...

    @property
    def silence(self) -> str:
        """What came since the last frame, for messages: "nothing", or what is no frame."""
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
