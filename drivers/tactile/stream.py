"""A port read frame by frame: the waiting that every driver of a tactile array does. Bytes in, bytes out.

The port is pyserial's; waiting is done by reading with a time-out, so that an emulated port can let virtual
time pass. Nothing here blocks longer than its stated limit on the clock it was given.
"""

from collections import deque
from collections.abc import Callable
from typing import Protocol, cast

import serial
from serial.serialutil import SerialBase

from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError

__all__ = ["FrameStream", "Port"]

_POLL_S = 0.005
_CHUNK = 64  # bytes of a frame that are worth looking at; far fewer than a frame has
_MAX_WAITING_FRAMES = 4096
_MOST_AT_ONCE = 1 << 20  # bytes: an array that sends faster than it is read must not hold the program up


class Port(Protocol):
    """The part of pyserial's port that these drivers use."""

    timeout: float | None

    @property
    def port(self) -> str | None:
        """Name or URL."""
        ...

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes, waiting up to `timeout` s."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        ...


class FrameStream:
    """The port of one array and the frames that wait to be read.

    `take` is handed whatever arrives, and calls `push` with frames; `name` is the finger's, for messages.
    """

    def __init__(
        self, port: SerialBase | Port, clock: Clock, name: str, take: Callable[[bytes], None]
    ) -> None:
        self._port = cast(Port, port)
        self._clock = clock
        self._name = name
        self._take = take
        self._frames: deque[TactileFrame] = deque()
        self.received = 0
        self.dropped = 0

    @property
    def where(self) -> str:
        """What messages call the array."""
        return f"tactile array {self._name} on {self._port.port}"

    def push(self, frame: TactileFrame) -> None:
        """Keep a frame until it is read; the oldest is dropped where too many wait."""
        if len(self._frames) >= _MAX_WAITING_FRAMES:
            self._frames.popleft()
            self.dropped += 1
        self.received += 1
        self._frames.append(frame)

    def clear(self) -> None:
        """Forget the frames that nobody has read."""
        self._frames.clear()

    def frames(self) -> list[TactileFrame]:
        """Return every frame that has arrived, oldest first, without waiting; after 2048 ask again."""
        self.drain(self._is_half_full)
        taken = list(self._frames)
        self._frames.clear()
        return taken

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`; raises DeviceError if none comes."""
        self.drain(self._is_half_full)
        self.wait_until(lambda: bool(self._frames), timeout_s, _CHUNK)
        if not self._frames:
            raise DeviceError(
                f"{self.where} sent no frame for {timeout_s:g} s; check its cable and that it was started"
            )
        return self._frames.popleft()

    def wait_until(self, done: Callable[[], bool], timeout_s: float, chunk: int = 1) -> bool:
        """Read until `done()` or for `timeout_s`; `chunk` bytes are worth looking at. Returns `done()`."""
        deadline = self._clock.now() + timeout_s
        while not done():
            if self._clock.now() >= deadline:
                return False
            self._wait(deadline, chunk, done)
        return True

    def write(self, data: bytes) -> None:
        """Send bytes; raises DeviceError if the port is gone."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as problem:
            raise self._gone(problem) from problem

    def drain(self, done: Callable[[], bool] = lambda: False) -> bool:
        """Take what has arrived, up to where `done()`, without waiting; returns whether that was anything.

        Raises DeviceError if the port is gone.
        """
        taken = 0
        try:
            while taken < _MOST_AT_ONCE and not done() and (waiting := self._port.in_waiting):
                data = self._port.read(waiting)
                if not data:
                    break
                taken += len(data)
                self._take(data)
        except (serial.SerialException, OSError) as problem:
            raise self._gone(problem) from problem
        return taken > 0

    def _wait(self, deadline: float, chunk: int, done: Callable[[], bool]) -> None:
        """Wait for `chunk` bytes, or for a few milliseconds; then take what is there, until `done()`."""
        before = self._clock.now()
        step = min(_POLL_S, deadline - before)
        data = b""
        try:
            if not self._port.in_waiting:
                self._port.timeout = step
                data = self._port.read(chunk)
        except (serial.SerialException, OSError) as problem:
            raise self._gone(problem) from problem
        self._take(data)
        if not self.drain(done) and not data and self._clock.now() <= before:
            self._clock.sleep(step)  # a port that returns at once must not turn waiting into a spin

    def _is_half_full(self) -> bool:
        """Whether to stop reading for now, while there is room for what one more read brings."""
        return len(self._frames) >= _MAX_WAITING_FRAMES // 2

    def _gone(self, problem: Exception) -> DeviceError:
        return DeviceError(f"{self.where} is gone ({problem}); check its cable and open it again")
