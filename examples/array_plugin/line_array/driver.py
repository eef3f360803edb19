"""Host driver of the line array: an `ArrayDriver`, most of which `StreamedArray` does."""

import numpy as np

from line_array.codec import LineDecoder, encode
from palpate.plugins import (
    Clock,
    Description,
    DeviceError,
    FrameStream,
    FrameTimes,
    Mounting,
    Port,
    StreamedArray,
    TactileFrame,
)

__all__ = ["LineArray"]

_ATTEMPTS = 3
_ANSWER_S = 0.15
_BIT_DEPTH = 12
_MAX_RATE_HZ = 100.0
_HEAD = 9  # characters of a frame before its taxels


class LineArray(StreamedArray):
    """A line array on an open port, with its mounting on a finger's tip."""

    def __init__(
        self, port: Port, clock: Clock, finger: str, mounting: Mounting, oversampling: int = 1
    ) -> None:
        super().__init__(FrameStream(port, clock, finger, self._take, b"\n"), clock)
        self._mounting = mounting
        self._oversampling = oversampling
        self._decoder = LineDecoder()
        self._answers: list[list[str]] = []
        self._times = FrameTimes(1e-3)

    @property
    def _lost_and_faults(self) -> tuple[int, int]:
        return self._times.lost, sum(self._decoder.faults.values())

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
        self._check_rate(rate_hz)
        self._ask("halt")
        self._times.restart()
        self._ask(f"go {rate_hz:g} {self._oversampling}")
        self._stream.expect(rate_hz, _HEAD + 12 + 3 * self.description.taxels)

    def stop(self) -> None:
        """Stop the stream."""
        self._ask("halt")

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
                self._stream.note_answer()
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
            self._refuse(f"{len(text)} characters, or a time that cannot be: {text[:_HEAD]}")
            return
        shape = (d.cols, d.rows) if self._mounting.upright else (d.rows, d.cols)
        cells = self._mounting.to_tip(np.array(counts, np.uint16).reshape(shape))
        self._stream.push(TactileFrame(place.sequence, place.time_s, self._clock.now(), cells))


def _fields(text: str) -> list[str]:
    """Digits of the stamp and of each taxel."""
    return [text[1:_HEAD], *(text[at : at + 3] for at in range(_HEAD, len(text), 3))]
