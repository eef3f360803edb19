"""Codec of PaXini's communication boards: bytes to messages and back, without port or clock.

    55 AA | 00 | function u8 | register u16 | length u16 | data of a write | LRC      to the board
    AA 55 | 00 | function u8 | register u16 | length u16 | data | LRC                 its answer
    AA 56 | 00 | length u16, of what follows but the LRC | error u8 | data | LRC      pushed by itself

Little-endian; all bytes of a message add up to 0 modulo 256. What is pushed is, of each module that is there,
its resultant force in 6 bytes and its taxels in 3 bytes each, or one of both: forces of 0.1 N in x and y,
signed, and along the normal, unsigned. So `paxini-sdk` and ORCA's `orca_core` read it.
"""

import enum
import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "COUNTS_PER_N",
    "MODULES",
    "Answer",
    "BoardDecoder",
    "Forces",
    "Function",
    "Layout",
    "Push",
    "Register",
    "Request",
    "encode",
    "pack_resultant",
    "pack_taxels",
]

COUNTS_PER_N = 10.0
_FINGERS = ("thumb", "index", "middle", "ring", "little")
_PARTS = ("proximal", "middle", "tip", "nail")
MODULES = (
    *(f"{finger}-{part}" for finger in _FINGERS for part in _PARTS),
    *(f"palm-{number}" for number in range(1, 9)),
)
"""Places for sensors on a board, in its order."""

Forces = NDArray[np.int64]
"""Forces x, y and along the normal, in counts, shape (n, 3)."""

MAX_READ_BYTES = 512  # that a request may ask for
_MAX_ANSWER_BYTES = 64  # that we ask for: a longer one is damage
_MAX_TAXELS = 239  # of any module
_HEADS = {True: re.compile(b"\xaa[\x55\x56]"), False: re.compile(b"\x55\xaa")}


class Function(enum.IntEnum):
    """What a request is; its answer says the same, or 0x80 and a number of why not."""

    READ = 0x03
    WRITE = 0x10
    ZERO = 0x17


class Register(enum.IntEnum):
    """Registers of a board."""

    VERSION = 0x0000
    ZERO = 0x0002
    ACTIVE = 0x0010
    KINDS = 0x0016
    PUSHING = 0x0017
    RESET = 0x0022
    TAXELS = 0x0030
    RESULTANTS = 0x0500


@dataclass(frozen=True)
class Request:
    """A request, with the data that it writes, or the number of bytes that it wants to read."""

    function: int
    register: int
    data: bytes = b""
    wanted: int = 0


@dataclass(frozen=True)
class Answer:
    """A board's answer."""

    function: int
    register: int
    data: bytes


@dataclass(frozen=True)
class Push:
    """Data that a board sends by itself; `error`: 0, or something is wrong with any of its modules."""

    error: int
    data: bytes


Message = Request | Answer | Push


def encode(message: Message) -> bytes:
    """Bytes of a message."""
    if isinstance(message, Push):
        body = b"\xaa\x56\0" + (1 + len(message.data)).to_bytes(2, "little") + bytes((message.error,))
    else:
        asks = isinstance(message, Request)
        length = message.wanted if isinstance(message, Request) and message.wanted else len(message.data)
        body = (b"\x55\xaa" if asks else b"\xaa\x55") + bytes((0, message.function))
        body += message.register.to_bytes(2, "little") + length.to_bytes(2, "little")
    body += message.data
    return body + bytes((-sum(body) & 0xFF,))


