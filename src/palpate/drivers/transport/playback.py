"""A port that plays back what was once read from it, by a clock. From a recording to a driver.

Unlike `replay`, which runs the recorded host again and compares it, this serves a host that does
something else: it answers the first questions with what followed them in the recording, and then plays
by time.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recording import Direction

__all__ = ["Piece", "PlaybackPort"]


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes that passed the port at `t_s` on the recording's clock."""

    t_s: float
    direction: Direction
    data: bytes


class PlaybackPort:
    """As much of a pyserial port as drivers use; what is written to it goes nowhere.

    Until `play` is called, each write releases what was received between the recorded write of the same
    number and the next one: answers come as they came, whenever they are asked for. After it, bytes are
    there from their recorded instant on.
    """

    def __init__(self, name: str, pieces: Sequence[Piece], clock: Clock) -> None:
        """`pieces` in order, on a clock that stands for the recording's."""
        self.port: str | None = name
        self.timeout: float | None = 0.0
        self._pieces = list(pieces)
        self._times_s = [piece.t_s for piece in pieces]
        self._clock = clock
        self._at = 0
        self._ready = bytearray()
        self._playing = False
        self.writes = 0

    @property
    def ended(self) -> bool:
        """Whether the recording has nothing more for this port."""
        return self._at >= len(self._pieces) and not self._ready

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting; also brings `writes`, those gone by, up to date."""
        if self._playing:
            self._pass(bisect_right(self._times_s, self._clock.now()))
        return len(self._ready)

    def extend(self, pieces: Sequence[Piece]) -> None:
        """Add what was recorded since, in order."""
        self._pieces += pieces
        self._times_s += [piece.t_s for piece in pieces]

    def play(self) -> None:
        """Give the rest by the clock."""
        self._playing = True

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes; if there are none, let `timeout` pass on the clock once."""
        if not self.in_waiting and self.timeout:
            self._clock.sleep(self.timeout)
        data = bytes(self._ready[: min(size, self.in_waiting)])
        del self._ready[: len(data)]
        return data

    def write(self, data: bytes, /) -> int:
        """Take bytes as a port would."""
        if not self._playing:
            self._pass(self._next_write(self._at) + 1)
            self._pass(self._next_write(self._at))
        return len(data)

    def _next_write(self, at: int) -> int:
        pieces = range(at, len(self._pieces))
        sent = (k for k in pieces if self._pieces[k].direction is Direction.SENT)
        return next(sent, len(self._pieces))

    def _pass(self, end: int) -> None:
        """Let everything before piece `end` go by."""
        for piece in self._pieces[self._at : end]:
            if piece.direction is Direction.RECEIVED:
                self._ready += piece.data
            else:
                self.writes += 1
        self._at = max(self._at, min(end, len(self._pieces)))
