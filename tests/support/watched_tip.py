"""An emulated array on a mock wire that feels what the test says, watched by the host."""

import numpy as np
from tactile_tip import COLS, DESCRIPTION, ROWS

from palpate.base.geometry import Floats
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.patches import TipCalibration
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.rig.array_monitor import MonitoredFinger

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
