"""Support of a state: how far work that is done at its outline can move it.

Everything is counted in *slide*: the mean path, in mm, of the points on which the part rests. Friction takes
at least the declared force times the slide, so the work done on the part bounds the slide
(docs/recogniser.md, "A part that moves").
"""

import math
from dataclasses import dataclass, fields

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.object_model import State
from palpate.config.rig_tables import SearchConfig
from palpate.recognizer import Catalogue
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.tables import Table
from palpate.rig.identification.stability import FRICTION_MOST

__all__ = ["Support", "SupportTable", "support_of", "supports_of"]

_SAMPLES = 24  # of an evenly loaded base, along the longer side of its box
_TURNS = 31  # centres of rotation looked at, along each side of thrice the part's reach
_SAMPLED = 1.03  # allowance for both grids
_MEDIAN_ROUNDS = 60
_MEDIAN_MM = 1e-4


@dataclass(frozen=True)
class Support:
    """How a state rests on the table.

    `holds_n`: what it bears at its middle; infinite: it is taken to lie still. Per mm of slide the centroid
    moves at most `shift`, the part turns at most `turn_rad_per_mm`, and no point of its outline moves more
    than `leverage`. A force f anywhere on the outline does not move it if f · `leverage` ≤ `holds_n`.
    `centre_mm` (2,): its centre of mass in the file's frame. Pushed with all that it bears, the centre of
    friction is carried off by so much that leverages grow by `carried`; under less, by that share of it.
    """

    holds_n: float
    shift: float
    turn_rad_per_mm: float
    leverage: float
    centre_mm: Floats
    carried: float


@dataclass(frozen=True, eq=False)
class SupportTable(Table):
    """Supports of n states: the columns of `Support`, (n,) each, and `centre_mm` (n, 2)."""

    holds_n: Floats
    shift: Floats
    turn_rad_per_mm: Floats
    leverage: Floats
    centre_mm: Floats
    carried: Floats

    def leverage_at(self, states: Ints, distance_mm: Floats) -> Floats:
        """As `leverage`, of points at distances (m,) from the centre of mass, of `states` (m,).

        The centre of friction moves with the mean velocity, and everything turns about it.
        """
        near = 1 + distance_mm * self.turn_rad_per_mm[states]
        result: Floats = np.minimum(self.leverage[states], near)
        return result


def supports_of(catalogue: Catalogue, search: SearchConfig, height_mm: float) -> SupportTable:
    """Supports of all states of a catalogue, touched at `height_mm` at most.

    What an object says goes before what the rig file says.
    """
    found = [support_of(item, search, height_mm) for item in catalogue.states]
    columns = (np.array([getattr(item, name.name) for item in found]) for name in fields(SupportTable))
    return SupportTable(*columns)


def support_of(item: CatalogueState, search: SearchConfig, height_mm: float) -> Support:
    """Support of one state.

    The pressure balances about the centre of mass, which is that of the sections, as of one material. A push
    at a height carries it on by height × push / weight, and while the part slides or stands no push is above
    friction × weight.
    """
    holds = item.holds_n or search.part_holds_n
    if holds is None:
        return Support(math.inf, 0.0, 0.0, 1.0, item.origin_mm, 0.0)
    centre = centre_of_mass_mm(item.state)
    sections = item.state.sections
    outline = np.concatenate([ring for section in sections for ring in section.rings])
    hull = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(outline))) - centre
    carried_mm, unsure_mm = FRICTION_MOST * height_mm, item.tolerance_mm + item.rounding_mm
    off = float(np.hypot(*(centre - item.origin_mm))) + carried_mm
    declared = item.support_mm or search.part_support_mm
    if declared is not None:
        reach = float(np.hypot(*hull.T).max()) + unsure_mm
        turn = 1 / declared
        return Support(holds, 1 + off * turn, turn, 1 + reach * turn, centre, carried_mm * turn)
    lowest = min(sections, key=lambda section: section.z_mm[0])
    base = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in lowest.polygons])
    base = shapely.affinity.translate(base, *(-centre))
    shift, turn, leverage = _evenly_loaded(base, hull, off, unsure_mm)
    return Support(holds, shift, turn, leverage, centre, carried_mm * turn * leverage)


def centre_of_mass_mm(state: State) -> Floats:
    """Centre of mass (2,) of a state in its file's frame, as of one material, seen from above."""
    total, moment = 0.0, np.zeros(2)
    for section in state.sections:
        lo, hi = section.z_mm
        for polygon in section.polygons:
            shape = shapely.Polygon(polygon.outer, polygon.holes)
            volume = shape.area * (hi - lo)
            total += volume
            moment += volume * shapely.get_coordinates(shape.centroid)[0]
    result: Floats = moment / total
    return result


def _evenly_loaded(
    base: shapely.Geometry, hull: Floats, off_mm: float, unsure_mm: float
) -> tuple[float, float, float]:
    """Shift, turn and leverage of the whole base, under a pressure that is known.

    The worst centre of rotation is looked for. All from the centre of mass. `hull` (v, 2): corners of the
    part's convex hull; the outline may be `unsure_mm` further from where the pressure balances.
    """
    points, load = _pressure(base)
    rho = _mean_distance_from_median(points, load) / _SAMPLED
    along = np.linspace(-3, 3, _TURNS) * np.hypot(*hull.T).max()
    centres = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    # A row of centres at a time stays in the processor's caches.
    mean = np.concatenate([_distances(row, points) @ load for row in np.split(centres, _TURNS)])
    furthest = _distances(centres, hull).max(axis=1)
    leverage = max(float(np.max((furthest + unsure_mm) / mean)), 1.0)
    distance = np.hypot(*centres.T)
    shift = max(float(np.max((distance + off_mm) / mean)), 1.0)
    return shift * _SAMPLED, 1 / rho, leverage * _SAMPLED


def _distances(one: Floats, other: Floats) -> Floats:
    """Distances (m, n) of points (m, 2) from points (n, 2): large catalogues have many states to look at.

    By the law of cosines, whose rounding is 1e-7 of the points' distances from the origin.
    """
    square: Floats = (-2 * one) @ other.T
    square += (one**2).sum(axis=1)[:, None]
    square += (other**2).sum(axis=1)
    return np.sqrt(np.maximum(square, 0.0, out=square), out=square)


def _pressure(base: shapely.Geometry) -> tuple[Floats, Floats]:
    """Points (n, 2) evenly over an area, and the share (n,) that each bears of a weight at the origin.

    The pressure is a linear function of the place, but never pulls: a stiff part on an elastic foundation.
    Evenly loaded if nothing balances so.
    """
    points = every = _grid_in(base)
    while len(points) >= _SAMPLES:
        lever = np.column_stack([np.ones(len(points)), points])
        load = lever @ np.linalg.lstsq(lever.T @ lever, np.array([1.0, 0.0, 0.0]))[0]
        if load.min() >= 0:
            return points, load
        points = points[load > 0]
    return every, np.full(len(every), 1 / len(every))


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


def _mean_distance_from_median(points: Floats, load: Floats) -> float:
    """Least mean distance from any one point, by Weiszfeld's iteration (1937)."""
    median = load @ points
    for _ in range(_MEDIAN_ROUNDS):
        weight = load / np.maximum(np.hypot(*(points - median).T), 1e-9)
        before, median = median, weight @ points / weight.sum()
        if math.dist(before, median) < _MEDIAN_MM:  # about its least the mean distance hardly changes
            break
    return float(load @ np.hypot(*(points - median).T))
