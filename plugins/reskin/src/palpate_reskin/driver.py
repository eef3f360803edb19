"""Host driver of a magnetometer skin: changes of the field as taxels.

A taxel's reading is |ΔB|, the size of the change of all three axes since the stream was started, 0.1 µT a
count. A place of the skin that is pressed in changes the field of a magnetometer the less the farther away it
is: for a dipole that stands on the skin and is pushed along its axis, at depth h below it and u h beside it,
by 3 √(u⁴ + 4) / (1 + u²)³, which only falls. So the magnetometer that changes most is the nearest one, but
for gains; signs and axes say nothing that bounds rest on. |a + e| is within |e| of |a|: what bounds drift and
noise of the field bounds those of the reading.
"""

from collections.abc import Sequence

import numpy as np

from palpate.plugins import (
    Clock,
    Corner,
    Counts,
    DecodedFrame,
    Description,
    DeviceError,
    FreeRunningArray,
    Port,
)
from palpate_reskin.codec import MARK, FieldDecoder, Fields

__all__ = ["COUNTS_PER_UT", "ReskinArray"]

COUNTS_PER_UT = 10.0
_MAX_COUNT = 65535
_ZERO_FRAMES = 16
_ZERO_FRAMES_LATE = 3  # times as long as they take


class _Changes:
    """Decoder of changes since `zero`, as the matrix on the tip; 0 until there is a zero."""

    def __init__(self, shape: tuple[int, int], first: Corner) -> None:
        self._shape, self._first = shape, first
        self._decoder = FieldDecoder(shape[0] * shape[1])
        self.faults = self._decoder.faults
        self.zero: Fields | None = None
        self._at_rest: list[Fields] = []

    def feed(self, data: bytes) -> Sequence[DecodedFrame]:
        """Take bytes as they came; return the changes of the frames that they complete."""
        return [DecodedFrame(self._counts(each)) for each in self._decoder.feed(data)]

    def take_zero(self) -> None:
        """Take the next few frames for the field at rest."""
        self._at_rest, self.zero = [], None

    def _counts(self, fields: Fields) -> Counts:
        if self.zero is None:
            self._at_rest.append(fields)
            if len(self._at_rest) == _ZERO_FRAMES:
                self.zero = np.mean(self._at_rest, axis=0)
        zero = fields if self.zero is None else self.zero
        change = np.linalg.norm(fields[:, 1:].astype(float) - zero[:, 1:], axis=1).reshape(self._shape)
        counts = np.minimum(np.rint(COUNTS_PER_UT * change), _MAX_COUNT).astype(np.uint16)
        return np.ascontiguousarray(self._first.flip(counts))


class ReskinArray(FreeRunningArray):
    """A magnetometer skin on an open port. Each `start` takes a zero anew: nothing may touch the tip then."""

    def __init__(
        self, port: Port, clock: Clock, finger: str, description: Description, first: Corner, delay_s: float
    ) -> None:
        shape = description.rows, description.cols
        self._changes = _Changes(shape, first)
        frame_bytes = 16 * shape[0] * shape[1] + len(MARK)
        super().__init__(port, clock, finger, description, self._changes, frame_bytes, delay_s)

    def start(self, rate_hz: float) -> None:
        """Take the mean of the next few frames for the field at rest, and frames from then on."""
        super().stop()
        self._check_rate(rate_hz)
        self._changes.take_zero()
        longest_s = _ZERO_FRAMES_LATE * _ZERO_FRAMES / self.description.max_rate_hz
        if not self._stream.wait_until(lambda: self._changes.zero is not None, longest_s):
            raise DeviceError(f"{self._stream.where} sends no frames; check its cable and its power")
        super().start(rate_hz)
