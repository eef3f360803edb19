"""Objects that are not quite as modelled: vertices off by up to the tolerance, and the truth is kept.

The catalogue holds the nominal outline, shapely simulates on the displaced one. Every seed is fixed.
"""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import shapely

from palpate.base.geometry import ObjectModel
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.recognition import recognise
from support.campaign.sampling import sample
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    holding_truth,
    outlines,
    place,
    touch,
    with_normal,
)

TOLERANCES = (0.05, 0.2, 0.5)
BOUNDS = (0.0, 0.05, 0.3)
HALF_RANGES = (math.radians(1), math.radians(10), None)
STEEP = math.radians(2)


def outline_of(model: ObjectModel) -> np.ndarray:
    return model.states[0].sections[0].polygons[0].outer


def displaced(model: ObjectModel, rng: np.random.Generator, *, exactly: bool) -> ObjectModel:
    """The same object with each vertex moved anyhow by up to, or by exactly, the tolerance."""
    nominal = outline_of(model)
    angle = rng.uniform(0, 2 * math.pi, len(nominal))
    size = np.full(len(nominal), 1 - 1e-12) if exactly else np.sqrt(rng.uniform(size=len(nominal)))
    by = model.tolerance_mm * size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return flat(model.name, nominal + by)


def inflated(model: ObjectModel, sign: float) -> ObjectModel:
    """The same object with every vertex moved outward, or inward, by the tolerance along its bisector."""
    nominal = outline_of(model)
    along = np.roll(nominal, -1, axis=0) - nominal
    along = along / np.hypot(*along.T)[:, None]
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    twice_area = np.sum(
        nominal[:, 0] * np.roll(nominal[:, 1], -1) - nominal[:, 1] * np.roll(nominal[:, 0], -1)
    )
    bisector = normal + np.roll(normal, 1, axis=0)
    bisector = bisector / np.hypot(*bisector.T)[:, None]
    by = sign * math.copysign(model.tolerance_mm * (1 - 1e-12), twice_area)
    return flat(model.name, nominal + by * bisector)


def mismeasured(contact: Contact, rng: np.random.Generator, bound: float, *, at_bound: bool) -> Contact:
    """The exact contact, moved as a whole by up to, or by exactly, its bound."""
    angle, size = rng.uniform(0, 2 * math.pi), bound * (1.0 if at_bound else rng.uniform())
    shift = size * (1 - 1e-12) * np.array([math.cos(angle), math.sin(angle)])
    start, end = (tuple((np.array(p) + shift).tolist()) for p in (contact.start_mm, contact.end_mm))
    return replace(contact, start_mm=start, end_mm=end, position_bound_mm=bound)


def is_kept(
    catalogue: Catalogue,
    true: Placed,
    exact: list[Contact],
    rng: np.random.Generator,
    *,
    bound: float,
    half_range: float | None,
    at_bound: bool,
) -> bool | None:
    """Whether the answer for these touches holds the truth; None where none of them touched."""
    if not any(contact.touched for contact in exact):
        return None
    contacts = []
    for contact in exact:
        shift = (half_range or 0.0) * (rng.choice([-1, 1]) if at_bound else rng.uniform(-1, 1))
        given = with_normal(true, contact, half_range, shift)
        contacts.append(mismeasured(given, rng, bound, at_bound=at_bound))
    return holding_truth(recognise(catalogue, contacts), true) is not None


def aimed(
    true: Placed,
    rng: np.random.Generator,
    targets: np.ndarray,
    directions: np.ndarray,
    *,
    radius: float,
    half_range: float | None,
    at_bound: bool,
) -> list[Contact]:
    """Approaches from outside through points (n, 2) of the object's frame, along directions (n,) in it."""
    cos, sin = math.cos(true.theta), math.sin(true.theta)
    turn = np.array([[cos, -sin], [sin, cos]])
    contacts = []
    for k, (target, direction) in enumerate(zip(targets, directions, strict=True)):
        ahead = direction + true.theta
        start = turn @ target + (true.x, true.y) - 120 * np.array([math.cos(ahead), math.sin(ahead)])
        contacts.append(
            touch(
                true.shape,
                rng,
                radius=radius,
                bound=0.0,
                half_range=half_range,
                direction=float(ahead),
                start=start,
                reach=240.0,
                at_bound=at_bound,
                name=f"f{k}",
            )
        )
    return contacts


def short_edged(step: float) -> ObjectModel:
    """A circle with a wave in steps of about `step` mm: each edge tilts a lot under the tolerance."""
    count = round(2 * math.pi * 25 / step)
    a = 2 * np.pi * np.arange(count) / count
    ring = (25 + 4 * np.sin(3 * a + 1) + 2 * np.cos(5 * a))[:, None] * np.column_stack([np.cos(a), np.sin(a)])
    return flat(f"steps of {step}", ring)


