"""The recording of a run: what the host asked of clock and ports, call by call, and what came of it.

`recorder` writes it, the session log keeps it, `replay` reads it. A call is a letter, for ports the port's
number in the order of opening, and what came of it if that is not the usual thing:

    t4000000  the clock, 4,000,000 ns after its last reading     .     the clock, as at its last reading
    z         a sleep on the clock                               r1    a read of port 1 that gave nothing
    w1:40     40 bytes were waiting on port 1; w1: none          n1:3  only 3 bytes of a write were taken
    q1:40     40 bytes were still to be sent; q1: none           s1    settings of port 1 were changed
    f1 d1 o1  flushed, input dropped, output dropped             m1    modem lines or break of port 1 were set
    c1        closed                                             p1    opened again

Reads that gave bytes and all writes have lines of their own in the log, and so have failures.
"""

import math
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

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
