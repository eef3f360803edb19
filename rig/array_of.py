"""A finger's tactile array and its contact extractor, from the rig file. Between `config` and `drivers`."""

import numpy as np
from serial.serialutil import SerialBase

from palpate.config import AnyFinger, RigFile
from palpate.drivers.tactile.contact import ContactExtractor, TipCalibration
from palpate.drivers.tactile.devices import open_array
from palpate.drivers.tactile.frames import ArrayDriver, TactileFrame
from palpate.drivers.tactile.messages import Description
from palpate.drivers.tactile.stream import Port
from palpate.drivers.transport.clock import Clock
from palpate.rig.convert import mounting_of

__all__ = ["array_of", "extractor_of"]


def array_of(spec: AnyFinger, port: SerialBase | Port, clock: Clock) -> ArrayDriver:
    """The driver of a finger's array on its open port, not yet connected."""
    return open_array(spec.array.protocol, port, clock, spec.name, mounting_of(spec))


def extractor_of(rig: RigFile, spec: AnyFinger, description: Description) -> ContactExtractor:
    """The extractor for a finger's array; raises InputError if it does not fit the array."""
    calibration = TipCalibration(
        gain=np.ones((description.rows, description.cols)),
        gain_spread=spec.array.gain_spread,
        contact_force_n=rig.closing.contact_force_n / 2,
        stiffness_n_per_mm=spec.tip.stiffness_n_per_mm,
        stiffness_bound=spec.tip.stiffness_spread,
        drift_counts_per_s=spec.array.drift_counts_per_s,
    )
    extractor = ContactExtractor(description, calibration)
    _rehearse(extractor, description)
    return extractor


def _rehearse(extractor: ContactExtractor, description: Description) -> None:
    """Let the extractor see a contact that nobody made.

    At its first contact it computes what it compares contacts with: longer than Bus Watchdog waits.
    """
    counts = np.zeros((description.rows, description.cols), np.uint16)
    counts[:, description.cols // 2] = description.max_count // 2
    extractor.extract(TactileFrame(0, 0.0, 0.0, counts))
