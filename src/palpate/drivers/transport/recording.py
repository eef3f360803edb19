"""Recording of a run: the host's calls to clock and ports, one by one, with their results.

`Recorder` writes it, the session log keeps it, `replay` reads it. A call is a letter, for ports the port's
number in the order of opening, and what came of it if that is not the usual thing:

    t4000000  the clock, 4,000,000 ns after its last reading     .     the clock, as at its last reading
    z         a sleep on the clock                               r1    a read of port 1 that gave nothing
    w1:40     40 bytes were waiting on port 1; w1: none          n1:3  only 3 bytes of a write were taken
    q1:40     40 bytes were still to be sent; q1: none           s1    settings of port 1 were changed
    f1 d1 o1  flushed, input dropped, output dropped             m1    modem lines or break of port 1 were set
    c1        closed                                             p1    opened again

Reads that gave bytes and all writes have lines of their own in the log, and so have failures.

What the host does is decided by what clock and ports tell it, call by call, and by interrupts. A `Recorder`
stands before both and notes all of it in a sink, the session log; `replay` gives it back. See ADR 0014.
`CalledPort` names calls by these letters: what a recorded and a replayed port share.
"""

import math
import re
import struct
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from serial.serialutil import SerialBase

from palpate.base.errors import OutputError
from palpate.drivers.transport.clock import Clock

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_CALL_PATTERN = r"t(?:-?[0-9]{1,18})(?:~-?[0-9]{1,19})?|[.z]|[cdfmnopqrsw][0-9]{1,6}(?::[0-9]{1,9})?"
CALLS = re.compile(f"(?:{_CALL_PATTERN})*")
"""Matches a whole text of calls, and nothing else."""

_CALL = re.compile(r"([a-z.])(-?[0-9]*)(?:([:~])(-?[0-9]+))?")
_NS_PER_S = 1e9
_DOUBLES = 1 << 64

_WORDS = {
    "t": "reads the clock",
    ".": "reads the clock",
    "z": "sleeps",
    "r": "reads from {}",
    "w": "asks how many bytes wait on {}",
    "n": "writes to {}",
    "x": "writes to {}",
    "q": "asks how many bytes {} has still to send",
    "s": "changes settings of {}",
    "f": "flushes {}",
    "d": "drops what {} has received",
    "o": "drops what {} has to send",
    "m": "sets modem lines of {}",
    "c": "closes {}",
    "p": "opens {} again",
}


@dataclass(frozen=True, slots=True)
class RecordedCall:
    """One call: its letter, the port's number (or the clock's ns), and what stands behind : or ~."""

    letter: str
    number: int
    value: int

    @property
    def key(self) -> str:
        """Letter and port, as failures name the call they happened in; clock readings are all alike."""
        if self.letter in "t.":
            return "t"
        return self.letter if self.letter == "z" else port_call(self.letter, self.number)


def port_call(letter: str, port: int) -> str:
    """The text of a call on a port that ended as usual."""
    return f"{letter}{port}"


def parse_calls(text: str) -> Iterator[RecordedCall]:
    """The calls of a text that `CALLS` matches."""
    for match in _CALL.finditer(text):
        letter, number, _, value = match.groups()
        yield RecordedCall(letter, int(number) if number else 0, int(value) if value else 0)


def describe_call(key: str, port: str) -> str:
    """Words for a call with this key, with the name of its port: "reads from mock://bus"."""
    return _WORDS.get(key[:1], "does something else").format(f"port {port}")


class Instants:
    """Clock readings (s) as text and back, to the last bit. Keeps the last reading: use one each way.

    A reading is written as the difference of whole nanoseconds to the one before. If the double is not
    exactly that many nanoseconds, it is k doubles further on, and ~k follows.
    """

    def __init__(self) -> None:
        self._ns = 0
        self._last = 0.0

    def text(self, instant: float) -> str:
        """The text of the next reading."""
        if instant == self._last:
            return "."
        ns = round(instant * _NS_PER_S)
        text = f"t{ns - self._ns}"
        if instant != (nearest := ns / _NS_PER_S):
            text += f"~{_bits(instant) - _bits(nearest)}"
        self._ns, self._last = ns, instant
        return text

    def instant(self, call: RecordedCall) -> float:
        """The next reading from its text; ValueError if there is no such double."""
        if call.letter == ".":
            return self._last
        self._ns += call.number
        self._last = _double(_bits(self._ns / _NS_PER_S) + call.value)
        if not math.isfinite(self._last):
            raise ValueError("a clock reading is not finite")
        return self._last


def _bits(value: float) -> int:
    """Rank of a double among the doubles."""
    return int.from_bytes(struct.pack(">d", value), "big")


