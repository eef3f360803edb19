"""Parts and catalogues of tests."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import trimesh

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.config import load_objects
from palpate.recognizer import Contact, Finger
from palpate.rig.catalogue.finger_model import AtHeight, RigFingers
from palpate.rig.catalogue.section_stack import StateSections, state_sections
from support.oracles.shapely_touches import Placed, flat

# ----------------------------------------------------------------------------------------------------
# Objects files and scenes for tests of what no finger can feel: one outline, at any scale and height.

OUTLINE = ((0.0, 0.0), (70.0, 0.0), (70.0, 25.0), (55.0, 40.0), (0.0, 40.0))


def part(
    name: str, scale: float = 1.0, height: float = 20.0, outline: Sequence[Sequence[float]] = OUTLINE
) -> dict[str, Any]:
    """A flat part, `height` unscaled; its bounding box is 70 by 40 mm."""
    return {"name": name, "outline": [[x * scale, y * scale] for x, y in outline], "height": height}


def objects_file(path: Path, *parts: Mapping[str, Any]) -> Path:
    """Write a catalogue; returns its path."""
    path.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts}))
    return path


def scene_file(path: Path, name: str, x: float, y: float, objects: str | None = None) -> Path:
    """Write a scene; returns its path."""
    content: dict[str, Any] = {"format": "palpate/scene@1", "object": name}
    content["configuration"] = {"x": x, "y": y, "theta": 0.0}
    path.write_text(json.dumps(content if objects is None else content | {"objects": objects}))
    return path


# ----------------------------------------------------------------------------------------------------
# Parts in few lines, for tests of what fingers can tell apart: sections of polygons, fingers of heights.

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


def stacked_part(
    name: str, *sections: Mapping[str, Any], tolerance: float = 0.0, **state: Any
) -> dict[str, Any]:
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


# ----------------------------------------------------------------------------------------------------
# A square that lies straight in the table's middle, and contacts with it written down by hand.

FINGER = Finger(5.0, 10.0)
SQUARE_RING = np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])
SQUARE = flat("square", SQUARE_RING)
STRAIGHT = Placed(SQUARE, 0.0, 0.0, 0.0)


def touching(name: str, start: tuple[float, float], end: tuple[float, float], bound: float = 0.3) -> Contact:
    """A contact without a normal."""
    return Contact(name, FINGER, True, start, end, bound)


def three_sides(bound: float = 0.3) -> list[Contact]:
    """What fingers a, b and c feel of its left, its right and its lower side."""
    return [
        touching("a", (-100.0, 3.0), (-25.0, 3.0), bound),
        touching("b", (100.0, -4.0), (25.0, -4.0), bound),
        touching("c", (2.0, -100.0), (2.0, -25.0), bound),
    ]


def sections(name: str, *polygons: Polygon, z_hi: float = 20.0) -> ObjectModel:
    """An object with one section of several polygons."""
    return ObjectModel(name, (State("flat", (Section((0.0, z_hi), polygons),)),))


# ----------------------------------------------------------------------------------------------------
# Solids as files, made without the code under test: prisms by shapely's triangulation, others by trimesh.

ELL = shapely.Polygon([(0, 0), (60, 0), (60, 8), (8, 8), (8, 40), (0, 40)])
"""An angle profile: legs of 60 mm and 40 mm, 8 mm thick."""

WEDGE = shapely.Polygon([(0, 0), (50, 0), (0, 30)])
"""A right-angled triangle; a prism of it lies on five faces."""


def prism(outline: shapely.Polygon, height: float) -> trimesh.Trimesh:
    """The closed solid over an outline, with its holes, from z = 0 to `height`."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
    flat = np.array([np.asarray(shapely.orient_polygons(item).exterior.coords)[:3] for item in triangles])
    whole = shapely.orient_polygons(outline)
    rings = [np.asarray(ring.coords) for ring in (whole.exterior, *whole.interiors)]
    start, end = np.vstack([ring[:-1] for ring in rings]), np.vstack([ring[1:] for ring in rings])

    def at(points: np.ndarray, z: float) -> np.ndarray:
        return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)

    low, high = np.stack([at(start, 0), at(end, 0)]), np.stack([at(start, height), at(end, height)])
    walls = [
        np.stack([low[0], low[1], high[1]], axis=1),
        np.stack([low[0], high[1], high[0]], axis=1),
    ]
    facets = np.concatenate([at(flat[:, ::-1], 0), at(flat, height), *walls])
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(facets))
    mesh.merge_vertices()
    assert mesh.is_volume
    return mesh


def mesh_file(mesh: trimesh.Trimesh, path: Path) -> Path:
    """Write a mesh; the suffix says how."""
    mesh.export(path)
    return path


def states_of(folder: Path, *parts: Any) -> tuple[StateSections, ...]:
    """Parts as states, by way of a file."""
    return state_sections(load_objects(objects_file(folder / "parts.json", *parts)))
