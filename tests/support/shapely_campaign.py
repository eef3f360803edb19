"""Seeded grips of every kind, simulated with shapely alone, and the question whether their truth was lost.

Shared by tests/recognizer/test_campaign.py and benchmarks/campaign.py. A trial (object, configuration, grip)
depends on nothing but (seed, index), so that each can be repeated alone. Nothing here is shared with the
recogniser but the types in which it is asked and answers.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import shapely
from shapely_bench import (
    SHARED_OUTLINES,
    SHIPPED_OBJECTS,
    Placed,
    equivalent_configurations,
    flat,
    holding_truth,
    outlines,
)

from palpate.recognizer import (
    Catalogue,
    Contact,
    Finger,
    Hypothesis,
    NormalRange,
    ObjectModel,
    Polygon,
    Recognition,
    Section,
    State,
    recognise,
)
from palpate.recognizer.arrays import Bools, Floats

BOUNDS_MM = (0.0, 0.01, 0.1, 0.3, 1.0, 2.0)
NORMALS_DEG = (1.0, 3.0, 10.0, 25.0, 45.0, 90.0, None)
_NORMALS_SHARES = (0.17, 0.17, 0.3, 0.14, 0.1, 0.05, 0.07)
RADII_MM = (0.0, 1.0, 5.0, 8.0)
FAMILIES = ("memo", "parts", "own", "loose")
TOLERANCE_MM = 0.25  # of the family "loose"
_SHARES = {"memo": 0.4, "parts": 0.35, "own": 0.15, "loose": 0.1}
_HEIGHTS_MM = {"own": (5.0, 10.0, 18.0)}  # 10: where two sections meet, both count
_FIRST_TOUCHES, _MOST_MISSES = 2, 3
_GRAZING_MM = 3e-9  # no approach is drawn to pass at just this distance
_CLEAR_MM = 1e-3  # at least, between a tip and the object where an approach begins
_RING_MM, _REACH_MM = 160.0, 340.0
_CELL_SLACK_MM, _CELL_SLACK_RAD = 1e-6, 1e-9


@dataclass(frozen=True)
class Setting:
    """What a trial is counted under. `normals_deg`: half of the normal range, None if nothing is known."""

    family: str
    normals_deg: float | None
    bound_mm: float
    radius_mm: float
    touches: int
    at_bound: bool
    extended: bool


@dataclass(frozen=True)
class Trial:
    """One object on the table and what was felt of it; `steps`: the first grip, then those that extend it."""

    index: int
    setting: Setting
    placed: Placed
    steps: tuple[tuple[Contact, ...], ...]


@dataclass(frozen=True)
class Outcome:
    """Whether the bounds, and the cells, of some hypothesis held the truth after every step."""

    in_bounds: bool
    in_cells: bool
    hypotheses: int
    verified: int


def objects_of(family: str) -> list[ObjectModel]:
    """The models of a family: shipped, shared outlines, own ones, or some of them with a tolerance."""
    if family == "parts":
        return outlines(SHARED_OUTLINES)
    if family == "own":
        return [_stepped(), _islands(), _frame(), _comb(), _square()]
    models = outlines(SHIPPED_OBJECTS)
    if family == "memo":
        return models
    return [replace(model, tolerance_mm=TOLERANCE_MM) for model in [*models, _comb(), _frame(), _square()]]


@cache
def catalogue_of(family: str) -> Catalogue:
    """Built once in each process."""
    return Catalogue(objects_of(family))


def asked(trial: Trial) -> list[Recognition]:
    """The recogniser's answer after every step."""
    answers = [recognise(catalogue_of(trial.setting.family), trial.steps[0])]
    for step in trial.steps[1:]:
        answers.append(answers[-1].extend(step))
    return answers


def outcome(trial: Trial, answers: list[Recognition]) -> Outcome:
    """Whether the truth was kept in all answers, and what the last of them says."""
    last = answers[-1].hypotheses
    return Outcome(
        in_bounds=all(holding_truth(answer, trial.placed) is not None for answer in answers),
        in_cells=all(holding_cell(answer, trial.placed) is not None for answer in answers),
        hypotheses=len(last),
        verified=sum(item.verified for item in last),
    )