def _double(bits: int) -> float:
    found: float = struct.unpack(">d", (bits % _DOUBLES).to_bytes(8, "big"))[0]
    return found


class Direction(Enum):
    """Direction of bytes, seen from the host."""

    SENT = "sent"
    RECEIVED = "received"


@dataclass(frozen=True, slots=True)
class PortOpened:
    """A port was opened; `url` is what it called itself."""

    number: int
    port: str
    url: str | None


@dataclass(frozen=True, slots=True)
class PortBytes:
    """Bytes went through a port."""

    direction: Direction
    port: str
    data: bytes


@dataclass(frozen=True, slots=True)
class ErrorRaised:
    """The call `during` failed, or with None an interrupt came before the next call."""

    during: str | None
    error: BaseException


@dataclass(frozen=True, slots=True)
class SessionEvent:
    """The session said something of its own. `interrupt` if this is its end, by an interrupt."""

    kind: str
    values: Mapping[str, Any]
    interrupt: BaseException | None = None


RecordedEvent = PortOpened | PortBytes | ErrorRaised | SessionEvent
"""What one line can be about."""


@dataclass(frozen=True, slots=True)
class RecordEntry:
    """One line of the recording: the calls since the line before, then what the line is about."""

    line: int
    t_s: float
    calls: str
    what: RecordedEvent


class CalledPort(SerialBase):
    """An open pyserial port that makes each of its operations a call; reading and writing are left out."""

    def __init__(
        self,
        opened: PortOpened,
        baudrate: int,
        timeout_s: float | None = 0.0,
        write_timeout_s: float | None = None,
    ) -> None:
        super().__init__()
        self._opened = opened
        self._port = opened.url
        self.name = self.portstr = opened.url
        self._baudrate = baudrate
        self._timeout = timeout_s
        self._write_timeout = write_timeout_s
        self.is_open = True

    def _call(self, letter: str, action: Callable[[Any], Any]) -> int:
        """Make a call, which on a port beneath is `action`; returns its count, 0 if it has none."""
        raise NotImplementedError

    def open(self) -> None:
        """Open again after it was closed."""
        self._call("p", lambda port: port.open())
        self.is_open = True

    def close(self) -> None:
        """Close; closing twice is harmless."""
        if self.is_open:
            self.is_open = False
            self._call("c", lambda port: port.close())

    @property
    def in_waiting(self) -> int:
        """Number of bytes that are ready."""
        return self._call("w", lambda port: port.in_waiting)

    @property
    def out_waiting(self) -> int:
        """Number of bytes that are still to be sent."""
        return self._call("q", lambda port: port.out_waiting)

    def flush(self) -> None:
        """Wait until everything is sent."""
        self._call("f", lambda port: port.flush())

    def reset_input_buffer(self) -> None:
        """Drop what is ready; bytes dropped unread are not recorded."""
        self._call("d", lambda port: port.reset_input_buffer())

    def reset_output_buffer(self) -> None:
        """Drop what is still to be sent."""
        self._call("o", lambda port: port.reset_output_buffer())

    def _reconfigure_port(self) -> None:
        self._call("s", lambda port: self._copy(port, "baudrate", "timeout", "write_timeout"))

    def _update_break_state(self) -> None:
        self._call("m", lambda port: self._copy(port, "break_condition"))

    def _update_rts_state(self) -> None:
        self._call("m", lambda port: self._copy(port, "rts"))

    def _update_dtr_state(self) -> None:
        self._call("m", lambda port: self._copy(port, "dtr"))

    def _copy(self, port: SerialBase, *settings: str) -> None:
        for name in settings:
            setattr(port, name, getattr(self, name))


_T = TypeVar("_T")

RecordItem = str | PortOpened | PortBytes | ErrorRaised
"""What a recording is made of: a call as `recording` describes it, or what has a line of its own."""


class RecordSink(Protocol):
    """Sink of a recording, in the order of the calls."""

    def note(self, what: RecordItem) -> None:
        """Take what has just happened, or bytes that are about to be written.

        Must not wait. Whatever it raises stays with the recording: no device is written to later, or not at
        all, because of it.
        """
        ...

    def check(self) -> None:
        """Raise OutputError if the recording has failed. Called where nothing is written to a device."""
        ...


