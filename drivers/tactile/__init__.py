"""Tactile arrays: protocol, host driver and contact extractor. Bytes in, contact patches out."""

from palpate.drivers.tactile.array import ArrayCounters, TactileArray, TactileFrame
from palpate.drivers.tactile.contact import ContactExtractor, ContactPatch, PatchFlag, TipCalibration
from palpate.drivers.tactile.messages import Description, Shape

__all__ = [
    "ArrayCounters",
    "ContactExtractor",
    "ContactPatch",
    "Description",
    "PatchFlag",
    "Shape",
    "TactileArray",
    "TactileFrame",
    "TipCalibration",
]
