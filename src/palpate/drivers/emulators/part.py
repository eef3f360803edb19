"""Emulated parts: their points of support on the table, and how far tips have pushed them.

The interface between the emulated bench and the engines that move parts. The bench reads `displacements`
before it computes what tips touch, and calls `step` once in each of its steps with a function that gives the
forces of tips on each part for any displacements. An engine decides what motion that makes; `mujoco_parts` is
another one.

`Support` has Coulomb friction at any number of points (Goyal, Ruina and Papadopoulos, Wear 143, 1991). A
`QuasiStaticPart` goes in each step where skin and friction together cost least: to the minimum of the skin's
energy plus what friction at all feet takes on the way there (Moreau's sweeping; Mason, Manipulator grasping
and pushing operations, 1982, for why inertia may be left out).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats


@dataclass(frozen=True, eq=False)
class Displacement:
    """Rigid displacement of a part from where it was put: x ↦ centre + R(turn) (x − centre) + shift, in W.

    `centre_mm` and `shift_mm` are (2,).
    """

    centre_mm: Floats
    shift_mm: Floats
    turn_rad: float

    @cached_property
    def is_none(self) -> bool:
        """True if the part is exactly where it was put."""
        return self.turn_rad == 0.0 and not self.shift_mm.any()

    def place(self, point_mm: Floats) -> Floats:
        """Place of a point (2,) of the part now."""
        if self.is_none:
            return point_mm
        result: Floats = self.centre_mm + self.rotate(point_mm - self.centre_mm) + self.shift_mm
        return result

    def back(self, point_mm: Floats) -> Floats:
        """Point (2,) of W in the frame that moves with the part; the same array if the part did not move."""
        if self.is_none:
            return point_mm
        x, y = point_mm - self.centre_mm - self.shift_mm
        c, s = self._cos_sin
        result: Floats = self.centre_mm + np.array([c * x + s * y, c * y - s * x])
        return result

    def rotate(self, vector: Floats) -> Floats:
        """Vector (2,) that turns with the part, in W."""
        if self.is_none:
            return vector
        (x, y), (c, s) = vector, self._cos_sin
        return np.array([c * x - s * y, s * x + c * y])

    @cached_property
    def _cos_sin(self) -> tuple[float, float]:
        return math.cos(self.turn_rad), math.sin(self.turn_rad)


IN_PLACE = Displacement(np.zeros(2), np.zeros(2), 0.0)
"""The displacement of a part that was not moved."""


@dataclass(frozen=True, eq=False)
class PointForce:
    """Force (2,) N on the part in W, parallel to the table, at a point (2,) mm of W and a height above it."""

    point_mm: Floats
    height_mm: float
    force_n: Floats


Displacements = tuple[Displacement, ...]
"""Displacement of each part on the table."""

TipForces = Callable[[Displacements], Sequence[Sequence[PointForce]]]
"""What tips, where they are now, would do to each part with the parts at some displacements."""


class Parts(Protocol):
    """Parts on the table, which one engine moves."""

    @property
    def displacements(self) -> Displacements:
        """Displacements since the start; the same value as long as all parts stand still."""
        ...

    @property
    def at_rest(self) -> bool:
        """True if all stay where they are as long as no tip pushes them."""
        ...

    def step(self, tip_forces: TipForces, touched: bool, dt_s: float, /) -> None:
        """Move on by `dt_s`; `touched`: some tip pushes now."""
        ...


class StillParts:
    """Parts that nothing moves: clamped, or far heavier than tips can push."""

    at_rest = True

    def __init__(self, count: int) -> None:
        self.displacements: Displacements = (IN_PLACE,) * count

    def step(self, _tip_forces: TipForces, _touched: bool, _dt_s: float) -> None:
        """Do nothing: they stay where they are."""


GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, eq=False)
class FrictionSupport:
    """`feet_mm` (n, 2) in W as the part is put, and `share` (n,) of its weight on each."""

    feet_mm: Floats
    share: Floats
    mass_kg: float
    friction: float

    @cached_property
    def centre_mm(self) -> Floats:
        """Centre of friction (2,): where a force makes the part slide without turning."""
        result: Floats = self.share @ self.feet_mm
        return result

    @property
    def slip_n(self) -> float:
        """Force through the centre of friction at which the part slides."""
        return self.friction * self.mass_kg * GRAVITY_M_S2

    @cached_property
    def median_distance_mm(self) -> float:
        """Mean distance ρ of the load from its geometric median: the moment slip_n · ρ turns the part."""
        at = self.centre_mm
        for _ in range(200):  # Weiszfeld
            weight = self.share / np.maximum(np.hypot(*(self.feet_mm - at).T), 1e-9)
            at = weight @ self.feet_mm / weight.sum()
        return float(self.share @ np.hypot(*(self.feet_mm - at).T))


_SMOOTHING_MM = (
    1e-5  # friction grows with motion up to here, so that the minimum can be found by Newton's steps
)
_STILL_MM = 10 * _SMOOTHING_MM  # smaller motions are that growth, and the part stands
_PROBE_MM = 1e-4
_MAX_NEWTON_STEPS = 40
_MAX_HALVINGS = 12
_MAX_RESIDUAL_SHARE = 0.2  # what a Newton step leaves of the forces if the stiffness is right
_FORCE_TOLERANCE_N = 1e-5
_MAX_STEP_MM = 0.05  # of a Newton step

_ForcesOnPart = Callable[[Displacement], Sequence[PointForce]]


class QuasiStaticPart:
    """A part on its support, alone on the table.

    Motions are (x, y, a): shift (mm) and turn times `_lever_mm` (mm).
    """

    at_rest = True

    def __init__(self, support: FrictionSupport) -> None:
        self._support = support
        self._centre = support.centre_mm
        feet = support.feet_mm - self._centre
        self._lever_mm = max(float(np.hypot(*feet.T).max()), 1.0)
        self._feet = feet
        self._stiffness: Floats | None = None
        self._last_motion = np.zeros(3)
        self.displacements: Displacements = (Displacement(self._centre, np.zeros(2), 0.0),)

    def step(self, tip_forces: TipForces, touched: bool, _dt_s: float) -> None:
        """Go where skin and friction cost least."""

        def forces_on_part(displacement: Displacement) -> Sequence[PointForce]:
            return tip_forces((displacement,))[0]

        motion = np.zeros(3)
        forces = forces_on_part(self._displacement) if touched else ()
        if forces and not self._holds(forces):
            motion = self._least_motion(forces_on_part, self._sum(forces, self._displacement))
            if np.hypot(*motion[:2]) + abs(motion[2]) > _STILL_MM:
                self.displacements = (self._displace(motion),)
        self._last_motion = motion

    @property
    def _displacement(self) -> Displacement:
        return self.displacements[0]

    def _holds(self, forces: Sequence[PointForce]) -> bool:
        """True if friction holds for certain, whatever the forces' directions."""
        reach = [
            np.hypot(*force.force_n) * (1 + self._lever(force) / self._support.median_distance_mm)
            for force in forces
        ]
        return bool(sum(reach) < self._support.slip_n)

    def _lever(self, force: PointForce) -> float:
        """Distance (mm) of a force's point from the centre of friction."""
        return float(np.hypot(*(force.point_mm - self._displacement.place(self._centre))))

    def _least_motion(self, tip_forces: _ForcesOnPart, pull: Floats) -> Floats:
        """The motion (3,) to the minimum, by Newton's steps; `pull` is the tips' wrench before it.

        Tips' forces take most of the time: the skin's stiffness is that of the last step as long as it leads
        on, and the first guess the last step's motion if less is left of the forces there.
        """
        ways = self._ways()
        motion, drag, drag_stiffness = np.zeros(3), *self._friction(np.zeros(3), ways)
        left = pull
        if self._last_motion.any():
            ahead = self._last_motion
            ahead_pull = self._wrench(tip_forces, ahead)
            drag, ahead_stiffness = self._friction(ahead, ways)
            if np.abs(ahead_pull - drag).max() < np.abs(left).max():
                motion, pull, left, drag_stiffness = ahead, ahead_pull, ahead_pull - drag, ahead_stiffness
        fresh = False
        for _ in range(_MAX_NEWTON_STEPS):
            before = float(np.abs(left).max())
            if before < _FORCE_TOLERANCE_N:
                break
            if self._stiffness is None:
                self._stiffness, fresh = self._skin_stiffness(tip_forces, motion, pull), True
            step = np.linalg.solve(self._stiffness + drag_stiffness, left).astype(np.float64)
            share = min(1.0, _MAX_STEP_MM / float(np.abs(step).max() or 1.0))
            for _ in range(_MAX_HALVINGS):
                there = motion + share * step
                pull = self._wrench(tip_forces, there)
                drag, there_stiffness = self._friction(there, ways)
                if np.abs(pull - drag).max() < before:
                    break
                share /= 2
            motion, left, drag_stiffness = there, pull - drag, there_stiffness
            if not fresh and np.abs(left).max() > _MAX_RESIDUAL_SHARE * before:
                self._stiffness = None
            fresh = False
        return motion

    def _wrench(self, tip_forces: _ForcesOnPart, motion: Floats) -> Floats:
        """Force and moment / lever (3,) N of all tips, with the part moved by `motion`."""
        moved = self._displace(motion)
        return self._sum(tip_forces(moved), moved)

    def _sum(self, forces: Sequence[PointForce], moved: Displacement) -> Floats:
        """Force and moment / lever (3,) N of forces on the part at a displacement."""
        total = np.zeros(3)
        middle = moved.place(self._centre)
        for force in forces:
            x, y = force.point_mm - middle
            total[:2] += force.force_n
            total[2] += (x * force.force_n[1] - y * force.force_n[0]) / self._lever_mm
        return total

    def _skin_stiffness(self, tip_forces: _ForcesOnPart, motion: Floats, pull: Floats) -> Floats:
        """Stiffness (3, 3), made positive, by which the tips' wrench falls from `pull` as the part
        moves on.
        """
        probes = np.eye(3) * _PROBE_MM
        matrix = np.array([(pull - self._wrench(tip_forces, motion + probe)) / _PROBE_MM for probe in probes])
        values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        result: Floats = (vectors * np.maximum(values, 1e-3)) @ vectors.T
        return result

    def _friction(self, motion: Floats, ways: Floats) -> tuple[Floats, Floats]:
        """Wrench of friction against a motion (3,), and its growth (3, 3)."""
        slide = ways @ motion
        length = np.sqrt((slide**2).sum(axis=1) + _SMOOTHING_MM**2)
        load = self._support.slip_n * self._support.share
        along = np.einsum("ni,nij->nj", slide / length[:, None], ways)
        flat, stiff = ways.reshape(-1, 3), load / length
        growth = (flat.T * np.repeat(stiff, 2)) @ flat - (along.T * stiff) @ along
        return load @ along, growth

    def _ways(self) -> Floats:
        """Motion of each foot (n, 2, 3) with that of the part, as it is turned now."""
        c, s = np.cos(self._displacement.turn_rad), np.sin(self._displacement.turn_rad)
        feet = self._feet @ np.array([[c, s], [-s, c]]) / self._lever_mm
        ways = np.zeros((len(feet), 2, 3))
        ways[:, 0, 0] = ways[:, 1, 1] = 1.0
        ways[:, 0, 2], ways[:, 1, 2] = -feet[:, 1], feet[:, 0]
        return ways

    def _displace(self, motion: Floats) -> Displacement:
        now = self._displacement
        return Displacement(
            self._centre, now.shift_mm + motion[:2], now.turn_rad + float(motion[2]) / self._lever_mm
        )


class QuasiStaticParts:
    """Parts that slide each by itself; `check_apart` raises once one is pushed into another."""

    def __init__(
        self, parts: Sequence[QuasiStaticPart], check_apart: Callable[[Displacements], None]
    ) -> None:
        self._parts, self._check_apart = tuple(parts), check_apart
        self.displacements: Displacements = tuple(part.displacements[0] for part in self._parts)

    @property
    def at_rest(self) -> bool:
        """True: without inertia they stay where they are."""
        return True

    def step(self, tip_forces: TipForces, touched: bool, dt_s: float) -> None:
        """Let tips push each part in turn."""
        for number, part in enumerate(self._parts):

            def forces_on_this(own: Displacements, number: int = number) -> Sequence[Sequence[PointForce]]:
                now = self.displacements
                return (tip_forces((*now[:number], *own, *now[number + 1 :]))[number],)

            part.step(forces_on_this, touched, dt_s)
        now = tuple(part.displacements[0] for part in self._parts)
        if any(new is not old for new, old in zip(now, self.displacements, strict=True)):
            self.displacements = now
            self._check_apart(now)
