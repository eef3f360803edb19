"""Hypotheses as a log has them, for drawing: which comes first, and where its outlines are."""

from collections.abc import Mapping, Sequence
from typing import Any

from palpate.geometry import Floats, ObjectModel
from palpate.geometry.plane import rotation_matrix

__all__ = ["heaviest_first", "outlines_in_w"]


def heaviest_first(hypotheses: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Hypotheses by weight, the largest first; one without a weight is last."""
    return sorted(hypotheses, key=lambda item: -(item["weight"] or 0.0))


def outlines_in_w(
    item: Mapping[str, Any], models: Mapping[str, ObjectModel], height_mm: float | None = None
) -> tuple[Floats, ...]:
    """Outlines (n, 2) mm, in W, of an object where it lies: those at a height, or of its lowest section.

    None of an object or state that the models lack.
    """
    model = models.get(item["object"])
    states = [] if model is None else [state for state in model.states if state.name == item["state"]]
    if not states:
        return ()
    lowest = min(states[0].sections, key=lambda part: part.z_mm[0])
    sections = [] if height_mm is None else states[0].sections_at(height_mm)
    at = item["configuration"]
    turn = rotation_matrix(at["theta_rad"]).T
    rings = (ring for section in sections or [lowest] for ring in section.rings)
    return tuple(ring @ turn + [at["x_mm"], at["y_mm"]] for ring in rings)
