"""Oblique touches: states that balls meet beside their equators, where a height counts as a place does.

Known before anything moves; a state that a ball may meet more than 60° from its equator is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError, counted
from palpate.base.geometry import ObjectModel, State
from palpate.config import RigFile
from palpate.recognizer.ball_section import met_by_ball
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.symmetry import Symmetry
from palpate.rig.conversion import finger_of

__all__ = ["ObliqueTouch", "oblique_lines", "oblique_touches"]

_SLIGHTLY_RAD = math.radians(20.0)  # up to which a height counts for a third of a place
_SHOWN = 5
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ObliqueTouch:
    """A state that a finger's ball may meet up to `latitude_rad` from its equator."""

    object_name: str
    state_name: str
    finger: str
    latitude_rad: float


def oblique_touches(rig: RigFile, models: Sequence[ObjectModel]) -> tuple[ObliqueTouch, ...]:
    """For each state the worst. Raises InputError, which names the finger, for one that is too oblique."""
    balls = {
        (finger_of(finger), finger.tip.least_share): finger.name
        for finger in reversed(rig.fingers)
        if finger.tip.is_ball
    }
    found = []
    for model, state in [(item, state) for item in models for state in item.states]:
        worst = ObliqueTouch(model.name, state.name, "", 0.0)
        item = _of_catalogue(model, state)
        for (ball, least_share), name in balls.items():
            try:
                met = met_by_ball(item, ball)
            except InputError as error:
                raise InputError(f"finger {name}: {error}") from error
            least = ball.tip_radius_mm if met is None else met.radius_mm - 2 * item.tolerance_mm
            share = min(least / ball.tip_radius_mm, 1.0)
            if share < least_share - _ROUNDING:
                raise InputError(
                    f'finger {name}: object "{model.name}", state "{state.name}": its ball may touch up to '
                    f"{math.degrees(math.acos(share)):.1f}° from its equator, more than tip.max_latitude_deg "
                    f"({math.degrees(math.acos(least_share)):g}); give that another value, at most 60"
                )
            if math.acos(share) > worst.latitude_rad:
                worst = ObliqueTouch(model.name, state.name, name, math.acos(share))
        if worst.latitude_rad > _SLIGHTLY_RAD:
            found.append(worst)
    return tuple(found)


def oblique_lines(rig: RigFile, models: Sequence[ObjectModel]) -> list[str]:
    """One line if there are any, else none. Raises InputError as `oblique_touches`."""
    found = sorted(oblique_touches(rig, models), key=lambda item: -item.latitude_rad)
    if not found:
        return []
    shown = "; ".join(
        f"{item.object_name}, {item.state_name} "
        f"(finger {item.finger}, {math.degrees(item.latitude_rad):.0f}°)"
        for item in found[:_SHOWN]
    )
    more = len(found) - _SHOWN
    rest = f" and {counted(more, 'more state', 'more states')}" if more > 0 else ""
    worst = math.tan(found[0].latitude_rad)
    return [
        f"{shown}{rest}: balls meet these beside their equators; what height_mm and the sections' heights "
        f"are off by puts a contact off by up to {worst:.1f} times as much, which no bound contains"
    ]


def _of_catalogue(model: ObjectModel, state: State) -> CatalogueState:
    return CatalogueState(
        model.name,
        state,
        np.zeros(2),
        Symmetry(),
        model.tolerance_mm + state.curves_off_mm,
        normal_bound_rad=model.normal_bound_rad,
    )
