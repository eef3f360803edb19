"""Random outlines of the campaign: what recognition finds hard, drawn anew for every grip.

Stars, ovals of many vertices, combs with slots and nicks narrower than the tip, polygons that are nearly
regular, slivers, frames with a hole, and stacks of two sections.
"""

import math
from collections.abc import Callable

import numpy as np
import shapely
from shapely_bench import flat, unit

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State

_Draw = Callable[[np.random.Generator, float], ObjectModel]
_THINNEST_MM = 0.2


def random_model(kind: str, rng: np.random.Generator, radius_mm: float) -> ObjectModel:
    """A valid model of one of `KINDS`, for a tip of a radius; on average it is 0.2 mm thick at least."""
    while True:
        model = KINDS[kind](rng, max(radius_mm, 1.0))
        if all(_is_solid(polygon) for section in model.states[0].sections for polygon in section.polygons):
            return model


def _is_solid(polygon: Polygon) -> bool:
    shape = shapely.Polygon(polygon.outer, polygon.holes)
    return bool(shape.is_valid) and shape.area > _THINNEST_MM * shape.length / 2


def _polar(radius: Floats, angle: Floats) -> Floats:
    return np.asarray(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def _star(rng: np.random.Generator, _: float) -> ObjectModel:
    points = int(rng.integers(4, 12))
    angle = np.sort(rng.uniform(0, 2 * math.pi, 2 * points))
    return flat("star", _polar(rng.uniform(12, 45, 2 * points), angle))


def _oval(rng: np.random.Generator, _: float) -> ObjectModel:
    """Anything from nearly round to 1 : 2; its vertices evenly spread, or one of them somewhere else."""
    count = int(rng.choice([12, 60, 240, 900]))
    angle = rng.uniform(0, 1) + 2 * math.pi * np.arange(count) / count
    width = float(rng.uniform(15, 35))
    slim = width * (1 - float(rng.choice([1e-5, 1e-3, 0.01, 0.1, 0.5])))
    ring = np.column_stack([width * np.cos(angle), slim * np.sin(angle)])
    if rng.random() < 0.3:
        ring[int(rng.integers(count))] *= 1 + float(rng.choice([-1, 1])) * 0.002
    return flat("oval", ring)


def _comb(rng: np.random.Generator, radius: float) -> ObjectModel:
    """A bar with slots, nicks and steps in one side, most of them narrower than the tip."""
    top: list[tuple[float, float]] = []
    at, depth = -40.0, 25.0
    while at < 32.0:
        wide = radius * float(rng.choice([0.3, 1.0, 1.9, 2.0, 2.05, rng.uniform(0.2, 3.0)]))
        land = float(rng.uniform(1.0, 10.0))
        down = depth - float(rng.uniform(2.0, 20.0))
        shape = int(rng.integers(4))
        if shape == 0:
            slot = [(at, depth), (at, down), (at + wide, down), (at + wide, depth)]
        elif shape == 1:
            slot = [(at, depth), (at + wide * float(rng.uniform(0.1, 0.9)), down), (at + wide, depth)]
        elif shape == 2:
            lean = 0.3 * wide * float(rng.uniform(-1, 1))
            slot = [(at, depth), (at - lean, down), (at + wide + lean, down), (at + wide, depth)]
        else:
            step = depth - float(rng.uniform(0.1, 3.0))
            slot = [(at, depth), (at, step), (at + wide, step), (at + wide, depth)]
        top += slot
        at += wide + land
    right = at + 5.0
    return flat("comb", [(right, -12.0), (right, depth), *reversed(top), (-46.0, depth), (-46.0, -12.0)])


def _near_regular(rng: np.random.Generator, _: float) -> ObjectModel:
    count = int(rng.choice([3, 4, 5, 6, 8, 12, 40]))
    angle = rng.uniform(0, 1) + 2 * math.pi * np.arange(count) / count
    off = float(rng.choice([0.0, 1e-7, 4e-4, 2e-3, 0.02, 0.3]))
    ring = _polar(np.full(count, rng.uniform(18, 35)), angle) + off * rng.uniform(-1, 1, (count, 2))
    return flat("near-regular", np.round(ring, 3) if rng.random() < 0.3 else ring)


def _sliver(rng: np.random.Generator, _: float) -> ObjectModel:
    length, thick = float(rng.uniform(20, 80)), float(rng.choice([0.5, 1.0, 3.0]))
    kind = int(rng.integers(3))
    if kind == 0:
        ring = [(0.0, 0.0), (length, 0.0), (length, thick), (0.0, thick * float(rng.uniform(0.8, 1.2)))]
    elif kind == 1:
        ring = [(0.0, 0.0), (length, float(rng.uniform(0, 1))), (float(rng.uniform(0, length)), 2 * thick)]
    else:
        leg = float(rng.uniform(10, 40))
        ring = [(0, 0), (length, 0), (length, thick), (thick, thick), (thick, leg), (0, leg)]
    return flat("sliver", np.array(ring) - (length / 2, 0.0))


def _holed(rng: np.random.Generator, radius: float) -> ObjectModel:
    """A polygon with a hole that a tip may just fit into, or not."""
    count, corners = int(rng.integers(3, 9)), int(rng.integers(3, 7))
    outer = _polar(rng.uniform(30, 48, count), np.sort(rng.uniform(0, 2 * math.pi, count)))
    around = np.linspace(0, 2 * math.pi, corners, endpoint=False) + rng.uniform(0, 1)
    hole = _polar(rng.uniform(0.8, 2.5, corners) * radius, around) + 6.0 * unit(rng.uniform(0, 6.3))
    return ObjectModel("holed", (State("flat", (Section((0, 20), (Polygon(outer, (hole[::-1],)),)),)),))


def _stack(rng: np.random.Generator, radius: float) -> ObjectModel:
    """Two sections of different outlines, that meet at a height of 10 mm."""
    low, high = (_star(rng, radius) if rng.random() < 0.5 else _near_regular(rng, radius) for _ in range(2))
    sections = (
        Section((0.0, 10.0), low.states[0].sections[0].polygons),
        Section((10.0, 25.0), high.states[0].sections[0].polygons),
    )
    return ObjectModel("stack", (State("flat", sections),))


KINDS: dict[str, _Draw] = {
    "star": _star,
    "oval": _oval,
    "comb": _comb,
    "near-regular": _near_regular,
    "sliver": _sliver,
    "holed": _holed,
    "stack": _stack,
}
"""How a model of each kind is drawn, for a tip of a radius (mm)."""
