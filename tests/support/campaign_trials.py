"""Seeded grips of every kind, simulated with shapely alone.

Shared by tests/recognizer/test_recognition_campaign.py and benchmarks/campaign.py. A trial (object,
configuration, grip) depends on nothing but (seed, index), so that each can be repeated alone. Nothing here is
shared with the recogniser but the types in which it is asked and answers. What it answers is judged in
campaign_checks.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from campaign_approaches import CLEAR_MM, REACH_MM, RING_MM, approach_to
from campaign_objects import FAMILIES, displaced, objects_of, placed_anyhow
from shapely_bench import Placed, unit
from shapely_contacts import first_contact, true_normal

from palpate.geometry import Floats
from palpate.recognizer import Contact, Finger, NormalRange

BOUNDS_MM = (0.0, 0.01, 0.1, 0.3, 1.0, 2.0)
NORMALS_DEG = (1.0, 3.0, 10.0, 25.0, 45.0, 90.0, None)
_NORMALS_SHARES = (0.17, 0.17, 0.3, 0.14, 0.1, 0.05, 0.07)
RADII_MM = (0.0, 1.0, 5.0, 8.0)
_SHARES = {"memo": 0.4, "parts": 0.35, "own": 0.15, "loose": 0.1}
_HEIGHTS_MM = {"own": (5.0, 10.0, 18.0)}  # 10: where two sections meet, both count
_FIRST_TOUCHES, _MOST_MISSES = 2, 3


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


def drawn(seed: int, index: int, families: tuple[str, ...] = FAMILIES) -> Trial:
    """Trial `index` of a campaign: its randomness depends on (seed, index) and on `families` only."""
    rng = np.random.default_rng((seed, index))
    weight = np.array([_SHARES[name] for name in families])
    family = str(rng.choice(families, p=weight / weight.sum()))
    setting = _setting(rng, family)
    models = objects_of(family)
    model = models[int(rng.integers(len(models)))]
    placed = placed_anyhow(displaced(model, rng), rng)
    felt = _felt(placed, setting, rng)
    return Trial(index, setting, placed, tuple(_steps(felt, setting.extended, rng)))


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


def _contact(placed: Placed, setting: Setting, rng: np.random.Generator, name: str) -> Contact:
    """One approach, carried out and mismeasured."""
    radius = setting.radius_mm if rng.random() < 0.9 else float(rng.choice(RADII_MM))
    height = float(rng.choice(_HEIGHTS_MM.get(setting.family, (10.0,))))
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
    return size * unit(rng.uniform(0, 2 * math.pi))
