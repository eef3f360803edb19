"""Codec of ReSkin and AnySkin boards: bytes to fields and back, without port or clock.

A frame in burst mode, as `reskin_sensor` and `anyskin` read it, is four little-endian floats a magnetometer,
temperature and field x, y, z (µT), and "\\r\\n" behind the last. It has neither number, length nor checksum:

    … 0D 0A | T x y z | T x y z | … | 0D 0A | T x y z …

The mark may occur inside. So a frame counts if a mark is before it, one behind it, and all values can be.
A bit that flips in a small digit does not show.
"""

import struct
from collections import Counter

import numpy as np
from numpy.typing import NDArray

__all__ = ["MARK", "FieldDecoder", "encode_fields"]

MARK = b"\r\n"
_MAX_FIELD_UT = 60_000.0  # what an MLX90393 can read, about
_MAX_TEMPERATURE_C = 150.0
_LEAST_UT = 1e-6  # a value that is nearer to 0, and not 0, is no reading

Fields = NDArray[np.float32]
"""Temperature (°C) and field x, y, z (µT) of each magnetometer, shape (n, 4)."""


def encode_fields(fields: Fields) -> bytes:
    """The frame of some fields, mark and all."""
    return fields.astype("<f4").tobytes() + MARK


class FieldDecoder:
    """Bytes in, fields out, however the bytes are cut; `faults` counts stretches that are no frame."""

    def __init__(self, magnetometers: int) -> None:
        self.faults: Counter[str] = Counter()
        self._size = 16 * magnetometers
        self._rest = b""
        self._skipping = True  # what comes before the first mark is no fault

    @property
    def waiting(self) -> int:
        """How many bytes are kept for a frame that is not complete; at most one frame with both its marks."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Fields]:
        """Take bytes as they came; return the fields of the frames that they complete."""
        data, found = self._rest + data, []
        at = data.find(MARK)
        while at >= 0 and len(data) - at >= self._size + 4:
            fields = self._fields(data[at + 2 : at + self._size + 4])
            if fields is None:
                self._fault()
                at = data.find(MARK, at + 1)
            else:
                found.append(fields)
                self._skipping = False
                at += self._size + 2
        self._rest = data[at:] if at >= 0 else data[-1:]
        if at < 0 and len(data) > 1:
            self._fault()
        return found

    def _fault(self) -> None:
        if not self._skipping:
            self.faults["no frame"] += 1
            self._skipping = True

    def _fields(self, frame: bytes) -> Fields | None:
        if not frame.endswith(MARK):
            return None
        fields = np.array(struct.unpack(f"<{self._size // 4}f", frame[:-2]), np.float32).reshape(-1, 4)
        size = np.abs(fields)
        most = np.array([_MAX_TEMPERATURE_C, *[_MAX_FIELD_UT] * 3])
        possible = (size <= most) & ((size == 0) | (size >= _LEAST_UT))  # nan is not
        return fields if possible.all() else None