class Recorder:
    """Makes a clock and ports that are recorded. For one thread."""

    def __init__(self, clock: Clock, sink: RecordSink, check: Callable[[], None] = lambda: None) -> None:
        """Record calls on `clock`, and on the ports that `open` opens, to `sink`.

        `check` is called in each of them, and may raise an interrupt that has come since.
        """
        self._raise_interrupt = check
        self._sink = sink
        self._failure: Exception | None = None
        self._reported = False
        self._noted = _interrupt_under_way()
        self._opened = 0
        self.clock: Clock = RecordingClock(clock, self)

    def open(self, port: str, opener: Callable[[], SerialBase]) -> SerialBase:
        """Open a port, called `port` in the recording, by `opener`, whose errors are recorded and go on."""
        found = self.ask("open", opener)
        opened = PortOpened(self._opened, port, found.port)
        self._opened += 1
        self.note(opened)
        return RecordingPort(found, self, opened)

    def note(self, what: RecordItem) -> None:
        """Record something, unless the sink has failed before: a recording keeps no device on."""
        if self._failure is not None:
            return
        try:
            self._sink.note(what)
        except Exception as error:
            self._failure = error

    def check(self) -> None:
        """Raise OutputError, once, if the recording has failed."""
        if self._failure is not None and not self._reported:
            self._reported = True
            message = f"the recording of ports failed: {self._failure!r}; the run was ended"
            raise OutputError(message) from self._failure
        self._sink.check()

    def ask(self, call: str, action: Callable[[], _T]) -> _T:
        """Return what `action` gives; what it raises, or an interrupt, is recorded as the end of `call`."""
        # Some thousand times a second of rig time: without a call more than it needs.
        if sys.exception() is not None:
            self._note_interrupt()
        try:
            self._raise_interrupt()
            return action()
        except BaseException as error:
            self._note_raised(call, error)
            raise

    def let_interrupt(self, call: str) -> None:
        """Let an interrupt come now, in `call`, before anything of it is done."""
        self.ask(call, lambda: None)

    def follow(self, call: str, action: Callable[[], _T]) -> _T:
        """Return what `action`, which is the rest of `call`, gives; what it raises is recorded."""
        try:
            return action()
        except BaseException as error:
            self._note_raised(call, error)
            raise

    def _note_raised(self, call: str, error: BaseException) -> None:
        """Record what ended a call."""
        if not isinstance(error, Exception):
            self._noted = error
        self.note(ErrorRaised(call, error))

    def _note_interrupt(self) -> None:
        """Record an interrupt that the host is clearing up after: nothing else tells of it in time."""
        error = _interrupt_under_way()
        if error is not None and error is not self._noted:
            self._noted = error
            self.note(ErrorRaised(None, error))


def _interrupt_under_way() -> BaseException | None:
    """The interrupt whose clearing up the caller is part of, if there is one."""
    error = sys.exception()
    while isinstance(error, Exception):  # met while clearing up
        error = error.__context__
    return None if isinstance(error, GeneratorExit) else error


class RecordingClock:
    """A clock whose readings are recorded."""

    def __init__(self, clock: Clock, recorder: Recorder) -> None:
        self._clock = clock
        self._recorder = recorder
        self._instants = Instants()

    def now(self) -> float:
        """Read the clock, s."""
        instant = self._recorder.ask("t", self._clock.now)
        self._recorder.note(self._instants.text(instant))
        return instant

    def sleep(self, seconds: float) -> None:
        """Sleep on the clock."""
        self._recorder.ask("z", lambda: self._clock.sleep(seconds))
        self._recorder.note("z")


class RecordingPort(CalledPort):
    """A pyserial port that passes everything on to another one and records what comes of it."""

    def __init__(self, port: SerialBase, recorder: Recorder, opened: PortOpened) -> None:
        """Wrap an open port; the wrapper takes over closing it."""
        super().__init__(opened, port.baudrate, port.timeout, port.write_timeout)
        self._inner = port
        self._recorder = recorder

    def read(self, size: int = 1, /) -> bytes:
        """Read from the port beneath."""
        call = port_call("r", self._opened.number)
        data = self._recorder.ask(call, lambda: self._inner.read(size))
        self._recorder.note(PortBytes(Direction.RECEIVED, self._opened.port, data) if data else call)
        return data

    def write(self, b: "ReadableBuffer", /) -> int | None:
        """Record the bytes, then write them to the port beneath."""
        data = bytes(b)
        if not data:
            return self._inner.write(data)
        call = port_call("x", self._opened.number)
        self._recorder.let_interrupt(call)
        self._recorder.note(PortBytes(Direction.SENT, self._opened.port, data))
        written = self._recorder.follow(call, lambda: self._inner.write(data))
        if written is not None and written != len(data):
            self._recorder.note(f"{port_call('n', self._opened.number)}:{written}")
        return written

    def _call(self, letter: str, action: Callable[[Any], Any]) -> int:
        call = port_call(letter, self._opened.number)
        count = int(self._recorder.ask(call, lambda: action(self._inner)) or 0)
        self._recorder.note(f"{call}:{count}" if count else call)
        return count
