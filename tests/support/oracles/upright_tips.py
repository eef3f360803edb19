"""Long tips and balls against drawn solids."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
import trimesh
from shapely import affinity

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Contact, Finger, Hypothesis, NormalRange
from support.benches.parts import prism
from support.oracles.shapely_touches import first_contact

# ----------------------------------------------------------------------------------------------------
# Upright cylinders against drawn solids: where a tip of some length stops, by slices of meshes.
#
# Solids are stacks of prisms and of frusta, as meshes made by trimesh. A tip touches one where the slices
# between its ends come as near to its axis as its radius: no section that the code under test has is looked
# at.

REACH_MM = 300.0
_EVENLY = 60  # slices, beside those where a mesh has corners
_JUST_MM = 1e-9  # beside a height at which blocks begin or end


@dataclass(frozen=True, eq=False)
class Block:
    """An outline from z_mm[0] to z_mm[1], scaled about its own centroid from 1 at its foot to `top_share`."""

    outline: shapely.Polygon
    z_mm: tuple[float, float]
    top_share: float = 1.0

    def at(self, z_mm: float) -> shapely.Polygon:
        """Its exact section at a height."""
        low, high = self.z_mm
        share = 1 + (self.top_share - 1) * (z_mm - low) / (high - low)
        return affinity.scale(self.outline, share, share, origin=self.outline.centroid)

    def mesh(self) -> trimesh.Trimesh:
        """The solid."""
        low, high = self.z_mm
        mesh = prism(self.outline, high - low)
        points = mesh.vertices.copy()
        top = points[:, 2] > (high - low) / 2
        middle = np.asarray(self.outline.centroid.coords)[0]
        points[top, :2] = middle + self.top_share * (points[top, :2] - middle)
        points[:, 2] += low
        return trimesh.Trimesh(points, mesh.faces, process=False)


@dataclass(frozen=True, eq=False)
class Stack:
    """Blocks on each other."""

    blocks: tuple[Block, ...]

    @property
    def top_mm(self) -> float:
        return max(block.z_mm[1] for block in self.blocks)


def drawn_stack(rng: np.random.Generator, *, leaning: bool) -> Stack:
    """Two to four blocks; of `leaning` ones, some are frusta."""
    blocks, z = [], 0.0
    for _ in range(int(rng.integers(2, 5))):
        high = z + float(rng.uniform(3.0, 12.0))
        share = float(rng.uniform(0.5, 1.3)) if leaning and rng.uniform() < 0.7 else 1.0
        blocks.append(Block(_outline(rng), (z, high), share))
        z = high
    return Stack(tuple(blocks))


def _outline(rng: np.random.Generator) -> shapely.Polygon:
    """A polygon about some middle, now and then with notches."""
    count = int(rng.integers(3, 9))
    angle = np.sort(rng.uniform(0, 2 * math.pi / count, count)) + 2 * math.pi * np.arange(count) / count
    radius = rng.uniform(10.0, 28.0, count)
    points = rng.uniform(-4.0, 4.0, 2) + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    found = shapely.Polygon(points)
    return found if found.is_valid else found.convex_hull


def model_of(stack: Stack, name: str = "stack", step_mm: float = 0.4) -> ObjectModel:
    """The stack as an object model: a section for a prism, slabs for a frustum, and how far these are off."""
    sections, off = [], 0.0
    for block in stack.blocks:
        low, high = block.z_mm
        count = 1 if block.top_share == 1.0 else math.ceil((high - low) / step_mm)
        ends = np.linspace(low, high, count + 1).tolist()
        for begin, end in pairwise(ends):
            middle = shapely.get_coordinates(block.at((begin + end) / 2).exterior)[:-1]
            foot = shapely.get_coordinates(block.at(begin).exterior)[:-1]
            off = max(off, float(np.hypot(*(foot - middle).T).max()))
            sections.append(Section((begin, end), (Polygon(middle),)))
    off = off + 1e-9 if off > 0 else 0.0
    return ObjectModel(name, (State("standing", tuple(sections)),), tolerance_mm=off)


def slices(stack: Stack, span_mm: tuple[float, float]) -> shapely.Geometry:
    """Outlines of the stack's meshes at many heights of a span, as lines."""
    low, high = span_mm
    heights = {*np.linspace(low, high, _EVENLY).tolist()}
    for z in (end for block in stack.blocks for end in block.z_mm):
        heights |= {each for each in (z - _JUST_MM, z + _JUST_MM) if low <= each <= high}
    lines = []
    for block in stack.blocks:
        mesh = block.mesh()
        for z in sorted(heights):
            if block.z_mm[0] < z < block.z_mm[1]:
                cut = trimesh.intersections.mesh_plane(mesh, [0, 0, 1], [0, 0, z])
                lines += list(shapely.linestrings(cut[:, :, :2]))
    return shapely.MultiLineString(lines)


