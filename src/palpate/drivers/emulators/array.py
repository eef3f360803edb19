"""Emulated tactile array: forces on taxels in, bytes of the tactile protocol out; TARE and SELF_TEST.

It is written from `docs/tactile-protocol.md` and knows nothing of objects or recognition: the bench calls
`sample` at the instants that `next_sample_s` names. What is wrong with the sensor is in `taxels`. It examines
itself as arrays do that can switch a test signal in place of the skin: the counts must rise with it, and keep
still.
"""

from collections import deque
from collections.abc import Callable

import numpy as np

from palpate.base.geometry import Counts, Floats, Ints
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import VERSION, DecodeFault, Decoder, FaultKind, encode
from palpate.drivers.tactile.description import REALS_PER_TAXEL, Corner
from palpate.drivers.tactile.messages import (
    MAX_LISTED_TAXELS,
    MAX_TARE_SAMPLES,
    Ack,
    BadTaxel,
    Describe,
    Frame,
    FrameFlag,
    Geometry,
    Hello,
    Message,
    MessageBody,
    MessageType,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Start,
    Stop,
    Tare,
    TaxelFault,
    TaxelPlaces,
)
from palpate.drivers.transport.wire import Emission

_SELF_TEST_SAMPLES = 16
_TEST_SIGNAL_SHARE = 0.75  # of the full scale
_MIN_RISE_SHARE = 1 / 8  # of the largest count; far below the signal, whatever a taxel's gain
_MAX_NOISE_SHARE = 1 / 32  # of the largest count, standard deviation


def _run_self_test(taxels: Taxels) -> tuple[BadTaxel, ...]:
    """Return the taxels that do not follow a test signal or do not keep still under it, row by row."""
    d = taxels.description
    nothing = np.zeros((d.rows, d.cols))
    rest = np.stack([taxels.counts(nothing) for _ in range(_SELF_TEST_SAMPLES)])
    test = np.stack(
        [taxels.counts(nothing + _TEST_SIGNAL_SHARE * d.full_scale_n) for _ in range(_SELF_TEST_SAMPLES)]
    )
    stuck = test.mean(axis=0) - rest.mean(axis=0) < _MIN_RISE_SHARE * d.max_count
    high = rest.mean(axis=0) > d.max_count / 2
    kind = np.zeros((d.rows, d.cols), dtype=np.int64)
    kind[test.std(axis=0) > _MAX_NOISE_SHARE * d.max_count] = TaxelFault.UNSTEADY
    kind[stuck & high] = TaxelFault.STUCK_HIGH
    kind[stuck & ~high] = TaxelFault.STUCK_LOW
    return tuple(BadTaxel(int(i), int(j), TaxelFault(kind[i, j])) for i, j in np.argwhere(kind))


class TareOffset:
    """RAW, AVERAGING or TARED, as in the page's section 3."""

    def __init__(self, max_count: int) -> None:
        self._max_count = max_count
        self._offset: Ints | None = None
        self._samples: list[Counts] = []
        self._wanted = 0
        self._pedestal = 0

    def forget(self) -> None:
        """Go back to raw counts."""
        self._offset = None
        self._wanted = 0

    def begin(self, samples: int, pedestal: int) -> None:
        """Average the next `samples` samples, then take the mean off and add `pedestal` counts."""
        self._samples, self._wanted, self._pedestal = [], samples, pedestal

    def apply(self, raw: Counts) -> tuple[Counts, bool]:
        """Take in one sample; return what the array sends of it, and whether that is tared."""
        offset = self._offset
        if self._wanted:
            self._average(raw)
        if offset is None:
            return raw, False
        counts = np.clip(raw - offset, 0, self._max_count)
        return np.where(raw == self._max_count, raw, counts).astype("<u2"), True  # full ones stay full

    def _average(self, raw: Counts) -> None:
        self._samples.append(raw)
        n = len(self._samples)
        if n == self._wanted:
            total: Ints = np.sum(self._samples, axis=0, dtype=np.int64)
            self._offset = (2 * total + n) // (2 * n) - self._pedestal  # halves go up
            self._samples, self._wanted = [], 0


_NO_RESULT = SelfTestResult(0)
_TAXELS_PER_MESSAGE = 64
_REASONS = {
    FaultKind.VERSION: NackReason.BAD_VERSION,
    FaultKind.UNKNOWN_TYPE: NackReason.UNKNOWN_TYPE,
    FaultKind.PAYLOAD: NackReason.BAD_PAYLOAD,
}


