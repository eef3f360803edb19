"""Tactile arrays: protocols, host drivers and contact extractor. Bytes in, contact patches out."""

from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.contact import (
    Baseline,
    ContactExtractor,
    ContactPatch,
    Patches,
    PatchFlag,
    TipCalibration,
)
from palpate.drivers.tactile.devices import PROTOCOLS, open_array
from palpate.drivers.tactile.frames import ArrayCounters, ArrayDriver, TactileFrame
from palpate.drivers.tactile.messages import Description, Report, Shape
from palpate.drivers.tactile.mounting import Mounting
from palpate.drivers.tactile.weiss import DsaArray, WtsArray

__all__ = [
    "PROTOCOLS",
    "ArrayCounters",
    "ArrayDriver",
    "Baseline",
    "ContactExtractor",
    "ContactPatch",
    "Description",
    "DsaArray",
    "Mounting",
    "PatchFlag",
    "Patches",
    "Report",
    "Shape",
    "TactileArray",
    "TactileFrame",
    "TipCalibration",
    "WtsArray",
    "open_array",
]
