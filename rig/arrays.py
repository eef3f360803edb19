"""A finger's tactile array and its contact extractor, from the rig file. Between `config` and `drivers`."""

from dataclasses import replace

import numpy as np
from serial.serialutil import SerialBase

from palpate.config import FingerConfig, RigFile
from palpate.drivers.tactile.contact import ContactExtractor, TipCalibration
from palpate.drivers.tactile.devices import open_array
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.drivers.tactile.messages import Description
from palpate.drivers.tactile.stream import Port
from palpate.drivers.transport.clock import Clock
from palpate.errors import InputError
from palpate.rig.conversion import mounting_of

__all__ = ["array_of", "calibration_of", "extractor_of"]


def array_of(spec: FingerConfig, port: SerialBase | Port, clock: Clock) -> ArrayDriver:
    """The driver of a finger's array on its open port, not yet connected."""
    return open_array(spec.array.protocol, port, clock, spec.name, mounting_of(spec))


def extractor_of(rig: RigFile, spec: FingerConfig, description: Description) -> ContactExtractor:
    """The extractor for a finger's array; raises InputError if it does not fit the array."""
    extractor = ContactExtractor(description, calibration_of(rig, spec, description))
    extractor.prepare()  # at the first contact it would take longer than Bus Watchdog waits
    return extractor


def calibration_of(rig: RigFile, spec: FingerConfig, description: Description) -> TipCalibration:
    """What the rig file says of a finger's array: of every taxel where it was calibrated, else of all alike.

    Raises InputError if the calibrated taxels are not as many as the array's.
    """
    shape = (description.rows, description.cols)
    alike = TipCalibration(
        gain=np.ones(shape),
        gain_spread=spec.array.gain_spread,
        contact_force_n=rig.closing.contact_force_n / 2,
        stiffness_n_per_mm=spec.tip.stiffness_n_per_mm,
        stiffness_bound=spec.tip.stiffness_spread,
        drift_counts_per_s=spec.array.drift_counts_per_s,
    )
    taxels = spec.array.taxels
    if taxels is None:
        return alike
    gain = np.array(taxels.gain)
    if gain.shape != shape:
        raise InputError(
            f"finger {spec.name}: array.taxels are {gain.shape[0]} x {gain.shape[1]} and the array has "
            f"{shape[0]} x {shape[1]}; calibrate this finger again, or leave array.taxels out"
        )
    usable = np.ones(shape, dtype=bool)
    for row, col in taxels.unusable:
        usable[row, col] = False
    return replace(
        alike,
        gain=gain,
        gain_spread=np.array(taxels.gain_bound),
        noise_counts=taxels.noise_counts,
        crosstalk=taxels.crosstalk,
        crosstalk_bound=taxels.crosstalk_bound,
        usable=usable,
    )
