"""Support of a state: how far work that is done at its outline can move it.

Everything is counted in *slide*: the mean path, in mm, of the points on which the part rests. Friction takes
at least the declared force times the slide, so the work done on the part bounds the slide
(docs/recogniser.md, "A part that moves").
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.config.rig_tables import SearchConfig
from palpate.geometry import Floats
from palpate.recognizer import Catalogue
from palpate.recognizer.edges import CatalogueState

__all__ = ["Support", "support_of", "supports_of"]

_SAMPLES = 24  # of an evenly loaded base, along the longer side of its box
_TURNS = 31  # centres of rotation looked at, along each side of thrice the part's reach
_SAMPLED = 1.03  # allowance for both grids
_MEDIAN_ROUNDS = 60


@dataclass(frozen=True)
class Support:
    """How a state rests on the table.

    `holds_n`: what it bears at its middle; infinite: it is taken to lie still. Per mm of slide the centroid
    moves at most `shift`, the part turns at most `turn_rad_per_mm`, and no point of its outline moves more
    than `leverage`. A force f anywhere on the outline does not move it if f · `leverage` ≤ `holds_n`.
    """

    holds_n: float
    shift: float
    turn_rad_per_mm: float
    leverage: float


def supports_of(catalogue: Catalogue, search: SearchConfig) -> tuple[Support, ...]:
    """Support of every state of a catalogue. What an object says goes before what the rig file says."""
    return tuple(
        support_of(item, float(reach), search)
        for item, reach in zip(catalogue.states, catalogue.reach_mm, strict=True)
    )


def support_of(item: CatalogueState, reach_mm: float, search: SearchConfig) -> Support:
    """Support of one state, whose outline is within `reach_mm` of its centroid."""
    holds = item.holds_n or search.part_holds_n
    if holds is None:
        return Support(math.inf, 0.0, 0.0, 1.0)
    lowest = min(item.state.sections, key=lambda section: section.z_mm[0])
    base = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in lowest.polygons])
    base = shapely.affinity.translate(base, *(-item.origin_mm))
    declared = item.support_mm or search.part_support_mm
    if declared is None:
        rings = [ring for section in item.state.sections for ring in section.rings]
        outline = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(np.concatenate(rings))))
        off = item.tolerance_mm + item.rounding_mm
        return _evenly_loaded(holds, base, outline - item.origin_mm, off)
    return _declared(holds, base, reach_mm, declared)


def _declared(holds_n: float, base: shapely.Geometry, reach_mm: float, support_mm: float) -> Support:
    """Any pressure on the base whose mean distance from its geometric median is `support_mm` at least.

    The centre of friction c is the pressure's mean: E|x|² − |c|² = E|x − c|² ≥ (E|x − c|)² ≥ ρ² bounds how
    far it is from the centroid. Round any centre of rotation z, E|x − z| is at least ρ and at least |c − z|.
    """
    widest = float(np.hypot(*shapely.get_coordinates(base).T).max())
    rho = min(support_mm, widest)
    off = math.sqrt(widest**2 - rho**2)
    return Support(holds_n, 1 + off / rho, 1 / rho, 1 + (reach_mm + off) / rho)


def _evenly_loaded(holds_n: float, base: shapely.Geometry, hull: Floats, off_mm: float) -> Support:
    """The whole base under even pressure: known, so the worst centre of rotation is looked for.

    `hull` (v, 2): corners of the part's convex hull, whose true ones are within `off_mm` of these.
    """
    points = _grid_in(base)
    rho = _mean_distance_from_median(points) / _SAMPLED
    middle = points.mean(axis=0)
    along = np.linspace(-3, 3, _TURNS) * np.hypot(*hull.T).max()
    centres = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2) + middle
    mean = np.mean(np.hypot(*np.moveaxis(points[None] - centres[:, None], 2, 0)), axis=1)
    distance = np.hypot(*centres.T)
    furthest = np.hypot(*np.moveaxis(hull[None] - centres[:, None], 2, 0)).max(axis=1)
    leverage = max(float(np.max((furthest + off_mm) / mean)), 1.0)
    shift = max(float(np.max(distance / mean)), 1.0)
    return Support(holds_n, shift * _SAMPLED, 1 / rho, leverage * _SAMPLED)


def _grid_in(base: shapely.Geometry) -> Floats:
    """Points (n, 2) evenly over an area."""
    x0, y0, x1, y1 = base.bounds
    step = max(x1 - x0, y1 - y0) / _SAMPLES
    while True:
        x, y = (np.arange(lo + step / 2, hi, step) for lo, hi in ((x0, x1), (y0, y1)))
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        inside: Floats = points[shapely.contains_xy(base, points)]
        if len(inside) >= _SAMPLES:
            return inside
        step /= 2


def _mean_distance_from_median(points: Floats) -> float:
    """Least mean distance from any one point, by Weiszfeld's iteration (1937)."""
    median = points.mean(axis=0)
    for _ in range(_MEDIAN_ROUNDS):
        weight = 1 / np.maximum(np.hypot(*(points - median).T), 1e-9)
        median = weight @ points / weight.sum()
    return float(np.hypot(*(points - median).T).mean())