class EmulatedArray:
    """A `Device` (see `drivers.transport.wire`) that answers commands and streams frames of its `taxels`.

    `advance(now)` is called before anything is answered, so that the world can bring its samples up to `now`.
    `first`: the corner of the tip from which it counts.
    `version` is the protocol's that it speaks. `broken` is what its self-test finds beside taxels; with
    a broken converter it streams no frames. The self-test takes `self_test_s`, and what arrives
    meanwhile waits. Raises DeviceError if the surface is free and the places of its taxels are not given.
    """

    def __init__(
        self,
        taxels: Taxels,
        advance: Callable[[float], None] | None = None,
        first: Corner = Corner.LOWER_LEFT,
        *,
        version: int = VERSION,
        broken: SelfTestResult = _NO_RESULT,
        self_test_s: float = 0.25,
    ) -> None:
        self.description = taxels.description
        self.taxels = taxels
        self.broken = broken
        self._advance = advance
        self._first = first
        self._version = version
        self._self_test_s = self_test_s
        d = self.description
        places = d.geometry or np.concatenate((d.positions_mm(), d.normals()), axis=-1)
        self._places = np.reshape(places, (d.taxels, REALS_PER_TAXEL))
        self._zero = TareOffset(d.max_count)
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Begin anew, as after a reset or power-up at `now`: IDLE and RAW, numbers and clock at 0."""
        self._decoder = Decoder(self._version)
        self._waiting: deque[tuple[float, Message | DecodeFault]] = deque()
        self._queue: deque[Emission] = deque()
        self._busy_until_s = self._born_s = now
        self._sequence = 0
        self._period_s: float | None = None
        self._start_s = now
        self._samples = 0
        self._zero.forget()

    def next_sample_s(self) -> float | None:
        """Instant at which the array samples next, or None while it does not stream."""
        if self._period_s is None:
            return None
        return self._start_s + (self._samples + 1) * self._period_s

    def sample(self, now: float, force_n: Floats) -> None:
        """Sample forces (N per taxel, shape (rows, cols)) at `now` and queue the frame.

        Does nothing while the array does not stream. Raises ValueError on another shape.
        """
        if self._period_s is None:
            return
        self._samples += 1
        d = self.description
        if self._first is not Corner.LOWER_LEFT:
            force_n = self._first.flip(force_n)
        counts, tared = self._zero.apply(self.taxels.counts(force_n, now))
        self._send(Frame(d.rows, d.cols, counts.tobytes()), now, FrameFlag.TARED if tared else 0)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes that arrived at `now`; return answers and frames due up to `now`."""
        if self._advance is not None:
            self._advance(now)
        self._waiting.extend((now, item) for item in self._decoder.feed(data))
        self._work(now)
        return self._due(now)

    def poll(self, now: float) -> list[Emission]:
        """Return answers and frames due up to `now`."""
        if self._advance is not None:
            self._advance(now)
        if self._waiting:
            self._work(now)
        return self._due(now) if self._queue else []

    def next_due(self) -> float | None:
        """Instant of the next answer or frame, or None if there is none in sight."""
        return self._queue[0][0] if self._queue else self.next_sample_s()

    def _due(self, now: float) -> list[Emission]:
        out = []
        while self._queue and self._queue[0][0] <= now:
            out.append(self._queue.popleft())
        return out

    def _work(self, now: float) -> None:
        while self._waiting and now >= self._busy_until_s:
            arrived, item = self._waiting.popleft()
            at = max(arrived, self._busy_until_s)
            if isinstance(item, DecodeFault):
                self._refuse(item, at)
            else:
                self._obey(item.body, at)

    def _refuse(self, fault: DecodeFault, now: float) -> None:
        reason = _REASONS.get(fault.kind)
        if reason is None or fault.request_id is None or fault.type_code is None:
            return
        if MessageType.is_request(fault.type_code):
            self._send(Nack(fault.request_id, reason), now)

    def _obey(self, body: MessageBody, now: float) -> None:
        match body:
            case Hello():
                self._period_s = None
                self._zero.forget()
                self._send(Describe(body.request_id, self.description), now)
            case Stop():
                self._period_s = None
                self._send(Ack(body.request_id), now)
            case SelfTest():
                self._examine_itself(body, now)
            case Geometry():
                self._tell_places(body, now)
            case Start() | Rate() | Tare():
                reason = self._tare(body) if isinstance(body, Tare) else self._pace(body, now)
                self._send(Ack(body.request_id) if reason is None else Nack(body.request_id, reason), now)
            case _:
                pass  # its own kind of message, come back on a shorted wire

    def _pace(self, body: Start | Rate, now: float) -> NackReason | None:
        """Stream at another rate; return why not, or None."""
        rate_hz = body.rate_mhz / 1000
        if not 0 < rate_hz <= self.description.max_rate_hz:
            return NackReason.BAD_RATE
        period_s = 1 / rate_hz
        if isinstance(body, Start):
            if self.broken & SelfTestResult.CONVERTER:
                return NackReason.HARDWARE
            self._start_s = now
        elif self._period_s is None:
            return NackReason.BAD_STATE
        else:
            last_s = self._start_s + self._samples * self._period_s
            self._start_s = max(last_s, now - period_s)  # a frame that would be late already comes at once
        self._period_s, self._samples = period_s, 0
        return None

    def _tare(self, body: Tare) -> NackReason | None:
        if body.samples > MAX_TARE_SAMPLES or body.pedestal > self.description.max_count:
            return NackReason.BAD_PAYLOAD
        if body.samples:
            self._zero.begin(body.samples, body.pedestal)
        else:
            self._zero.forget()
        return None

    def _examine_itself(self, body: SelfTest, now: float) -> None:
        if self._period_s is not None:
            self._send(Nack(body.request_id, NackReason.BAD_STATE), now)
            return
        self._busy_until_s = now + self._self_test_s
        bad = _run_self_test(self.taxels)
        result = self.broken | (SelfTestResult.TAXELS if bad else _NO_RESULT)
        self._send(
            SelfTestReport(body.request_id, result, len(bad), bad[:MAX_LISTED_TAXELS]), self._busy_until_s
        )

    def _tell_places(self, body: Geometry, now: float) -> None:
        places = self._places[body.first : body.first + _TAXELS_PER_MESSAGE]
        if places.size:
            values = tuple(map(float, places.ravel()))
            self._send(TaxelPlaces(body.request_id, body.first, values), now)
        else:
            self._send(Nack(body.request_id, NackReason.BAD_PAYLOAD), now)

    def _send(self, body: MessageBody, now: float, flags: int = 0) -> None:
        message = Message(self._sequence, round((now - self._born_s) * 1e6), body, flags)
        self._queue.append((now, encode(message, self._version)))
        self._sequence = (self._sequence + 1) % (1 << 32)