def holding_cell(recognition: Recognition, placed: Placed) -> Hypothesis | None:
    """The hypothesis that has the true configuration, or a symmetric one, in a cell; None if lost.

    Sharper than its bounds: a cell holds positions s = R(−θ)(p − anchor) of the centroid in a polygon, for θ
    in an interval (`Cells`).
    """
    for item in recognition.hypotheses:
        if item.state.object_name != placed.model.name:
            continue
        centre, cells = item.state.origin_mm, item.cells
        for x, y, theta in equivalent_configurations(placed, item.state.symmetry_order, centre):
            turns = (cells.lo - _CELL_SLACK_RAD <= theta) & (theta <= cells.hi + _CELL_SLACK_RAD)
            if not turns.any():
                continue
            away = np.array([x, y]) - recognition.anchor_mm
            cos, sin = math.cos(theta), math.sin(theta)
            seen = np.array([cos * away[0] + sin * away[1], cos * away[1] - sin * away[0]])
            position = centre + seen
            if in_polygons(cells.polygon[turns], position).any():
                return item
    return None


_ROUNDING_MM2 = 1e-9


def in_polygons(polygon: Floats, point: Floats) -> Bools:
    """Which convex polygons (k, v, 2), counter-clockwise and maybe flat, hold a point, give or take.

    `point`: the same for all, (2,), or one for each, (k, 1, 2).
    """
    leg = np.roll(polygon, -1, axis=1) - polygon
    away = point - polygon
    # Corners that are one but for rounding make a leg of no length, to which nothing is left or right.
    left = leg[..., 0] * away[..., 1] - leg[..., 1] * away[..., 0] >= -_ROUNDING_MM2
    square = np.maximum(np.sum(leg * leg, axis=2), 1e-300)
    along = np.clip(np.sum(leg * away, axis=2) / square, 0.0, 1.0)
    gap = np.linalg.norm(away - along[..., None] * leg, axis=2).min(axis=1)
    solid = np.any(np.abs(polygon - polygon[:, :1]) > _CELL_SLACK_MM, axis=(1, 2))
    result: Bools = (left.all(axis=1) & solid) | (gap <= _CELL_SLACK_MM)
    return result


def drawn(seed: int, index: int, families: tuple[str, ...] = FAMILIES) -> Trial:
    """Trial `index` of a campaign: its randomness depends on (seed, index) and on `families` only."""
    rng = np.random.default_rng((seed, index))
    weight = np.array([_SHARES[name] for name in families])
    family = str(rng.choice(families, p=weight / weight.sum()))
    setting = _setting(rng, family)
    models = _models(family)
    model = models[int(rng.integers(len(models)))]
    placed = _placed(displaced(model, rng), rng)
    felt = _felt(placed, setting, rng)
    return Trial(index, setting, placed, tuple(_steps(felt, setting.extended, rng)))


@cache
def _models(family: str) -> list[ObjectModel]:
    return objects_of(family)


def _setting(rng: np.random.Generator, family: str) -> Setting:
    while True:
        touches = int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.03, 0.2, 0.4, 0.22, 0.1, 0.05]))
        setting = Setting(
            family=family,
            normals_deg=NORMALS_DEG[int(rng.choice(len(NORMALS_DEG), p=_NORMALS_SHARES))],
            bound_mm=float(rng.choice(BOUNDS_MM)),
            radius_mm=float(rng.choice(RADII_MM)),
            touches=touches,
            at_bound=bool(rng.random() < 0.5),
            extended=bool(touches > 1 and rng.random() < 0.25),
        )
        if not _too_wide(setting, min(touches, _FIRST_TOUCHES) if setting.extended else touches):
            return setting


def _too_wide(setting: Setting, first: int) -> bool:
    """Whether `first` touches would leave so much that the answer takes seconds: kept out by design.

    What they would show is shown by the few models of the family "own" as well, or with a touch more.
    """
    half = 180.0 if setting.normals_deg is None else setting.normals_deg
    if setting.family == "own":
        return False
    if setting.bound_mm > 0.3 and setting.family != "memo" and half > 10.0:
        return True
    if setting.bound_mm > (0.3 if setting.family == "loose" else 1.0):
        return first < 3
    most = {1: 10.0, 2: 25.0} if setting.family == "memo" else {1: 3.0, 2: 10.0, 3: 25.0}
    return half > most.get(first, 180.0)


def _felt(placed: Placed, setting: Setting, rng: np.random.Generator) -> list[Contact]:
    """Approaches until enough of them touched; the misses among them stay, but not too many."""
    contacts: list[Contact] = []
    touches = misses = 0
    while touches < setting.touches:
        contact = _contact(placed, setting, rng, f"f{len(contacts)}")
        touches, misses = touches + contact.touched, misses + (not contact.touched)
        if contact.touched or misses <= _MOST_MISSES:
            contacts.append(contact)
    return contacts


