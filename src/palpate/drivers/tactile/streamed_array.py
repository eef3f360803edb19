"""Base of array drivers: what each does alike with the stream of its frames."""

from abc import ABC, abstractmethod

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import ArrayCounters, TactileFrame
from palpate.drivers.tactile.stream import FrameStream
from palpate.drivers.transport.clock import Clock

__all__ = ["StreamedArray"]


class StreamedArray(ABC):
    """An `ArrayDriver` but for `connect`, `start` and `stop`, which talk to the array.

    `connect` sets `_description`, None as long as it does not know. Frames are pushed to `_stream`, and those
    that make no sense given to `_refuse`.
    """

    def __init__(self, stream: FrameStream, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock
        self._description: Description | None = None
        self._misshapen = 0

    @property
    @abstractmethod
    def _lost_and_faults(self) -> tuple[int, int]:
        """How many frames never came, and how many stretches of the stream were no message."""

    @property
    def description(self) -> Description:
        """What the array said of itself; raises DeviceError before `connect`."""
        if self._description is None:
            raise DeviceError(f"{self._stream.where} has not been asked what it is; call connect() first")
        return self._description

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        lost, faults = self._lost_and_faults
        return ArrayCounters(self._stream.received, lost, faults, self._misshapen, self._stream.dropped)

    @property
    def silence(self) -> str:
        """What came since the last frame, for messages: "nothing", or what is no frame."""
        return self._stream.silence

    def frames(self) -> list[TactileFrame]:
        """Return every frame that has arrived, oldest first, without waiting.

        Takes a bounded time, whatever arrives; raises DeviceError if it makes no sense for long.
        """
        return self._stream.frames()

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`; raises DeviceError if none comes."""
        return self._stream.wait_frame(timeout_s)

    def _check_rate(self, rate_hz: float) -> None:
        """Raise DeviceError for a rate that the array cannot do."""
        limit = self.description.max_rate_hz
        if not 0 < rate_hz <= limit:
            raise DeviceError(
                f"{self._stream.where} cannot sample at {rate_hz:g} Hz; choose a rate up to {limit:g} Hz"
            )

    def _refuse(self, reason: str) -> None:
        """Count a frame that makes no sense."""
        self._misshapen += 1
        self._stream.refuse(reason)
