"""The C firmware in this process; line, clock and taxels are the test's (`firmware/test/bench.c`)."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wire_messages import Said, request, said

__all__ = ["Bench", "Counters", "Makeup"]

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


class Bench:
    """One array. `problem` says why the firmware refuses the description, if it does."""

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
        """Put bytes on the line to the array."""
        taken = self._library.bench_input(self._state, data, ctypes.c_size_t(len(data)))
        assert taken == len(data)

    def poll(self, clock_us: int) -> bytes:
        """Let the array run once at an instant; what it sent."""
        self._library.bench_poll(self._state, ctypes.c_uint64(clock_us))
        out = ctypes.create_string_buffer(65536)
        size = self._library.bench_output(self._state, out, ctypes.c_size_t(len(out)))
        return out.raw[:size]

    def ask(self, clock_us: int, kind: int, number: int, *values: int) -> Said:
        """Send a request and return the only message that comes back."""
        self.send(request(kind, number, *values))
        (answer,) = said(self.poll(clock_us))
        assert answer.request == number
        return answer

    def room(self, size: int) -> None:
        """So many bytes the line still takes, until told otherwise."""
        self._library.bench_set_room(self._state, ctypes.c_size_t(size))

    def number(self, sequence: int) -> None:
        """Set the number of the next message."""
        self._library.bench_set_sequence(self._state, ctypes.c_uint32(sequence))

    def feel(self, counts: Sequence[int]) -> None:
        """What samples show from now on."""
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
        """What works."""
        self._library.bench_set_health(self._state, *map(ctypes.c_bool, (stream, sample, test)))

    @property
    def is_on(self) -> bool:
        """Whether the board was told to get ready for sampling."""
        return bool(self._library.bench_is_on(self._state))

    @property
    def counters(self) -> Counters:
        """How it went so far."""
        found = (ctypes.c_uint32 * 4)()
        self._library.bench_counters(self._state, found)
        return Counters(*found)
