"""Emulated free-running array: it samples at its own rate from power on; `frame` makes the bytes."""

from collections.abc import Callable, Sequence

from palpate.base.geometry import Floats
from palpate.drivers.tactile.description import Description
from palpate.drivers.transport.wire import Device, Emission

_SCATTER = 0.618033988749895  # of a period: no two arrays sample in step


class EmulatedFreeRunningArray:
    """A device on a wire that takes no orders.

    `description`: of the taxels to which the bench hands forces. `frame(now, force_n)`: bytes of the frame
    that was sampled at `now` (s), from forces (rows, cols) in N; it leaves `held_s` later.
    """

    def __init__(
        self,
        description: Description,
        advance: Callable[[float], None],
        rate_hz: float,
        frame: Callable[[float, Floats], bytes],
        held_s: float = 0.0,
    ) -> None:
        self._described, self._advance, self._frame = description, advance, frame
        self._period_s, self._held_s = 1 / rate_hz, held_s
        self.restart(0.0)

    @property
    def description(self) -> Description:
        """The truth about its taxels."""
        return self._described

    def restart(self, now: float) -> None:
        """Begin anew, as when power comes on."""
        self._queue: list[Emission] = []
        self._next_s = now + _SCATTER * self._period_s

    def next_sample_s(self) -> float | None:
        """Instant of the next sample."""
        return self._next_s

    def sample(self, now: float, force_n: Floats) -> None:
        """Send a frame of forces (N, rows x cols)."""
        self._queue.append((now + self._held_s, self._frame(now, force_n)))
        self._next_s += self._period_s

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Ignore what arrives; return frames that are due."""
        del data
        return self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        """Return what is due at `now`."""
        self._advance(now)
        due = [item for item in self._queue if item[0] <= now]
        self._queue = [item for item in self._queue if item[0] > now]
        return due

    def next_due(self) -> float | None:
        """Instant of the next emission."""
        return self._queue[0][0] if self._queue else self._next_s + self._held_s


class SharedWire:
    """Several devices on one wire: each hears all that comes, and they send one after the other."""

    def __init__(self, devices: Sequence[Device]) -> None:
        self._devices = tuple(devices)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes; return what any device sends."""
        return _in_order([sent for device in self._devices for sent in device.feed(data, now)])

    def poll(self, now: float) -> list[Emission]:
        """Return what any device has sent up to `now`."""
        return _in_order([sent for device in self._devices for sent in device.poll(now)])

    def next_due(self) -> float | None:
        """Instant of the next emission of any device."""
        return min((due for device in self._devices if (due := device.next_due()) is not None), default=None)


def _in_order(sent: list[Emission]) -> list[Emission]:
    return sorted(sent, key=lambda item: item[0])
