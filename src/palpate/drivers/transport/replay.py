"""Replay: a clock and ports that return what was recorded and compare the host's calls; playback.

The other end of `Recorder`: a `Replayer` goes through the entries of a session log and lets the host's code
run as then. Every call must be the recorded one, and every byte sent the recorded byte. The first difference
is an error, and so is every call after it. A `PlaybackPort` serves a host that does something else: it
answers the first questions with what followed them in the recording, and then plays by time.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from serial.serialutil import SerialBase

from palpate.base.errors import PalpateError
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.recording import (
    CalledPort,
    Direction,
    ErrorRaised,
    Instants,
    PortBytes,
    PortOpened,
    RecordedCall,
    RecordedEvent,
    RecordEntry,
    SessionEvent,
    describe_call,
    parse_calls,
    port_call,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_BYTES_SHOWN = 24


class ReplayDiffers(PalpateError):
    """The host does not do what it did when the session was recorded."""


class RecordEnded(PalpateError):
    """The recording goes no further; the host would."""


class Replayer:
    """Goes through a recording together with the host's code. For one thread."""

    def __init__(self, entries: Sequence[RecordEntry], describe: Callable[[str, bytes], str]) -> None:
        """`entries` in order; `describe(port, data)` says what bytes on a port mean, "" if unknown."""
        self._entries = entries
        self._describe = describe
        self._at = 0
        self._calls: deque[RecordedCall] = deque()
        self._names: dict[int, str] = {}
        self._failed: PalpateError | None = None
        self.interrupt: BaseException | None = None
        self.sent_bytes = self.received_bytes = 0
        self.clock: Clock = ReplayClock(self)
        self._load()

    @property
    def failure(self) -> PalpateError | None:
        """The difference that was met, or that the recording ended; None as long as all is as recorded."""
        return self._failed

    @property
    def lines(self) -> int:
        """Number of lines whose event has come about again."""
        return self._at

    def open(self, port: str, baudrate: int) -> SerialBase:
        """Open a recorded port by its name in the rig file; raises what opening it raised then."""
        self._raise_if_due("open")
        what = self._next(f"opens port {port}")
        if not isinstance(what, PortOpened) or what.port != port:
            self._differ(f"opens port {port}")
        self._advance()
        self._names[what.number] = port
        return ReplayPort(self, what, baudrate)

    def call(self, letters: str, port: int = 0) -> RecordedCall:
        """Let the host make a call, one of `letters`; raises what it raised then."""
        key = letters[0] if letters[0] in "tz" else port_call(letters[0], port)
        doing = describe_call(key, self._names.get(port, ""))
        self._raise_if_due(key)
        return self._take(key, doing)

    def _take(self, key: str, doing: str) -> RecordedCall:
        """The recorded call under way, which must be the one with this key."""
        what = self._next(doing)
        if not isinstance(what, RecordedCall) or what.key != key:
            self._differ(doing)
        return self._calls.popleft()

    def read(self, port: PortOpened, size: int) -> bytes:
        """Result of a read."""
        key = port_call("r", port.number)
        doing = describe_call(key, port.port)
        self._raise_if_due(key)
        what = self._next(doing)
        if isinstance(what, PortBytes) and what.port == port.port and what.direction is Direction.RECEIVED:
            if len(what.data) > size:
                self._differ(f"reads {size} bytes at most from port {port.port}")
            self._advance()
            self.received_bytes += len(what.data)
            return what.data
        self._take(key, doing)
        return b""

    def write(self, port: PortOpened, data: bytes) -> int:
        """Compare what is sent with what was sent; returns how much of it was taken."""
        key = port_call("x", port.number)
        self._raise_if_due(key)
        what = self._next("")
        if not isinstance(what, PortBytes) or what.port != port.port or what.direction is not Direction.SENT:
            self._differ(f"sends {self._show_bytes(port.port, data)} to port {port.port}")
        if what.data != data:
            self._differ_in_bytes(port.port, data, what.data)
        self._advance()
        self.sent_bytes += len(data)
        self._raise_if_due(key)
        if self._calls and self._calls[0].key == port_call("n", port.number):
            return self._calls.popleft().value
        return len(data)

    def session_event(self, kind: str) -> Mapping[str, Any]:
        """Value that the session recorded of this kind, compared with now's; raises an interrupt
        before it.
        """
        self._raise_if_due(None)
        return self._values(kind, f'comes to "{kind}"')

    def ends(self) -> Mapping[str, Any]:
        """End that the recording's last line states; a difference if the host ends before it."""
        return self._values("end", "ends")

    def _values(self, kind: str, doing: str) -> Mapping[str, Any]:
        """The values of the recorded event under way, which must be of this kind."""
        what = self._next(doing)
        if not isinstance(what, SessionEvent) or what.kind != kind:
            self._differ(doing)
        self._advance()
        return what.values

    def close(self, port: PortOpened) -> None:
        """Close a port: the one call that may be left out, as garbage collection may make it."""
        if self._failed is not None or self._at >= len(self._entries):
            return
        self._raise_if_due(port_call("c", port.number))
        if self._calls and self._calls[0].key == port_call("c", port.number):
            self._calls.popleft()

    def differ(self, problem: str) -> NoReturn:
        """Report a difference in the line that has just come about."""
        self._fail(self._entries[max(self._at - 1, 0)], problem)

    def raise_damaged(self, problem: str) -> NoReturn:
        """Report that the line under way makes no sense."""
        self._fail(self._entries[min(self._at, len(self._entries) - 1)], problem)

    def _raise_if_due(self, call: str | None) -> None:
        """Raise what the recording says was raised in this call, or before it."""
        if self._failed is not None:
            raise self._failed
        if self._calls or self._at >= len(self._entries):
            return
        what = self._entries[self._at].what
        if isinstance(what, SessionEvent) and what.interrupt is not None:
            self.interrupt = what.interrupt
            raise what.interrupt
        if isinstance(what, ErrorRaised) and (what.during is None or what.during == call):
            self._advance()
            if not isinstance(what.error, Exception):
                self.interrupt = what.error
            raise what.error

    def _next(self, doing: str) -> RecordedCall | RecordedEvent:
        if self._failed is not None:
            raise self._failed
        if self._calls:
            return self._calls[0]
        if self._at >= len(self._entries):
            last = self._entries[-1].line if self._entries else 0
            self._failed = RecordEnded(f"the log ends after line {last}; the host {doing or 'goes on'} there")
            raise self._failed
        return self._entries[self._at].what

    def _advance(self) -> None:
        self._at += 1
        self._load()

    def _load(self) -> None:
        if self._at < len(self._entries):
            self._calls.extend(parse_calls(self._entries[self._at].calls))

    def _differ(self, doing: str) -> NoReturn:
        recorded = self._describe_recorded(self._next(doing))
        self._fail(self._entries[self._at], f"the host {doing}; in the recording it {recorded}")

    def _differ_in_bytes(self, port: str, sent: bytes, recorded: bytes) -> NoReturn:
        pairs = enumerate(zip(sent, recorded, strict=False))
        first = next((k for k, (a, b) in pairs if a != b), min(len(sent), len(recorded)))
        self._fail(
            self._entries[self._at],
            f"port {port}: byte {first} of what is sent differs: sent {self._show_bytes(port, sent, first)}, "
            f"recorded {self._show_bytes(port, recorded, first)}",
        )

    def _fail(self, entry: RecordEntry, problem: str) -> NoReturn:
        self._failed = ReplayDiffers(f"line {entry.line}, {entry.t_s:.6f} s: {problem}")
        raise self._failed

    def _describe_recorded(self, what: RecordedCall | RecordedEvent) -> str:
        match what:
            case RecordedCall():
                name = self._names.get(what.number, "") if what.key not in ("t", "z") else ""
                return describe_call(what.key, name)
            case PortOpened(port=port):
                return f"opens port {port}"
            case PortBytes(direction=Direction.SENT):
                return f"sends {self._show_bytes(what.port, what.data)} to port {what.port}"
            case PortBytes():
                return f"receives {len(what.data)} bytes from port {what.port}"
            case ErrorRaised():
                return f"meets an error ({what.error})"
        return f'comes to "{what.kind}"'

    def _show_bytes(self, port: str, data: bytes, around: int = 0) -> str:
        """Bytes in hexadecimal, those near byte `around` if they are many, and what they mean."""
        start = max(0, around - _BYTES_SHOWN // 2) if around >= _BYTES_SHOWN else 0
        end = start + _BYTES_SHOWN
        text = ("… " if start else "") + data[start:end].hex(" ") + (" …" if len(data) > end else "")
        meaning = self._describe(port, data)
        return f"{text} ({meaning})" if meaning else text


class ReplayClock:
    """A clock that gives recorded readings."""

    def __init__(self, replayer: Replayer) -> None:
        self._replayer = replayer
        self._instants = Instants()

    def now(self) -> float:
        """The recorded reading, s."""
        call = self._replayer.call("t")
        try:
            return self._instants.instant(call)
        except (ValueError, OverflowError):
            self._replayer.raise_damaged("holds a clock reading that no clock can have")

    def sleep(self, seconds: float) -> None:
        """Return at once: the readings say what time has passed."""
        del seconds
        self._replayer.call("z")


class ReplayPort(CalledPort):
    """A pyserial port with the recording behind it. Comes open from `Replayer.open`."""

    def __init__(self, replayer: Replayer, opened: PortOpened, baudrate: int) -> None:
        super().__init__(opened, baudrate)
        self._replayer = replayer

    def read(self, size: int = 1, /) -> bytes:
        """Result of a read."""
        return self._replayer.read(self._opened, size)

    def write(self, b: "ReadableBuffer", /) -> int:
        """Compare with what was sent; ReplayDiffers at the first byte that is not the same."""
        data = bytes(b)
        return self._replayer.write(self._opened, data) if data else 0

    def _call(self, letter: str, action: Callable[[Any], Any]) -> int:
        del action
        if letter == "c":
            self._replayer.close(self._opened)
            return 0
        return self._replayer.call(letter, self._opened.number).value


@dataclass(frozen=True, slots=True)
class RecordedBytes:
    """Bytes that passed the port at `t_s` on the recording's clock."""

    t_s: float
    direction: Direction
    data: bytes


class PlaybackPort:
    """Subset of a pyserial port that drivers use; what is written to it goes nowhere.

    Until `play` is called, each write releases what was received between the recorded write of the same
    number and the next one: answers come as they came, whenever they are asked for. After it, bytes are
    there from their recorded instant on.
    """

    def __init__(self, name: str, pieces: Sequence[RecordedBytes], clock: Clock) -> None:
        """`pieces` in order, on a clock that stands for the recording's."""
        self.port: str | None = name
        self.timeout: float | None = 0.0
        self._pieces = list(pieces)
        self._times_s = [piece.t_s for piece in pieces]
        self._clock = clock
        self._at = 0
        self._ready = bytearray()
        self._playing = False
        self.writes = 0

    @property
    def ended(self) -> bool:
        """True if the recording has nothing more for this port."""
        return self._at >= len(self._pieces) and not self._ready

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting; also brings `writes`, those gone by, up to date."""
        if self._playing:
            self._pass(bisect_right(self._times_s, self._clock.now()))
        return len(self._ready)

    def extend(self, pieces: Sequence[RecordedBytes]) -> None:
        """Add what was recorded since, in order."""
        self._pieces += pieces
        self._times_s += [piece.t_s for piece in pieces]

    def play(self) -> None:
        """Give the rest by the clock."""
        self._playing = True

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes; if there are none, let `timeout` pass on the clock once."""
        if not self.in_waiting and self.timeout:
            self._clock.sleep(self.timeout)
        data = bytes(self._ready[: min(size, self.in_waiting)])
        del self._ready[: len(data)]
        return data

    def write(self, data: bytes, /) -> int:
        """Take bytes as a port would."""
        if not self._playing:
            self._pass(self._next_write(self._at) + 1)
            self._pass(self._next_write(self._at))
        return len(data)

    def _next_write(self, at: int) -> int:
        pieces = range(at, len(self._pieces))
        sent = (k for k in pieces if self._pieces[k].direction is Direction.SENT)
        return next(sent, len(self._pieces))

    def _pass(self, end: int) -> None:
        """Let everything before piece `end` go by."""
        for piece in self._pieces[self._at : end]:
            if piece.direction is Direction.RECEIVED:
                self._ready += piece.data
            else:
                self.writes += 1
        self._at = max(self._at, min(end, len(self._pieces)))