def _steps(
    contacts: list[Contact], extended: bool, rng: np.random.Generator
) -> Iterator[tuple[Contact, ...]]:
    """All at once, or the first few touches and then the other contacts in one or two more grips."""
    touched = [k for k, contact in enumerate(contacts) if contact.touched]
    first = 1 + touched[min(_FIRST_TOUCHES, len(touched)) - 1]
    if not extended or first >= len(contacts):
        yield tuple(contacts)
        return
    cuts = sorted({0, len(contacts), *(int(v) for v in rng.integers(first, len(contacts), 2))})
    for begin, end in pairwise(cuts):
        yield tuple(contacts[begin:end])


def _placed(model: ObjectModel, rng: np.random.Generator) -> Placed:
    """Anywhere near the middle and turned anyhow; often at a quarter turn exactly, or next to one."""
    theta = float(rng.uniform(-math.pi, math.pi))
    if rng.random() < 0.35:
        beside = float(rng.choice([0.0, 0.0, 0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2])) * float(
            rng.choice([-1, 1])
        )
        theta = float(rng.choice([0.0, math.pi / 2, -math.pi / 2, math.pi, -math.pi])) + beside
    x, y = (0.0, 0.0) if rng.random() < 0.1 else (float(v) for v in rng.uniform(-15.0, 15.0, 2))
    return Placed(model, x, y, theta)


