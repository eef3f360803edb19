"""Trials of the campaign and what is checked of each."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import Bools, Floats, ObjectModel
from palpate.base.vocabulary import DEFAULT_BUDGET
from palpate.recognizer import (
    Budget,
    Catalogue,
    Contact,
    Finger,
    Hypothesis,
    NormalRange,
    Recognition,
    recognise,
)
from support.campaign.objects import (
    DRAWN,
    FAMILIES,
    catalogue_of,
    displaced,
    drawn_objects,
    drawn_source,
    objects_of,
    placed_anyhow,
)
from support.oracles.shapely_touches import Placed, edges_of, first_contact, true_normal, turned, unit

# ----------------------------------------------------------------------------------------------------
# Approaches of the campaign: at vertices, along edges, into slots, from the inside, and past everything.

CLEAR_MM = 1e-3  # at least, between a tip and the object where an approach begins
RING_MM, REACH_MM = 160.0, 340.0


def approach_to(
    shape: shapely.Geometry, radius: float, rng: np.random.Generator
) -> tuple[Floats, Floats, float]:
    """Start, unit heading and longest travel: mostly roughly to the middle of the object."""
    kind = rng.choice(
        ["middle", "off", "vertex", "edge", "slot", "inside", "graze"],
        p=[0.45, 0.1, 0.12, 0.1, 0.08, 0.1, 0.05],
    )
    if kind == "inside":
        start = _inside(shape, radius, rng)
        if start is not None:
            return start, unit(_direction(rng)), REACH_MM
    begin, end = edges_of(shape)
    k = int(rng.integers(len(begin)))
    along = (end[k] - begin[k]) / np.linalg.norm(end[k] - begin[k])
    outward = np.array([along[1], -along[0]])
    aside = float(rng.choice([0.0, 0.0, 1.0, -1.0, rng.uniform(-1, 1)])) * radius
    aside += float(rng.choice([0.0, 0.0, 1e-9, -1e-6, 1e-3, -0.1]))
    if kind == "vertex":
        heading = unit(_direction(rng))
        target = begin[k] + aside * np.array([-heading[1], heading[0]])
    elif kind == "edge":
        # Square onto the edge, near its end; or along it, just grazing.
        short = float(rng.choice([0.0, 1e-9, 1e-6, 1e-3, 0.1, 0.5])) * np.linalg.norm(end[k] - begin[k])
        heading, target = (-outward, begin[k] + short * along)
        if rng.random() < 0.3:
            heading, target = along * rng.choice([-1, 1]), begin[k] + aside * outward
    elif kind == "graze":
        lean = float(rng.choice([1e-4, 0.003, 0.02]))
        heading = math.cos(lean) * float(rng.choice([-1, 1])) * along - math.sin(lean) * outward
        target = (begin[k] + end[k]) / 2 + radius * outward
    elif kind == "slot":
        heading, target = _into_slot(begin, end, rng)
    else:
        heading = unit(_direction(rng))
        size = math.sqrt(shape.convex_hull.area)
        off = rng.normal(0.0, 0.2) if kind == "middle" else rng.choice([-1, 1]) * rng.uniform(0.3, 1.0)
        off, centre = off * size, shapely.get_coordinates(shape.centroid)[0]
        target = centre + off * np.array([-heading[1], heading[0]])
    return target - RING_MM * heading, heading, REACH_MM


def _direction(rng: np.random.Generator) -> float:
    if rng.random() < 0.15:
        return float(rng.integers(4)) * math.pi / 2
    return float(rng.uniform(-math.pi, math.pi))


def _inside(shape: shapely.Geometry, radius: float, rng: np.random.Generator) -> Floats | None:
    """A free start in a concavity or a hole: within the convex hull; None if a few tries find none."""
    hull = shape.convex_hull
    low, high = np.array(hull.bounds[:2]), np.array(hull.bounds[2:])
    for point in rng.uniform(low, high, (60, 2)):
        at = shapely.Point(point)
        if hull.contains(at) and shapely.distance(shape, at) > radius + CLEAR_MM:
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
    return unit(angle), begin[k]


# ----------------------------------------------------------------------------------------------------
# Seeded grips of every kind, simulated with shapely alone.
#
# Shared by tests/recognizer/test_campaign.py and benchmarks/bench_completeness.py. A trial (object,
# configuration, grip) depends on nothing but its seed, so that each can be repeated alone. Nothing here is
# shared with the recogniser but the types in which it is asked and answers. What it answers is judged in
# campaign_checks.

BOUNDS_MM = (0.0, 0.01, 0.1, 0.3, 1.0, 2.0)
NORMALS_DEG = (0.0, 1e-4, 1.0, 3.0, 10.0, 25.0, 45.0, 90.0, None)
_NORMALS_SHARES = (0.05, 0.05, 0.15, 0.15, 0.28, 0.12, 0.08, 0.05, 0.07)
RADII_MM = (0.0, 1.0, 5.0, 8.0)
FURTHER_MM = (0.0, 0.0, 0.0, 0.5, 2.0, 5.0)
_SHARES = {"memo": 0.25, "parts": 0.2, "own": 0.12, "loose": 0.08, "drawn": 0.35}
_HEIGHTS_MM = {
    "own": (5.0, 10.0, 18.0),
    "stack": (5.0, 10.0, 18.0),
}  # 10: where two sections meet, both count
_FIRST_TOUCHES, _MOST_MISSES = 2, 3
_COARSE, _FINE = 12, 100  # vertices, from which on only narrow ranges are drawn
_MOST_DRAWS = 40
_WIDE_SHARE = 0.05  # of settings that would be too wide are kept


@dataclass(frozen=True)
class Setting:
    """What a trial is counted under. `kind`: of the object; `normals_deg`: half of the normal range, None if
    nothing is known; `further_mm`: by how much the path's bound is beyond that of the position; `budget`: the
    recogniser's, in units of work.
    """

    family: str
    kind: str
    normals_deg: float | None
    bound_mm: float
    further_mm: float
    radius_mm: float
    tolerance_mm: float
    touches: int
    at_bound: bool
    extended: bool
    budget: int = DEFAULT_BUDGET


@dataclass(frozen=True)
class Trial:
    """One object on the table and what was felt of it; `steps`: the first grip, then those that extend it.

    `model`: the object as the catalogue has it; `placed`: as it is.
    """

    seed: int
    setting: Setting
    source: str
    models: tuple[ObjectModel, ...]
    model: ObjectModel
    placed: Placed
    steps: tuple[tuple[Contact, ...], ...]

    def catalogue(self) -> Catalogue:
        """That of the source, or one for this grip alone."""
        return Catalogue(self.models) if self.source == DRAWN else catalogue_of(self.source)


def drawn(seed: int, families: tuple[str, ...] = FAMILIES) -> Trial:
    """The trial of a seed: its randomness depends on that and on `families` only."""
    rng = np.random.default_rng((705, seed))
    while True:
        trial = _attempt(seed, rng, families)
        if trial is not None:
            return trial


def _attempt(seed: int, rng: np.random.Generator, families: tuple[str, ...]) -> Trial | None:
    """A trial; None if hardly anything touched the object."""
    weight = np.array([_SHARES[name] for name in families])
    family = str(rng.choice(families, p=weight / weight.sum()))
    source = drawn_source(family, rng)
    radius = _radius(rng, family)
    models = drawn_objects(rng, radius) if family == DRAWN else objects_of(source)
    model = models[0] if family == DRAWN else models[int(rng.integers(len(models)))]
    setting = _setting(rng, family, radius, model, _vertices(models))
    placed = placed_anyhow(displaced(model, rng, at_bound=setting.at_bound), rng)
    felt = _felt(placed, setting, rng)
    if felt is None:
        return None
    return Trial(seed, setting, source, models, model, placed, tuple(_steps(felt, setting.extended, rng)))


def _radius(rng: np.random.Generator, family: str) -> float:
    """Edges for a radius are made anew: any one for the few models that are drawn, some for all others."""
    if family == DRAWN and rng.random() < 0.6:
        return float(rng.uniform(0.2, 8.0))
    return float(rng.choice(RADII_MM))


def _vertices(models: tuple[ObjectModel, ...]) -> int:
    return max(
        len(ring) for model in models for section in model.states[0].sections for ring in section.rings
    )


def _setting(
    rng: np.random.Generator, family: str, radius: float, model: ObjectModel, vertices: int
) -> Setting:
    while True:
        touches = int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.03, 0.2, 0.4, 0.22, 0.1, 0.05]))
        setting = Setting(
            family=family,
            kind=model.name if family == DRAWN else family,
            normals_deg=NORMALS_DEG[int(rng.choice(len(NORMALS_DEG), p=_NORMALS_SHARES))],
            bound_mm=float(rng.choice(BOUNDS_MM)),
            further_mm=float(rng.choice(FURTHER_MM)),
            radius_mm=radius,
            tolerance_mm=model.tolerance_mm,
            touches=touches,
            at_bound=bool(rng.random() < 0.5),
            extended=bool(touches > 1 and rng.random() < 0.25),
            budget=DEFAULT_BUDGET if rng.random() < 0.7 else int(10 ** rng.uniform(4.0, 6.0)),
        )
        first = min(touches, _FIRST_TOUCHES) if setting.extended else touches
        if rng.random() < _WIDE_SHARE or not _too_wide(setting, first, vertices):
            return setting


def _too_wide(setting: Setting, first: int, vertices: int) -> bool:
    """Whether `first` touches would leave so much that the budget is spent: most of these are left out.

    What they would show is shown by the few models of other families as well, or with a touch more.
    """
    half = 180.0 if setting.normals_deg is None else setting.normals_deg
    if setting.family == "own":
        return False
    if setting.family == DRAWN:
        if vertices > _FINE:
            return half > 3.0 or setting.bound_mm > 0.1 or first < 2
        loose = first < 3 or setting.bound_mm > 0.3 or setting.tolerance_mm > 0
        return half > (45.0 if vertices <= _COARSE else 10.0) / (3.0 if loose else 1.0)
    if setting.bound_mm > 0.3 and setting.family != "memo" and half > 10.0:
        return True
    if setting.bound_mm > (0.3 if setting.family == "loose" else 1.0):
        return first < 3
    most_of = {1: 10.0, 2: 25.0} if setting.family == "memo" else {1: 3.0, 2: 10.0, 3: 25.0}
    return half > most_of.get(first, 180.0)


def _felt(placed: Placed, setting: Setting, rng: np.random.Generator) -> list[Contact] | None:
    """Approaches until enough of them touched; the misses among them stay, but not too many."""
    contacts: list[Contact] = []
    touches = misses = 0
    for _ in range(_MOST_DRAWS):
        contact = _contact(placed, setting, rng, f"f{len(contacts)}")
        touches, misses = touches + contact.touched, misses + (not contact.touched)
        if contact.touched or misses <= _MOST_MISSES:
            contacts.append(contact)
        if touches == setting.touches:
            return contacts
    return None


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


def _contact(placed: Placed, setting: Setting, rng: np.random.Generator, name: str) -> Contact:
    """One approach, carried out and mismeasured."""
    radius = setting.radius_mm
    if rng.random() < 0.1:
        radius = float(rng.choice(RADII_MM))
    height = float(rng.choice(_HEIGHTS_MM.get(setting.kind, (10.0,))))
    shape = placed.shape_at(height)
    if shape.is_empty:
        start, heading, reach = np.array([RING_MM, 0.0]), np.array([-1.0, 0.0]), REACH_MM
    else:
        start, heading, reach = approach_to(shape, radius, rng)
        while shapely.distance(shape, shapely.Point(start)) <= radius + CLEAR_MM:
            start, heading, reach = approach_to(shape, radius, rng)
    travel = first_contact(shape, start, heading, radius, reach)
    touched = math.isfinite(travel)
    if touched and rng.random() < 0.05:
        # The path ends just before the object, or somewhere on the way to it.
        touched, reach = False, travel * float(rng.choice([1 - 1e-9, 0.999, rng.uniform(0.1, 1.0)]))
    centre = start + (travel if touched else reach) * heading
    end_error = _error(setting.bound_mm, setting.at_bound, rng)
    start_error = end_error
    if setting.further_mm > 0 or rng.random() < 0.4:
        start_error = _error(setting.bound_mm + setting.further_mm, setting.at_bound, rng)
    begin, end = start + start_error, centre + end_error
    return Contact(
        name,
        Finger(radius, height),
        touched,
        (float(begin[0]), float(begin[1])),
        (float(end[0]), float(end[1])),
        setting.bound_mm,
        _normal(shape, centre, radius, setting, rng) if touched else None,
        path_bound_mm=setting.bound_mm + setting.further_mm if setting.further_mm > 0 else None,
    )


def _normal(
    shape: shapely.Geometry, centre: Floats, radius: float, setting: Setting, rng: np.random.Generator
) -> NormalRange | None:
    """A range that holds a true normal, sometimes said a whole turn further on."""
    if setting.normals_deg is None:
        return None
    half = math.radians(setting.normals_deg)
    shift = float(rng.choice([-1, 1])) * half if setting.at_bound else float(rng.uniform(-half, half))
    middle = true_normal(shape, centre, radius, rng) + shift + 2 * math.pi * float(rng.choice([0, 0, 1, -1]))
    return NormalRange(middle - half, middle + half)


def _error(bound: float, at_bound: bool, rng: np.random.Generator) -> Floats:
    size = bound if at_bound else bound * math.sqrt(rng.random())
    return size * unit(rng.uniform(0, 2 * math.pi))


# ----------------------------------------------------------------------------------------------------
# What the recogniser answers to a trial, and whether its truth was lost.

_CELL_SLACK_MM, _CELL_SLACK_RAD = 1e-6, 1e-9
_ROUNDING_MM2 = 1e-9
_ALIKE_MM = 1.001e-3  # what looks the same but for this is the same


@dataclass(frozen=True)
class Outcome:
    """Whether the bounds, and the cells, of some hypothesis held the truth after every step."""

    in_bounds: bool
    in_cells: bool
    hypotheses: int
    verified: int


def asked(trial: Trial) -> list[Recognition]:
    """The recogniser's answer after every step."""
    budget = Budget(trial.setting.budget)
    answers = [recognise(trial.catalogue(), trial.steps[0], budget=budget)]
    for step in trial.steps[1:]:
        answers.append(answers[-1].extend(step))
    return answers


