"""Ports with something between them and the device."""

import array
import fcntl
import os
import select
import termios
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from serial.serialutil import SerialBase

from palpate.drivers.tactile.stream import Port
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recording import (
    Direction,
    PortBytes,
    PortOpened,
    Recorder,
    RecordingPort,
    RecordItem,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# ----------------------------------------------------------------------------------------------------
# A serial port whose bytes get damaged on their way to the host.


class NoisyPort:
    """Flips one bit of a share of the bytes that are read; `flipped` counts them."""

    def __init__(self, port: Port, share: float, seed: int) -> None:
        self._port = port
        self._share = share
        self._rng = np.random.default_rng(seed)
        self.flipped = 0
        self.timeout: float | None = 0.0

    @property
    def port(self) -> str | None:
        return self._port.port

    @property
    def in_waiting(self) -> int:
        return self._port.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        self._port.timeout = self.timeout
        data = np.frombuffer(self._port.read(size), np.uint8).copy()
        hit = self._rng.random(data.size) < self._share
        data[hit] ^= np.uint8(1) << self._rng.integers(0, 8, int(hit.sum())).astype(np.uint8)
        self.flipped += int(hit.sum())
        return data.tobytes()

    def write(self, data: bytes, /) -> int | None:
        return self._port.write(data)


# ----------------------------------------------------------------------------------------------------
# A port made of two named pipes, one for each way; with the methods that a driver calls on a serial port.

_HELD_BYTES = 1 << 20  # what Linux lets any user ask for


class PipePort:
    """Reads `path`.out, which then holds a MiB that has not been read, and writes `path`.in."""

    def __init__(self, path: str) -> None:
        self._incoming = os.open(f"{path}.out", os.O_RDONLY | os.O_NONBLOCK)
        self._outgoing = os.open(f"{path}.in", os.O_WRONLY)
        fcntl.fcntl(self._incoming, fcntl.F_SETPIPE_SZ, _HELD_BYTES)
        self.port: str | None = path
        self.timeout: float | None = 0.0

    @property
    def in_waiting(self) -> int:
        held = array.array("i", [0])
        fcntl.ioctl(self._incoming, termios.FIONREAD, held)
        return held[0]

    def read(self, size: int = 1, /) -> bytes:
        ready, _, _ = select.select([self._incoming], [], [], self.timeout)
        return os.read(self._incoming, size) if ready else b""

    def write(self, data: bytes, /) -> int | None:
        return os.write(self._outgoing, data)

    def close(self) -> None:
        os.close(self._incoming)
        os.close(self._outgoing)


# ----------------------------------------------------------------------------------------------------
# Ports whose bytes a test listens to, by way of the recorder that the session log uses.

Heard = tuple[Direction, float, bytes]


class Listener:
    """A sink that keeps the bytes alone, with the clock's instant (s), in order."""

    def __init__(self, clock: Clock, on_bytes: Callable[[], None] = lambda: None) -> None:
        """`on_bytes` is called before any are read or written, and may raise in the port's place."""
        self.heard: list[Heard] = []
        self._clock, self._on_bytes = clock, on_bytes
        self._recorder = Recorder(clock, self)

    @property
    def sent(self) -> bytes:
        """Everything that the host has sent, in a row."""
        return b"".join(data for way, _, data in self.heard if way is Direction.SENT)

    def on(self, port: SerialBase) -> SerialBase:
        """An open port with this listener on it."""
        return _Listened(port, self._recorder, self._on_bytes)

    def note(self, what: RecordItem) -> None:
        """Keep what passes a port; calls and failures are of no interest here."""
        if isinstance(what, PortBytes):
            self.heard.append((what.direction, self._clock.now(), what.data))

    def check(self) -> None:
        """Nothing fails here."""


class _Listened(RecordingPort):
    """A recorded port that does something of a test's before it reads or writes."""

    def __init__(self, port: SerialBase, recorder: Recorder, before: Callable[[], None]) -> None:
        super().__init__(port, recorder, PortOpened(0, port.port or "", port.port))
        self._before = before

    def read(self, size: int = 1, /) -> bytes:
        self._before()
        return super().read(size)

    def write(self, b: "ReadableBuffer", /) -> int | None:
        self._before()
        return super().write(b)
