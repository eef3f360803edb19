"""Balls against drawn solids: where a ball stops, by distances from triangles of meshes.

Distances are trimesh's, from the ball's middle to the nearest triangle: no section is looked at. Paths are
followed by steps as long as the way to the nearest triangle allows.
"""

import math

import numpy as np
import trimesh
from upright_tips import Stack

from palpate.base.geometry import Floats
from palpate.recognizer import Contact, Finger, NormalRange

__all__ = ["ball_contacts", "first_touch_of_ball", "nearest_point", "triangles_of", "wobbly_triangles"]

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
