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
from palpate.drivers.tactile.frames import ArrayCounters, ArrayDriver, TactileFrame
from palpate.drivers.tactile.messages import Description, SelfTestReport, Shape
from palpate.drivers.tactile.mounting import Mounting

__all__ = [
    "ArrayCounters",
    "ArrayDriver",
    "Baseline",
    "ContactExtractor",
    "ContactPatch",
    "Description",
    "Mounting",
    "PatchFlag",
    "Patches",
    "SelfTestReport",
    "Shape",
    "TactileArray",
    "TactileFrame",
    "TipCalibration",
]
