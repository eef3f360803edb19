"""Noise of an emulated array: what forces it does not notice, as the rig's own extractor says when tared."""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import FingerConfig, RigFile
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.frames import TactileFrame
from palpate.rig.arrays import calibration_of
from palpate.rig.emulated.devices import description_of

__all__ = ["ArrayNoise", "noise_of"]

_TARE_FRAMES = 64
_MOST_FRAMES = 64
_COLUMNS = 3  # on which a light contact is read


@dataclass(frozen=True, eq=False)
class ArrayNoise:
    """What an array does not notice: forces up to `least_n` in one frame, and less in the mean of more.

    `sigma_n`: standard deviation of what a frame reads. `shares` (n,): how much of it is left in the mean of
    1, 2, … frames.
    """

    least_n: float
    sigma_n: float
    shares: Floats

    def share(self, frames: int) -> float:
        """In the mean of so many frames."""
        return float(self.shares[frames - 1])


def noise_of(rig: RigFile, finger: FingerConfig) -> ArrayNoise:
    """Of a finger's array.

    A rig file that says nothing of emulated arrays has one that notices no less than the rig's threshold.
    """
    frames = np.arange(1, _MOST_FRAMES + 1)
    if rig.emulation is None:
        return ArrayNoise(rig.closing.contact_force_n, 0.0, 1 / np.sqrt(frames))
    description = description_of(finger, 0)
    taxels = Taxels(
        description,
        seed=0,
        noise_counts=rig.emulation.noise_counts,
        offset_counts=rig.emulation.offset_counts,
    )
    extractor = ContactExtractor(description, calibration_of(rig, finger, description))
    none = np.zeros((description.rows, description.cols))
    extractor.tare([TactileFrame(k, 0.0, 0.0, taxels.counts(none)) for k in range(_TARE_FRAMES)])
    least = min(extractor.least_force_n, rig.closing.contact_force_n)
    counts = rig.emulation.noise_counts * math.sqrt(_COLUMNS * description.rows)
    return ArrayNoise(
        least,
        counts / description.counts_per_n,
        np.array([extractor.noise_share(count) for count in frames.tolist()]),
    )
