"""Emulated devices on pseudo-terminals in real time, for unmodified clients in other processes.

One pty per device. A single thread owns the devices while the service runs, woken by bytes from a client, by
an answer whose time has come, or by a device that speaks of its own accord. Physics shared between devices
may also be touched by others under `lock`.

If the computer is too slow for the devices, their time runs slower than the clock's: a turn of the service
lets them live for a few milliseconds at most, and then answers. Real servos are never late with an answer
because their motors are hard to compute.

As on a real wire, a client that opens the port at another baud rate than the device's is not understood; a
device that knows rates decides for itself. The service holds the slave side open itself, so that clients may
come and go.
"""

import contextlib
import os
import select
import threading
import tty
from collections import deque
from collections.abc import Mapping
from types import TracebackType

from palpate.drivers.emulators.terminal import baud_rate
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import Device, Emission, RatedDevice, wire_time_s
from palpate.errors import DeviceError

__all__ = ["PtyService", "serve_pty"]

_IDLE_S = 0.02  # longest sleep: how late a stop request or the physics may be noticed
_TURN_S = 0.025  # the devices live for this long in one turn, at most
_CHUNK = 4096


class _Line:
    """One device on its pty."""

    def __init__(self, device: Device, baudrate: int) -> None:
        self.device = device
        self.baudrate = baudrate
        try:
            self.master, self.slave = os.openpty()
        except OSError as error:
            raise DeviceError(
                f"no pseudo-terminal for an emulated device: {error}; close some terminals"
            ) from error
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self.slave)
        self._free_s = 0.0
        self._outgoing: deque[tuple[float, bytes, int]] = deque()  # arrival, bytes, their rate

    def take(self, now: float) -> None:
        """Feed the device what a client has written."""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self.master, _CHUNK)
            rate = self._client_rate()
            if isinstance(self.device, RatedDevice):
                self._schedule(self.device.feed_at(data, now, rate), rate)
            elif rate == self.baudrate:
                self._schedule(self.device.feed(data, now), rate)

    def run(self, now: float) -> None:
        """Let the device speak, and deliver what has arrived at the client by now."""
        self._schedule(self.device.poll(now), self.baudrate)
        while self._outgoing and self._outgoing[0][0] <= now:
            _, data, rate = self._outgoing.popleft()
            if rate == self._client_rate():
                # a client that does not read loses bytes, as at a full receive buffer
                with contextlib.suppress(BlockingIOError):
                    os.write(self.master, data)

    def next_event_s(self) -> float | None:
        """Instant of the next delivery or of the device's next own emission."""
        own = self.device.next_due()
        if not self._outgoing:
            return own
        return self._outgoing[0][0] if own is None else min(own, self._outgoing[0][0])

    def close(self) -> None:
        os.close(self.master)
        os.close(self.slave)

    def _schedule(self, emissions: list[Emission], rate: int) -> None:
        for instant, data in emissions:
            self._free_s = max(instant, self._free_s) + wire_time_s(len(data), rate)
            self._outgoing.append((self._free_s, data, rate))

    def _client_rate(self) -> int:
        """The client's baud rate, or the device's where the system cannot tell."""
        rate = baud_rate(self.master)
        return self.baudrate if rate is None else rate


class _Lifetime:
    """The devices' time: as the clock's, but it never jumps by more than `_TURN_S`."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._seen = clock.now()
        self._now = self._seen

    def advanced(self) -> float:
        """Begin a turn: the devices' time (s) in it."""
        seen = self._clock.now()
        self._now += min(seen - self._seen, _TURN_S)
        self._seen = seen
        return self._now

    def until(self, instant: float) -> float:
        """How long to wait (s) for an instant of the devices' time."""
        return max(0.0, instant - self._now - (self._clock.now() - self._seen))


class PtyService:
    """Devices being served; ends with `stop`, at the end of a `with` block, or by the event given to it."""

    def __init__(
        self, devices: Mapping[str, tuple[Device, int]], clock: Clock, stop: threading.Event
    ) -> None:
        self.lock = threading.Lock()
        self._clock = _Lifetime(clock)
        self._stop = stop
        self._lines: dict[str, _Line] = {}
        self.failure: BaseException | None = None
        try:
            for name, (device, baudrate) in devices.items():
                self._lines[name] = _Line(device, baudrate)
        except DeviceError:
            self._close()
            raise
        self.paths: dict[str, str] = {name: line.path for name, line in self._lines.items()}
        self._thread = threading.Thread(target=self._run, name="pty devices", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the service and take the ports away, which clients see as an unplug.

        Raises what a device raised if that is what ended the service. Stopping twice is harmless.
        """
        self._stop.set()
        self._thread.join()
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure

    def __enter__(self) -> "PtyService":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def _run(self) -> None:
        by_master = {line.master: line for line in self._lines.values()}
        try:
            while not self._stop.is_set():
                readable, _, _ = select.select(list(by_master), [], [], self._patience_s())
                with self.lock:
                    now = self._clock.advanced()
                    for master in readable:
                        by_master[master].take(now)
                    for line in self._lines.values():
                        line.run(now)
        except BaseException as error:
            self.failure = error
            self._stop.set()
        finally:
            self._close()

    def _patience_s(self) -> float:
        with self.lock:
            events = [line.next_event_s() for line in self._lines.values()]
        wait = min((event for event in events if event is not None), default=None)
        return _IDLE_S if wait is None else min(_IDLE_S, self._clock.until(wait))

    def _close(self) -> None:
        for line in self._lines.values():
            line.close()


def serve_pty(devices: Mapping[str, tuple[Device, int]], clock: Clock, stop: threading.Event) -> PtyService:
    """Serve devices, given by name with their baud rates, until `stop` is set; returns at once.

    `paths` of the result maps each name to the terminal that a client opens. `clock` must run in real time.
    Raises DeviceError if the system has no pseudo-terminals left.
    """
    return PtyService(devices, clock, stop)