def first_touch(outlines: shapely.Geometry, start: Floats, heading: Floats, radius_mm: float) -> float:
    """Travel at which a tip's axis stops; infinite if it passes by."""
    if outlines.is_empty:
        return math.inf
    return first_contact(outlines, start, heading, radius_mm, REACH_MM)


def stack_contacts(
    outlines: shapely.Geometry,
    finger: Finger,
    at: tuple[float, float, float],
    rng: np.random.Generator,
    *,
    count: int,
    bound_mm: float = 0.1,
    half_rad: float = 0.15,
) -> list[Contact]:
    """Contacts and misses of the stack put at (x, y, θ), their places and normals off within their bounds."""
    x, y, theta = at
    there = affinity.translate(affinity.rotate(outlines, theta, (0, 0), use_radians=True), x, y)
    found = []
    for number in range(count):
        angle = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(angle), math.sin(angle)])
        aim = np.array([x, y]) + rng.uniform(-14.0, 14.0, 2)
        start = aim - 110.0 * heading
        travel = first_touch(there, start, heading, finger.tip_radius_mm)
        touched = travel < 200.0
        end = start + min(travel, 200.0) * heading
        normal = None
        if touched:
            foot = shapely.get_coordinates(shapely.shortest_line(there, shapely.Point(end)))[0]
            out = math.atan2(*(end - foot)[::-1]) + half_rad * float(rng.uniform(-1, 1))
            normal = NormalRange(out - half_rad, out + half_rad)
        off = bound_mm * math.sqrt(rng.uniform()) * _unit(float(rng.uniform(-math.pi, math.pi)))
        found.append(
            Contact(
                f"f{number}",
                finger,
                touched,
                _pair(start + off),
                _pair(end + off),
                bound_mm + 1e-6,
                normal,
            )
        )
    return found


def holds(found: list[Hypothesis], name: str, at: tuple[float, float, float]) -> bool:
    """Whether some hypothesis of the object has the placement within its bounds."""
    for item in found:
        bounds = item.bounds
        turn = (at[2] - bounds.theta_rad[0]) % (2 * math.pi) + bounds.theta_rad[0]
        ends = ((at[0], bounds.x_mm), (at[1], bounds.y_mm), (turn, bounds.theta_rad))
        if item.state.object_name == name and all(lo <= value <= hi for value, (lo, hi) in ends):
            return True
    return False


def cone_model(tolerance_mm: float) -> ObjectModel:
    """A cone of discs, 24 mm wide at its foot, 1 mm narrower each mm, with a bore."""
    sections = [
        {
            "z": [z, z + 1],
            "polygons": [
                {
                    "outer": {"circle": {"centre": [0, 0], "radius": 24 - z}},
                    "holes": [{"circle": {"centre": [0, 0], "radius": 3}}],
                }
            ],
        }
        for z in range(12)
    ]
    states = [{"name": "standing", "sections": sections}]
    table = {"name": "cone", "tolerance": tolerance_mm, "states": states}
    text = {"format": "palpate/objects@1", "units": "mm", "objects": [table]}
    return objects_from_text(ObjectsFileText.model_validate_json(json.dumps(text)), "here").objects[0]


def square(half: float) -> Polygon:
    return Polygon(half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]))


def _unit(angle_rad: float) -> Floats:
    return np.array([math.cos(angle_rad), math.sin(angle_rad)])


