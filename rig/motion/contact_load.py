"""Load on the part by a touch: peak force, travel in contact and work, from what a guarded move reads."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.geometry import Floats

__all__ = ["ContactLoad", "LoadMeter", "TouchStage"]


class TouchStage(StrEnum):
    """Stage of a touch: the quick one finds the part, the slow one measures it."""

    QUICK = "quick"
    SLOW = "slow"


@dataclass(frozen=True)
class ContactLoad:
    """Load on the part by one stage of a touch, from the first contact until the finger has left it.

    `peak_force_n`: the largest force in a frame of the array. `travel_mm`: how far the tip went on in
    contact, forwards only, since the last frame without any force. `work_mj`: force times travel, likewise.
    `begun_s`, `ended_s`: from that frame to the first one without force again, on the rig's clock; loads of
    two fingers at different times do not add up. Infinite where that is not known.

    Measured, without bounds. Forces are off by the array's gain, and below its noise nothing is measured; so
    a load below half of contact_force_n is not listed. Between two frames the force may have been larger by
    stiffness × speed × sample period. Servos are read less often: where the tip was meanwhile is
    interpolated, also while it brakes, and how far it went on and came back between two reads is missing.
    """

    stage: TouchStage
    peak_force_n: float
    travel_mm: float
    work_mj: float
    begun_s: float = -math.inf
    ended_s: float = math.inf


class LoadMeter:
    """Collects forces and travels of one finger, each at its instant, and sums them up to loads."""

    def __init__(self, contact_force_n: float, period_s: float) -> None:
        """`contact_force_n`: half of it counts as contact; `period_s`: time between two frames."""
        self._least_n, self._period_s = contact_force_n / 2, period_s
        self._forces: list[tuple[float, float]] = []
        self._travels: list[tuple[float, float]] = []
        self._begun: list[tuple[float, TouchStage]] = []

    def begin(self, stage: TouchStage, now: float) -> None:
        """Begin a stage; one that is begun again is a touch of its own."""
        self._begun.append((now, stage))

    def feel(self, force_n: float, now: float) -> None:
        """Note the force of a frame that has arrived."""
        # It may have been sampled one period ago: then the tip was not yet where it is now.
        self._forces.append((now - self._period_s, force_n))

    def see(self, travel_mm: float, now: float) -> None:
        """Note how far along its line the tip is."""
        self._travels.append((now, travel_mm))

    def loads(self) -> tuple[ContactLoad, ...]:
        """A load for each stage in which something was felt, in order of time."""
        if not self._forces or not self._travels:
            return ()
        times, forces = np.array(self._forces).T
        travels = np.interp(times, *np.array(self._travels).T)
        ends = [*(begun for begun, _ in self._begun[1:]), math.inf]
        found = []
        for (begun, stage), end in zip(self._begun, ends, strict=True):
            during = (times >= begun) & (times < end)
            if (forces[during] > self._least_n).any():
                found.append(self._load(stage, times[during], forces[during], travels[during]))
        return tuple(found)

    def _load(self, stage: TouchStage, times: Floats, forces: Floats, travels: Floats) -> ContactLoad:
        felt = np.flatnonzero(forces > self._least_n)
        free = np.flatnonzero(forces <= 0)
        first = max(free[free < felt[0]], default=0)
        last = min(free[free > felt[-1]], default=len(forces) - 1)
        force, travel = forces[first : last + 1], travels[first : last + 1]
        steps = np.maximum(np.diff(travel), 0.0)
        work = float(((force[1:] + force[:-1]) / 2 * steps).sum())
        begun_s, ended_s = float(times[first]), float(times[last])
        if forces[last] > 0:
            ended_s = math.inf  # it has not left the part yet
        return ContactLoad(stage, float(force.max()), float(steps.sum()), work, begun_s, ended_s)