def displaced(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """The true object: its outline is off the model's by up to the tolerance, often by all of it somewhere.

    Moved as a whole, or scaled, or every vertex moved on its own as long as nothing crosses.
    """
    tolerance = model.tolerance_mm
    if tolerance == 0.0 or rng.random() < 0.2:
        return model
    size = tolerance if rng.random() < 0.5 else float(rng.uniform(0.0, tolerance))
    points = np.concatenate(list(_rings_of(model)))
    reach = float(np.max(np.linalg.norm(points, axis=1)))
    kind = int(rng.integers(3))
    angle = rng.uniform(0, 2 * math.pi)
    for _ in range(20):
        if kind == 0:
            shift = size * np.array([math.cos(angle), math.sin(angle)])
            moved = _mapped(model, lambda ring: ring + shift)  # noqa: B023 - used at once
        elif kind == 1:
            factor = 1.0 + float(rng.choice([-1, 1])) * size / reach
            moved = _mapped(model, lambda ring: ring * factor)  # noqa: B023 - used at once
        else:
            moved = _mapped(model, lambda ring: ring + _jitter(rng, len(ring), size))
        if all(
            shapely.Polygon(polygon.outer, polygon.holes).is_valid
            for state in moved.states
            for section in state.sections
            for polygon in section.polygons
        ):
            return moved
    return model


def _jitter(rng: np.random.Generator, count: int, size: float) -> Floats:
    angle = rng.uniform(0, 2 * math.pi, count)
    result: Floats = size * np.column_stack([np.cos(angle), np.sin(angle)])
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


def _contact(placed: Placed, setting: Setting, rng: np.random.Generator, name: str) -> Contact:
    """One approach, carried out and mismeasured."""
    radius = setting.radius_mm if rng.random() < 0.9 else float(rng.choice(RADII_MM))
    height = float(rng.choice(_HEIGHTS_MM.get(setting.family, (10.0,))))
    shape = placed.shape_at(height)
    if shape.is_empty:
        start, heading, reach = np.array([_RING_MM, 0.0]), np.array([-1.0, 0.0]), _REACH_MM
    else:
        start, heading, reach = _approach(shape, radius, rng)
        while shapely.distance(shape, shapely.Point(start)) <= radius + _CLEAR_MM:
            start, heading, reach = _approach(shape, radius, rng)
    travel = first_contact(shape, start, heading, radius, reach)
    touched = math.isfinite(travel)
    if touched and rng.random() < 0.05:
        # The path ends just before the object, or somewhere on the way to it.
        touched, reach = False, travel * float(rng.choice([1 - 1e-9, 0.999, rng.uniform(0.1, 1.0)]))
    centre = start + (travel if touched else reach) * heading
    bound = setting.bound_mm
    end_error = _error(bound, setting.at_bound, rng)
    start_error = end_error if rng.random() < 0.6 else _error(bound, setting.at_bound, rng)
    normal = None
    if touched and setting.normals_deg is not None:
        half = math.radians(setting.normals_deg)
        shift = float(rng.choice([-1, 1])) * half if setting.at_bound else float(rng.uniform(-half, half))
        middle = true_normal(shape, centre, heading, radius, rng) + shift
        normal = NormalRange(middle - half, middle + half)
    begin, end = start + start_error, centre + end_error
    return Contact(
        name,
        Finger(radius, height),
        touched,
        (float(begin[0]), float(begin[1])),
        (float(end[0]), float(end[1])),
        bound,
        normal,
        path_bound_mm=bound + float(rng.uniform(0.0, 0.5)) if rng.random() < 0.1 else None,
    )


def _error(bound: float, at_bound: bool, rng: np.random.Generator) -> Floats:
    size = bound if at_bound else bound * math.sqrt(rng.random())
    angle = rng.uniform(0, 2 * math.pi)
    return size * np.array([math.cos(angle), math.sin(angle)])


def first_contact(
    shape: shapely.Geometry, start: Floats, heading: Floats, radius: float, reach: float
) -> float:
    """Travel at which a disc on a straight path first touches the shape; infinite if it passes by.

    The distance of the path so far to the shape only falls with the travel: halving finds where it reaches
    the radius, however flatly the path grazes the shape. Give or take: GEOS may take a path through a
    vertex for one that passes it 1e-15 mm away.
    """

    def met(travel: float) -> bool:
        path = shapely.LineString([start, start + travel * heading])
        return bool(shapely.distance(shape, path) <= radius + _GRAZING_MM)

    if not met(reach):
        return math.inf
    free, touching = 0.0, reach
    while touching - free > 1e-12 * reach:
        middle = (free + touching) / 2
        free, touching = (free, middle) if met(middle) else (middle, touching)
    return touching


def true_normal(
    shape: shapely.Geometry, centre: Floats, heading: Floats, radius: float, rng: np.random.Generator
) -> float:
    """Direction of an outward normal where a tip at `centre` touches.

    For a disc: of the edge that it is on, or from the vertex that it is at (shapely's nearest point is not
    exact enough near the end of an edge). For a point (r = 0): of the edge that it is on; at a vertex, of
    either of the two edges there, drawn from those against which the tip moved. The cone between the two is
    not drawn from, because the recogniser pairs a point with edges only.
    """
    begin, end = edges_of(shape)
    along = end - begin
    away = centre - begin
    free = np.sum(away * along, axis=1) / np.sum(along * along, axis=1)
    from_foot = away - np.clip(free, 0.0, 1.0)[:, None] * along
    gap = np.linalg.norm(from_foot, axis=1)
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    if radius > 0:
        near = np.flatnonzero(gap <= gap.min() + 1e-12)
        faced = near[(free[near] >= 0.0) & (free[near] <= 1.0)]
        normal = outward[faced[0]] if len(faced) else from_foot[near[0]]
    else:
        against = outward @ heading / np.linalg.norm(outward, axis=1)
        near = np.flatnonzero(gap <= gap.min() + 2 * _GRAZING_MM)
        facing = near[against[near] < 0]
        normal = outward[rng.choice(facing) if len(facing) else near[np.argmin(against[near])]]
    return math.atan2(normal[1], normal[0])


def edges_of(shape: shapely.Geometry) -> tuple[Floats, Floats]:
    """Begins and ends (n, 2) of all edges of a shape, the solid on their left."""
    begins, ends = [], []
    for part in shapely.get_parts(shape):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            points = shapely.get_coordinates(ring)
            begins.append(points[:-1])
            ends.append(points[1:])
    return np.concatenate(begins), np.concatenate(ends)


def _approach(
    shape: shapely.Geometry, radius: float, rng: np.random.Generator
) -> tuple[Floats, Floats, float]:
    """Start, unit heading and longest travel: mostly roughly to the middle of the object."""
    kind = rng.choice(
        ["middle", "off", "vertex", "edge", "slot", "inside"], p=[0.5, 0.1, 0.12, 0.1, 0.08, 0.1]
    )
    if kind == "inside":
        start = _inside(shape, radius, rng)
        if start is not None:
            return start, _unit(_direction(rng)), _REACH_MM
    begin, end = edges_of(shape)
    k = int(rng.integers(len(begin)))
    along = (end[k] - begin[k]) / np.linalg.norm(end[k] - begin[k])
    outward = np.array([along[1], -along[0]])
    aside = float(rng.choice([0.0, 0.0, 1.0, -1.0, rng.uniform(-1, 1)])) * radius
    aside += float(rng.choice([0.0, 0.0, 1e-9, -1e-6, 1e-3, -0.1]))
    if kind == "vertex":
        heading = _unit(_direction(rng))
        target = begin[k] + aside * np.array([-heading[1], heading[0]])
    elif kind == "edge":
        # Square onto the edge, near its end; or along it, just grazing.
        short = float(rng.choice([0.0, 1e-9, 1e-6, 1e-3, 0.1, 0.5])) * np.linalg.norm(end[k] - begin[k])
        heading, target = (-outward, begin[k] + short * along)
        if rng.random() < 0.3:
            heading, target = along * rng.choice([-1, 1]), begin[k] + aside * outward
    elif kind == "slot":
        heading, target = _into_slot(begin, end, rng)
    else:
        heading = _unit(_direction(rng))
        size = math.sqrt(shape.convex_hull.area)
        off = rng.normal(0.0, 0.2) if kind == "middle" else rng.choice([-1, 1]) * rng.uniform(0.3, 1.0)
        off, centre = off * size, shapely.get_coordinates(shape.centroid)[0]
        target = centre + off * np.array([-heading[1], heading[0]])
    return target - _RING_MM * heading, heading, _REACH_MM


def _direction(rng: np.random.Generator) -> float:
    if rng.random() < 0.15:
        return float(rng.integers(4)) * math.pi / 2
    return float(rng.uniform(-math.pi, math.pi))


def _unit(angle: float) -> Floats:
    return np.array([math.cos(angle), math.sin(angle)])


def _inside(shape: shapely.Geometry, radius: float, rng: np.random.Generator) -> Floats | None:
    """A free start in a concavity or a hole: within the convex hull; None if a few tries find none."""
    hull = shape.convex_hull
    low, high = np.array(hull.bounds[:2]), np.array(hull.bounds[2:])
    for point in rng.uniform(low, high, (60, 2)):
        at = shapely.Point(point)
        if hull.contains(at) and shapely.distance(shape, at) > radius + _CLEAR_MM:
            return np.asarray(point)
    return None


def _into_slot(begin: Floats, end: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Heading roughly along the bisector of a reflex vertex, and that vertex; any if none is reflex."""
    before, after = begin - np.roll(begin, 1, axis=0), end - begin
    joined = np.all(np.roll(end, 1, axis=0) == begin, axis=1)
    reflex = np.flatnonzero(joined & (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < 0))
    k = int(rng.choice(reflex)) if len(reflex) else int(rng.integers(len(begin)))
    into = before[k] / np.linalg.norm(before[k]) - after[k] / np.linalg.norm(after[k])
    angle = math.atan2(into[1], into[0]) + float(rng.choice([0.0, rng.normal(0.0, 0.1)]))
    return _unit(angle), begin[k]


def _ring(*points: tuple[float, float]) -> Floats:
    return np.array(points, dtype=float)


def _stepped() -> ObjectModel:
    """Two sections that differ, the upper with a hole; a second way to lie."""
    base = Polygon(_ring((-30, -20), (34, -20), (34, 16), (10, 16), (10, 24), (-30, 24)))
    hole = _ring((-6, -6), (-6, 6), (8, 6), (6, -6))
    top = Polygon(_ring((-20, -12), (20, -14), (16, 12), (-18, 10)), (hole,))
    low, high = Section(0, 10, (base,)), Section(10, 25, (top,))
    return ObjectModel("stepped", (State("on-base", (low, high)), State("on-end", (Section(0, 40, (top,)),))))


def _islands() -> ObjectModel:
    """A section of three polygons, one of them with a hole, and a bridge over two of them."""
    left = Polygon(
        _ring((-40, -20), (-10, -20), (-10, 25), (-40, 20)), (_ring((-34, -12), (-18, -12), (-24, 10)),)
    )
    right = Polygon(_ring((4, -24), (30, -20), (24, 4), (8, 0)))
    post = Polygon(_ring((10, 18), (18, 18), (22, 26), (10, 30)))
    bridge = Polygon(_ring((-40, -15), (30, -15), (30, -5), (-40, -5)))
    return ObjectModel(
        "islands", (State("flat", (Section(0, 10, (left, right, post)), Section(10, 20, (bridge,)))),)
    )


def _frame() -> ObjectModel:
    """A ring wide enough for a tip to come down in it."""
    hole = _ring((-32, -22), (-30, 22), (4, 24), (32, 18), (32, -22))
    outer = _ring((-42, -32), (42, -32), (42, 28), (10, 34), (-42, 32))
    return ObjectModel("frame", (State("flat", (Section(0, 20, (Polygon(outer, (hole,)),)),)),))


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
