"""Orbits of stable states: those that the solid's own rotational symmetry makes of one.

They are congruent for certain, so that one of them is compared with those of other orbits.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.cad.rotational_symmetry import axis_frame
from palpate.cad.values import Solid, StableState

__all__ = ["NEGLIGIBLE", "Orbit", "orbits_of"]

_UPRIGHT = 1e-5
"""Directions down that are so near after a turn, rad, are the same but for rounding."""
NEGLIGIBLE = 0.1
"""Of the distance within which states are one: a symmetry that is so exact may make orbits."""


@dataclass(eq=False)
class Orbit:
    """States that turns make of the `first`, which is among them; none is further than `apart_mm` from it."""

    first: StableState
    members: list[StableState] = field(default_factory=list)
    apart_mm: float = 0.0


def orbits_of(solid: Solid, states: Sequence[StableState], within_mm: float) -> list[Orbit]:
    """States by orbits, in their order; each by itself where no symmetry is known, or is exact enough."""
    symmetry = solid.symmetry
    if symmetry is None:
        return [Orbit(state, [state]) for state in states]
    size = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    if symmetry.apart_mm + _UPRIGHT * size > NEGLIGIBLE * within_mm:
        return [Orbit(state, [state]) for state in states]
    frame, turn = axis_frame(symmetry.axis), 2 * math.pi / symmetry.order
    found: list[Orbit] = []
    polar, azimuth = np.zeros(0), np.zeros(0)
    for state in states:
        x, y, z = -frame @ state.rotation[2]
        its_polar, its_azimuth = math.atan2(math.hypot(x, y), z), math.atan2(y, x)
        beyond = np.abs((azimuth - its_azimuth + turn / 2) % turn - turn / 2)
        tilt = np.hypot(polar - its_polar, math.sin(its_polar) * beyond)
        same = np.flatnonzero(tilt <= _UPRIGHT)
        if len(same):
            orbit = found[int(same[0])]
            orbit.members.append(state)
            off = symmetry.apart_mm + float(tilt[same[0]]) * size
            orbit.apart_mm = max(orbit.apart_mm, off)
        else:
            found.append(Orbit(state, [state]))
            polar, azimuth = np.append(polar, its_polar), np.append(azimuth, its_azimuth)
    return found
