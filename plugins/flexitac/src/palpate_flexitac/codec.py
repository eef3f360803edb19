"""Codec of FlexiTac: bytes to matrices and back, without port or clock.

A frame is AA 55 and a byte for each taxel, row by row; the next one follows at once. There is neither length
nor checksum, and the mark may stand among the taxels, for as long as something presses on two of them just
so. So the decoder looks for the one place at which `_PROOF` marks follow each other a frame apart, and takes
none while there are two. Once it knows the place it keeps it, as long as a mark is there.
"""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

__all__ = ["MARK", "MatrixDecoder", "encode_matrix"]

MARK = b"\xaa\x55"
_PROOF = 3

Matrix = NDArray[np.uint8]


def encode_matrix(cells: Matrix) -> bytes:
    """The frame of a matrix."""
    return MARK + cells.astype(np.uint8).tobytes()


class MatrixDecoder:
    """Bytes in, matrices out, however the bytes are cut; `faults` counts losses of the place of the mark."""

    def __init__(self, rows: int, cols: int) -> None:
        self.faults: Counter[str] = Counter()
        self._shape, self._size = (rows, cols), len(MARK) + rows * cols
        self._rest = b""
        self._in_step = False

    @property
    def waiting(self) -> int:
        """How many bytes are kept, fewer than so many frames as prove where they begin, and one more."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Matrix]:
        """Take bytes as they came; return the matrices that they complete.

        A frame is complete with the mark of the next one.
        """
        self._rest += data
        found: list[Matrix] = []
        while self._in_step or self._find_step():
            if len(self._rest) < self._size + len(MARK):
                break
            if self._rest[self._size :].startswith(MARK):
                cells = np.frombuffer(self._rest, np.uint8, self._size - len(MARK), len(MARK))
                found.append(cells.reshape(self._shape).copy())
                self._rest = self._rest[self._size :]
            else:  # something was lost, or came in between
                self.faults["out of step"] += 1
                self._in_step = False
                self._rest = self._rest[len(MARK) :]
        return found

    def _find_step(self) -> bool:
        """Go to where frames begin; False as long as that is not sure."""
        while len(self._rest) >= _PROOF * self._size + len(MARK):
            places = [at for at in range(self._size) if self._is_proven(at)]
            if len(places) == 1:
                self._rest = self._rest[places[0] :]
                self._in_step = True
                return True
            self._rest = self._rest[self._size :]
        return False

    def _is_proven(self, at: int) -> bool:
        return all(self._rest.startswith(MARK, at + k * self._size) for k in range(_PROOF))
