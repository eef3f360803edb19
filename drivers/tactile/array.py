"""Host driver of one tactile array. Stands between a port and the contact extractor: bytes in, frames out.

The port is pyserial's; waiting is done by reading with a time-out, so that an emulated port can let virtual
time pass. Nothing here blocks longer than its stated limit on the clock it was given.
"""

from collections import deque
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
import serial
from numpy.typing import NDArray
from serial.serialutil import SerialBase

from palpate.drivers.tactile.messages import (
    Ack,
    Body,
    Describe,
    Description,
    Frame,
    Hello,
    Message,
    Nack,
    Start,
    Stop,
)
from palpate.drivers.tactile.protocol import DELIMITER, Decoder, encode
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError

__all__ = ["ArrayCounters", "Port", "TactileArray", "TactileFrame"]

ANSWER_TIMEOUT_S = 0.5
COMMAND_TIMEOUT_S = 0.15  # short: servos whose Bus Watchdog is armed hear nothing meanwhile
ATTEMPTS = 3
_POLL_S = 0.005
_CHUNK = 64  # bytes of a frame that are worth looking at; far fewer than a frame has
_MAX_WAITING_FRAMES = 4096


class Port(Protocol):
    """The part of pyserial's port that this driver uses."""

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


@dataclass(frozen=True, eq=False)
class TactileFrame:
    """One sample of every taxel: `counts` has shape (rows, cols), uint16, lowest row first.

    `device_time_s` is the array's own clock at the sample; `host_time_s` is the host's clock when the frame
    was read from the port, which is later by the time on the wire and by the wait until somebody looked.
    """

    sequence: int
    device_time_s: float
    host_time_s: float
    counts: NDArray[np.uint16]


@dataclass(frozen=True)
class ArrayCounters:
    """What went wrong on this port since it was opened."""

    frames: int
    lost: int
    faults: int
    misshapen: int
    dropped: int


