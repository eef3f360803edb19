"""Gauge freedom: which of all frames a calibration refers to, since touches determine none.

Touches of references at unknown places say where fingers stand to one another, not where the rig stands on
its table. So W is defined by the rig file: it is the frame in which bases and headings are, all in all,
nearest to what the file says.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import FingerConfig

__all__ = ["HEADING_ARM_MM", "BasePose", "RigidMotion", "align_to_nominal", "fitted_poses", "nominal_poses"]

HEADING_ARM_MM = 100.0
"""A heading counts like a point so far from its base; with several fingers it hardly matters."""


@dataclass(frozen=True)
class BasePose:
    """Where a finger stands: its base (mm) and its heading (rad)."""

    base_mm: tuple[float, float]
    heading_rad: float


@dataclass(frozen=True)
class RigidMotion:
    """A turn about the origin, then a shift: point ↦ R(angle) · point + shift."""

    angle_rad: float
    shift_mm: tuple[float, float]

    def point_mm(self, point: tuple[float, float]) -> tuple[float, float]:
        """A point in the other frame."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        x, y = point
        return (c * x - s * y + self.shift_mm[0], s * x + c * y + self.shift_mm[1])

    def place(self, place: BasePose) -> BasePose:
        """A finger's place in the other frame."""
        return BasePose(self.point_mm(place.base_mm), place.heading_rad + self.angle_rad)


def align_to_nominal(nominal: Sequence[BasePose], found: Sequence[BasePose]) -> RigidMotion:
    """The motion that brings `found` places nearest to `nominal` ones: from any frame to the hand frame.

    Least squares over bases and, as points `HEADING_ARM_MM` away, headings (Horn's closed form in the plane;
    Umeyama 1991). One finger is enough, because it has a heading. ValueError for none.
    """
    if not nominal or len(nominal) != len(found):
        raise ValueError("a hand frame needs as many places found as described, and at least one")
    wanted = np.array([complex(*place.base_mm) for place in nominal])
    given = np.array([complex(*place.base_mm) for place in found])
    turns = np.array([n.heading_rad - f.heading_rad for n, f in zip(nominal, found, strict=True)])
    centred = (given - given.mean()).conj() * (wanted - wanted.mean())
    angle = float(np.angle(centred.sum() + HEADING_ARM_MM**2 * np.exp(1j * turns).sum()))
    shift = wanted.mean() - np.exp(1j * angle) * given.mean()
    return RigidMotion(angle, (float(shift.real), float(shift.imag)))


def nominal_poses(specs: Sequence[FingerConfig]) -> list[BasePose]:
    """Where the rig file says that fingers stand."""
    return [BasePose(spec.base_mm, math.radians(spec.heading_deg)) for spec in specs]


def fitted_poses(values: Floats) -> list[BasePose]:
    """Where fingers stand by values (fingers, k) of a fit."""
    return [BasePose((x, y), heading) for x, y, heading in values[:, :3].tolist()]
