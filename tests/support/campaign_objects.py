"""Objects of the campaign, and how one of them really lies there: displaced within its tolerance.

Used by campaign_trials, which draws them. Families: "memo" (shipped), "parts" (shared outlines), "own" (drawn
here: steps, holes, slots, symmetry), "loose" (some of them with a tolerance), and "drawn": anew for every
grip, by campaign_outlines. A source is one catalogue: a family, or one set of the shared outlines.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
import shapely
from campaign_outlines import KINDS, random_model
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, outlines, unit
from shared_files import SHARED_OUTLINE_SETS

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue

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
        return (_stepped(), _islands(), _frame(), _comb(), _square())
    models = tuple(outlines(SHIPPED_OBJECTS))
    if source == "memo":
        return models
    loose = (*models, _comb(), _frame(), _square())
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


def _comb() -> ObjectModel:
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
