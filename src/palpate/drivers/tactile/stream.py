"""Frame stream: reads a port frame by frame, with the waiting common to all drivers of tactile arrays.

The port is pyserial's; waiting is done by reading with a time-out, so that an emulated port can let virtual
time pass. Nothing here blocks longer than its stated limit on the clock it was given. `StreamedArray` is the
base of drivers: what each does alike with the stream of its frames.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, cast

import serial
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import ArrayCounters, ArrayLost, TactileFrame
from palpate.drivers.transport.clock import Clock

_POLL_S = 0.005
_BUSY_PAUSE_S = 0.001  # between two looks at a port that always has more
_MIN_CHUNK_BYTES = 64  # bytes of a frame that are worth looking at; far fewer than a frame has
_MAX_WAITING_FRAMES = 4096
_MAX_READ_BYTES = 4096  # bytes: what a terminal's buffer holds; what is read ahead of the limit comes late
_MAX_EXTRA_PIECES = 64  # beyond what the rate brings: decoding so many takes a fraction of a millisecond
_MAX_EXTRA_BYTES = 1024  # where every byte may be as much work as a piece
_PIECE_BYTES = 256  # of a long piece that are as much work as a short one
_MAX_RATE_RATIO = 2.0  # times the rate that is read without complaint
_PIECES_PER_BATCH = 1024  # pieces between two looks at what came of them
_MAX_BABBLE_S = 0.25
_MAX_SENSELESS_FRAMES = 5  # frames in a row


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


@dataclass(frozen=True)
class _Backlog:
    """Time when the port first had more than might be taken, and the bytes taken by then."""

    since_s: float
    frames: int
    bytes: int


class FrameStream:
    """The port of one array and the frames that wait to be read.

    `take` is handed whatever arrives, and calls `push` with frames, or `refuse` with what is wrong with one;
    `name` is the finger's, for messages. `mark` is the byte that bounds the work of decoding: a stretch of
    bytes is as much work as it has marks, whatever else is in it. None: as it has bytes.

    However much a port sends, one call takes no more of it than twice what `expect` announced for the time
    since the last call, and a little. The rest is taken by the next calls. A port that goes on like that for
    0.25 s, and not with frames, is an error, and so are 5 frames in a row that are refused.
    """

    def __init__(
        self,
        port: SerialBase | Port,
        clock: Clock,
        name: str,
        take: Callable[[bytes], None],
        mark: bytes | None = None,
    ) -> None:
        self._port = cast(Port, port)
        self._clock = clock
        self._name = name
        self._take = take
        self._mark = mark
        self._frames: deque[TactileFrame] = deque()
        self._unread = b""
        self._has_all = False  # that waited when the port was asked last
        self._rate_hz, self._frame_bytes = 0.0, _MAX_EXTRA_BYTES
        self._looked_s = self._empty_s = clock.now()
        self._behind: _Backlog | None = None
        self._refused = 0
        self._refusal = ""
        self._has_restarted = False
        self._since_frame = 0
        self.received = 0
        self.dropped = 0
        self.bytes = 0

    @property
    def name(self) -> str:
        """The finger's."""
        return self._name

    @property
    def where(self) -> str:
        """Name of the array in messages."""
        return f"tactile array {self._name} on {self._port.port}"

    @property
    def silence(self) -> str:
        """Words for what came since the last frame: "nothing", or what is no frame."""
        if self._refused:
            return f"{self._refused} frames that make no sense ({self._refusal})"
        return f"{self._since_frame} bytes that are no frame" if self._since_frame else "nothing"

    @property
    def read_within_s(self) -> float:
        """How long before now what is being taken can have come to this computer, at most."""
        return self._clock.now() - self._empty_s

    def expect(self, rate_hz: float, frame_bytes: int) -> None:
        """A stream begins: so many frames a second, each of so many bytes at most."""
        self._rate_hz, self._frame_bytes = rate_hz, frame_bytes
        self._behind = None
        self._refused = self._since_frame = 0

    def push(self, frame: TactileFrame) -> None:
        """Keep a frame until it is read; the oldest is dropped where too many wait."""
        if len(self._frames) >= _MAX_WAITING_FRAMES:
            self._frames.popleft()
            self.dropped += 1
        self.received += 1
        self._refused = self._since_frame = 0
        self._frames.append(frame)

    def refuse(self, reason: str, *, restarted: bool = False) -> None:
        """Note that a frame makes no sense, or shows a restart, and why. It was dropped."""
        self._refused += 1
        self._refusal = reason
        self._has_restarted = restarted

    def note_answer(self) -> None:
        """Note that what came was an answer: the array is not silent and sends no noise."""
        self._since_frame = 0

    def clear(self) -> None:
        """Forget unread frames."""
        self._frames.clear()

    def frames(self) -> list[TactileFrame]:
        """Return the frames that have arrived, oldest first, without waiting; of too many some come later.

        Raises DeviceError if what arrives makes no sense for long: see the class.
        """
        self.drain(self._is_half_full)
        if self._refused or self._behind is not None:
            self._judge()
        taken = list(self._frames)
        self._frames.clear()
        return taken

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`; raises DeviceError if none comes."""
        self.drain(self._is_half_full)
        self.wait_until(
            lambda: bool(self._frames) or self._refused >= _MAX_SENSELESS_FRAMES, timeout_s, _MIN_CHUNK_BYTES
        )
        self._judge()
        if not self._frames:
            but, cause = (
                (f", but {self.silence}", "its firmware")
                if self._since_frame
                else ("", "that it was started")
            )
            raise ArrayLost(
                self._name,
                f"{self.where} sent no frame for {timeout_s:g} s{but}; check its cable and {cause}",
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
            raise self._loss_error(problem) from problem

    def drain(self, done: Callable[[], bool] = lambda: False) -> None:
        """Take what has arrived, up to where `done()` or to the limit, without waiting.

        Raises DeviceError if the port is gone.
        """
        left = self._allowance()
        while left > 0 and not done() and self._fetch():
            head, work = self._cut(min(left, _PIECES_PER_BATCH))
            left -= work
            self._since_frame += len(head)
            self.bytes += len(head)
            self._take(head)
            if self._has_all and not self._unread and self._clock.now() == self._looked_s:
                self._empty_s = self._looked_s
                break  # no time has passed, as it does not on a virtual clock: nothing can have come
        if left > 0:
            self._behind = None
        elif self._behind is None:  # since when the port has had more than may be taken
            self._behind = _Backlog(self._looked_s, self.received, self.bytes)

    def _allowance(self) -> int:
        """Work that one call may do: twice what the rate brings, and a little."""
        before, self._looked_s = self._looked_s, self._clock.now()
        frames = _MAX_RATE_RATIO * self._rate_hz * (self._looked_s - before)
        if self._mark is None:
            return _MAX_EXTRA_BYTES + int(frames * self._frame_bytes)
        a_frame = 2 + self._frame_bytes // _PIECE_BYTES  # a mark may come before a frame, too
        return _MAX_EXTRA_PIECES + int(frames * a_frame)

    def _work(self, data: bytes) -> int:
        return len(data) if self._mark is None else 1 + data.count(self._mark) + len(data) // _PIECE_BYTES

    def _cut(self, most: int) -> tuple[bytes, int]:
        """Take from what was read a beginning that is about so much work at most; also how much it is."""
        data = self._unread
        work = self._work(data)
        if work <= most:  # all of it, as nearly always
            self._unread = b""
            return data, work
        end = most if self._mark is None else most * _PIECE_BYTES
        if self._mark is not None and data.count(self._mark, 0, end) > most:
            end = len(data) - len(data.split(self._mark, most)[-1])
        head, self._unread = data[:end], data[end:]
        return head, self._work(head)

    def _fetch(self) -> bool:
        """True if there are bytes to take, read now if need be."""
        try:
            if not self._unread:
                now, waiting = self._clock.now(), self._port.in_waiting
                if not waiting:
                    self._empty_s = now
                    return False
                self._unread = self._port.read(min(waiting, _MAX_READ_BYTES))
                self._has_all = waiting <= _MAX_READ_BYTES
        except (serial.SerialException, OSError) as problem:
            raise self._loss_error(problem) from problem
        return bool(self._unread)

    def _judge(self) -> None:
        """Raise DeviceError if nothing but senseless frames, or more than can be frames, keeps coming."""
        if self._refused >= _MAX_SENSELESS_FRAMES:
            count, self._refused = self._refused, 0
            if self._has_restarted:
                raise self.has_restarted(self._refusal)
            raise DeviceError(
                f"{self.where} sent {count} frames in a row that make no sense: {self._refusal}; "
                "check its firmware and its supply"
            )
        behind = self._behind
        if behind is None or (spent_s := self._looked_s - behind.since_s) < _MAX_BABBLE_S:
            return
        if self.received - behind.frames <= _MAX_RATE_RATIO * (self._rate_hz * spent_s + 1):
            self._behind = None
            rate = (self.bytes - behind.bytes + len(self._unread)) / spent_s
            raise DeviceError(
                f"{self.where} babbles: it sends {rate:.0f} bytes/s or more, too many for {self._rate_hz:g} "
                "frames/s; power it off and on, then check its firmware and the baud rate"
            )

    def _wait(self, deadline: float, chunk: int, done: Callable[[], bool]) -> None:
        """Wait for `chunk` bytes, or for a few milliseconds; then take what is there, until `done()`."""
        before = self._clock.now()
        step = min(_POLL_S, deadline - before)
        try:
            if not self._unread and not self._port.in_waiting:
                self._port.timeout = step
                self._unread = self._port.read(chunk)
        except (serial.SerialException, OSError) as problem:
            raise self._loss_error(problem) from problem
        had = self.bytes
        self.drain(done)
        if done():
            return
        if self._unread:
            self._clock.sleep(min(step, _BUSY_PAUSE_S))
        elif self.bytes == had and self._clock.now() <= before:
            self._clock.sleep(step)  # a port that returns at once must not turn waiting into a spin

    def _is_half_full(self) -> bool:
        """True if reading should stop for now, while there is room for one more read."""
        return len(self._frames) >= _MAX_WAITING_FRAMES // 2

    def has_restarted(self, how: str) -> DeviceError:
        """The error of an array that was reset; `how` it shows."""
        return ArrayLost(
            self._name,
            f"{self.where} has restarted ({how}) and has lost its settings: check its supply and "
            "its cable, then start again",
        )

    def _loss_error(self, problem: Exception) -> DeviceError:
        return ArrayLost(self._name, f"{self.where} is gone ({problem}); check its cable and open it again")


class StreamedArray(ABC):
    """An `ArrayDriver` but for `connect`, `start` and `stop`, which talk to the array.

    `connect` sets `_description`, None as long as it does not know. Frames are pushed to `_stream`, and those
    that make no sense given to `_refuse`.
    """

    def __init__(self, stream: FrameStream, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock
        self._description: Description | None = None
        self._misshapen = 0

    @property
    @abstractmethod
    def _lost_and_faults(self) -> tuple[int, int]:
        """Number of frames that never came, and of stretches of the stream that were no message."""

    @property
    def description(self) -> Description:
        """Description that the array gave; raises DeviceError before `connect`."""
        if self._description is None:
            raise DeviceError(f"{self._stream.where} has not been asked what it is; call connect() first")
        return self._description

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        lost, faults = self._lost_and_faults
        return ArrayCounters(self._stream.received, lost, faults, self._misshapen, self._stream.dropped)

    @property
    def silence(self) -> str:
        """Words for what came since the last frame: "nothing", or what is no frame."""
        return self._stream.silence

    def frames(self) -> list[TactileFrame]:
        """Return every frame that has arrived, oldest first, without waiting.

        Takes a bounded time, whatever arrives; raises DeviceError if it makes no sense for long.
        """
        return self._stream.frames()

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`; raises DeviceError if none comes."""
        return self._stream.wait_frame(timeout_s)

    def _check_rate(self, rate_hz: float) -> None:
        """Raise DeviceError for a rate that the array cannot do."""
        limit = self.description.max_rate_hz
        if not 0 < rate_hz <= limit:
            raise DeviceError(
                f"{self._stream.where} cannot sample at {rate_hz:g} Hz; choose a rate up to {limit:g} Hz"
            )

    def _refuse(self, reason: str) -> None:
        """Count a frame that makes no sense."""
        self._misshapen += 1
        self._stream.refuse(reason)
