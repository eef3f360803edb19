"""Device server: emulated devices on ports of this computer in real time, for clients in other processes.

One port per device, a pseudo-terminal (for clients that want a device path and a baud rate) or a TCP port
(for those that open `socket://HOST:PORT`: raw bytes both ways, one client at a time). A single thread owns
the devices while the service runs, woken by bytes from a client, by an answer whose time has come, or by a
device that speaks of its own accord. Physics shared between devices may also be touched by that thread alone.
"""

import contextlib
import os
import select
import socket
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from types import TracebackType

from palpate.base.errors import DeviceError
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import AdaptedDevice, Device, Emission, RatedDevice, wire_time_s

CHUNK_BYTES = 4096
"""Most bytes that are taken from a client at once."""


class ServedPort(ABC):
    """One device, and the port on which clients reach it. `address` is what a client opens."""

    address: str

    def __init__(self, device: Device, baudrate: int) -> None:
        self.device = device
        self.baudrate = baudrate
        self._free_s = 0.0
        self._outgoing: deque[tuple[float, bytes, int]] = deque()  # arrival, bytes, their rate

    @abstractmethod
    def handles(self) -> list[int]:
        """File descriptors that become readable when there is something to `take`."""

    @abstractmethod
    def close(self) -> None:
        """Take the port away."""

    @abstractmethod
    def _receive(self) -> bytes:
        """Bytes that a client has sent, empty if none. Does not wait."""

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Hand bytes to the client. One that does not read loses them, as at a full receive buffer."""

    def _client_rate(self) -> int:
        """The client's baud rate, or the device's where that is unknown."""
        return self.baudrate

    def take(self, now: float) -> None:
        """Feed the device what a client has sent."""
        data = self._receive()
        if not data:
            return
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
                self._send(data)

    def next_event_s(self) -> float | None:
        """Instant of the next delivery or of the device's next own emission."""
        own = self.device.next_due()
        if not self._outgoing:
            return own
        return self._outgoing[0][0] if own is None else min(own, self._outgoing[0][0])

    def _schedule(self, emissions: list[Emission], rate: int) -> None:
        adapted = self.device if isinstance(self.device, AdaptedDevice) else None
        if adapted is not None:
            rate = adapted.arrival_rate
        for instant, data in emissions:
            lasts = wire_time_s(len(data), rate) if adapted is None else 0.0
            self._free_s = max(instant, self._free_s) + lasts
            self._outgoing.append((self._free_s, data, rate))


LOOPBACK = "127.0.0.1"


class TcpPort(ServedPort):
    """One device on its TCP port; `address` is the port's URL."""

    def __init__(self, device: Device, baudrate: int, port: int = 0, host: str = LOOPBACK) -> None:
        """Listen on `port` of an address of this computer, 0 for any free one. DeviceError if it is taken."""
        super().__init__(device, baudrate)
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._client: socket.socket | None = None
        try:
            if os.name == "posix":  # ports of a service that has just ended may be used again at once
                self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((host, port))
            self._listener.listen()
        except (OSError, OverflowError) as error:
            self._listener.close()
            code = error.errno if isinstance(error, OSError) else None
            reason = os.strerror(code).lower() if code else str(error)
            raise DeviceError(
                f"no TCP port {host}:{port} for an emulated device: {reason}; choose other ports"
            ) from error
        self._listener.setblocking(False)
        self.address = f"socket://{host}:{self._listener.getsockname()[1]}"

    def handles(self) -> list[int]:
        """Sockets of the listener and of the client."""
        found = [self._listener, *([] if self._client is None else [self._client])]
        return [one.fileno() for one in found]

    def close(self) -> None:
        """Stop listening and leave the client, which sees an unplug."""
        self._listener.close()
        self._leave()

    def _receive(self) -> bytes:
        data = self._client_bytes()
        if not data:  # only now is it known whether the last client is still there
            self._welcome()
        return data

    def _client_bytes(self) -> bytes:
        if self._client is None:
            return b""
        try:
            data = self._client.recv(CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._leave()
        return data

    def _welcome(self) -> None:
        try:
            come, _ = self._listener.accept()
        except OSError:  # no client, or gone again
            return
        if self._client is not None:
            come.close()
            return
        come.setblocking(False)
        # without this the system holds small packets back until earlier ones are confirmed
        come.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = come

    def _leave(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _send(self, data: bytes) -> None:
        if self._client is None:
            return
        try:
            with contextlib.suppress(BlockingIOError):
                self._client.send(data)
        except OSError:
            self._leave()


_IDLE_S = 0.02  # longest sleep: how late a stop request or the physics may be noticed
_MAX_TURN_S = 0.004  # the devices live for this long in one turn, at most
_MAX_LAG_S = 0.25  # what the devices are behind the clock by more is never made up for

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

    def advance(self) -> float:
        """Begin a turn: the devices' time (s) in it."""
        seen = self._clock.now()
        self._behind = min(self._behind + seen - self._seen, _MAX_LAG_S)
        self._seen = seen
        turn = min(self._behind, _MAX_TURN_S)
        self._behind -= turn
        self._now += turn
        return self._now

    def until(self, instant: float | None) -> float:
        """Time to wait (s) for an instant of the devices' time; None: no instant is due."""
        if self._behind > 0.0:
            return 0.0
        if instant is None:
            return _IDLE_S
        return min(_IDLE_S, max(0.0, instant - self._now - (self._clock.now() - self._seen)))


class DeviceServer:
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

    def __enter__(self) -> "DeviceServer":
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
                    now = self._clock.advance()
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


def serve_tcp(
    devices: Devices, clock: Clock, stop: threading.Event, first_port: int = 0, host: str = LOOPBACK
) -> DeviceServer:
    """Serve devices on TCP ports of an address of this computer, until `stop` is set; returns at once.

    Devices are given by name with their baud rates, and get ports from `first_port` on in their order, 0: any
    free ones. `clock` must run in real time. Raises DeviceError if a port is taken.
    """

    def line(index: int, device: Device, baudrate: int) -> ServedPort:
        return TcpPort(device, baudrate, first_port + index if first_port else 0, host)

    return DeviceServer(devices, line, clock, stop)
