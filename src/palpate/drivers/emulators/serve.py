"""Emulated devices on ports of this computer in real time, for unmodified clients in other processes.

One port per device, a pseudo-terminal (`pty_port`) or a TCP port (`tcp_port`). A single thread owns the
devices while the service runs, woken by bytes from a client, by an answer whose time has come, or by a device
that speaks of its own accord. Physics shared between devices may also be touched by others under `lock`.

If the computer is too slow for the devices, their time runs slower than the clock's. A turn of the service
lets them live for a few milliseconds at most, and then answers, also while it catches up: real servos are
never late with an answer because their motors are hard to compute.
"""

import select
import threading
from collections.abc import Callable, Mapping
from types import TracebackType

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.pty_port import PtyPort
from palpate.drivers.emulators.served_port import ServedPort
from palpate.drivers.emulators.tcp_port import LOOPBACK, TcpPort
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import Device

__all__ = ["Service", "serve_pty", "serve_tcp"]

_IDLE_S = 0.02  # longest sleep: how late a stop request or the physics may be noticed
_TURN_S = 0.004  # the devices live for this long in one turn, at most
_MOST_BEHIND_S = 0.25  # what the devices are behind the clock by more is never made up for

Devices = Mapping[str, tuple[Device, int]]


class _Lifetime:
    """The devices' time: follows the clock's in turns of `_TURN_S` at most.

    `_MOST_BEHIND_S` is half of what a servo's bus watchdog waits in a run: a client that is held up as long
    as the devices must not look silent to them when they catch up.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._seen = clock.now()
        self._now = self._seen
        self._behind = 0.0

    def advanced(self) -> float:
        """Begin a turn: the devices' time (s) in it."""
        seen = self._clock.now()
        self._behind = min(self._behind + seen - self._seen, _MOST_BEHIND_S)
        self._seen = seen
        turn = min(self._behind, _TURN_S)
        self._behind -= turn
        self._now += turn
        return self._now

    def until(self, instant: float | None) -> float:
        """How long to wait (s) for an instant of the devices' time; None: for nothing in particular."""
        if self._behind > 0.0:
            return 0.0
        if instant is None:
            return _IDLE_S
        return min(_IDLE_S, max(0.0, instant - self._now - (self._clock.now() - self._seen)))


class Service:
    """Devices being served; ends with `stop`, at the end of a `with` block, or by the event given to it.

    `paths`: what a client opens for each device, a terminal's path or a URL.
    """

    def __init__(
        self,
        devices: Devices,
        line: Callable[[int, Device, int], ServedPort],
        clock: Clock,
        stop: threading.Event,
    ) -> None:
        """`line(index, device, baudrate)` makes a device's line, counted from 0; may raise DeviceError."""
        self.lock = threading.Lock()
        self._clock = _Lifetime(clock)
        self._stop = stop
        self._lines: dict[str, ServedPort] = {}
        self.failure: BaseException | None = None
        try:
            for index, (name, (device, baudrate)) in enumerate(devices.items()):
                self._lines[name] = line(index, device, baudrate)
        except DeviceError:
            self._close()
            raise
        self.paths: dict[str, str] = {name: line.address for name, line in self._lines.items()}
        self._thread = threading.Thread(target=self._run, name="served devices", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"<Service {', '.join(f'{name} at {path}' for name, path in self.paths.items())}>"

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the service has ended, for `seconds` at most; raises nothing."""
        self._stop.wait(seconds)

    def stop(self) -> None:
        """End the service and take the ports away, which clients see as an unplug.

        Raises what a device raised if that is what ended the service. Stopping twice is harmless.
        """
        self._stop.set()
        self._thread.join()
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure

    def __enter__(self) -> "Service":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                lines = {handle: line for line in self._lines.values() for handle in line.handles()}
                readable, _, _ = select.select(list(lines), [], [], self._patience_s())
                with self.lock:
                    now = self._clock.advanced()
                    for line in dict.fromkeys(lines[handle] for handle in readable):
                        line.take(now)
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
        return self._clock.until(min((event for event in events if event is not None), default=None))

    def _close(self) -> None:
        for line in self._lines.values():
            line.close()


def serve_pty(devices: Devices, clock: Clock, stop: threading.Event) -> Service:
    """Serve devices on pseudo-terminals, until `stop` is set; returns at once.

    Devices are given by name with their baud rates. `clock` must run in real time. Raises DeviceError if the
    system has no pseudo-terminals left.
    """
    return Service(devices, lambda _, device, baudrate: PtyPort(device, baudrate), clock, stop)


def serve_tcp(
    devices: Devices, clock: Clock, stop: threading.Event, first_port: int = 0, host: str = LOOPBACK
) -> Service:
    """The same on TCP ports of an address of this computer, from `first_port` on in the devices' order.

    0: any free ones. Raises DeviceError if one is taken.
    """

    def line(index: int, device: Device, baudrate: int) -> ServedPort:
        return TcpPort(device, baudrate, first_port + index if first_port else 0, host)

    return Service(devices, line, clock, stop)
