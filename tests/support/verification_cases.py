"""Random questions to verification: parts and contacts of every kind, poses near the truth and far."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from campaign_objects import FAMILIES, drawn_objects, drawn_source, objects_of
from shapely_bench import Placed, grip, place, turned

from palpate.base.geometry import Bools, Floats, ObjectModel
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange
from palpate.recognizer.verification import Poses

__all__ = ["Case", "drawn_case"]

_RADII_MM = (0.0, 0.2, 1.0, 5.0, 8.0)
_BOUNDS_MM = (0.0, 0.01, 0.3, 1.0, 5.0)
_HALF_RAD = (0.0, 0.02, 0.2, 1.0, math.pi)
_SPREAD = (1e-7, 1e-2, 0.3, 2.0, 20.0)  # of poses about the truth: mm, and half of that in degrees
_POSES = 60


@dataclass(frozen=True, eq=False)
class Case:
    """Poses (n,) and m contacts; `skipped` (n, m) or None: those that are no evidence."""

    models: tuple[ObjectModel, ...]
    poses: Poses
    contacts: tuple[Contact, ...]
    anchor_mm: Floats
    skipped: Bools | None

    def catalogue(self) -> Catalogue:
        """A new one."""
        return Catalogue(self.models)


@cache
def _discs() -> tuple[ObjectModel, ...]:
    """A round state with a bound of its normals, one with a tolerance besides, and a polygon with both."""
    parts = []
    for name, more in (("disc", {}), ("loose disc", {"tolerance": 0.2})):
        circles = [{"circle": {"centre": [3.0, 1.0], "radius": radius}} for radius in (21.0, 8.0)]
        section = {"z": [0, 20], "polygons": [{"outer": circles[0], "holes": [circles[1]]}]}
        parts.append({"name": name, "states": [{"name": "flat", "sections": [section]}], **more})
    text = {"format": "palpate/objects@1", "units": "mm", "objects": parts}
    models = objects_from_text(ObjectsFileText.model_validate(text), "here").objects
    bounded = replace(objects_of("memo")[0], name="bounded", tolerance_mm=0.4, normal_bound_rad=0.15)
    return (*models, bounded)


def _drawn_models(rng: np.random.Generator) -> tuple[ObjectModel, ...]:
    family = str(rng.choice([family for family in (*FAMILIES, "discs") if family != "parts"]))
    if family == "discs":
        return _discs()
    if family == "drawn":
        return drawn_objects(rng, float(rng.choice(_RADII_MM)))
    models = objects_of(drawn_source(family, rng))
    some = rng.choice(len(models), min(3, len(models)), replace=False)
    # A tolerance beyond the tip's radius lets paths go through the outline.
    wide = float(rng.choice([0.0, 0.0, 0.0, 0.05, 1.5]))
    return tuple(replace(models[k], tolerance_mm=max(models[k].tolerance_mm, wide)) for k in some)


def _drawn_contacts(placed: Placed, rng: np.random.Generator) -> list[Contact]:
    contacts = grip(
        placed,
        rng,
        fingers=int(rng.integers(1, 6)),
        radius=float(rng.choice(_RADII_MM)),
        bound=float(rng.choice(_BOUNDS_MM)),
        half_range=float(rng.choice(_HALF_RAD)),
        at_bound=bool(rng.random() < 0.5),
        ring=float(rng.choice([60.0, 140.0])),
        aim=float(rng.choice([0.15, 0.4])),
    )
    if rng.random() < 0.5:
        contacts.append(_grazing(contacts[0], rng))
    return [_varied(contact, rng) for contact in contacts]


def _grazing(contact: Contact, rng: np.random.Generator) -> Contact:
    """A miss whose path runs across the end of another's."""
    across = contact.direction_rad + math.pi / 2 + float(rng.normal(0, 0.5))
    way = 30.0 * np.array([math.cos(across), math.sin(across)])
    (x0, y0), (x1, y1) = (np.array(contact.end_mm) + side * way for side in (-1, 1))
    ends = {"start_mm": (float(x0), float(y0)), "end_mm": (float(x1), float(y1))}
    return replace(contact, name="miss", touched=False, normal=None, **ends)


def _varied(contact: Contact, rng: np.random.Generator) -> Contact:
    """The same with another range of normals, path bound or height, or without travel; or touched or not."""
    change, half = int(rng.integers(8)), float(rng.choice(_HALF_RAD))
    middle = contact.direction_rad + math.pi + float(rng.normal(0, 0.3))
    changes: dict[int, dict[str, object]] = {
        0: {"normal": None},
        1: {"normal": NormalRange(middle - half, middle + half), "touched": True},
        2: {"path_bound_mm": contact.position_bound_mm + float(rng.choice([0.0, 0.1, 2.0]))},
        3: {"finger": Finger(contact.finger.tip_radius_mm, float(rng.choice([3.0, 17.0, 1000.0])))},
        4: {"touched": not contact.touched, "normal": None},
        5: {"start_mm": contact.end_mm, "normal": NormalRange(middle - half, middle + half)},
    }
    return replace(contact, **changes.get(change, {}))


def drawn_case(seed: int) -> Case:
    """Case `seed`: about half of its poses are of the true state, at any distance from the truth."""
    rng = np.random.default_rng([24, seed])
    models = _drawn_models(rng)
    catalogue = Catalogue(models)
    number = int(rng.integers(len(models)))
    placed = place(models[number], rng)
    contacts, anchor = _drawn_contacts(placed, rng), rng.normal(0, 5, 2)
    true = [state.object_name for state in catalogue.states].index(models[number].name)
    state = np.where(rng.random(_POSES) < 0.6, true, rng.integers(len(catalogue.states), size=_POSES))
    spread = rng.choice(_SPREAD, _POSES)
    theta = placed.theta + rng.normal(0, 1, _POSES) * spread * math.radians(0.5)
    theta += 2 * math.pi * rng.integers(-1, 2, _POSES)
    position = np.empty((_POSES, 2))
    for k in range(_POSES):
        at = np.array([placed.x, placed.y]) + rng.normal(0, spread[k], 2)
        centre = at + turned(catalogue.origins_mm[state[k]], theta[k])
        position[k] = turned(centre - anchor, -theta[k])
    skipped = rng.random((_POSES, len(contacts))) < 0.2 if rng.random() < 0.3 else None
    return Case(models, Poses(state, theta, position), tuple(contacts), anchor, skipped)