@dataclass(frozen=True)
class Layout:
    """Layout of what is pushed: modules that are there, how many taxels each of all has, and what of them."""

    active: tuple[int, ...]
    taxels: tuple[int, ...]
    has_resultants: bool
    has_taxels: bool

    @classmethod
    def of(cls, active: bytes, kinds: int, taxels: bytes) -> "Layout":
        """Layout by the values of three registers."""
        bits = int.from_bytes(active, "little")
        counts = np.frombuffer(taxels, "<u2").tolist()
        there = tuple(module for module in range(len(MODULES)) if bits >> module & 1)
        return cls(there, tuple(counts), bool(kinds & 1), bool(kinds & 2))

    @property
    def size(self) -> int:
        """Number of bytes that are pushed at once, beside head, error and LRC."""
        return sum(map(self._size_of, self.active))

    def _size_of(self, module: int) -> int:
        return 6 * self.has_resultants + 3 * self.has_taxels * self.taxels[module]

    def forces(self, data: bytes, module: int) -> Forces:
        """Forces (n, 3) on a module's taxels, in counts, of what was pushed."""
        at = sum(self._size_of(other) for other in self.active if other < module) + 6 * self.has_resultants
        raw = np.frombuffer(data, np.uint8, 3 * self.taxels[module], at).reshape(-1, 3).astype(np.int64)
        raw[:, :2] -= 256 * (raw[:, :2] > 127)
        return raw


def pack_taxels(forces: Forces) -> bytes:
    """Bytes of the forces (n, 3) on taxels, in counts; what does not fit is held at the end of the range."""
    return (np.clip(forces, (-128, -128, 0), (127, 127, 255)) & 0xFF).astype(np.uint8).tobytes()


def pack_resultant(force: Forces) -> bytes:
    """Bytes of a resultant (1, 3): two an axis, of which the higher one repeats the sign of the lower one."""
    return np.frombuffer(pack_taxels(force), np.int8).astype("<i2").tobytes()


class BoardDecoder:
    """Bytes in, messages out, however the bytes are cut; `faults` counts stretches that are no message.

    `push_size`: the number of bytes that are pushed at once; None: any that can be.
    """

    def __init__(self, *, from_board: bool = True) -> None:
        """`from_board`: answers and what is pushed are looked for, not requests."""
        self.faults: Counter[str] = Counter()
        self.push_size: int | None = None
        self._head = _HEADS[from_board]
        self._rest = b""
        self._skipping = False

    @property
    def waiting(self) -> int:
        """How many bytes are kept for a message whose end has not come."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Message]:
        """Take bytes as they came; return the messages that they complete."""
        data, found, at = self._rest + data, list[Message](), 0
        while (head := self._head.search(data, at)) is not None:
            if head.start() > at:
                self._fault()
            at = head.start()
            size = self._size(data[at : at + 8])
            if size is None or len(data) < at + size:
                break
            if size and sum(data[at : at + size]) % 256 == 0:
                found.append(_message(data[at : at + size]))
                self._skipping = False
                at += size
            else:
                self._fault()
                at += 1
        if head is None:  # the last byte may begin one
            last = len(data) - data.endswith((b"\xaa", b"\x55"))
            if last > at:
                self._fault()
                at = last
        self._rest = data[at:]
        return found

    def _size(self, head: bytes) -> int | None:
        """Size of a message by its beginning; 0 if there is no such message, None if more has to come."""
        if head.startswith(b"\xaa\x56"):
            if len(head) < 5:
                return None
            length, size = int.from_bytes(head[3:5], "little"), self.push_size
            most = len(MODULES) * (6 + 3 * _MAX_TAXELS)
            right = 1 <= length <= 1 + most if size is None else length == 1 + size
            return 6 + length if right else 0
        if len(head) < 8:
            return None
        length = int.from_bytes(head[6:8], "little")
        if head.startswith(b"\x55\xaa") and head[3] == Function.READ:
            return 9 if 1 <= length <= MAX_READ_BYTES else 0
        return 9 + length if length <= _MAX_ANSWER_BYTES else 0

    def _fault(self) -> None:
        if not self._skipping:
            self._skipping = True
            self.faults["no message"] += 1


def _message(data: bytes) -> Message:
    if data.startswith(b"\xaa\x56"):
        return Push(data[5], data[6:-1])
    function, register = data[3], int.from_bytes(data[4:6], "little")
    if data.startswith(b"\xaa\x55"):
        return Answer(function, register, data[8:-1])
    if function == Function.READ:
        return Request(function, register, wanted=int.from_bytes(data[6:8], "little"))
    return Request(function, register, data[8:-1])
