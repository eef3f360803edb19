"""One finger as the host sees it: its part of the rig file, its devices and its kinematics."""

from dataclasses import dataclass

from palpate.config import FingerConfig
from palpate.drivers.finger import FingerKinematics, Line
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.rig.drives import Drive

__all__ = ["HostFinger"]


@dataclass(frozen=True, eq=False)
class HostFinger:
    """One finger as the host sees it: its part of the rig file, its devices and its kinematics.

    `home`: a way that starts where the finger stands when the stage turns.
    """

    spec: FingerConfig
    kinematics: FingerKinematics
    drive: Drive
    home: Line
    array: ArrayDriver
    extractor: ContactExtractor

    @property
    def name(self) -> str:
        """The rig file's name of the finger."""
        return self.spec.name