def outcome(trial: Trial, answers: list[Recognition]) -> Outcome:
    """Whether the truth was kept in all answers, and what the last of them says."""
    last = answers[-1].hypotheses
    return Outcome(
        in_bounds=all(_in_bounds(answer, trial.model, trial.placed) for answer in answers),
        in_cells=all(holding_cell(answer, trial.model, trial.placed) is not None for answer in answers),
        hypotheses=len(last),
        verified=sum(item.verified for item in last),
    )


def _in_bounds(recognition: Recognition, model: ObjectModel, placed: Placed) -> bool:
    for item in recognition.hypotheses:
        if item.state.object_name != model.name:
            continue
        bounds = item.bounds
        for x, y, theta in _alike(item, model, placed, *bounds.theta_rad):
            values = ((x, bounds.x_mm), (y, bounds.y_mm), (theta, bounds.theta_rad))
            if all(lo <= value <= hi for value, (lo, hi) in values):
                return True
    return False


def holding_cell(recognition: Recognition, model: ObjectModel, placed: Placed) -> Hypothesis | None:
    """The hypothesis that has the true configuration, or one that looks the same, in a cell; None if lost.

    Sharper than its bounds: a cell holds positions s = R(−θ)(p − anchor) of the centroid in a polygon, for θ
    in an interval (`Cells`).
    """
    for item in recognition.hypotheses:
        if item.state.object_name != model.name:
            continue
        centre, cells = item.state.origin_mm, item.cells
        for x, y, theta in _alike(item, model, placed, float(cells.lo.min()), float(cells.hi.max())):
            turns = (cells.lo - _CELL_SLACK_RAD <= theta) & (theta <= cells.hi + _CELL_SLACK_RAD)
            if not turns.any():
                continue
            away = np.array([x, y]) - recognition.anchor_mm
            cos, sin = math.cos(theta), math.sin(theta)
            seen = np.array([cos * away[0] + sin * away[1], cos * away[1] - sin * away[0]])
            if in_polygons(cells.polygon[turns], centre + seen).any():
                return item
    return None


