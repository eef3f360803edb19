"""Grips of pads, simulated by shapely alone, without arrays: errors as large as approaches allow."""

import math
from collections.abc import Sequence

import numpy as np
import shapely
from pad_touches import face_stop_mm, seen_along
from shapely_bench import Placed

from palpate.config import TipConfig
from palpate.drivers.tactile.patches import ContactPatch
from palpate.recognizer import Approach, Contact
from palpate.rig.pads import PadTouch, face_points_of, touched_points

__all__ = ["pad_contacts"]

_DENT_MM, _DEEPEST_MM = 0.05, 0.1


def pad_contacts(
    placed: Placed, approaches: Sequence[Approach], rng: np.random.Generator, pitch_mm: float = 0.5
) -> list[Contact]:
    """What points of faces meet of a part: one column presses, the one where the part is met first."""
    return [contact for approach in approaches for contact in _touch(placed.shape, approach, rng, pitch_mm)]


def _touch(
    part: shapely.Geometry, approach: Approach, rng: np.random.Generator, pitch_mm: float
) -> tuple[Contact, ...]:
    angle, half = approach.direction_rad, approach.finger.tip_radius_mm
    bound = approach.position_bound_mm - math.hypot(pitch_mm, _DEEPEST_MM) / 2
    assert bound > 0
    around = angle + float(rng.choice([0.0, math.pi, rng.uniform(-math.pi, math.pi)]))
    off = bound * np.array([math.cos(around), math.sin(around)])
    ahead = np.array([math.cos(angle), math.sin(angle)])
    start = np.array(approach.start_mm) + off
    said = start - off
    tip = TipConfig(shape="pad", width_mm=2 * half, stiffness_n_per_mm=6.0, stiffness_spread=0.2)
    stop = face_stop_mm(part, start, angle, half)
    if stop > approach.travel_mm:
        end = said + approach.travel_mm * ahead
        way = Contact("f", approach.finger, False, _pair(said), _pair(end), bound)
        return face_points_of(way, tip, angle, 0.0)
    met = shapely.intersection(seen_along(part, start, angle), shapely.box(0.0, -half, stop + 1e-6, half))
    across = float(shapely.get_coordinates(met)[0, 1])
    column = min(max(math.floor((across + half) / pitch_mm), 0), math.ceil(2 * half / pitch_mm) - 1)
    pressed = -half + column * pitch_mm, -half + (column + 1) * pitch_mm
    touch = PadTouch(
        "f",
        approach.finger,
        _pair(said),
        _pair(said + (stop + _DENT_MM) * ahead),
        angle,
        0.0,
        _DEEPEST_MM,
        bound,
        bound,
    )
    patch = ContactPatch(*[math.nan] * 4, *[(0.0, 0.0, 0.0)] * 2, *[math.nan] * 6, (pressed, pressed))
    return (*touched_points(touch, patch, tip), *face_points_of(touch.way, tip, angle, 0.0))


def _pair(point: np.ndarray) -> tuple[float, float]:
    x, y = point.tolist()
    return x, y
