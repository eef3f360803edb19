"""Objects of the campaign and their outlines."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
import shapely

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue
from support.commands.repository import SHARED_OUTLINE_SETS
from support.oracles.shapely_touches import SHIPPED_OBJECTS, Placed, flat, outlines, unit

# ----------------------------------------------------------------------------------------------------
# Random outlines of the campaign: what recognition finds hard, drawn anew for every grip.
#
# Stars, ovals of many vertices, combs with slots and nicks narrower than the tip, polygons that are nearly
# regular, slivers, frames with a hole, and stacks of two sections.

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


# ----------------------------------------------------------------------------------------------------
# Objects of the campaign, and how one of them really lies there: displaced within its tolerance.
#
# Used by campaign_trials, which draws them. Families: "memo" (shipped), "parts" (shared outlines), "own"
# (drawn
# here: steps, holes, slots, symmetry), "loose" (some of them with a tolerance), and "drawn": anew for every
# grip, by campaign_outlines. A source is one catalogue: a family, or one set of the shared outlines.

FAMILIES = ("memo", "parts", "own", "loose", "drawn")
DRAWN = "drawn"
TOLERANCE_MM = 0.25  # of the family "loose"
_TOLERANCES_MM = (0.0, 0.0, 0.0, 0.05, 0.25)
_FINE = 40  # vertices
_SETS = {file.stem: file for file in SHARED_OUTLINE_SETS}


@cache
def objects_of(source: str) -> tuple[ObjectModel, ...]:
    """The models of a source: shipped, a set of shared outlines, own ones, or some with a tolerance."""
    if source in _SETS:
        return tuple(outlines(_SETS[source]))
    if source == "own":
        return (_stepped(), _islands(), _frame(), _slotted_comb(), _square())
    models = tuple(outlines(SHIPPED_OBJECTS))
    if source == "memo":
        return models
    loose = (*models, _slotted_comb(), _frame(), _square())
    return tuple(replace(model, tolerance_mm=TOLERANCE_MM) for model in loose)


@cache
def catalogue_of(source: str) -> Catalogue:
    """Built once in each process."""
    return Catalogue(objects_of(source))


def drawn_source(family: str, rng: np.random.Generator) -> str:
    """The family itself, or one of the sets that it consists of."""
    return str(rng.choice(sorted(_SETS))) if family == "parts" else family


def drawn_objects(rng: np.random.Generator, radius_mm: float) -> tuple[ObjectModel, ...]:
    """A random object, one that is nearly the same, and one of any kind; some with a tolerance.

    Of edges that are shorter than the tolerance nothing is known, and no answer comes soon.
    """
    kinds = sorted(KINDS)
    first = random_model(str(rng.choice(kinds)), rng, radius_mm)
    near = _mapped(first, partial(np.multiply, 1.0 + float(rng.choice([0.002, 0.03]))))
    third = random_model(str(rng.choice(kinds)), rng, radius_mm)
    delta = float(rng.choice(_TOLERANCES_MM))
    if any(len(ring) > _FINE for ring in _rings_of(first)):
        delta = 0.0
    return (
        replace(first, tolerance_mm=delta),
        replace(near, name=f"near {first.name}"),
        replace(third, name=f"other {third.name}"),
    )


def placed_anyhow(model: ObjectModel, rng: np.random.Generator) -> Placed:
    """Anywhere near the middle and turned anyhow; often at a quarter turn exactly, or next to one."""
    theta = float(rng.uniform(-math.pi, math.pi))
    if rng.random() < 0.35:
        beside = float(rng.choice([0.0, 0.0, 0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2])) * float(
            rng.choice([-1, 1])
        )
        theta = float(rng.choice([0.0, math.pi / 2, -math.pi / 2, math.pi, -math.pi])) + beside
    x, y = (0.0, 0.0) if rng.random() < 0.1 else (float(v) for v in rng.uniform(-15.0, 15.0, 2))
    return Placed(model, x, y, theta)


def displaced(model: ObjectModel, rng: np.random.Generator, *, at_bound: bool) -> ObjectModel:
    """The true object: its outline is off the model's by up to the tolerance, by all of it if at the bound.

    Moved as a whole, or scaled, or every vertex moved on its own as long as nothing crosses.
    """
    tolerance = model.tolerance_mm
    if tolerance == 0.0 or rng.random() < 0.2:
        return model
    size = tolerance if at_bound else float(rng.uniform(0.0, tolerance))
    points = np.concatenate(list(_rings_of(model)))
    reach = float(np.max(np.linalg.norm(points, axis=1)))
    kind = int(rng.integers(3))
    shift = size * unit(rng.uniform(0, 2 * math.pi))
    for _ in range(20):
        if kind == 0:
            move = partial(np.add, shift)
        elif kind == 1:
            move = partial(np.multiply, 1.0 + float(rng.choice([-1, 1])) * size / reach)
        else:
            move = partial(_jittered, rng=rng, size=size)
        moved = _mapped(model, move)
        if _is_valid(moved):
            return moved
    return model


def _jittered(ring: Floats, *, rng: np.random.Generator, size: float) -> Floats:
    angle = rng.uniform(0, 2 * math.pi, len(ring))
    result: Floats = ring + size * np.column_stack([np.cos(angle), np.sin(angle)])
    return result


def _mapped(model: ObjectModel, move: Callable[[Floats], Floats]) -> ObjectModel:
    states = tuple(
        replace(
            state,
            sections=tuple(
                replace(
                    section,
                    polygons=tuple(
                        Polygon(move(polygon.outer), tuple(move(hole) for hole in polygon.holes))
                        for polygon in section.polygons
                    ),
                )
                for section in state.sections
            ),
        )
        for state in model.states
    )
    return replace(model, states=states)


def _rings_of(model: ObjectModel) -> Iterator[Floats]:
    for state in model.states:
        for section in state.sections:
            for polygon in section.polygons:
                yield polygon.outer
                yield from polygon.holes


def _is_valid(model: ObjectModel) -> bool:
    return all(
        shapely.Polygon(polygon.outer, polygon.holes).is_valid
        for state in model.states
        for section in state.sections
        for polygon in section.polygons
    )


def _ring(*points: tuple[float, float]) -> Floats:
    return np.array(points, dtype=float)


def _stepped() -> ObjectModel:
    """Two sections that differ, the upper with a hole; a second way to lie."""
    base = Polygon(_ring((-30, -20), (34, -20), (34, 16), (10, 16), (10, 24), (-30, 24)))
    hole = _ring((-6, -6), (-6, 6), (8, 6), (6, -6))
    top = Polygon(_ring((-20, -12), (20, -14), (16, 12), (-18, 10)), (hole,))
    low, high = Section((0, 10), (base,)), Section((10, 25), (top,))
    return ObjectModel(
        "stepped", (State("on-base", (low, high)), State("on-end", (Section((0, 40), (top,)),)))
    )


def _islands() -> ObjectModel:
    """A section of three polygons, one of them with a hole, and a bridge over two of them."""
    left = Polygon(
        _ring((-40, -20), (-10, -20), (-10, 25), (-40, 20)), (_ring((-34, -12), (-18, -12), (-24, 10)),)
    )
    right = Polygon(_ring((4, -24), (30, -20), (24, 4), (8, 0)))
    post = Polygon(_ring((10, 18), (18, 18), (22, 26), (10, 30)))
    bridge = Polygon(_ring((-40, -15), (30, -15), (30, -5), (-40, -5)))
    return ObjectModel(
        "islands", (State("flat", (Section((0, 10), (left, right, post)), Section((10, 20), (bridge,)))),)
    )


def _frame() -> ObjectModel:
    """A ring wide enough for a tip to come down in it."""
    hole = _ring((-32, -22), (-30, 22), (4, 24), (32, 18), (32, -22))
    outer = _ring((-42, -32), (42, -32), (42, 28), (10, 34), (-42, 32))
    return ObjectModel("frame", (State("flat", (Section((0, 20), (Polygon(outer, (hole,)),)),)),))


def _slotted_comb() -> ObjectModel:
    """Slots: an acute one, and ones about as wide as the tips are thick."""
    outline = [
        (-50, -20),
        (50, -20),
        (50, 25),
        (40, 25),
        (40, 0),
        (24, 0),
        (24, 25),
        (12, 25),
        (12, -5),
        (2, -5),
    ]
    return flat("comb", [*outline, (2, 25), (-12, 25), (-18, 0), (-22, 25), (-40, 25), (-43, 8), (-50, 25)])


def _square() -> ObjectModel:
    """Looks the same after every quarter turn."""
    return flat("square", [(-25, -25), (25, -25), (25, 25), (-25, 25)])
