"""Seeded grips whose verified configurations are judged: one row of settings after the other.

Shared by tests/recognizer/test_verification.py and benchmarks/bench_verified.py. A scene depends on its seed
and index.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import shapely
from campaign_objects import displaced
from configuration_judge import objections
from shapely_bench import SHIPPED_OBJECTS, Placed, grip, outlines, place, until_touched
from shapely_contacts import true_normal
from shared_files import SHARED_OUTLINES

from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact, Recognition, recognise
from palpate.recognizer.contact import NormalRange

__all__ = ["RADII_MM", "Scene", "asked", "drawn", "refused"]

RADII_MM = (0.0, 1.0, 3.0, 5.0, 8.0)
BOUNDS_MM = (0.05, 0.1, 0.2, 0.3, 0.5)
NORMALS_DEG = (5.0, 10.0, 15.0, 20.0)
TOLERANCE_MM = 0.05


@dataclass(frozen=True)
class Scene:
    """One grip. `family`: "memo" or "parts"; `normals_deg`: half of the range of normals."""

    family: str
    tolerance_mm: float
    radius_mm: float
    bound_mm: float
    normals_deg: float
    placed: Placed
    contacts: tuple[Contact, ...]

    @property
    def touches(self) -> int:
        """How many fingers touched."""
        return sum(contact.touched for contact in self.contacts)


@cache
def models_of(family: str, tolerance_mm: float) -> tuple[ObjectModel, ...]:
    """The shipped parts, or the shared outlines."""
    file = SHIPPED_OBJECTS if family == "memo" else SHARED_OUTLINES
    return tuple(replace(model, tolerance_mm=tolerance_mm) for model in outlines(file))


@cache
def catalogue_of(family: str, tolerance_mm: float) -> Catalogue:
    """Built once in each process."""
    return Catalogue(models_of(family, tolerance_mm))


def drawn(seed: int, index: int, families: tuple[str, ...]) -> Scene:
    """Scene `index`: a grip of two to five fingers, some of which miss."""
    rng = np.random.default_rng((seed, index))
    family = families[int(rng.integers(len(families)))]
    tolerance = TOLERANCE_MM if rng.random() < 0.25 else 0.0
    radius, bound = float(rng.choice(RADII_MM)), float(rng.choice(BOUNDS_MM))
    half = float(rng.choice(NORMALS_DEG))
    models = models_of(family, tolerance)
    at_bound = bool(rng.random() < 0.5)
    placed = place(displaced(models[int(rng.integers(len(models)))], rng, at_bound=at_bound), rng)
    contacts = until_touched(
        grip,
        placed,
        rng,
        fingers=int(rng.choice([2, 3, 4, 5], p=[0.2, 0.4, 0.3, 0.1])),
        radius=radius,
        bound=bound,
        half_range=math.radians(half),
        at_bound=at_bound,
        aim=float(rng.choice([0.15, 0.4])),
    )
    felt = [_with_normal(contact, placed.shape, math.radians(half), rng) for contact in contacts]
    return Scene(family, tolerance, radius, bound, half, placed, tuple(felt))


def _with_normal(contact: Contact, shape: shapely.Geometry, half: float, rng: np.random.Generator) -> Contact:
    """Point fingers are given a normal as well."""
    if not contact.touched or contact.normal is not None:
        return contact
    normal = true_normal(shape, np.array(contact.end_mm), 0.0, rng) + rng.uniform(-half, half)
    return replace(contact, normal=NormalRange(normal - half, normal + half))


def asked(scene: Scene) -> Recognition:
    """The recogniser's answer."""
    return recognise(catalogue_of(scene.family, scene.tolerance_mm), scene.contacts)


def refused(scene: Scene, answer: Recognition) -> list[str]:
    """What the judge says against verified configurations."""
    found = []
    for item in answer.hypotheses:
        if item.verified:
            against = objections(item.state.state, scene.tolerance_mm, item.configuration, scene.contacts)
            found += [f"{item.state.object_name} at {item.configuration}: {what}" for what in against]
    return found
