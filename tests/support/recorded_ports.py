"""Ports whose bytes a test listens to, by way of the recorder that the session log uses."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from serial.serialutil import SerialBase

from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recorder import Recorder, RecordingPort, RecordItem
from palpate.drivers.transport.recording import Direction, PortBytes, PortOpened

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

__all__ = ["Listener"]

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
