"""Draws of a study: which state of the catalogue lies on the table, and where."""

from collections.abc import Mapping

import numpy as np

from palpate.base.geometry import Floats, ObjectModel
from palpate.config import ObjectsFile, RigFile
from palpate.rig.emulated.scene import Placement, put_down

__all__ = ["draw_for_study", "has_probabilities", "placed_within_mm", "shares_drawn"]

_PLACED_SHARE = (
    0.16  # of the workspace's radius, where a rig file does not say how far from the middle parts lie
)


def placed_within_mm(rig: RigFile) -> float:
    """How far from the middle of the workspace a part's centre of area lies at most, by the rig file."""
    emulation = rig.emulation
    return _PLACED_SHARE * rig.workspace.radius_mm if emulation is None else emulation.placement_radius_mm


def has_probabilities(model: ObjectModel) -> bool:
    """Whether all states of an object have a probability, and one of them is not 0."""
    known = [item.probability for item in model.states if item.probability is not None]
    return len(known) == len(model.states) and sum(known) > 0


def shares_drawn(objects: ObjectsFile) -> Mapping[tuple[str, str], float]:
    """Of all runs, by object and state: objects evenly, states by their probabilities or evenly."""
    count = len(objects.objects)
    return {
        (model.name, state.name): share / count
        for model in objects.objects
        for state, share in zip(model.states, _shares(model).tolist(), strict=True)
    }


def draw_for_study(
    objects: ObjectsFile, radius_mm: float, rng: np.random.Generator, workspace_mm: float
) -> Placement:
    """An object, one of its states, and where it lies within `radius_mm` of the middle.

    Unlike a scene of the emulated bench, whose states are all as frequent, this follows probabilities.
    """
    model = objects.objects[int(rng.integers(len(objects.objects)))]
    if has_probabilities(model):
        state = model.states[int(rng.choice(len(model.states), p=_shares(model)))]
    else:
        state = model.states[int(rng.integers(len(model.states)))]
    return put_down(model, state, radius_mm, rng, workspace_mm)


def _shares(model: ObjectModel) -> Floats:
    """Of an object's runs that each state has (s,); probabilities of states that were left out are shared."""
    if not has_probabilities(model):
        return np.full(len(model.states), 1 / len(model.states))
    found: Floats = np.array([item.probability for item in model.states], dtype=float)
    return found / float(found.sum())
