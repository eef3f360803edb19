"""Host driver of the line array, as an `ArrayDriver`."""

import numpy as np

from line_array.codec import LineDecoder, encode
from palpate.plugins import (
    ArrayCounters,
    Clock,
    Description,
    DeviceError,
    FrameStream,
    FrameTimes,
    Mounting,
    Port,
    TactileFrame,
)

__all__ = ["LineArray"]

_ATTEMPTS = 3
_ANSWER_S = 0.15
_BIT_DEPTH = 12
_MAX_RATE_HZ = 100.0
_HEAD = 9  # characters of a frame before its taxels


class LineArray:
    """A line array on an open port, with its mounting on a finger's tip."""

    def __init__(
        self, port: Port, clock: Clock, finger: str, mounting: Mounting, oversampling: int = 1
    ) -> None:
        self._stream = FrameStream(port, clock, finger, self._take, b"\n")
        self._clock = clock
        self._mounting = mounting
        self._oversampling = oversampling
        self._decoder = LineDecoder()
        self._answers: list[list[str]] = []
        self._description: Description | None = None
        self._times = FrameTimes(1e-3)
        self._misshapen = 0

    @property
    def description(self) -> Description:
        """What the array said of itself; raises DeviceError before `connect`."""
        if self._description is None:
            raise DeviceError(f"{self._stream.where} has not been asked what it is; call connect() first")
        return self._description

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        faults = sum(self._decoder.faults.values())
        stream = self._stream
        return ArrayCounters(stream.received, self._times.lost, faults, self._misshapen, stream.dropped)

    @property
    def silence(self) -> str:
        """What came since the last frame, for messages."""
        return self._stream.silence

    def connect(self) -> Description:
        """Ask the array what it is; a running stream stops."""
        self._description = None
        self._ask("halt")
        try:
            cols, rows, width, height = map(float, self._ask("what")[1:])
            self._description = self._mounting.describe(
                (int(cols), int(rows)),
                (width, height),
                unique_id=b"lines",
                firmware="lines 1",
                emulated=True,
                bit_depth=_BIT_DEPTH,
                max_rate_hz=_MAX_RATE_HZ,
            )
        except ValueError as problem:
            raise DeviceError(
                f"{self._stream.where} cannot be used: {problem}; check the rig file"
            ) from problem
        self._times.restart()
        self._stream.clear()
        return self._description

    def start(self, rate_hz: float) -> None:
        """Stream frames at `rate_hz`."""
        limit = self.description.max_rate_hz
        if not 0 < rate_hz <= limit:
            raise DeviceError(
                f"{self._stream.where} cannot sample at {rate_hz:g} Hz; choose a rate up to {limit:g} Hz"
            )
        self._ask("halt")
        self._times.restart()
        self._ask(f"go {rate_hz:g} {self._oversampling}")
        self._stream.expect(rate_hz, _HEAD + 12 + 3 * self.description.taxels)

    def stop(self) -> None:
        """Stop the stream."""
        self._ask("halt")

    def frames(self) -> list[TactileFrame]:
        """Return the frames that have arrived, without waiting."""
        return self._stream.frames()

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`."""
        return self._stream.wait_frame(timeout_s)

    def _ask(self, text: str) -> list[str]:
        verb = text.split(maxsplit=1)[0]
        self._answers.clear()
        for _ in range(_ATTEMPTS):
            self._stream.write(encode(text))
            if self._stream.wait_until(lambda: any(said[0] == verb for said in self._answers), _ANSWER_S):
                return next(said for said in self._answers if said[0] == verb)
        raise DeviceError(f"{self._stream.where} does not answer; check its power, its cable and its port")

    def _take(self, data: bytes) -> None:
        for text in self._decoder.feed(data):
            if text.startswith("f"):
                self._frame(text)
            elif text.split():
                self._stream.understood()
                self._answers.append(text.split())

    def _frame(self, text: str) -> None:
        d = self._description
        if d is None:
            return
        try:
            stamp, *counts = (int(digits, 16) for digits in _fields(text))
        except ValueError:
            stamp, counts = 0, []
        place = self._times.place(stamp) if len(counts) == d.taxels else None
        if place is None:
            self._misshapen += 1
            self._stream.refuse(f"{len(text)} characters, or a time that cannot be: {text[:_HEAD]}")
            return
        shape = (d.cols, d.rows) if self._mounting.upright else (d.rows, d.cols)
        cells = self._mounting.to_tip(np.array(counts, np.uint16).reshape(shape))
        self._stream.push(TactileFrame(place.sequence, place.time_s, self._clock.now(), cells))


def _fields(text: str) -> list[str]:
    """Digits of the stamp and of each taxel."""
    return [text[1:_HEAD], *(text[at : at + 3] for at in range(_HEAD, len(text), 3))]
