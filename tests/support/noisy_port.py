"""A serial port whose bytes get damaged on their way to the host."""

import numpy as np

from palpate.drivers.tactile.stream import Port

__all__ = ["NoisyPort"]


class NoisyPort:
    """Flips one bit of a share of the bytes that are read; `flipped` counts them."""

    def __init__(self, port: Port, share: float, seed: int) -> None:
        self._port = port
        self._share = share
        self._rng = np.random.default_rng(seed)
        self.flipped = 0
        self.timeout: float | None = 0.0

    @property
    def port(self) -> str | None:
        return self._port.port

    @property
    def in_waiting(self) -> int:
        return self._port.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        self._port.timeout = self.timeout
        data = np.frombuffer(self._port.read(size), np.uint8).copy()
        hit = self._rng.random(data.size) < self._share
        data[hit] ^= np.uint8(1) << self._rng.integers(0, 8, int(hit.sum())).astype(np.uint8)
        self.flipped += int(hit.sum())
        return data.tobytes()

    def write(self, data: bytes, /) -> int | None:
        return self._port.write(data)
