"""Codec of the line protocol: bytes to texts and back, without port or clock."""

import zlib
from collections import Counter

__all__ = ["LONGEST", "LineDecoder", "encode"]

LONGEST = 16 * 1024
"""Bytes: longer than any line."""


def encode(text: str) -> bytes:
    """Line that carries `text`, with its checksum."""
    data = text.encode()
    return b"%s*%08x\n" % (data, zlib.crc32(data))


class LineDecoder:
    """Bytes in, texts of intact lines out, however the bytes are cut; `faults` counts the damaged ones."""

    def __init__(self) -> None:
        self.faults: Counter[str] = Counter()
        self._rest = b""

    @property
    def waiting(self) -> int:
        """How many bytes are kept for a line whose end has not come."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[str]:
        """Take bytes as they came; return the texts of the lines that they complete."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-LONGEST:]  # a line that is too long loses its beginning, and fails its check
        texts = []
        for line in lines:
            text, _, crc = line.rpartition(b"*")
            if crc == b"%08x" % zlib.crc32(text):
                texts.append(text.decode("latin-1"))
            else:
                self.faults["damaged line"] += 1
        return texts
