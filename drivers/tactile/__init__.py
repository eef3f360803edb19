"""Tactile arrays: protocol, host driver and contact extractor. Bytes in, contact patches out."""

from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.contact import ContactExtractor, ContactPatch, PatchFlag, TipCalibration
from palpate.drivers.tactile.frames import ArrayCounters, ArrayDriver, TactileFrame
from palpate.drivers.tactile.messages import Description, Shape

__all__ = [
    "ArrayCounters",
    "ArrayDriver",
    "ContactExtractor",
    "ContactPatch",
    "Description",
    "PatchFlag",
    "Shape",
    "TactileArray",
    "TactileFrame",
    "TipCalibration",
]
