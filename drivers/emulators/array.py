"""An emulated tactile array: forces on taxels in, protocol bytes out. Stands where a real array's port ends.

It is written from `docs/tactile-protocol.md` and knows nothing of objects or recognition: whoever plays
the world calls `sample` at the instants that `next_sample_s` names. The sensor's faults are its own: gain
and offset per taxel, crosstalk to the four neighbours, noise, saturation, quantisation, dead and hot taxels.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.drivers.tactile.messages import (
    Ack,
    Body,
    Describe,
    Description,
    Frame,
    Hello,
    Message,
    MessageType,
    Nack,
    NackReason,
    Start,
    Stop,
)
from palpate.drivers.tactile.protocol import DecodeFault, Decoder, FaultKind, encode
from palpate.drivers.transport.wire import Emission

__all__ = ["EmulatedArray"]

_COMMANDS = (MessageType.HELLO, MessageType.START, MessageType.STOP)


class EmulatedArray:
    """A `Device` (see `drivers.transport.wire`) that answers commands and streams frames.

    `gain_spread` is the half-width of the uniform gain error of each taxel, `crosstalk` the share of a
    taxel's force that each of its four neighbours takes from it (the total is kept), `noise_counts` the
    standard deviation of the noise. `dead` and `hot` are (row, column) pairs stuck at 0 and at full.
    `advance(now)` is called before anything is answered, so that the world can bring its samples up to `now`.
    Same seed and same forces: same bytes.
    """

    def __init__(
        self,
        description: Description,
        *,
        seed: int,
        noise_counts: float = 2.0,
        gain_spread: float = 0.0,
        offset_counts: float = 0.0,
        crosstalk: float = 0.0,
        dead: Sequence[tuple[int, int]] = (),
        hot: Sequence[tuple[int, int]] = (),
        advance: Callable[[float], None] | None = None,
    ) -> None:
        self.description = description
        shape = (description.rows, description.cols)
        self._rng = np.random.default_rng(seed)
        gain = 1.0 + gain_spread * self._rng.uniform(-1.0, 1.0, shape)
        self._gain_counts = gain * description.counts_per_n
        self._offset = np.full(shape, float(offset_counts))
        self._noise = noise_counts
        self._spread_rows = _exchange(description.rows, crosstalk)
        self._spread_cols = _exchange(description.cols, crosstalk)
        self._dead = tuple(dead)
        self._hot = tuple(hot)
        self._advance = advance
        self._decoder = Decoder()
        self._queue: deque[Emission] = deque()
        self._sequence = 0
        self._period_s: float | None = None
        self._start_s = 0.0
        self._samples = 0

    @property
    def gain(self) -> NDArray[np.float64]:
        """True relative gain of every taxel, shape (rows, cols): the truth that calibration looks for."""
        return self._gain_counts / self.description.counts_per_n

    def next_sample_s(self) -> float | None:
        """Instant at which the array samples next, or None while it does not stream."""
        if self._period_s is None:
            return None
        return self._start_s + (self._samples + 1) * self._period_s

    def sample(self, now: float, force_n: NDArray[np.float64]) -> None:
        """Sample forces (N per taxel, shape (rows, cols)) at `now` and queue the frame.

        Does nothing while the array does not stream. Raises ValueError on another shape.
        """
        d = self.description
        if force_n.shape != (d.rows, d.cols):
            raise ValueError(f"forces of shape {force_n.shape} for an array of {d.rows} x {d.cols}")
        if self._period_s is None:
            return
        self._samples += 1
        counts = self._spread_rows @ force_n
        counts += force_n @ self._spread_cols
        counts += force_n
        counts *= self._gain_counts
        counts += self._offset
        counts += self._noise * self._rng.standard_normal(counts.shape)
        np.rint(counts, out=counts)
        np.clip(counts, 0, d.max_count, out=counts)
        for place in self._dead:
            counts[place] = 0
        for place in self._hot:
            counts[place] = d.max_count
        self._send(Frame(d.rows, d.cols, counts.astype("<u2").tobytes()), now)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes that arrived at `now`; return answers and frames due up to `now`."""
        self._catch_up(now)
        for item in self._decoder.feed(data):
            if isinstance(item, Message):
                self._obey(item.body, now)
            else:
                self._refuse(item, now)
        return self._due(now)

    def poll(self, now: float) -> list[Emission]:
        """Return frames due up to `now`."""
        self._catch_up(now)
        return self._due(now)

    def next_due(self) -> float | None:
        """Instant of the next frame, or None while the array does not stream."""
        return self._queue[0][0] if self._queue else self.next_sample_s()

    def _catch_up(self, now: float) -> None:
        if self._advance is not None:
            self._advance(now)

    def _due(self, now: float) -> list[Emission]:
        out = []
        while self._queue and self._queue[0][0] <= now:
            out.append(self._queue.popleft())
        return out

    def _obey(self, body: Body, now: float) -> None:
        match body:
            case Hello():
                self._period_s = None
                self._send(Describe(body.request_id, self.description), now)
            case Stop():
                self._period_s = None
                self._send(Ack(body.request_id), now)
            case Start():
                rate_hz = body.rate_mhz / 1000
                if 0 < rate_hz <= self.description.max_rate_hz:
                    self._period_s, self._start_s, self._samples = 1 / rate_hz, now, 0
                    self._send(Ack(body.request_id), now)
                else:
                    self._send(Nack(body.request_id, NackReason.BAD_RATE), now)
            case _:
                pass  # its own kind of message, come back on a shorted wire

    def _refuse(self, fault: DecodeFault, now: float) -> None:
        if fault.request_id is None:
            return
        if fault.kind is FaultKind.UNKNOWN_TYPE and fault.type_code is not None and fault.type_code < 0x80:
            self._send(Nack(fault.request_id, NackReason.UNKNOWN_TYPE), now)
        elif fault.kind is FaultKind.PAYLOAD and fault.type_code in _COMMANDS:
            self._send(Nack(fault.request_id, NackReason.BAD_PAYLOAD), now)

    def _send(self, body: Body, now: float) -> None:
        self._queue.append((now, encode(Message(self._sequence, round(now * 1e6), body))))
        self._sequence = (self._sequence + 1) % (1 << 32)


def _exchange(count: int, share: float) -> NDArray[np.float64]:
    """Return the change that neighbours in a line of `count` work on each other, shape (count, count)."""
    matrix = np.zeros((count, count))
    for i in range(count - 1):
        matrix[i, i + 1] = matrix[i + 1, i] = share
        matrix[i, i] -= share
        matrix[i + 1, i + 1] -= share
    return matrix
