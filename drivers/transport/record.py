"""Noting everything from outside that a run depends on, in order. Between the host and its clock and ports.

What the host does is decided by what clock and ports tell it, call by call, and by interrupts. A `Recorder`
stands before both and hands all of it to a sink, the session log; `replay` gives it back. See ADR 0014.
"""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeVar

from serial.serialutil import SerialBase

from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recording import Direction, Instants, port_call
from palpate.errors import OutputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

__all__ = ["Recorder", "RecordingClock", "RecordingPort", "Sink"]

_T = TypeVar("_T")


class Sink(Protocol):
    """Where a recording goes, in the order of the calls.

    A sink must not wait. Whatever it raises stays with it: no device is written to later, or not at all,
    because of its recording.
    """

    def call(self, text: str) -> None:
        """A call, as `recording` describes it."""
        ...

    def opened(self, number: int, port: str, url: str | None) -> None:
        """Port `port` was opened and is number `number` from now on."""
        ...

    def passed(self, direction: Direction, instant: float, port: str, data: bytes) -> None:
        """Bytes were read, or are about to be written; `instant` is the clock's, s."""
        ...

    def raised(self, during: str | None, error: BaseException) -> None:
        """The call `during` failed; with None, an interrupt came between the last call and the next one."""
        ...

    def check(self) -> None:
        """Raise OutputError if the recording has failed. Called where nothing is written to a device."""
        ...


class _Shielded:
    """A sink whose failures stay with it: what it raises is kept for `check`, and it is told nothing more."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._failure: Exception | None = None

    def call(self, text: str) -> None:
        self._tell(lambda: self._sink.call(text))

    def opened(self, number: int, port: str, url: str | None) -> None:
        self._tell(lambda: self._sink.opened(number, port, url))

    def passed(self, direction: Direction, instant: float, port: str, data: bytes) -> None:
        self._tell(lambda: self._sink.passed(direction, instant, port, data))

    def raised(self, during: str | None, error: BaseException) -> None:
        self._tell(lambda: self._sink.raised(during, error))

    def check(self) -> None:
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise OutputError(f"the recording of ports failed: {failure!r}; the run was ended") from failure
        self._sink.check()

    def _tell(self, action: Callable[[], None]) -> None:
        if self._failure is not None:
            return
        try:
            action()
        except Exception as error:  # a recording must not keep a device from being switched off
            self._failure = error


class Recorder:
    """Makes a clock and ports that are recorded. For one thread."""

    def __init__(self, clock: Clock, sink: Sink, check: Callable[[], None] = lambda: None) -> None:
        """Record calls on `clock`, and on the ports that `open` opens, to `sink`.

        `check` is called in each of them, and may raise an interrupt that has come since.
        """
        self._raw = clock
        self._check = check
        self.sink: Sink = _Shielded(sink)
        self._noted = _interrupt_under_way()
        self._opened = 0
        self.clock: Clock = RecordingClock(clock, self)

    def open(self, port: str, opener: Callable[[], SerialBase]) -> SerialBase:
        """Open a port, called `port` in the recording, by `opener`, whose errors are recorded and go on."""
        found = self.ask("open", opener)
        number = self._opened
        self._opened += 1
        self.sink.opened(number, port, found.port)
        return RecordingPort(found, self, port, number)

    def ask(self, call: str, action: Callable[[], _T]) -> _T:
        """What `action` gives; what it raises, or an interrupt, is recorded as the end of `call`."""
        self.let_interrupt(call)
        return self.follow(call, action)

    def let_interrupt(self, call: str) -> None:
        """Let an interrupt come now, in `call`, before anything of it is done."""
        self.note_interrupt()
        self.follow(call, self._check)

    def follow(self, call: str, action: Callable[[], _T]) -> _T:
        """What `action`, which is part of `call`, gives; what it raises is recorded."""
        try:
            return action()
        except BaseException as error:
            if not isinstance(error, Exception):
                self._noted = error
            self.sink.raised(call, error)
            raise

    def note_interrupt(self) -> None:
        """Record an interrupt that the host is clearing up after: nothing else tells of it in time."""
        error = _interrupt_under_way()
        if error is not None and error is not self._noted:
            self._noted = error
            self.sink.raised(None, error)

    def passed(self, direction: Direction, port: str, data: bytes) -> None:
        """Record bytes at the clock's time."""
        self.sink.passed(direction, self._raw.now(), port, data)


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
        self._recorder.sink.call(self._instants.text(instant))
        return instant

    def sleep(self, seconds: float) -> None:
        """Sleep on the clock."""
        self._recorder.ask("z", lambda: self._clock.sleep(seconds))
        self._recorder.sink.call("z")


