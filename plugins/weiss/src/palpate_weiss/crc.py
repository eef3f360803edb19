"""Checksum of the packets of Weiss Robotics' tactile sensors.

It is no catalogued CRC: the table of CRC-16/CCITT (polynomial 0x1021, most significant bit first) is
used with the update of a least-significant-bit-first one, beginning with 0xFFFF; "123456789" gives
0x6EB4. So does Schunk's SDHLibrary (crc.h, dsa.py), and CNCR-NTU/wts-ft for the WTS.

The update is linear over bits, so the checksum of any stretch follows from the registers at its two
ends. A decoder that tries many places in the same bytes pays for each byte once, however long the
packets claim to be.
"""

__all__ = ["INITIAL", "RunningCrc", "crc16"]

INITIAL = 0xFFFF
_MAX_LENGTH_BITS = 17  # stretches shorter than 2 ** 17 bytes; a length field has 16 bits


def _table_entry(byte: int) -> int:
    register = byte << 8
    for _ in range(8):
        register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    return register


_TABLE = tuple(map(_table_entry, range(256)))


def crc16(data: bytes, register: int = INITIAL) -> int:
    """Checksum of `data`, continuing from `register`."""
    for byte in data:
        register = _TABLE[(register ^ byte) & 0xFF] ^ register >> 8
    return register


def _apply(images: tuple[int, ...], register: int) -> int:
    """Apply a linear map, given by what it makes of each of the 16 bits."""
    out = 0
    for bit, image in enumerate(images):
        if register >> bit & 1:
            out ^= image
    return out


def _doublings() -> tuple[tuple[int, ...], ...]:
    """What 1, 2, 4, 8, … zero bytes do to the register."""
    maps = [tuple(crc16(b"\0", 1 << bit) for bit in range(16))]
    while len(maps) < _MAX_LENGTH_BITS:
        last = maps[-1]
        maps.append(tuple(_apply(last, image) for image in last))
    return tuple(maps)


_DOUBLINGS = _doublings()


class RunningCrc:
    """Registers at every place of a window of bytes that grows at its end and shrinks at its beginning."""

    def __init__(self) -> None:
        self._registers = [0]

    def extend(self, data: bytes) -> None:
        """Take bytes in at the window's end."""
        register = self._registers[-1]
        append = self._registers.append
        for byte in data:
            register = _TABLE[(register ^ byte) & 0xFF] ^ register >> 8
            append(register)

    def drop(self, count: int) -> None:
        """Forget `count` bytes at the window's beginning."""
        del self._registers[:count]

    def of(self, start: int, end: int) -> int:
        """Checksum of the bytes from place `start` of the window to `end`, at most 131,071 apart."""
        register = self._registers[start] ^ INITIAL
        length = end - start
        for power, images in enumerate(_DOUBLINGS):
            if length >> power & 1:
                register = _apply(images, register)
        return self._registers[end] ^ register
