"""Hypotheses as a log has them, for drawing: which comes first, and where its outlines are."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from palpate.base.geometry import Floats, ObjectModel
from palpate.base.geometry.plane import rotation_matrix

__all__ = ["answered", "heaviest_first", "outlines_in_w"]

_ROUNDING_RAD = 1e-5  # of numbers in a result


def heaviest_first(hypotheses: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Hypotheses by weight, the largest first; one without a weight is last."""
    return sorted(hypotheses, key=lambda item: -(item["weight"] or 0.0))


def answered(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The answer and its alternatives, of the event `result`, in the form of those of `recognised`.

    They are of the part as it lies when the fingers have left it, so they may be wider than the last ones of
    `recognised`, and lie beside them. Empty if no hypothesis was left. `verified` is None: results do not
    keep it.
    """
    if result.get("configuration") is None:
        return []
    others = result["alternatives"]
    first = {**result, "weight": max(0.0, 1.0 - sum(item["weight"] or 0.0 for item in others))}
    return [_as_logged(item) for item in (first, *others)]


def _as_logged(item: Mapping[str, Any]) -> Mapping[str, Any]:
    at, bounds = item["configuration"], item["bounds"]
    lo, hi = bounds["theta"]
    return {
        "object": item["object"],
        "state": item["state"],
        "configuration": {"x_mm": at["x"], "y_mm": at["y"], "theta_rad": at["theta"]},
        "bounds": {"x_mm": bounds["x"], "y_mm": bounds["y"], "theta_rad": bounds["theta"]},
        "weight": item["weight"],
        "verified": None,
        "symmetry_order": item.get("symmetry_order", 0 if hi - lo >= math.tau - _ROUNDING_RAD else 1),
    }


def outlines_in_w(
    item: Mapping[str, Any],
    models: Mapping[str, ObjectModel],
    span_mm: tuple[float, float] | None = None,
) -> tuple[Floats, ...]:
    """Outlines (n, 2) mm, in W, of an object where it lies: those beside a tip, or of its lowest section.

    None of an object or state that the models lack.
    """
    model = models.get(item["object"])
    states = [] if model is None else [state for state in model.states if state.name == item["state"]]
    if not states:
        return ()
    lowest = min(states[0].sections, key=lambda part: part.z_mm[0])
    sections = [] if span_mm is None else states[0].sections_within(span_mm)
    at = item["configuration"]
    turn = rotation_matrix(at["theta_rad"]).T
    rings = (ring for section in sections or [lowest] for ring in section.rings)
    return tuple(ring @ turn + [at["x_mm"], at["y_mm"]] for ring in rings)
