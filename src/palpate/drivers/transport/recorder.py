"""Recorder of everything from outside that a run depends on, in order.

What the host does is decided by what clock and ports tell it, call by call, and by interrupts. A `Recorder`
stands before both and notes all of it in a sink, the session log; `replay` gives it back. See ADR 0014.
`CalledPort` names calls by the letters that `recording` lists: what a recorded and a replayed port share.
"""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from serial.serialutil import SerialBase

from palpate.base.errors import OutputError
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recording import (
    Direction,
    ErrorRaised,
    Instants,
    PortBytes,
    PortOpened,
    port_call,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


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
