"""States on surfaces that are curved both ways: a dome on its round side, an egg.

Facets tell how far a surface is, and only nearly where it is lowest: the solid comes to rest on one facet or
another near the true place, leaning by some degrees. About its axis a solid of revolution leans nowhere: the
axis itself is upright then, if facets show that the lowest place is near it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.cad.hull import centre_of_mass
from palpate.cad.stable import LeftOut, rotations_onto
from palpate.cad.values import Solid, StableState
from palpate.geometry import Floats

__all__ = ["settled"]

_NEAR_RAD = math.radians(20.0)
"""How far from the axis facets that stand for an upright state may be."""
_TILTS = 400


def settled(solid: Solid, states: Sequence[StableState]) -> tuple[list[StableState], list[LeftOut]]:
    """The states without those that lean, which become one for either end of the axis or are left out."""
    kept = [state for state in states if not state.leans]
    leaning = [state for state in states if state.leans]
    for end in () if solid.axis is None else (solid.axis, -solid.axis):
        near = [state for state in leaning if -state.rotation[2] @ end > math.cos(_NEAR_RAD)]
        upright = _upright(solid, end, near)
        if upright is not None:
            kept.append(upright)
            leaning = [state for state in leaning if not any(state is item for item in near)]
    if not leaning:
        return kept, []
    reason = "lies on a surface that is curved both ways, of which facets do not tell how far it leans"
    share = sum(state.probability for state in leaning)
    return kept, [LeftOut(f"{reason}: {100 * share:.2g} %", share, -leaning[0].rotation[2])]


def _upright(solid: Solid, down: Floats, near: Sequence[StableState]) -> StableState | None:
    """The state with an end of the axis down; None if the surface may be lower beside it."""
    if not near:
        return None
    centre = centre_of_mass(solid)
    aside = rotations_onto(down[None])[0][0]
    tilt = np.linspace(0.0, _NEAR_RAD, _TILTS)[:, None]
    height = ((solid.vertices_mm - centre) @ (np.cos(tilt) * down + np.sin(tilt) * aside).T).max(axis=0)
    # The true surface is as far as this from the facets: twice as much higher is higher for certain.
    if height[-1] <= height[0] + 2 * solid.off_mm:
        return None
    rotation = rotations_onto(down[None])[0]
    offset = -rotation @ centre
    offset[2] += height[0]
    return replace(
        near[0],
        rotation=rotation,
        offset_mm=offset,
        probability=sum(state.probability for state in near),
        tipping_angle_rad=min(state.tipping_angle_rad for state in near),
        support_mm=np.zeros((1, 2)),
        leans=False,
    )
