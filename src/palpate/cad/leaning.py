"""States on surfaces that are curved both ways: a dome on its round side, an egg.

Facets tell how far a surface is, and only nearly where it is lowest: the solid comes to rest on one facet or
another near the true place, leaning by some degrees. About its axis a solid of revolution leans nowhere: the
axis itself is upright then, if facets show that the lowest place is near it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.cad.hull import centre_of_mass
from palpate.cad.stable import LeftOut, rotations_onto
from palpate.cad.values import Solid, StableState

__all__ = ["settled", "upright"]

_NEAR_RAD = math.radians(20.0)
"""How far from the axis facets that stand for an upright state may be."""
_TILTS = 41


def settled(solid: Solid, states: Sequence[StableState]) -> tuple[list[StableState], list[LeftOut]]:
    """The states without those that lean, which become one for either end of the axis or are left out."""
    kept = [state for state in states if not state.leans]
    leaning = [state for state in states if state.leans]
    for end in () if solid.axis is None else (solid.axis, -solid.axis):
        near = [state for state in leaning if -state.rotation[2] @ end > math.cos(_NEAR_RAD)]
        if near and _is_lowest(solid, end):
            kept.insert(0, upright(solid, end, near))
            leaning = [state for state in leaning if not any(state is item for item in near)]
    if not leaning:
        return kept, []
    reason = "lies on a surface that is curved both ways, of which facets do not tell how far it leans"
    share = sum(state.probability for state in leaning)
    return kept, [LeftOut(f"{reason}: {100 * share:.2g} %", share, -leaning[0].rotation[2])]


def upright(solid: Solid, down: Floats, states: Sequence[StableState]) -> StableState:
    """The state with a direction (3,) down, in place of others."""
    rotation = rotations_onto(down[None])[0]
    centre = centre_of_mass(solid)
    offset = -rotation @ centre
    offset[2] += _height_mm(solid, centre, down)
    return replace(
        states[0],
        rotation=rotation,
        offset_mm=offset,
        probability=sum(state.probability for state in states),
        tipping_angle_rad=max(min(state.tipping_angle_rad for state in states), 0.0),
        support_mm=np.zeros((1, 2)),
        leans=False,
    )


def _is_lowest(solid: Solid, down: Floats) -> bool:
    """Whether the centre of mass is lowest on the axis, as far as can be told, and higher further off."""
    centre = centre_of_mass(solid)
    aside = rotations_onto(down[None])[0][0]
    leaning = [
        _height_mm(solid, centre, math.cos(tilt) * down + math.sin(tilt) * aside)
        for tilt in np.linspace(0.0, _NEAR_RAD, _TILTS).tolist()
    ]
    # The true surface is as far as this from the facets: twice as much higher is higher for certain.
    return min(leaning) > leaning[0] - solid.off_mm and leaning[-1] > leaning[0] + 2 * solid.off_mm


def _height_mm(solid: Solid, centre: Floats, down: Floats) -> float:
    """How high the centre is above a plane that the solid lies on."""
    return float(((solid.vertices_mm - centre) @ down).max())
