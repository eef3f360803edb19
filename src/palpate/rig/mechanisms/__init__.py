"""Mechanisms of fingers: `MECHANISMS` is the one place that knows which kinds there are.

A further kind is a module with its `Mechanism`, and one line here.
"""

from collections.abc import Callable
from typing import Any

from palpate.config import ArmFingerConfig, FingerConfig, RigFile, SlideFingerConfig
from palpate.drivers.kinematics import FingerKinematics
from palpate.rig.mechanisms.arm import ArmMechanism
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.mechanisms.slide import SlideMechanism

MECHANISMS: dict[type, Callable[[Any], Mechanism]] = {
    SlideFingerConfig: SlideMechanism,
    ArmFingerConfig: ArmMechanism,
}
"""Mechanism of each kind of finger, by the model of its table in the rig file."""


def mechanism_of(finger: FingerConfig) -> Mechanism:
    """Mechanism of a finger of any kind."""
    return MECHANISMS[type(finger)](finger)


def lowest_links(rig: RigFile) -> tuple[float, str]:
    """Height (mm) of the lowest links above the table, and whose they are; infinite without links."""
    lowest = min(map(mechanism_of, rig.fingers), key=lambda item: item.lowest_link_mm)
    return lowest.lowest_link_mm, lowest.spec.name


def kinematics_of(finger: FingerConfig) -> FingerKinematics:
    """Kinematics of a finger of any kind."""
    return mechanism_of(finger).kinematics
