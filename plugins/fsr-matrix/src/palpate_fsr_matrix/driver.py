"""Host driver of the matrix: frames that come unasked, with stamps and a checksum."""

from palpate.plugins import Clock, Corner, DecodedFrame, Description, FreeRunningArray, Port
from palpate_fsr_matrix.circuit import conductances
from palpate_fsr_matrix.codec import ReadingsDecoder, frame_bytes

__all__ = ["FsrMatrix"]


class _Conductances:
    """Decoder of frames as conductances on the tip."""

    def __init__(self, shape: tuple[int, int], first: Corner) -> None:
        self._decoder, self._first = ReadingsDecoder(*shape), first
        self.faults = self._decoder.faults

    def feed(self, data: bytes) -> list[DecodedFrame]:
        """Take bytes as they came; return the frames that they complete."""
        found = self._decoder.feed(data)
        return [DecodedFrame(self._first.flip(conductances(each.adc)), each.time_us) for each in found]


class FsrMatrix(FreeRunningArray):
    """A resistive matrix on an open port, read by the sketch of this plug-in."""

    tick_s = 1e-6

    def __init__(
        self, port: Port, clock: Clock, finger: str, description: Description, first: Corner, delay_s: float
    ) -> None:
        shape = description.rows, description.cols
        super().__init__(
            port, clock, finger, description, _Conductances(shape, first), frame_bytes(*shape), delay_s
        )
