"""Emulated WTS and DSA on a mock wire, with drivers on the other end; tests say what touches."""

import numpy as np

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.wire_faults import FaultyWire
from palpate.drivers.tactile.description import Mounting, Shape
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate_weiss.arrays import DsaArray, WtsArray
from palpate_weiss.emulated_arrays import EmulatedDsa, EmulatedWts
from palpate_weiss.messages import MatrixInfo

MATRIX = MatrixInfo(8, 4, 3.4, 3.8, 4095)
OTHER = MatrixInfo(6, 14, 3.4, 3.4, 4095.0)
BAUD = 115_200


def taxels(mounting: Mounting, **faults: object) -> Taxels:
    """Taxels of a tip with MATRIX mounted so: four rows of eight, or the other way round."""
    truth = mounting.describe(
        (MATRIX.cells_x, MATRIX.cells_y),
        (MATRIX.width_mm, MATRIX.height_mm),
        unique_id=b"truth",
        firmware="none",
        emulated=True,
        bit_depth=12,
        max_rate_hz=1000.0,
    )
    return Taxels(truth, seed=3, noise_counts=0.0, offset_counts=20.0, **faults)


class World:
    """What touches an emulated sensor: `force_n` on its taxels, whenever it looks."""

    def __init__(self, mounting: Mounting) -> None:
        d = taxels(mounting).description
        self.force_n = np.zeros((d.rows, d.cols))
        self.device: EmulatedWts | EmulatedDsa | None = None

    def advance(self, now: float) -> None:
        device = self.device
        while device is not None and (due := device.next_sample_s()) is not None and due <= now:
            device.sample(due, self.force_n)


class Bench:
    """A sensor, its wire with faults that a test sets, and its driver."""

    def __init__(
        self, protocol: str, mounting: Mounting | None = None, matrix: int = 0, **device: object
    ) -> None:
        self.clock = VirtualClock()
        self.matrix = matrix
        self.mounting = mounting or Mounting(Shape.CYLINDER, 8.5, 1000.0)
        self.world = World(self.mounting)
        kind = {"weiss-wts": self._wts, "weiss-dsa": self._dsa}[protocol]
        self.device: EmulatedWts | EmulatedDsa = kind(device)
        self.world.device = self.device
        self.wire = FaultyWire(self.device, 5)
        self.hub = MockHub(self.clock, "weiss")
        self.url = self.hub.attach("f1", self.wire, BAUD)
        self.port = open_port(self.url, BAUD)
        driver = WtsArray if protocol == "weiss-wts" else DsaArray
        self.array = driver(self.port, self.clock, "f1", self.mounting, matrix)

    def _wts(self, options: dict) -> EmulatedWts:
        to_device = self.mounting.to_device
        return EmulatedWts(taxels(self.mounting), MATRIX, self.world.advance, to_device=to_device, **options)

    def _dsa(self, options: dict) -> EmulatedDsa:
        number, to_device = self.matrix, self.mounting.to_device
        matrices = [OTHER] * number + [MATRIX, OTHER]
        return EmulatedDsa(
            taxels(self.mounting),
            matrices,
            self.world.advance,
            touched=number,
            to_device=to_device,
            **options,
        )
