"""Mechanisms of fingers: `MECHANISMS` is the only place that lists their kinds.

A further kind is a module with its table and its `Mechanism`, and one line that registers them. Jobs that
need more of it (calibration, emulation) refuse it in one line until that is there.
"""

from collections.abc import Callable
from typing import Any

from palpate.config import ArmFingerConfig, FingerConfig, RigFile, SlideFingerConfig, add_finger_type
from palpate.drivers.kinematics import FingerKinematics
from palpate.rig.mechanisms.arm import ArmMechanism
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.mechanisms.slide import SlideMechanism

MECHANISMS: dict[type, Callable[[Any], Mechanism]] = {
    SlideFingerConfig: SlideMechanism,
    ArmFingerConfig: ArmMechanism,
}
"""Mechanism of each kind of finger, by the model of its table in the rig file."""


def register(name: str, table: type[FingerConfig], mechanism: Callable[[Any], Mechanism]) -> None:
    """Let rigs have fingers of one more type; `name`: what `type` says in a rig file."""
    add_finger_type(name, table)
    MECHANISMS[table] = mechanism


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
