"""Base of the emulated tactile sensors of Weiss Robotics: scans, streams, power-up.

Whoever plays the world calls `sample` at the instants that `next_sample_s` names, as with `EmulatedArray`.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable

from palpate.plugins import Counts, Description, Emission, Floats, Taxels, wire_time_s
from palpate_weiss.codec import WeissDecoder, WeissDialect, WeissPacket, encode
from palpate_weiss.messages import FRAME, frame_payload

__all__ = ["EmulatedWeiss"]


_INTERRUPTED_S = 0.1  # a command whose rest takes longer is given up
_LONGEST_COMMAND = 256


class EmulatedWeiss(ABC):
    """A `Device` (see `drivers.transport.wire`) with a matrix of texels that it scans, each scan in turn.

    `scan_s`: how long a scan takes at least; frames that the wire cannot carry so fast come more slowly.
    `powered_s`: instant at which power came on. `to_device`: from the tip's rows and columns to the device's.
    """

    _dialect: WeissDialect
    _boot_s: float

    def __init__(
        self,
        taxels: Taxels,
        advance: Callable[[float], None] | None,
        *,
        scan_s: float,
        baudrate: int,
        powered_s: float,
        tick_s: float,
        to_device: Callable[[Counts], Counts],
    ) -> None:
        self.taxels = taxels
        self._advance = advance
        self._scan_s = scan_s
        self._baudrate = baudrate
        self._powered_s = powered_s
        self._tick_s = tick_s
        self._to_device = to_device
        self._decoder = WeissDecoder(self._dialect, _LONGEST_COMMAND)
        self._heard_s = powered_s
        self._queue: deque[Emission] = deque()
        self._period_s: float | None = None
        self._next_s = 0.0
        self._compressed = False
        self._once: tuple[float, Callable[[Counts, float], None]] | None = None

    @property
    def description(self) -> Description:
        """The truth about its texels, in the tip's rows and columns."""
        return self.taxels.description

    @property
    def streaming(self) -> bool:
        """Whether it sends frames of its own accord."""
        return self._period_s is not None

    def next_sample_s(self) -> float | None:
        """Instant at which the next scan is complete, or None while it scans nothing."""
        due = [] if self._period_s is None else [self._next_s]
        due += [] if self._once is None else [self._once[0]]
        return min(due) if due else None

    def sample(self, now: float, force_n: Floats) -> None:
        """Scan forces (N per taxel, shape (rows, cols) of the description) at `now`."""
        texels = self._read(self._to_device(self.taxels.counts(force_n, now)).ravel())
        if self._once is not None and now >= self._once[0]:
            _, use = self._once
            self._once = None
            use(texels, now)
        if self._period_s is not None and now >= self._next_s:
            sent = self._send(WeissPacket(FRAME, self._frame(texels, now, compressed=self._compressed)), now)
            self._next_s = now + max(self._period_s, self._scan_s, wire_time_s(sent, self._baudrate))

    def restart(self, _now: float) -> None:
        """Stop scanning, as after a reset of its board."""
        self._stop()
        self._once = None
        self._queue.clear()

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes that arrived at `now`; return answers and frames due up to `now`."""
        self._catch_up(now)
        if now >= self._powered_s + self._boot_s:
            if now - self._heard_s > _INTERRUPTED_S:
                self._decoder.give_up()
            self._heard_s = now
            for item in self._decoder.feed(data):
                if isinstance(item, WeissPacket):
                    self._obey(item, now)
        return self._due(now)

    def poll(self, now: float) -> list[Emission]:
        """Return frames due up to `now`."""
        self._catch_up(now)
        return self._due(now)

    def next_due(self) -> float | None:
        """Instant of the next frame or of boot noise, or None while there is none in sight."""
        own = self.next_sample_s()
        if not self._queue:
            return own
        return self._queue[0][0] if own is None else min(own, self._queue[0][0])

    @abstractmethod
    def _obey(self, packet: WeissPacket, now: float) -> None:
        """Carry out a command and answer it."""

    @abstractmethod
    def _read(self, texels: Counts) -> Counts:
        """What the device makes of the counts of its texels, in its own order."""

    def _start(self, period_s: float, now: float, *, compressed: bool) -> None:
        self._period_s, self._compressed = period_s, compressed
        self._next_s = now + max(period_s, self._scan_s)

    def _stop(self) -> None:
        self._period_s = None

    def _scan(self, now: float, use: Callable[[Counts, float], None]) -> None:
        """Do one scan more, and give what it reads and its instant to `use`."""
        self._once = (now + self._scan_s, use)

    def _frame(self, texels: Counts, now: float, *, compressed: bool) -> bytes:
        stamp = round((now - self._powered_s) / self._tick_s)
        return frame_payload(stamp, texels, compressed=compressed)

    def _answer(self, command: int, status: int, now: float, data: bytes = b"") -> None:
        self._send(WeissPacket(command, status.to_bytes(2, "little") + data), now)

    def _send(self, packet: WeissPacket, now: float) -> int:
        data = encode(self._dialect, packet)
        self._queue.append((now, data))
        return len(data)

    def _catch_up(self, now: float) -> None:
        if self._advance is not None:
            self._advance(now)

    def _due(self, now: float) -> list[Emission]:
        out = []
        while self._queue and self._queue[0][0] <= now:
            out.append(self._queue.popleft())
        return out
