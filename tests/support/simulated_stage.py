"""A turning stage without servo, port and time, for the simulated rig: it stops near its goal, with play."""

import math

import numpy as np

from palpate.config import RigFile
from palpate.drivers.emulators.mechanics import EmulatedStage, Play
from palpate.drivers.emulators.tip import PartSection
from palpate.drivers.kinematics import TICK_RAD

__all__ = ["SimulatedStage"]


class SimulatedStage:
    """A stage with the emulated one's truth: its servo stops near its goal, its ring follows with play."""

    def __init__(self, truth: EmulatedStage, rig: RigFile, rng: np.random.Generator) -> None:
        assert rig.stage is not None
        self.centre_mm, self._joint = truth.centre_mm, truth.truth
        self._zero_rad = math.radians(rig.stage.zero_deg) - math.pi
        self._rng, self._goal_rad, self._shaft_rad = rng, math.nan, self._zero_rad
        self._play = Play(self._joint.play_rad, self._driven())
        self.turn_to(0.0)

    def turn_to(self, angle_rad: float) -> None:
        """Nothing if it is there."""
        if angle_rad != self._goal_rad:
            goal = self._zero_rad + self._joint.gear_ratio * angle_rad
            self._shaft_rad = goal + self._rng.normal(0, 0.5 * TICK_RAD)
            self._play.follow(self._driven())
        self._goal_rad = angle_rad

    @property
    def read_rad(self) -> float:
        """Angle by the servo."""
        return (round(self._shaft_rad / TICK_RAD) * TICK_RAD - self._zero_rad) / self._joint.gear_ratio

    def seen(self, outline: PartSection | None) -> PartSection | None:
        """An outline of W as the ring sees it."""
        if outline is None:
            return None
        c, s = math.cos(self._play.at), math.sin(self._play.at)
        back, centre = np.array([[c, -s], [s, c]]), np.array(self.centre_mm)
        start, end = ((corners - centre) @ back + centre for corners in (outline.start, outline.end))
        return PartSection(start, end, outline.top_mm)

    def _driven(self) -> float:
        return (self._shaft_rad - self._joint.zero_rad) / self._joint.gear_ratio
