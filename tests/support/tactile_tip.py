"""A finger tip's array for tests of the contact extractor: as emulated, and as the extractor sees it."""

import math

import numpy as np

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.messages import Frame, Message, Start
from palpate.drivers.tactile.patches import ContactPatch, TipCalibration

ROWS, COLS, RADIUS = 8, 20, 5.0
PITCH = math.radians(13.5)
DESCRIPTION = Description(
    unique_id=b"test array no. 2",
    firmware="emulated 0.1",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=ROWS,
    cols=COLS,
    bit_depth=12,
    max_rate_hz=500.0,
    full_scale_n=1.0,
    counts_per_n=4095.0,
    tip_radius_mm=RADIUS,
    columns=tuple(float(np.float32((j - 9.5) * PITCH)) for j in range(COLS)),
    row_heights_mm=tuple(1.0 + 2.0 * i for i in range(ROWS)),
)


class TactileTip:
    """An emulated array and a tared extractor that only gets its decoded frames."""

    def __init__(
        self,
        seed: int,
        *,
        description: Description = DESCRIPTION,
        gain_spread: float = 0.2,
        noise: float = 2.0,
        crosstalk: float = 0.075,
        **faults: list[tuple[int, int]],
    ) -> None:
        taxels = Taxels(
            description,
            seed=seed,
            noise_counts=noise,
            gain_spread=gain_spread,
            offset_counts=20,
            crosstalk=crosstalk,
            **faults,
        )
        self.array = EmulatedArray(taxels)
        self.decoder = Decoder()
        self.now = 0.0
        start = encode(Message(0, 0, Start(1, 200_000)))
        self.decoder.feed(b"".join(data for _, data in self.array.feed(start, 0.0)))
        calibration = TipCalibration(gain=np.ones((ROWS, COLS)), gain_spread=gain_spread, noise_counts=noise)
        self.extractor = ContactExtractor(description, calibration)
        self.extractor.tare(self.frames(np.zeros((ROWS, COLS)), 16))

    def frames(self, taxels_n: np.ndarray, count: int) -> list[TactileFrame]:
        """The next `count` frames with these forces (ROWS, COLS) on the taxels."""
        taken = []
        for _ in range(count):
            self.now += 0.005
            self.array.sample(self.now, taxels_n)
            (item,) = self.decoder.feed(b"".join(data for _, data in self.array.poll(self.now)))
            assert isinstance(item, Message)
            assert isinstance(item.body, Frame)
            taken.append(TactileFrame(item.sequence, item.time_us * 1e-6, self.now, item.body.counts))
        return taken

    def touch(self, taxels_n: np.ndarray, count: int = 1) -> ContactPatch | None:
        """What the extractor makes of them."""
        return self.extractor.extract(self.frames(taxels_n, count))
