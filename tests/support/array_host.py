"""The firmware's host program (`firmware/host/`) in a process of its own, and what it must be sending."""

import json
import os
import select
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from serial.serialutil import SerialBase

from palpate.base.geometry import Counts

__all__ = ["ArrayHost", "Sips", "array_host", "expected_counts", "read_quiet", "read_until"]

_PATIENCE_S = 20.0


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
            _, errors = self._process.communicate(timeout=_PATIENCE_S)
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


def read_until(descriptor: int, wanted: int, patience_s: float = _PATIENCE_S) -> bytes:
    """Read from a pseudo-terminal until so many delimiters have come, and what came with the last of them."""
    found = bytearray()
    end = time.monotonic() + patience_s
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
