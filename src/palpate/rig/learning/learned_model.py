"""Learned model: an outline between the bounds of a felt one, with a tolerance that holds for all between.

Its tolerance δ is such that, wherever the felt outline runs between the bounds, it is within δ of the
model's, and neither reaches further than δ beyond the other: what the recogniser takes a tolerance to be.
An outline that may as well be symmetric is made so: touches do not tell its poses apart.
Normals of what was touched are not bounded, but for what tips of that radius can feel (`normal_bound` π).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import shapely

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.base.geometry.object_model import LEARNED_HEIGHT_MM
from palpate.rig.learning.felt_outline import FeltOutline
from palpate.rig.learning.symmetric_outline import SYMMETRY_ORDERS, symmetric_outline

_MOST_SHRINK_MM, _SHRINK_STEP_MM = 2.6, 0.5  # of the outer bound; then more closely about the best
_SIMPLIFIED_SHARE = 0.1  # of the tolerance: by how much the outline may be simplified
_MOST_TOLERANCE_MM = 6.0  # of a model
_SAMPLES_MM = 0.5
_ROUNDING_MM = 1e-3
_EVEN_FACTOR = 1.25  # by which a tolerance may be larger for the sake of a symmetry
_GROWTH = 1.02  # of a tolerance that proves to be too small

_ANY_NORMAL_RAD = math.pi


@dataclass(frozen=True, eq=False)
class NominalOutline:
    """Corners (n, 2) in W of a simple polygon, and the tolerance with which it is a felt outline."""

    points_mm: Floats
    tolerance_mm: float


def known_outline(felt: FeltOutline) -> NominalOutline | None:
    """The outline between bounds; None while they are not closed, or so far apart that it says little."""
    if not felt.is_closed:
        return None
    found = nominal_outline(felt)
    return found if found.tolerance_mm <= _MOST_TOLERANCE_MM else None


def nominal_outline(felt: FeltOutline) -> NominalOutline:
    """The outline between the bounds whose tolerance is least of some; the bounds must be closed."""
    coarse = _between_bounds(felt, np.arange(0.0, _MOST_SHRINK_MM, _SHRINK_STEP_MM))
    shrink, _, _ = _best_of(felt, coarse)
    close = shrink + _SHRINK_STEP_MM * np.linspace(-0.8, 0.8, 9)
    tried = {**coarse, **_between_bounds(felt, np.maximum(close, 0.0))}
    _, rough, tolerance = _best_of(felt, tried)
    fine = rough.simplify(_SIMPLIFIED_SHARE * tolerance)
    chosen = fine if isinstance(fine, shapely.Polygon) and fine.is_valid else rough
    for order in SYMMETRY_ORDERS:
        turned = {
            key: even
            for key, item in tried.items()
            if (even := symmetric_outline(item, order, _SIMPLIFIED_SHARE * tolerance)) is not None
        }
        if not turned:
            break
        _, even, its_tolerance = _best_of(felt, turned)
        if its_tolerance <= _EVEN_FACTOR * tolerance:
            chosen = even
            break
    return NominalOutline(shapely.get_coordinates(chosen.exterior)[:-1], _tolerance_mm(felt, chosen))


def _best_of(
    felt: FeltOutline, tried: Mapping[float, shapely.Polygon]
) -> tuple[float, shapely.Polygon, float]:
    """The outline of the least tolerance, about, with its key before it and its tolerance behind."""
    tolerances = {key: _rough_tolerance_mm(felt, item) for key, item in tried.items()}
    best = min(tolerances, key=tolerances.__getitem__)
    return best, tried[best], tolerances[best]


def deficits_mm(felt: FeltOutline, nominal: shapely.Polygon) -> tuple[Floats, Floats]:
    """Places (n, 2) along both bounds, and how far each is from a nominal outline (n,), mm."""
    places = shapely.get_coordinates(shapely.segmentize([felt.inner, felt.outer], _SAMPLES_MM))
    away: Floats = shapely.distance(nominal.exterior, shapely.points(places))
    return places, away


def _between_bounds(felt: FeltOutline, shrinks_mm: Floats) -> dict[float, shapely.Polygon]:
    """The outer bound, shrunk by so much, with all of the inner one; where that is not in pieces."""
    found = {shrink: shapely.union(felt.outer.buffer(-shrink), felt.inner) for shrink in shrinks_mm.tolist()}
    return {
        shrink: shapely.Polygon(item.exterior)
        for shrink, item in found.items()
        if isinstance(item, shapely.Polygon)
    }


def _rough_tolerance_mm(felt: FeltOutline, nominal: shapely.Polygon) -> float:
    places = shapely.get_coordinates(shapely.segmentize(nominal.exterior, _SAMPLES_MM))
    beyond = np.minimum(
        shapely.distance(shapely.points(places), felt.inner), felt.touched.distances_mm(places)
    )
    return float(max(deficits_mm(felt, nominal)[1].max(), beyond.max()))


def _tolerance_mm(felt: FeltOutline, nominal: shapely.Polygon) -> float:
    """A tolerance for which all conditions hold, tested by shapely; rounded up."""
    tolerance = _rough_tolerance_mm(felt, nominal)
    while not _is_tolerated(felt, nominal, tolerance):
        tolerance *= _GROWTH
    return math.ceil((tolerance + _ROUNDING_MM) * 100) / 100


def _is_tolerated(felt: FeltOutline, nominal: shapely.Polygon, tolerance_mm: float) -> bool:
    near = [felt.inner.buffer(tolerance_mm), *felt.touched.surroundings(tolerance_mm)]
    pairs = (
        (felt.band, nominal.exterior.buffer(tolerance_mm)),
        (felt.outer, nominal.buffer(tolerance_mm)),
        (nominal, shapely.union_all(near)),
        (nominal.buffer(-tolerance_mm), felt.inner),
    )
    return all(within.difference(whole).is_empty for within, whole in pairs)


def learned_model(
    name: tuple[str, str],
    outlines: Mapping[tuple[float, float], NominalOutline],
    height_mm: float,
    least_tip_radius_mm: float,
) -> ObjectModel:
    """The object and state of these names, so high, of outlines felt by tips between heights (from, to).

    Its frame's origin is about its middle.
    """
    first = next(iter(outlines.values()))
    origin = np.round(first.points_mm.mean(axis=0), 3)
    heights = [
        (max(low - LEARNED_HEIGHT_MM, 0.0), min(high + LEARNED_HEIGHT_MM, height_mm))
        for low, high in outlines
    ]
    sections = tuple(
        Section(span, (Polygon(np.round(item.points_mm - origin, 4)),))
        for span, item in zip(heights, outlines.values(), strict=True)
    )
    state = State(name[1], sections, height_mm=height_mm, heights_mm=tuple(sorted(heights)))
    tolerance = max(item.tolerance_mm for item in outlines.values())  # with room for rounded corners
    return ObjectModel(
        name[0],
        (state,),
        round(tolerance, 3),
        normal_bound_rad=_ANY_NORMAL_RAD,
        least_tip_radius_mm=least_tip_radius_mm,
    )


def with_further_states(known: ObjectModel, learned: ObjectModel) -> ObjectModel:
    """The object, known in some states, with those that were learned, and the bounds that hold for all."""
    radii = [item.least_tip_radius_mm or 0.0 for item in (known, learned)]
    return replace(
        known,
        states=(*known.states, *learned.states),
        tolerance_mm=max(known.tolerance_mm, learned.tolerance_mm),
        normal_bound_rad=_ANY_NORMAL_RAD,
        least_tip_radius_mm=max(radii),
    )