def _pair(point: Floats | Sequence[float]) -> tuple[float, float]:
    return float(point[0]), float(point[1])


# ----------------------------------------------------------------------------------------------------
# Balls against drawn solids: where a ball stops, by distances from triangles of meshes.
#
# Distances are trimesh's, from the ball's middle to the nearest triangle: no section is looked at. Paths are
# followed by steps as long as the way to the nearest triangle allows.

_REACH_MM = 220.0
_TOUCHES_MM = 1e-7
_STEPS = 4000


def triangles_of(stack: Stack, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Floats:
    """Triangles (n, 3, 3) of the stack's meshes, put at (x, y, θ)."""
    x, y, theta = at
    turn = trimesh.transformations.rotation_matrix(theta, [0, 0, 1])
    turn[:2, 3] = x, y
    found: Floats = np.concatenate([block.mesh().apply_transform(turn).triangles for block in stack.blocks])
    return found


def wobbly_triangles(
    stack: Stack, off_mm: float, rng: np.random.Generator, at: tuple[float, float, float]
) -> Floats:
    """The same with every corner moved aside by `off_mm` at most: walls lean, and none is in its place."""
    x, y, theta = at
    turn = trimesh.transformations.rotation_matrix(theta, [0, 0, 1])
    turn[:2, 3] = x, y
    found = []
    for block in stack.blocks:
        mesh = block.mesh()
        points, around = mesh.vertices.copy(), rng.uniform(-math.pi, math.pi, len(mesh.vertices))
        away = off_mm * (np.sqrt(rng.uniform(size=len(points))) if rng.uniform() < 0.5 else 1.0)
        points[:, 0] += away * np.cos(around)
        points[:, 1] += away * np.sin(around)
        moved = trimesh.Trimesh(points, mesh.faces, process=False)
        found.append(moved.apply_transform(turn).triangles)
    result: Floats = np.concatenate(found)
    return result


def nearest_point(triangles: Floats, middle: Floats) -> Floats:
    """The nearest point (3,) of all triangles."""
    points = trimesh.triangles.closest_point(triangles, np.broadcast_to(middle, (len(triangles), 3)))
    found: Floats = points[np.argmin(np.sum((points - middle) ** 2, axis=1))]
    return found


def first_touch_of_ball(triangles: Floats, start: Floats, heading: Floats, radius_mm: float) -> float:
    """Travel at which a ball with its middle at `start` (3,), free there, stops; infinite if it passes by."""
    travel = 0.0
    for _ in range(_STEPS):
        middle = start + travel * heading
        free = math.dist(nearest_point(triangles, middle), middle) - radius_mm
        if free <= _TOUCHES_MM:
            return travel
        travel += free
        if travel > _REACH_MM:
            return math.inf
    return travel  # it glides along


def ball_contacts(
    triangles: Floats,
    finger: Finger,
    at_mm: tuple[float, float],
    rng: np.random.Generator,
    *,
    count: int,
    bound_mm: float = 0.1,
    half_rad: float = 0.15,
) -> list[Contact]:
    """Contacts and misses of a solid about `at_mm`, their places and normals off within their bounds."""
    found = []
    for number in range(count):
        angle = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(angle), math.sin(angle), 0.0])
        start = np.array([*at_mm, finger.height_mm]) - 110.0 * heading
        start[:2] += rng.uniform(-14.0, 14.0, 2)
        travel = first_touch_of_ball(triangles, start, heading, finger.tip_radius_mm)
        touched = travel < 200.0
        end = start + min(travel, 200.0) * heading
        normal = None
        if touched:
            x, y, _ = end - nearest_point(triangles, end)
            out = math.atan2(y, x) + half_rad * float(rng.uniform(-1, 1))
            normal = NormalRange(out - half_rad, out + half_rad)
        around = float(rng.uniform(-math.pi, math.pi))
        off = bound_mm * math.sqrt(rng.uniform()) * np.array([math.cos(around), math.sin(around)])
        found.append(
            Contact(
                f"f{number}",
                finger,
                touched,
                tuple((start[:2] + off).tolist()),
                tuple((end[:2] + off).tolist()),
                bound_mm + 1e-6,
                normal,
            )
        )
    return found
