"""The C firmware of arrays: built, called in this process, and run as a host program."""

import ctypes
import fcntl
import json
import os
import select
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from serial.serialutil import SerialBase

from palpate.base.geometry import Counts
from palpate.drivers.tactile.codec import Decoder
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Message, MessageBody, SelfTestResult
from support.commands.command import PATIENCE_S
from support.commands.repository import ROOT
from support.devices.array_wire import Scripted, emulated
from support.oracles.array_messages import ACK, FRAME, HELLO, SMALL, START, STOP, Said, request, said

# ----------------------------------------------------------------------------------------------------
# Builds `firmware/` with the computer's C compiler, once for all tests that run at the same time.

FIRMWARE = ROOT / "firmware"


def build_firmware(target: str = "all") -> Path:
    """Make a target of `firmware/Makefile`; returns the folder with the programs."""
    built = FIRMWARE / "build"
    built.mkdir(exist_ok=True)
    with (built / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = subprocess.run(
            ["make", "-C", str(FIRMWARE), target],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
    assert done.returncode == 0, (
        f"the firmware does not build; is there a C compiler?\n{done.stdout}{done.stderr}"
    )
    return built


# ----------------------------------------------------------------------------------------------------
# The C firmware in this process; line, clock and taxels are the test's (`firmware/test/bench.c`).

_REAL = ctypes.c_float


class _Description(ctypes.Structure):
    _fields_ = (
        ("unique_id", ctypes.c_uint8 * 16),
        ("is_emulated", ctypes.c_bool),
        ("shape", ctypes.c_int),
        ("bit_depth", ctypes.c_uint8),
        ("rows", ctypes.c_uint8),
        ("columns", ctypes.c_uint8),
        ("max_rate_mhz", ctypes.c_uint32),
        ("full_scale_n", _REAL),
        ("counts_per_n", _REAL),
        ("tip_radius_mm", _REAL),
        ("column_places", ctypes.POINTER(_REAL)),
        ("row_heights", ctypes.POINTER(_REAL)),
        ("firmware", ctypes.c_char_p),
        ("has_self_test", ctypes.c_bool),
        ("has_geometry", ctypes.c_bool),
    )


@dataclass(frozen=True)
class Makeup:
    """What the array on the bench is; by default the one of the page's first DESCRIBE vector."""

    shape: int = 1
    bit_depth: int = 12
    columns: Sequence[float] | None = (-0.5, 0.0, 0.5)
    rows: Sequence[float] | None = (1.0, 3.0)
    size: tuple[int, int] = (2, 3)
    max_rate_mhz: int = 200_000
    radius_mm: float = 5.0
    firmware: bytes = b"emu 1"
    has_self_test: bool = True
    has_geometry: bool = True

    def pack(self) -> _Description:
        def reals(values: Sequence[float] | None) -> object:
            return (
                None if values is None else ctypes.cast((_REAL * len(values))(*values), ctypes.POINTER(_REAL))
            )

        return _Description(
            (ctypes.c_uint8 * 16)(*range(16)),
            True,
            self.shape,
            self.bit_depth,
            *self.size,
            self.max_rate_mhz,
            2.0,
            2047.5,
            self.radius_mm,
            reals(self.columns),
            reals(self.rows),
            self.firmware,
            self.has_self_test,
            self.has_geometry,
        )


@dataclass(frozen=True)
class Counters:
    """`struct palpate_counters`."""

    faults: int
    requests: int
    frames: int
    given_up: int


class PolledArray(ABC):
    """An array on a bench without time of its own: bytes in, bytes out whenever it is polled."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Put bytes on the line to the array."""

    @abstractmethod
    def poll(self, clock_us: int) -> bytes:
        """Let the array run once at an instant; what it sent."""

    @abstractmethod
    def feel(self, counts: Sequence[int]) -> None:
        """What samples show from now on."""

    @abstractmethod
    def health(self, *, stream: bool = True) -> None:
        """What works."""

    @property
    @abstractmethod
    def is_on(self) -> bool:
        """True if it samples, or was told to get ready for it."""

    @property
    def counted(self) -> int | None:
        """How many faults it counted, if it counts."""
        return None

    def ask(self, clock_us: int, kind: int, number: int, *values: int) -> Said:
        """Send a request and return the only message that comes back."""
        (answer,) = self.told(request(kind, number, *values), clock_us)
        assert answer.request == number
        return answer

    def told(self, data: bytes, clock_us: int = 1) -> list[Said]:
        """What comes back to bytes at once."""
        self.send(data)
        return said(self.poll(clock_us))

    def stream(self, rate_mhz: int, at_us: int = 0) -> None:
        """Start it."""
        assert self.ask(at_us, START, 1, rate_mhz).type == ACK

    def frames(self, until_us: int) -> list[Said]:
        """What comes when it is polled every ms up to an instant."""
        return [found for now in range(0, until_us + 1, 1000) for found in said(self.poll(now))]

    def instants(self, times: range) -> list[int]:
        """Device times of what comes when it is polled at some instants."""
        return [found.time_us for now in times for found in said(self.poll(now))]

    def one(self, clock_us: int) -> Said:
        """The only frame that comes at an instant."""
        (found,) = said(self.poll(clock_us))
        assert found.type == FRAME
        return found


class EmulatedBench(PolledArray):
    """The emulated array of `SMALL`."""

    def __init__(self) -> None:
        self._taxels = Scripted(SMALL, [(0,) * 6])
        self._array = emulated(self._taxels, self_test_s=0.0)
        self._line = b""

    def send(self, data: bytes) -> None:
        self._line += data

    def poll(self, clock_us: int) -> bytes:
        data, self._line = self._line, b""
        now = clock_us / 1e6 + (0 if data else 1e-9)  # periods add up to a little more than what is meant
        return b"".join(sent for _, sent in self._array.feed(data, now))

    def feel(self, counts: Sequence[int]) -> None:
        self._taxels.script = [np.reshape(counts, (2, 3)).astype("<u2")]

    def health(self, *, stream: bool = True) -> None:
        self._array.broken = SelfTestResult(0) if stream else SelfTestResult.CONVERTER

    @property
    def is_on(self) -> bool:
        return self._array.next_sample_s() is not None


class Bench(PolledArray):
    """The firmware. `problem` says why it refuses the description, if it does."""

    def __init__(self, built: Path, makeup: Makeup | None = None) -> None:
        self._library = ctypes.CDLL(str(built / "bench.so"))
        self._library.bench_init.restype = ctypes.c_char_p
        for name in ("bench_size", "bench_input", "bench_output"):
            getattr(self._library, name).restype = ctypes.c_size_t
        self._library.bench_is_on.restype = ctypes.c_bool
        self._state = ctypes.create_string_buffer(self._library.bench_size())
        problem = self._library.bench_init(self._state, ctypes.byref((makeup or Makeup()).pack()))
        self.problem = None if problem is None else problem.decode()

    def send(self, data: bytes) -> None:
        taken = self._library.bench_input(self._state, data, ctypes.c_size_t(len(data)))
        assert taken == len(data)

    def poll(self, clock_us: int) -> bytes:
        self._library.bench_poll(self._state, ctypes.c_uint64(clock_us))
        out = ctypes.create_string_buffer(65536)
        size = self._library.bench_output(self._state, out, ctypes.c_size_t(len(out)))
        return out.raw[:size]

    def room(self, size: int) -> None:
        """So many bytes the line still takes, until told otherwise."""
        self._library.bench_set_room(self._state, ctypes.c_size_t(size))

    def number(self, sequence: int) -> None:
        """Set the number of the next message."""
        self._library.bench_set_sequence(self._state, ctypes.c_uint32(sequence))

    def feel(self, counts: Sequence[int]) -> None:
        packed = (ctypes.c_uint16 * len(counts))(*counts)
        self._library.bench_set_counts(self._state, packed, ctypes.c_size_t(len(counts)))

    def ail(self, kinds: Sequence[int], result: int = 0) -> None:
        """What a self-test finds."""
        packed = (ctypes.c_uint8 * len(kinds))(*kinds)
        self._library.bench_set_kinds(
            self._state, packed, ctypes.c_size_t(len(kinds)), ctypes.c_uint16(result)
        )

    def place(self, places: Sequence[Sequence[float]]) -> None:
        """Where the taxels are: six reals each."""
        flat = [value for place in places for value in place]
        self._library.bench_set_places(self._state, (_REAL * len(flat))(*flat), ctypes.c_size_t(len(places)))

    def health(self, *, stream: bool = True, sample: bool = True, test: bool = True) -> None:
        self._library.bench_set_health(self._state, *map(ctypes.c_bool, (stream, sample, test)))

    @property
    def is_on(self) -> bool:
        return bool(self._library.bench_is_on(self._state))

    @property
    def counted(self) -> int:
        return self.counters.faults

    @property
    def counters(self) -> Counters:
        """How it went so far."""
        found = (ctypes.c_uint32 * 4)()
        self._library.bench_counters(self._state, found)
        return Counters(*found)


# ----------------------------------------------------------------------------------------------------
# The firmware's host program (`firmware/host/`) in a process of its own, and what it must be sending.


class ArrayHost:
    """A running host program: `path` is its pseudo-terminal. `told` has its own account once it has ended."""

    def __init__(self, program: Path, options: tuple[object, ...]) -> None:
        self._process = subprocess.Popen(
            [str(program), *map(str, options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.path = self._process.stdout.readline().strip()
        self.told: dict[str, int] = {}

    def end(self) -> dict[str, int]:
        """Close its stdin, and return its account; fails if it did not end well."""
        if not self.told:
            _, errors = self._process.communicate(timeout=PATIENCE_S)
            assert self._process.returncode == 0, errors
            self.told = json.loads(errors)
        return self.told

    def terminate(self) -> dict[str, int]:
        """End it by SIGTERM instead."""
        self._process.terminate()
        return self.end()

    def kill(self) -> None:
        """Whatever happened, leave nothing running."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()


@contextmanager
def array_host(program: Path, *options: object) -> Iterator[ArrayHost]:
    """Serve an array until the block ends; its account must say so."""
    host = ArrayHost(program, options)
    try:
        yield host
        host.end()
    finally:
        host.kill()


def expected_counts(numbers: NDArray[np.uint32], rows: int, columns: int, depth: int = 16) -> Counts:
    """What frames with these numbers hold, shape (frames, rows, columns).

    The formula is that of `frame_pattern` in firmware/test/pattern.h.
    """
    x = np.asarray(numbers, np.uint32)[:, None] * np.uint32(0x9E3779B1)
    x = x + np.arange(rows * columns, dtype=np.uint32) * np.uint32(0x85EBCA77)
    x = (x ^ (x >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
    x = (x ^ (x >> np.uint32(12))) & np.uint32((1 << depth) - 1)
    return x.astype(np.uint16).reshape(-1, rows, columns)


class Sips:
    """A port that lets a stretch of bytes through and then none until `refill`.

    An array that streams as fast as the line takes it never leaves the line empty, and reading until nothing
    is left would not end. The bytes held back wait in the pseudo-terminal.
    """

    def __init__(self, port: SerialBase, size: int) -> None:
        self._port = port
        self._size = self._left = size
        self.timeout: float | None = 0.0

    @property
    def port(self) -> str | None:
        return self._port.port

    @property
    def in_waiting(self) -> int:
        return min(self._port.in_waiting, self._left)

    def read(self, size: int = 1, /) -> bytes:
        self._port.timeout = self.timeout
        data: bytes = self._port.read(min(size, self._left))
        self._left -= len(data)
        return data

    def write(self, data: bytes, /) -> int | None:
        self.refill()
        return self._port.write(data)

    def refill(self) -> None:
        self._left = self._size


def read_until(descriptor: int, wanted: int) -> bytes:
    """Read from a pseudo-terminal until so many delimiters have come, and what came with the last of them."""
    found = bytearray()
    end = time.monotonic() + PATIENCE_S
    while found.count(0) < wanted:
        left = end - time.monotonic()
        assert left > 0, f"{found.count(0)} messages instead of {wanted}"
        if select.select([descriptor], [], [], left)[0]:
            found += os.read(descriptor, 65536)
    return bytes(found)


def read_quiet(descriptor: int, quiet_s: float) -> bytes:
    """Read from a pseudo-terminal until nothing comes for so long."""
    found = bytearray()
    while select.select([descriptor], [], [], quiet_s)[0]:
        found += os.read(descriptor, 65536)
    return bytes(found)


# ----------------------------------------------------------------------------------------------------
# Many frames from the firmware's host program to the Python decoder, each one checked and accounted for.

RATE_MHZ = 1_000_000
PERIOD_US = 1000
_ATTEMPTS = 20
_ANSWER_S = 10.0
_STALL_S = 5.0
_TAIL = 100  # frames, at most so many are thought lost at the end
_QUIET_S = 0.3  # nothing for so long: there are none


@dataclass
class Taken:
    """What came, from DESCRIBE on."""

    frames: int = 0
    answers: int = 0
    wrong: int = 0  # frames whose counts are not what the array sampled
    first: int = -1  # number of DESCRIBE
    last: int = -1  # number of the last message
    phases: set[int] = field(default_factory=set)  # instant less number times the period: one for each START


class Exchange:
    """One conversation over a pseudo-terminal. Questions are said again until they are answered."""

    def __init__(self, descriptor: int, rows: int, columns: int) -> None:
        self._descriptor = descriptor
        self._size = (rows, columns)
        self._request = 0
        self.decoder = Decoder()
        self.taken = Taken()

    def describe(self) -> Describe:
        """HELLO, until there is an answer. What the array used up before is not counted."""
        found = self._ask(HELLO, lambda body: isinstance(body, Describe))
        assert isinstance(found, Describe)
        return found

    def start(self) -> None:
        """START; its answer or frames must come."""
        self._ask(START, lambda body: isinstance(body, Ack | Frame), RATE_MHZ)

    def read(self, frames: int) -> None:
        """Take all that comes: so many frames, but for those that are lost."""
        while self.taken.frames + self.decoder.lost < frames - _TAIL:
            assert self._step(_STALL_S) is not None, f"nothing after {self.taken.frames} frames"
        while self._step(_QUIET_S) is not None:
            pass

    def stop(self) -> None:
        """STOP; the number of its answer tells what is missing at the end."""
        self._ask(STOP, lambda body: isinstance(body, Ack))

    def _ask(self, kind: int, is_wanted: Callable[[MessageBody], bool], *values: int) -> MessageBody:
        for _ in range(_ATTEMPTS):
            self._request += 1
            os.write(self._descriptor, b"\x00" + request(kind, self._request, *values))
            end = time.monotonic() + _ANSWER_S
            while time.monotonic() < end:
                for body in self._step(_ANSWER_S) or ():
                    if is_wanted(body):
                        return body
        raise AssertionError(f"no answer to request {kind}")

    def _step(self, patience_s: float) -> list[MessageBody] | None:
        """Take what is there now; None if nothing comes for a while."""
        ready, _, _ = select.select([self._descriptor], [], [], patience_s)
        if not ready:
            return None
        items = self.decoder.feed(os.read(self._descriptor, 1 << 16))
        came = [item for item in items if isinstance(item, Message)]
        self._check([item for item in came if isinstance(item.body, Frame)])
        for message in came:
            if isinstance(message.body, Describe):
                self.taken = Taken(first=message.sequence)
                self.decoder.lost = 0
            elif not isinstance(message.body, Frame):
                self.taken.answers += 1
            self.taken.last = message.sequence
        return [message.body for message in came]

    def _check(self, messages: list[Message]) -> None:
        if not messages:
            return
        rows, columns = self._size
        numbers = np.array([message.sequence for message in messages], np.uint32)
        bodies = b"".join(message.body.taxels for message in messages if isinstance(message.body, Frame))
        counts = np.frombuffer(bodies, "<u2").reshape(-1, rows, columns)
        wrong = (counts != expected_counts(numbers, rows, columns)).any(axis=(1, 2))
        self.taken.wrong += int(np.count_nonzero(wrong))
        self.taken.frames += len(messages)
        self.taken.phases |= {message.time_us - PERIOD_US * message.sequence for message in messages}


def exchange(host: ArrayHost, rows: int, columns: int, frames: int) -> tuple[Taken, int]:
    """Have the frames sent that `host` was told to sample, `frames` in all.

    Returns what came, and how many messages are missing (`Decoder.lost`): numbers between DESCRIBE and the
    answer to STOP that never came, of frames and of answers.
    """
    descriptor = os.open(host.path, os.O_RDWR | os.O_NOCTTY)
    try:
        talk = Exchange(descriptor, rows, columns)
        talk.describe()
        talk.start()
        talk.read(frames)
        talk.stop()
    finally:
        os.close(descriptor)
    return talk.taken, talk.decoder.lost
