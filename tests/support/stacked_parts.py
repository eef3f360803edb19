"""Parts in few lines, for tests of what fingers can tell apart: sections of polygons, fingers of heights."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from palpate.rig.catalogue.finger_model import AtHeight, RigFingers

Ring = list[list[float]]
BOUND_MM = 0.5
L_SHAPE: Ring = [[0, 0], [60, 0], [60, 8], [8, 8], [8, 40], [0, 40]]


def rectangle(width: float, height: float, x: float = 0.0, y: float = 0.0) -> Ring:
    return [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]


def polygon(corners: int, radius: float, turn: float = 0.0) -> Ring:
    angles = [turn + 2 * math.pi * k / corners for k in range(corners)]
    return [[radius * math.cos(a), radius * math.sin(a)] for a in angles]


def mirrored(ring: Ring) -> Ring:
    return [[-x, y] for x, y in reversed(ring)]


def moved(ring: Ring, turn: float, x: float, y: float) -> Ring:
    c, s = math.cos(turn), math.sin(turn)
    return [[c * px - s * py + x, s * px + c * py + y] for px, py in ring]


def section(low: float, high: float, *rings: Ring, holes: Sequence[Ring] = ()) -> dict[str, Any]:
    """Rings beside each other; holes are in the first."""
    polygons = [{"outer": ring, "holes": list(holes) if k == 0 else []} for k, ring in enumerate(rings)]
    return {"z": [low, high], "polygons": polygons}


def part(name: str, *sections: Mapping[str, Any], tolerance: float = 0.0, **state: Any) -> dict[str, Any]:
    """An object with one state; `state`: more keys of it."""
    return {
        "name": name,
        "tolerance": tolerance,
        "states": [{"name": "s", "sections": list(sections), **state}],
    }


def objects(*parts: Mapping[str, Any]) -> dict[str, Any]:
    return {"format": "palpate/objects@1", "units": "mm", "objects": list(parts)}


def fingers_at(*heights: float, radius: float = 5.0, bound: float = BOUND_MM) -> RigFingers:
    at = tuple(AtHeight(height, radius, (f"f{k}",)) for k, height in enumerate(heights, 1))
    return RigFingers("made", at, bound)
