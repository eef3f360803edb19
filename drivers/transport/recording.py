"""What a recording holds, as values: between the session log's reader and `replay`."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

__all__ = ["Direction", "Entry", "Opened", "Passed", "Raised", "Told", "What"]


class Direction(Enum):
    """Which way bytes went, seen from the host."""

    SENT = "sent"
    RECEIVED = "received"


@dataclass(frozen=True, slots=True)
class Opened:
    """A port was opened; `url` is what it called itself."""

    number: int
    port: str
    url: str | None


@dataclass(frozen=True, slots=True)
class Passed:
    """Bytes went through a port."""

    direction: Direction
    port: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Raised:
    """The call `during` failed, or with None an interrupt came before the next call."""

    during: str | None
    error: BaseException


@dataclass(frozen=True, slots=True)
class Told:
    """The session said something of its own. `interrupt` if this is its end, by an interrupt."""

    kind: str
    values: Mapping[str, Any]
    interrupt: BaseException | None = None


What = Opened | Passed | Raised | Told
"""What one line can be about."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the recording: the calls since the line before, then what the line is about."""

    line: int
    t_s: float
    calls: str
    what: What
