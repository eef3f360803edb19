"""Contacts whose truth is known: half-planes pressed into a round tip, the pressure as deep as the dent.

An array of tests/support/tactile_tip.py feels them.
"""

import math
from dataclasses import dataclass

import numpy as np
from tactile_tip import COLS, PITCH, RADIUS, ROWS

CELL_STEPS = 27  # half a degree
# Ray directions: the middles of CELL_STEPS slices of each column, then on around the back of the tip.
SLICE = PITCH / CELL_STEPS
RAYS = -10 * PITCH + (np.arange(round(2 * math.pi / SLICE)) + 0.5) * SLICE


@dataclass(frozen=True)
class HalfPlane:
    """The points x with x . (cos angle, sin angle) >= distance: an edge met in direction `angle`."""

    angle: float
    distance: float


def entry(planes: list[HalfPlane]) -> np.ndarray:
    """Distance along RAYS at which the intersection of half-planes is entered; inf where it is missed."""
    near, far = np.zeros(RAYS.size), np.full(RAYS.size, np.inf)
    for plane in planes:
        c = np.cos(RAYS - plane.angle)
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = plane.distance / c
        near = np.where(c > 1e-9, np.maximum(near, hit), near)
        far = np.where(c < -1e-9, np.minimum(far, hit), far)
        if plane.distance > 0:
            far = np.where(c <= 1e-9, -1.0, far)
    return np.where(near < far, near, np.inf)


def tipped(angle: float, at: float, distance: float, turn: float) -> HalfPlane:
    """Face through the surface point in direction `at` at `distance`, its inward normal turned by `turn`."""
    return HalfPlane(angle + turn, distance * math.cos(at - angle - turn))


@dataclass(frozen=True)
class Truth:
    kind: str
    normals: tuple[float, ...]
    depth_mm: float
    force_n: float
    top_mm: float
    taxels_n: np.ndarray


def contact(rng: np.random.Generator, kind: str, middle: float, depth: float, force: float | None) -> Truth:
    """A contact at direction `middle` with penetration `depth` of the deepest edge."""
    c = RADIUS - depth
    normals = [middle]
    if kind == "flat":
        rho = entry([HalfPlane(middle, c)])
    elif kind == "vertex":
        turn = math.pi - math.radians(rng.uniform(30, 150))
        right = rng.uniform(0, turn)
        rho = entry([tipped(middle, middle, c, -(turn - right)), tipped(middle, middle, c, right)])
        # A face met in direction middle + right recedes on the side below, and the other way round.
    elif kind == "end":
        planes = [HalfPlane(middle, c)]
        for side in (1, -1)[: rng.integers(1, 3)]:
            at = rng.uniform(0, math.radians(30))
            drop = math.pi - math.radians(rng.uniform(30, 150))
            planes.append(tipped(middle, middle + side * at, c / math.cos(at), -side * drop))
        rho = entry(planes)
    else:
        # A "dell" is a notch so shallow that both its edges may dent the tip in one stretch.
        between = rng.uniform(60, 150) if kind == "notch" else rng.uniform(150, 178)
        other = middle + math.pi - math.radians(between)
        second = RADIUS - depth * rng.uniform(0.02, 1.0)
        normals.append(other)
        rho = np.minimum(entry([HalfPlane(middle, c)]), entry([HalfPlane(other, second)]))
    pressure = np.maximum(0.0, RADIUS - rho)
    cells = pressure[: COLS * CELL_STEPS].reshape(COLS, CELL_STEPS).sum(axis=1)
    if force is None:  # a foundation of constant modulus, as stiff as the linear one at half a millimetre
        flat = np.maximum(0.0, RADIUS - entry([HalfPlane(0.0, RADIUS - 0.5)])).sum()
        force = 1.5 * rng.uniform(0.8, 1.2) * float(pressure.sum()) / float(flat)
    top = rng.uniform(6.0, 12.0)
    bottom = np.arange(ROWS) * 2.0
    rows = np.clip(top - bottom, 0.0, 2.0)
    taxels = force * np.outer(rows / rows.sum(), cells / pressure.sum())
    return Truth(kind, tuple(normals), depth, force, top, taxels)


def draw(rng: np.random.Generator, kind: str) -> Truth:
    middle = rng.uniform(-math.radians(100), math.radians(100))
    if kind in ("notch", "dell"):
        middle = rng.uniform(-math.radians(110), math.radians(0))
    if rng.random() < 0.5:
        force = math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
        return contact(rng, kind, middle, force / (3.0 * rng.uniform(0.8, 1.2)), force)
    while True:
        truth = contact(rng, kind, middle, rng.uniform(0.08, 1.2), None)
        if 0.3 <= truth.force_n <= 3.0:
            return truth