def spiked() -> ObjectModel:
    """Sharp convex and concave vertices."""
    ring = [
        (-30, -20),
        (-4, -20),
        (0, 8),
        (4, -20),
        (30, -20),
        (60, -18),
        (30, -16),
        (26, 20),
        (0, 24),
        (-55, 4),
    ]
    return flat("spiked", ring)


def notched(width: float, depth: float, slope: float, name: str = "notched") -> ObjectModel:
    """A block with a notch in its upper side: `width` at the floor, walls leaning outward by `slope`."""
    open_half = width / 2 + depth * math.tan(slope)
    ring = [
        (-35, -20),
        (30, -20),
        (30, 18),
        (open_half, 18),
        (width / 2, 18 - depth),
        (-width / 2, 18 - depth),
        (-open_half, 18),
        (-35, 14),
    ]
    return flat(name, ring)


NOTCHES = list(product([1.0, 5.0, 8.0], [0.0, STEEP, math.radians(20)]))


def into_notch(rng: np.random.Generator, fingers: int) -> tuple[np.ndarray, np.ndarray]:
    """Targets and directions: two fingers into the notch, the others against the sides."""
    targets = [(rng.uniform(-0.6, 0.6), 18.0), (rng.uniform(-5, 5), 18.0), (0.0, rng.uniform(-15, 10))]
    directions = [-math.pi / 2 + rng.uniform(-0.03, 0.03), -math.pi / 2, rng.choice([0.0, math.pi])]
    for _ in range(fingers - 3):
        targets.append((rng.uniform(-25, 25), 0.0))
        directions.append(math.pi / 2)
    return np.array(targets), np.array(directions)


@pytest.mark.parametrize(("radius", "slope"), sample(NOTCHES, NOTCHES[::8]))
def test_notches_about_as_wide_as_the_finger(radius: float, slope: float) -> None:
    """True notches wider and narrower than modelled: a finger enters where the model is shut, or stops."""
    rng = np.random.default_rng(int(10 * radius + 100 * slope))
    tried, lost = 0, []
    for tolerance in TOLERANCES:
        for over in (-2.0, -1.0, -0.1, 0.0, 0.1, 1.0, 2.0):
            width = 2 * radius + over * tolerance
            nominal = replace(notched(width, 10.0, slope), tolerance_mm=tolerance)
            catalogue = Catalogue([nominal])
            for kind in range(4):
                at_bound = bool(kind % 2)
                model = (
                    notched(width + 2 * (1.0 - 2 * kind) * tolerance * (1 - 1e-9), 10.0, slope)
                    if kind < 2
                    else displaced(nominal, rng, exactly=at_bound)
                )
                true = place(model, rng)
                bound, half_range = BOUNDS[kind % 3], HALF_RANGES[int(rng.integers(3))]
                targets, directions = into_notch(rng, 3 + kind % 2)
                exact = aimed(
                    true, rng, targets, directions, radius=radius, half_range=half_range, at_bound=at_bound
                )
                kept = is_kept(
                    catalogue, true, exact, rng, bound=bound, half_range=half_range, at_bound=at_bound
                )
                tried += kept is not None
                if kept is False:
                    lost.append((tolerance, over, kind, bound, half_range))
    assert tried > 70
    assert lost == []


