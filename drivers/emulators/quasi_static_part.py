"""Quasi-static part: slides under tips as dry friction at its support allows, without inertia.

In each step it goes where skin and friction together cost least: to the minimum of the skin's energy plus
what friction at all feet takes on the way there (Moreau's sweeping; Mason, Manipulator grasping and pushing
operations, 1982, for why inertia may be left out). That is exact for any support and any number of tips. At
rest no motion lowers that sum, and the part stands still.
"""

from collections.abc import Sequence

import numpy as np

from palpate.drivers.emulators.part import Displacement, PointForce, TipForces
from palpate.drivers.emulators.support import Support
from palpate.geometry import Floats

__all__ = ["QuasiStaticPart"]

_SMOOTH_MM = 2e-5  # friction grows with motion up to here, so that the minimum can be found by Newton's steps
_STILL_MM = 5 * _SMOOTH_MM  # smaller motions are that growth, and the part stands
_PROBE_MM = 1e-4
_STEPS = 40
_DONE_N = 1e-6
_LONGEST_MM = 0.05  # of a Newton step


class QuasiStaticPart:
    """A part on its support. Motions are (x, y, a): shift (mm) and turn times `_lever_mm` (mm)."""

    def __init__(self, support: Support) -> None:
        self._support = support
        self._centre = support.centre_mm
        feet = support.feet_mm - self._centre
        self._lever_mm = max(float(np.hypot(*feet.T).max()), 1.0)
        self._feet = feet
        self.displacement = Displacement(self._centre, np.zeros(2), 0.0)

    def step(self, tip_forces: TipForces, touched: bool, _dt_s: float) -> None:
        """Go where skin and friction cost least."""
        if not touched or self._holds(tip_forces(self.displacement)):
            return
        motion = self._least_motion(tip_forces)
        if np.hypot(*motion[:2]) + abs(motion[2]) > _STILL_MM:
            self.displacement = self._moved(motion)

    def _holds(self, forces: Sequence[PointForce]) -> bool:
        """Whether friction holds for certain, whatever the forces' directions."""
        reach = [
            np.hypot(*force.force_n) * (1 + self._lever(force) / self._support.median_distance_mm)
            for force in forces
        ]
        return bool(sum(reach) < self._support.slip_n)

    def _lever(self, force: PointForce) -> float:
        """Distance (mm) of a force's point from the centre of friction."""
        return float(np.hypot(*(force.point_mm - self.displacement.place(self._centre))))

    def _least_motion(self, tip_forces: TipForces) -> Floats:
        """The motion (3,) to the minimum, by Newton's steps with the skin's stiffness from differences."""
        motion = np.zeros(3)
        stiffness = self._stiffness(tip_forces, motion)
        for k in range(_STEPS):
            pull = self._wrench(tip_forces, motion)
            drag, drag_stiffness = self._friction(motion)
            rest = pull - drag
            if np.abs(rest).max() < _DONE_N:
                break
            if k % 8 == 7:
                stiffness = self._stiffness(tip_forces, motion)
            step = np.linalg.solve(stiffness + drag_stiffness, rest).astype(np.float64)
            motion = motion + step * self._damped(tip_forces, motion, step, rest)
        return motion

    def _damped(self, tip_forces: TipForces, motion: Floats, step: Floats, rest: Floats) -> float:
        """How much of a step to take, so that what is left of the forces shrinks."""
        share = min(1.0, _LONGEST_MM / float(np.abs(step).max() or 1.0))
        before = float(rest @ rest)
        for _ in range(12):
            there = motion + share * step
            left = self._wrench(tip_forces, there) - self._friction(there)[0]
            if float(left @ left) < before:
                return share
            share /= 2
        return share

    def _wrench(self, tip_forces: TipForces, motion: Floats) -> Floats:
        """Force and moment / lever (3,) N of all tips, with the part moved by `motion`."""
        moved = self._moved(motion)
        total = np.zeros(3)
        middle = moved.place(self._centre)
        for force in tip_forces(moved):
            x, y = force.point_mm - middle
            total[:2] += force.force_n
            total[2] += (x * force.force_n[1] - y * force.force_n[0]) / self._lever_mm
        return total

    def _stiffness(self, tip_forces: TipForces, motion: Floats) -> Floats:
        """How the tips' wrench falls as the part moves on, (3, 3), made positive."""
        columns = []
        for k in range(3):
            probe = np.zeros(3)
            probe[k] = _PROBE_MM
            ahead = self._wrench(tip_forces, motion + probe)
            columns.append((self._wrench(tip_forces, motion - probe) - ahead) / (2 * _PROBE_MM))
        matrix = np.array(columns)
        values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        result: Floats = (vectors * np.maximum(values, 1e-3)) @ vectors.T
        return result

    def _friction(self, motion: Floats) -> tuple[Floats, Floats]:
        """What friction resists a motion with (3,), and its growth (3, 3)."""
        feet = self._turned_feet
        slide = motion[:2] + np.column_stack([-feet[:, 1], feet[:, 0]]) * (motion[2] / self._lever_mm)
        length = np.sqrt((slide**2).sum(axis=1) + _SMOOTH_MM**2)
        load = self._support.slip_n * self._support.share
        ways = np.zeros((len(feet), 2, 3))  # how each foot moves with the motion
        ways[:, 0, 0] = ways[:, 1, 1] = 1.0
        ways[:, 0, 2], ways[:, 1, 2] = -feet[:, 1] / self._lever_mm, feet[:, 0] / self._lever_mm
        unit = slide / length[:, None]
        force = np.einsum("n,nij,ni->j", load, ways, unit)
        growth = (np.eye(2) - unit[:, :, None] * unit[:, None, :]) * (load / length)[:, None, None]
        return force, np.einsum("nik,nij,njl->kl", ways, growth, ways)

    @property
    def _turned_feet(self) -> Floats:
        """Feet (n, 2) from the centre of friction, as the part is turned now."""
        c, s = np.cos(self.displacement.turn_rad), np.sin(self.displacement.turn_rad)
        result: Floats = self._feet @ np.array([[c, s], [-s, c]])
        return result

    def _moved(self, motion: Floats) -> Displacement:
        now = self.displacement
        return Displacement(
            self._centre, now.shift_mm + motion[:2], now.turn_rad + float(motion[2]) / self._lever_mm
        )
