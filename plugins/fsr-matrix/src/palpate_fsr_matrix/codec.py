"""Codec of the Arduino's frames: bytes to readings and back, without port or clock.

A frame, little-endian:

    A5 C3 | rows u8 | columns u8 | matrix u8 | number u16 | time u32, µs | readings u16, row by row | CRC u16

The CRC is CCITT's (polynomial 0x1021, from 0xFFFF) over all before it. Garbage before, in and
after a frame costs no other: where the CRC does not fit, the search goes on behind the first byte.
"""

import binascii
import struct
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Readings", "ReadingsDecoder", "encode_readings", "frame_bytes"]

_MARK = b"\xa5\xc3"
_HEAD = struct.Struct("<2sBBBHI")
_CRC_SEED = 0xFFFF


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of the converter, (rows, columns), 0 to 1023, with the frame's number and time (µs).

    `matrix`: of those that the board has, from 0.
    """

    matrix: int
    number: int
    time_us: int
    adc: NDArray[np.uint16]


def frame_bytes(rows: int, cols: int) -> int:
    """Length of a frame."""
    return _HEAD.size + 2 * rows * cols + 2


def encode_readings(readings: Readings) -> bytes:
    """The frame of some readings."""
    head = _HEAD.pack(_MARK, *readings.adc.shape, readings.matrix, readings.number, readings.time_us)
    body = head + readings.adc.astype("<u2").tobytes()
    return body + struct.pack("<H", binascii.crc_hqx(body, _CRC_SEED))


class ReadingsDecoder:
    """Bytes in, readings out, however the bytes are cut; `faults` counts stretches that are no frame."""

    def __init__(self, rows: int, cols: int) -> None:
        """`rows`, `cols`: of frames that are looked for; others are no frames."""
        self.faults: Counter[str] = Counter()
        self._mark = _MARK + bytes((rows, cols))
        self._shape, self._size = (rows, cols), frame_bytes(rows, cols)
        self._rest = b""
        self._skipping = False

    @property
    def waiting(self) -> int:
        """How many bytes are kept for a frame whose end has not come."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Readings]:
        """Take bytes as they came; return what is in the frames that they complete."""
        data, found = self._rest + data, []
        while (at := data.find(self._mark)) >= 0:
            if at:
                self._fault()
            data = data[at:]
            if len(data) < self._size:
                break
            frame = data[: self._size]
            if binascii.crc_hqx(frame[:-2], _CRC_SEED) == int.from_bytes(frame[-2:], "little"):
                found.append(self._readings(frame))
                self._skipping, data = False, data[self._size :]
            else:
                self._fault()
                data = data[1:]
        if at < 0 and len(data) >= len(self._mark):
            self._fault()
            data = data[1 - len(self._mark) :]
        self._rest = data
        return found

    def _fault(self) -> None:
        if not self._skipping:
            self._skipping = True
            self.faults["no frame"] += 1

    def _readings(self, frame: bytes) -> Readings:
        _, _, _, matrix, number, time_us = _HEAD.unpack_from(frame)
        adc = np.frombuffer(frame, "<u2", offset=_HEAD.size, count=self._shape[0] * self._shape[1])
        return Readings(matrix, number, time_us, adc.astype(np.uint16).reshape(self._shape))