class RecordingPort(SerialBase):
    """A pyserial port that passes everything on to another one and records what comes of it."""

    def __init__(self, port: SerialBase, recorder: Recorder, name: str, number: int) -> None:
        """Wrap an open port; the wrapper takes over closing it."""
        super().__init__()
        self._inner = port
        self._recorder = recorder
        self._recorded_as = name
        self._number = number
        self._port = port.port
        self.name = self.portstr = port.port
        self._baudrate = port.baudrate
        self._timeout = port.timeout
        self._write_timeout = port.write_timeout
        self.is_open = port.is_open

    def open(self) -> None:
        """Open the port beneath again after it was closed."""
        self._do("p", self._inner.open)  # type: ignore[attr-defined]  # every port has it, the base class has not
        self.is_open = True

    def close(self) -> None:
        """Close the port beneath; closing twice is harmless."""
        if not self.is_open:
            return
        self.is_open = False
        self._do("c", self._inner.close)

    @property
    def in_waiting(self) -> int:
        """Number of bytes that the port beneath has ready."""
        return self._count("w", lambda: int(self._inner.in_waiting))  # type: ignore[attr-defined]

    @property
    def out_waiting(self) -> int:
        """Number of bytes that the port beneath has still to send."""
        return self._count("q", lambda: int(self._inner.out_waiting))  # type: ignore[attr-defined]

    def read(self, size: int = 1, /) -> bytes:
        """Read from the port beneath."""
        call = port_call("r", self._number)
        data = self._recorder.ask(call, lambda: self._inner.read(size))
        if data:
            self._recorder.passed(Direction.RECEIVED, self._recorded_as, data)
        else:
            self._recorder.sink.call(call)
        return data

    def write(self, b: "ReadableBuffer", /) -> int | None:
        """Record the bytes, then write them to the port beneath."""
        data = bytes(b)
        if not data:
            return self._inner.write(data)
        call = port_call("x", self._number)
        self._recorder.let_interrupt(call)
        self._recorder.passed(Direction.SENT, self._recorded_as, data)
        written = self._recorder.follow(call, lambda: self._inner.write(data))
        if written is not None and written != len(data):
            self._recorder.sink.call(f"{port_call('n', self._number)}:{written}")
        return written

    def flush(self) -> None:
        """Wait until the port beneath has sent everything."""
        self._do("f", self._inner.flush)

    def reset_input_buffer(self) -> None:
        """Drop what the port beneath has ready; bytes dropped unread are not recorded."""
        self._do("d", self._inner.reset_input_buffer)  # type: ignore[attr-defined]

    def reset_output_buffer(self) -> None:
        """Drop what the port beneath has still to send."""
        self._do("o", self._inner.reset_output_buffer)  # type: ignore[attr-defined]

    def _reconfigure_port(self) -> None:
        def pass_on() -> None:
            self._inner.baudrate = self._baudrate
            self._inner.timeout = self._timeout
            self._inner.write_timeout = self._write_timeout

        self._do("s", pass_on)

    def _update_break_state(self) -> None:
        self._set_line("break_condition")

    def _update_rts_state(self) -> None:
        self._set_line("rts")

    def _update_dtr_state(self) -> None:
        self._set_line("dtr")

    def _set_line(self, line: str) -> None:
        self._do("m", lambda: setattr(self._inner, line, getattr(self, line)))

    def _do(self, letter: str, action: Callable[[], object]) -> None:
        call = port_call(letter, self._number)
        self._recorder.ask(call, action)
        self._recorder.sink.call(call)

    def _count(self, letter: str, action: Callable[[], int]) -> int:
        call = port_call(letter, self._number)
        found = self._recorder.ask(call, action)
        self._recorder.sink.call(f"{call}:{found}" if found else call)
        return found