def touches(outline: np.ndarray, radius: float, step: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 2) and outward normals (n,) of all ways in which a disc may rest on an outline, sampled."""
    closed = np.vstack([outline, outline[:1]])
    if np.sum(closed[:-1, 0] * closed[1:, 1] - closed[:-1, 1] * closed[1:, 0]) < 0:
        outline = outline[::-1]
    along = np.roll(outline, -1, axis=0) - outline
    facing = np.arctan2(-along[:, 0], along[:, 1])
    centres, normals = [], []
    for k, point in enumerate(outline):
        part = np.linspace(1e-9, 1 - 1e-9, max(3, int(np.hypot(*along[k]) / step)))
        unit = np.array([math.cos(facing[k]), math.sin(facing[k])])
        centres.append(point + part[:, None] * along[k] + radius * unit)
        normals.append(np.full(len(part), facing[k]))
        turn = math.remainder(facing[k] - facing[k - 1], 2 * math.pi)
        if turn > 0 and radius > 0:
            angle = facing[k - 1] + turn * np.linspace(0, 1, int(radius * turn / step) + 3)
            centres.append(point + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
            normals.append(angle)
    centre, normal = np.vstack(centres), np.concatenate(normals)
    free = shapely.distance(shapely.Polygon(outline), shapely.points(centre)) >= radius - 1e-9
    return centre[free], normal[free]


def on_no_edge(nominal: ObjectModel, true: ObjectModel, radius: float) -> int:
    """How many touches of the true outline no edge of the nominal one allows, by position and normal."""
    catalogue = Catalogue([nominal])
    edges, origin = catalogue.edges(Finger(radius, 10.0)), catalogue.origins_mm[0]
    centre, normal = touches(outline_of(true), radius)
    missing = 0
    for some in np.array_split(np.arange(len(centre)), len(centre) // 500 + 1):
        rel = centre[some, None] - origin - edges.start
        along = np.einsum("mnj,nj->mn", rel, edges.direction)
        height = np.einsum("mnj,nj->mn", rel, edges.normal)
        fits = (height <= edges.slack_out + 1e-7) & (height >= -edges.slack_in - 1e-7)
        fits &= (along >= -edges.slack_along - 1e-7) & (along <= edges.length + edges.slack_along + 1e-7)
        fits &= np.abs(wrap_angle(normal[some, None] - edges.normal_rad)) <= edges.span + 1e-7
        missing += int(np.sum(~fits.any(axis=1)))
    return missing


def shapes() -> list[ObjectModel]:
    notches = [notched(10.0, 10.0, 0.0), notched(10.0, 10.0, 0.3), notched(16.0, 12.0, 0.1)]
    return [*outlines(SHIPPED_OBJECTS), spiked(), short_edged(2.0), *notches]


@pytest.mark.parametrize("radius", [0.0, 1.0, 4.9, 7.9])
def test_every_touch_of_an_exact_outline_is_on_an_edge(radius: float) -> None:
    assert [on_no_edge(model, model, radius) for model in shapes()] == [0] * len(shapes())


@pytest.mark.parametrize("last", sample([1, len(TOLERANCES)], [1]))
@pytest.mark.parametrize("radius", sample([1.0, 8.0], [8.0]))
def test_every_touch_of_a_displaced_outline_is_on_an_edge(radius: float, last: int) -> None:
    rng = np.random.default_rng(81)
    missing = {}
    for nominal in shapes():
        for tolerance in TOLERANCES[-last:]:
            model = replace(nominal, tolerance_mm=tolerance)
            draws = 12 if nominal.name == "notched" else 3
            for true in (inflated(model, -1.0), *(displaced(model, rng, exactly=True) for _ in range(draws))):
                if shapely.Polygon(outline_of(true)).is_valid and (count := on_no_edge(model, true, radius)):
                    missing[nominal.name, tolerance] = count
    assert missing == {}


def trapezoid(radius: float, turn: float) -> np.ndarray:
    """A block with a notch that just lets a disc down to its floor at y = 0; walls turn up from it."""
    half = (radius + 0.01) * math.tan(turn / 2)
    far = half + 15.0 / math.tan(turn)
    lower = [(-60, -40), (50, -40), (50, 15), (far, 15), (half, 0), (-half, 0), (-far, 15), (-60, 9)]
    return np.array(lower, dtype=float)


@pytest.mark.parametrize(("radius", "tolerance"), [(1.0, 0.05), (5.0, 0.2), (8.0, 0.5)])
def test_a_floor_that_the_model_hides(radius: float, tolerance: float) -> None:
    """In the model the walls stand a little further in, well within the tolerance."""
    outline = trapezoid(radius, math.radians(60))
    modelled = outline.copy()
    modelled[3:5, 0] -= 0.8 * tolerance
    modelled[5:7, 0] += 0.8 * tolerance
    nominal = replace(flat("trapezoid", modelled), tolerance_mm=tolerance)
    true = Placed(flat("trapezoid", outline), 2.0, -3.0, 0.6)
    rng = np.random.default_rng(82)
    targets = np.array([(0.0, 15.0), (0.0, -5.0), (30.0, 0.0), (-30.0, 0.0)])
    directions = np.array([-math.pi / 2, 0.0, math.pi / 2, math.pi / 2])
    exact = aimed(true, rng, targets, directions, radius=radius, half_range=0.02, at_bound=False)
    # The disc touches floor and walls at once, or nearly so: it is the floor's normal that is measured.
    floor = true.theta + math.pi / 2
    exact[0] = replace(exact[0], normal=NormalRange(floor - 0.02, floor + 0.02))
    contacts = [replace(contact, position_bound_mm=0.05) for contact in exact]
    assert holding_truth(recognise(Catalogue([nominal]), contacts), true) is not None
