"""Fuzzing of stream decoders: millions of wrong bytes, reproducible by seed.

Half of them are noise, the other half a valid stream with flipped bits, and with stretches cut out, put in,
repeated, moved, or blown up by a gap without a delimiter. They arrive in pieces of any length.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

ROUNDS = 20
MAX_PIECE_BYTES = 8192
MAX_GAP_BYTES = 60_000
MAX_EDITS = 12  # to one copy of the valid stream
Bytes = np.ndarray
Edit = Callable[[np.random.Generator, Bytes], Bytes]


class StreamDecoder(Protocol):
    """Decoder to be fuzzed: `faults` counts by kind, `waiting` is the number of bytes kept between calls."""

    faults: Counter[Any]

    @property
    def waiting(self) -> int:
        """Number of bytes kept between calls."""
        ...

    def feed(self, data: bytes, /) -> Sequence[object]:
        """Take bytes; return the values and faults that they complete."""
        ...


@dataclass(frozen=True)
class FuzzTally:
    """Tally of a fuzzed stream.

    `items` counts what `feed` returned by the name of its type, `faults` is what the decoders counted
    themselves, by kind. `recovered` counts the items of each type that the valid stream gave after each round
    of garbage, and `undisturbed` those that it gives to a fresh decoder.
    """

    fed: int
    items: Counter[str]
    faults: Counter[Any]
    most_waiting: int
    recovered: tuple[Counter[str], ...]
    undisturbed: Counter[str]


def fuzz(
    make_decoder: Callable[[], StreamDecoder], valid_stream: bytes, total_bytes: int, seed: int
) -> FuzzTally:
    """Feed `total_bytes` of garbage to decoders, a fresh one for each of twenty rounds."""
    rng = np.random.default_rng(seed)
    items: Counter[str] = Counter()
    recovered: list[Counter[str]] = []
    faults: Counter[Any] = Counter()
    most = fed = 0
    for _ in range(ROUNDS):
        decoder = make_decoder()
        for piece in _pieces(rng, _garbage(rng, valid_stream, total_bytes // ROUNDS)):
            items.update(_names(decoder.feed(piece)))
            most = max(most, decoder.waiting)
            fed += len(piece)
        faults.update(decoder.faults)
        recovered.append(_names(decoder.feed(valid_stream)))
    undisturbed = _names(make_decoder().feed(valid_stream))
    return FuzzTally(fed, items, faults, most, tuple(recovered), undisturbed)


def _names(items: Sequence[object]) -> Counter[str]:
    return Counter(type(item).__name__ for item in items)


def _pieces(rng: np.random.Generator, data: bytes) -> Iterator[bytes]:
    """Cut it into pieces; short ones are as likely as long ones."""
    at = 0
    while at < len(data):
        size = int(MAX_PIECE_BYTES ** rng.random())
        yield data[at : at + size]
        at += size


def _garbage(rng: np.random.Generator, valid: bytes, size: int) -> bytes:
    parts: list[bytes] = []
    left = size
    while left > 0:
        part = _noise(rng) if rng.random() < 0.5 else _mutate(rng, np.frombuffer(valid, np.uint8))
        parts.append(part[:left].tobytes())
        left -= len(parts[-1])
    return b"".join(parts)


def _noise(rng: np.random.Generator) -> Bytes:
    """Bytes from nowhere; those that frame messages come more or less often."""
    noise = rng.integers(0, 256, int(rng.integers(1, 30_000)), dtype=np.uint8)
    noise[rng.random(noise.size) < 0.3 * rng.random() ** 4] = rng.choice([0x00, 0xAA, 0xFF, 0x01])
    return noise


def _mutate(rng: np.random.Generator, valid: Bytes) -> Bytes:
    for _ in range(int(rng.integers(1, MAX_EDITS))):
        valid = _EDITS[int(rng.integers(len(_EDITS)))](rng, valid)
    return valid


def _flip_bits(rng: np.random.Generator, data: Bytes) -> Bytes:
    out = data.copy()
    places = rng.integers(0, max(data.size, 1), int(rng.integers(1, 20)))
    if data.size:
        out[places] ^= (1 << rng.integers(0, 8, places.size)).astype(np.uint8)
    return out


def _stretch(rng: np.random.Generator, data: Bytes, longest: int) -> tuple[int, int]:
    a = int(rng.integers(0, data.size + 1))
    return a, min(data.size, a + int(longest ** rng.random()))


def _delete_stretch(rng: np.random.Generator, data: Bytes) -> Bytes:
    a, b = _stretch(rng, data, 400)
    return np.concatenate((data[:a], data[b:]))


def _insert_stretch(rng: np.random.Generator, data: Bytes) -> Bytes:
    a, b = _stretch(rng, data, 400)
    new = rng.integers(0, 256, b - a, dtype=np.uint8)
    return np.concatenate((data[:a], new, data[a:]))


def _repeat_stretch(rng: np.random.Generator, data: Bytes) -> Bytes:
    a, b = _stretch(rng, data, 400)
    return np.concatenate((data[:b], data[a:]))


def _move_stretch(rng: np.random.Generator, data: Bytes) -> Bytes:
    a, b = sorted(map(int, rng.integers(0, data.size + 1, 2)))
    return np.concatenate((data[b:], data[a:b], data[:a]))


def _insert_gap(rng: np.random.Generator, data: Bytes) -> Bytes:
    a = int(rng.integers(0, data.size + 1))
    new = rng.integers(1, 256, int(MAX_GAP_BYTES ** rng.random()), dtype=np.uint8)
    return np.concatenate((data[:a], new, data[a:]))


_EDITS: tuple[Edit, ...] = (
    _flip_bits,
    _flip_bits,
    _delete_stretch,
    _insert_stretch,
    _repeat_stretch,
    _move_stretch,
    _insert_gap,
)
