"""The array of a tip that feels what the test says."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.messages import Frame, Message, Start
from palpate.drivers.tactile.patches import ContactPatch, TipCalibration
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.rig.array_monitor import MonitoredFinger

# ----------------------------------------------------------------------------------------------------
# A finger tip's array for tests of the contact extractor: as emulated, and as the extractor sees it.

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


# ----------------------------------------------------------------------------------------------------
# An emulated array on a mock wire that feels what the test says, watched by the host.

BAUDRATE = 4_000_000


class WatchedTip:
    """`taxels_n` presses from now on; after `silent_from_s` the array samples nothing any more."""

    def __init__(self, rate_hz: float = 200.0, **faults: list[tuple[int, int]]) -> None:
        self.taxels_n: Floats = np.zeros((ROWS, COLS))
        self.silent_from_s = np.inf
        self.clock = VirtualClock()
        errors = {"gain_spread": 0.1, "offset_counts": 20.0, "crosstalk": 0.075}
        taxels = Taxels(DESCRIPTION, seed=5, **errors, **faults)
        self.emulated = EmulatedArray(taxels, self._advance)
        self.hub = MockHub(self.clock, "watched")
        url = self.hub.attach("tip", self.emulated, BAUDRATE)
        array = TactileArray(open_port(url, BAUDRATE), self.clock, "tip")
        array.connect()
        extractor = ContactExtractor(DESCRIPTION, TipCalibration(gain=np.ones((ROWS, COLS))))
        self.finger = MonitoredFinger("tip", url, array, extractor, self.clock)
        array.start(rate_hz)

    def pass_time(self, seconds: float) -> None:
        """Let time pass, with the polls that belong to it."""
        end = self.clock.now() + seconds
        while self.clock.now() < end:
            self.clock.sleep(0.01)
            self.finger.poll()

    def press(self, column: int, newtons: float) -> None:
        """Press on a column and its neighbours, over all rows."""
        self.taxels_n = np.zeros((ROWS, COLS))
        for k, share in ((-1, 0.25), (0, 0.5), (1, 0.25)):
            self.taxels_n[:, column + k] = share * newtons / ROWS

    def _advance(self, now: float) -> None:
        while (due := self.emulated.next_sample_s()) is not None and due <= min(now, self.silent_from_s):
            self.emulated.sample(due, self.taxels_n)


# ----------------------------------------------------------------------------------------------------
# A patch that an array may have felt straight ahead, for tests that look at some of its fields only.

_AHEAD = ContactPatch(
    angle_rad=0.0,
    angle_half_range_rad=0.1,
    centroid_rad=0.0,
    centroid_bound_rad=0.1,
    position_mm=(5.0, 0.0, 8.0),
    position_bound_mm=(0.1, 0.1, 0.1),
    height_mm=8.0,
    height_bound_mm=0.1,
    force_n=0.4,
    force_bound_n=0.04,
    extent_rad=0.3,
    area_mm2=6.0,
    flags=frozenset(),
)


def felt_patch(**changes: Any) -> ContactPatch:
    """That patch with some of its fields (see `ContactPatch`) changed."""
    return replace(_AHEAD, **changes)
