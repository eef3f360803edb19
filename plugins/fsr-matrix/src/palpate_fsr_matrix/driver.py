"""Host driver of the matrix: frames that come unasked, with stamps and a checksum."""

from palpate.plugins import Clock, Corner, DecodedFrame, Description, FreeRunningArray, Port, first_corner
from palpate_fsr_matrix.circuit import conductances
from palpate_fsr_matrix.codec import ReadingsDecoder, frame_bytes
from palpate_fsr_matrix.config import FsrMatrixConfig

__all__ = ["fsr_matrix"]


class _Conductances:
    """Decoder of frames of one matrix as conductances on the tip."""

    def __init__(self, shape: tuple[int, int], first: Corner, matrix: int) -> None:
        self._decoder, self._first, self._matrix = ReadingsDecoder(*shape), first, matrix
        self.faults = self._decoder.faults

    def feed(self, data: bytes) -> list[DecodedFrame]:
        """Take bytes as they came; return the frames that they complete."""
        found = [each for each in self._decoder.feed(data) if each.matrix == self._matrix]
        return [DecodedFrame(self._first.flip(conductances(each.adc)), each.time_us) for each in found]


def fsr_matrix(
    port: Port, clock: Clock, finger: str, description: Description, config: FsrMatrixConfig
) -> FreeRunningArray:
    """The driver of a resistive matrix on an open port, read by the sketch of this plug-in."""
    shape = description.rows, description.cols
    decoder = _Conductances(shape, first_corner(config), config.matrix)
    # All matrices of a board come on its connection.
    on_wire = config.matrices * frame_bytes(*shape)
    return FreeRunningArray(port, clock, finger, description, decoder, on_wire, config.delay_s)