class TactileArray:
    """A tactile array on a port. Call `connect` first; the verbs may be repeated without harm."""

    def __init__(self, port: SerialBase | Port, clock: Clock, name: str) -> None:
        self._port = cast(Port, port)
        self._clock = clock
        self._name = name
        self._decoder = Decoder()
        self._frames: deque[TactileFrame] = deque()
        self._answers: list[Body] = []
        self._sequence = 0
        self._request = 0
        self._description: Description | None = None
        self._received = self._misshapen = self._dropped = 0

    @property
    def description(self) -> Description:
        """What the array said of itself; raises DeviceError before `connect`."""
        if self._description is None:
            raise DeviceError(f"{self._where()} has not been asked what it is; call connect() first")
        return self._description

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        faults = sum(self._decoder.faults.values())
        return ArrayCounters(self._received, self._decoder.lost, faults, self._misshapen, self._dropped)

    def connect(self) -> Description:
        """Ask the array what it is; a running stream stops. Raises DeviceError if nothing answers."""
        self._description = None
        for _ in range(ATTEMPTS):
            answer = self._ask(Hello(self._next_request()))
            if isinstance(answer, Describe):
                self._description = answer.description
                self._frames.clear()
                return answer.description
            if isinstance(answer, Nack):
                raise DeviceError(
                    f"{self._where()} refuses to describe itself ({answer.reason.name}); "
                    "power it off and on, then check its firmware"
                )
        raise DeviceError(
            f"{self._where()} does not answer; check its power, its cable and the port's name in the rig file"
        )

    def start(self, rate_hz: float) -> None:
        """Stream frames at `rate_hz`. Raises DeviceError if the array refuses the rate or does not answer."""
        limit = self.description.max_rate_hz
        if not 0 < rate_hz <= limit:
            raise DeviceError(
                f"{self._where()} cannot sample at {rate_hz:g} Hz; choose a rate up to {limit:g} Hz"
            )
        self._command(Start(self._next_request(), round(rate_hz * 1000)), "start")

    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""
        self._command(Stop(self._next_request()), "stop")

    def frames(self) -> list[TactileFrame]:
        """Return every frame that has arrived, oldest first, without waiting."""
        self._drain()
        taken = list(self._frames)
        self._frames.clear()
        return taken

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`; raises DeviceError if none comes."""
        deadline = self._clock.now() + timeout_s
        self._drain()
        while not self._frames and self._clock.now() < deadline:
            self._wait(deadline, _CHUNK)
        if not self._frames:
            raise DeviceError(
                f"{self._where()} sent no frame for {timeout_s:g} s; check its cable and that it was started"
            )
        return self._frames.popleft()

    def _command(self, body: Start | Stop, verb: str) -> None:
        """Say it more than once: command or answer may get lost, and doing it twice does no harm."""
        answer = next(
            (said for _ in range(ATTEMPTS) if (said := self._ask(body, COMMAND_TIMEOUT_S)) is not None), None
        )
        if isinstance(answer, Nack):
            raise DeviceError(
                f"{self._where()} refuses to {verb} ({answer.reason.name}); check the rate and the firmware"
            )
        if answer is None:
            raise DeviceError(f"{self._where()} did not answer {verb.upper()}; check its power and its cable")

    def _ask(self, body: Hello | Start | Stop, timeout_s: float = ANSWER_TIMEOUT_S) -> Body | None:
        self._answers.clear()
        # A leading delimiter ends whatever noise the array's receiver holds.
        self._write(DELIMITER + encode(Message(self._sequence, self._now_us(), body)))
        self._sequence = (self._sequence + 1) % (1 << 32)
        deadline = self._clock.now() + timeout_s
        while True:
            for answer in self._answers:
                if isinstance(answer, Ack | Nack | Describe) and answer.request_id == body.request_id:
                    return answer
            self._answers.clear()
            if self._clock.now() >= deadline:
                return None
            self._wait(deadline)

    def _wait(self, deadline: float, chunk: int = 1) -> None:
        """Wait for `chunk` bytes, or for a few milliseconds; then take all that is there."""
        before = self._clock.now()
        step = min(_POLL_S, deadline - before)
        try:
            if not self._port.in_waiting:
                self._port.timeout = step
                self._take(self._port.read(chunk))
        except (serial.SerialException, OSError) as problem:
            raise self._gone(problem) from problem
        self._drain()
        if not self._answers and not self._frames and self._clock.now() <= before:
            self._clock.sleep(step)  # a port that returns at once must not turn waiting into a spin

    def _drain(self) -> None:
        try:
            while waiting := self._port.in_waiting:
                data = self._port.read(waiting)
                if not data:
                    return
                self._take(data)
        except (serial.SerialException, OSError) as problem:
            raise self._gone(problem) from problem

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as problem:
            raise self._gone(problem) from problem

    def _take(self, data: bytes) -> None:
        for item in self._decoder.feed(data):
            if isinstance(item, Message):
                self._sort(item)

    def _sort(self, message: Message) -> None:
        body = message.body
        if not isinstance(body, Frame):
            self._answers.append(body)
            return
        shape = self._description
        if shape is None:
            return
        if (body.rows, body.cols) != (shape.rows, shape.cols):
            self._misshapen += 1
            return
        if len(self._frames) >= _MAX_WAITING_FRAMES:
            self._frames.popleft()
            self._dropped += 1
        self._received += 1
        self._frames.append(
            TactileFrame(message.sequence, message.time_us * 1e-6, self._clock.now(), body.counts)
        )

    def _next_request(self) -> int:
        self._request = self._request % 0xFFFF + 1
        return self._request

    def _now_us(self) -> int:
        return round(self._clock.now() * 1e6)

    def _where(self) -> str:
        return f"tactile array {self._name} on {self._port.port}"

    def _gone(self, problem: Exception) -> DeviceError:
        return DeviceError(f"{self._where()} is gone ({problem}); check its cable and open it again")
