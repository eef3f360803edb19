"""An emulated tactile array: forces on taxels in, protocol bytes out. Stands where a real array's port ends.

It is written from `docs/tactile-protocol.md` and knows nothing of objects or recognition: whoever plays
the world calls `sample` at the instants that `next_sample_s` names. What is wrong with the sensor is in
`taxels`.
"""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.messages import (
    Ack,
    Body,
    Describe,
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
    """A `Device` (see `drivers.transport.wire`) that answers commands and streams frames of its `taxels`.

    `advance(now)` is called before anything is answered, so that the world can bring its samples up to `now`.
    """

    def __init__(self, taxels: Taxels, advance: Callable[[float], None] | None = None) -> None:
        self.description = taxels.description
        self.taxels = taxels
        self._advance = advance
        self._decoder = Decoder()
        self._queue: deque[Emission] = deque()
        self._sequence = 0
        self._period_s: float | None = None
        self._start_s = 0.0
        self._samples = 0

    def next_sample_s(self) -> float | None:
        """Instant at which the array samples next, or None while it does not stream."""
        if self._period_s is None:
            return None
        return self._start_s + (self._samples + 1) * self._period_s

    def sample(self, now: float, force_n: NDArray[np.float64]) -> None:
        """Sample forces (N per taxel, shape (rows, cols)) at `now` and queue the frame.

        Does nothing while the array does not stream. Raises ValueError on another shape.
        """
        if self._period_s is None:
            return
        self._samples += 1
        d = self.description
        self._send(Frame(d.rows, d.cols, self.taxels.counts(force_n, now).tobytes()), now)

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