def _alike(
    item: Hypothesis, model: ObjectModel, placed: Placed, lo: float, hi: float
) -> Iterator[tuple[float, float, float]]:
    """(x, y, θ) of the object with θ in [lo, hi], turned about its centre so that it looks the same.

    The recogniser says by which turns; that these are true is for shapely to say.
    """
    centre, step = item.state.origin_mm, 2 * math.pi / item.state.symmetry_order
    at = placed.on_table(centre)
    first = math.ceil((lo - placed.theta - _CELL_SLACK_RAD) / step)
    last = math.floor((hi - placed.theta + _CELL_SLACK_RAD) / step)
    for count in range(first, last + 1):
        if looks_alike(model, centre, count * step):
            theta = placed.theta + count * step
            x, y = at - turned(centre, theta)
            yield float(x), float(y), theta


def looks_alike(model: ObjectModel, centre: Floats, angle: float) -> bool:
    """Whether no boundary is off by more than a micrometre or so after a turn about `centre` (2,)."""
    if abs(math.remainder(angle, 2 * math.pi)) < _CELL_SLACK_RAD:
        return True
    for section in model.states[0].sections:
        edge = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in section.polygons]).boundary
        image = affinity.rotate(edge, angle, origin=(centre[0], centre[1]), use_radians=True)
        if shapely.hausdorff_distance(edge, image) > _ALIKE_MM:
            return False
    return True


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
