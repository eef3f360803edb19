"""Choice of the next touches of an unknown part: between those that are too far apart.

Until something is known of the outline, fingers go where `exploration` sends them. Then every approach is
taken to stop at the outline between the bounds, or at what was touched. Touches are wanted halfway between
neighbours between which a tip might pass, or where the bounds are too far apart. A grip is made of the
approaches that come nearest to these, one for each finger, as far as they go together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer import Contact, FingerApproach
from palpate.rig.identification.exploration import fast_to_workspace
from palpate.rig.learning.felt_outline import FeltOutline
from palpate.rig.learning.learned_model import deficits_mm
from palpate.rig.reach.approaches import Reach

_LINK_SHARE = 1.0  # of the tip's radius: a tip is unlikely to pass between contacts that are no further apart
_LINK_WORTH = 10.0  # of a touch where a tip may pass, beside so many mm by which bounds are too far apart
_MOST_WORTH = 5.0
_NEAR_SHARE = 1.5  # of the distance to others: further away a touch is worth little
_BESIDE_SHARE, _BESIDE_STEPS = 0.02, 8.0  # so much; nothing where that many of these distances away
_AFTER_MM = 10.0  # a finger goes on so far beyond where it is taken to stop
_SAME_PLACE_MM, _SPACING_MM = 0.5, 2.0  # touches that are nearer tell nothing more, or less
_SAME_WAY_COS = 0.99
_SOLID_SHARE = 0.8  # of the tip's radius that keeps it out: room that was swept is narrower than the tip
_TOUCHED_SHARE = 0.9  # and of what was touched
_UNSURE_MM = 8.0  # of where an approach is taken to stop
_GRIP_S = 8.0  # of a grip beside what its fingers take


class TouchChooser:
    """Chooser of grips within a rig's reach, by its fingers of one height."""

    def __init__(self, reach: Reach, workspace_radius_mm: float) -> None:
        self._reach = reach
        self._radius_mm = workspace_radius_mm
        angle = np.array([item.direction_rad for item in reach.approaches])
        self._start = np.array([item.start_mm for item in reach.approaches])
        self._heading = np.column_stack([np.cos(angle), np.sin(angle)])
        self._travel = np.array([item.travel_mm for item in reach.approaches])

    def grip(
        self, contacts: Sequence[Contact], felt: FeltOutline, nominal: shapely.Polygon, tolerance_mm: float
    ) -> tuple[FingerApproach, ...]:
        """The grip that brings most for its time; none if no approach promises anything."""
        stops = self._stops_mm(felt, nominal)
        ends = shapely.points(self._start + self._heading * stops[:, None])
        at = shapely.line_locate_point(nominal.exterior, ends)
        touched = shapely.line_interpolate_point(nominal.exterior, at)
        targets = touch_targets(felt, nominal, tolerance_mm)
        away = shapely.distance(touched[:, None], shapely.points(targets.places_mm)) / targets.apart_mm
        near = np.clip(_NEAR_SHARE - away, 0.0, 1.0)
        gains = targets.worth * (near + _BESIDE_SHARE * np.clip(1 - away / _BESIDE_STEPS, 0.0, 1.0))
        gains[stops >= self._travel] = 0.0
        gains *= self._novelty(contacts, stops)[:, None]
        best: tuple[float, list[int]] = (0.0, [])
        for stage in np.unique(self._reach.stage_rad):
            best = max(best, self._grip_at(self._reach.of_stage(float(stage)), gains, stops))
        # No further than it was proven that fingers keep apart.
        chosen = [self._reach.approaches[k].up_to(float(stops[k]) + _AFTER_MM) for k in best[1]]
        return tuple(fast_to_workspace(item, self._radius_mm) for item in chosen)

    def _grip_at(self, rows: Sequence[int], gains: Floats, stops: Floats) -> tuple[float, list[int]]:
        """Gain per second of a greedy grip at one stage angle, and its approaches."""
        gained, chosen = 0.0, list[int]()
        open_rows: Ints = np.array(rows, dtype=np.int64)
        worth = gains[open_rows].copy()
        far = np.minimum(stops + _AFTER_MM, self._travel)
        while len(open_rows):
            total = worth.sum(axis=1)
            best = int(np.argmax(total))
            if total[best] <= 0:
                break
            chosen.append(int(open_rows[best]))
            gained += float(total[best])
            worth = np.maximum(worth - worth[best], 0.0)
            kept: Bools = self._reach.together(chosen[-1], float(far[chosen[-1]]), open_rows, far[open_rows])
            open_rows, worth = open_rows[kept], worth[kept]
        if not chosen:
            return 0.0, []
        seconds = float(self._reach.seconds(stops)[chosen].max())
        return gained / (seconds + _GRIP_S), chosen

    def _stops_mm(self, felt: FeltOutline, nominal: shapely.Polygon) -> Floats:
        """Travels (n,) at which approaches are taken to stop: all of the way if they miss."""
        known = shapely.MultiPoint(felt.touched.middles_mm).buffer(_TOUCHED_SHARE * felt.radius_mm)
        grown = nominal.buffer(_SOLID_SHARE * felt.radius_mm).union(known)
        ends = self._start + self._heading * self._travel[:, None]
        ways = shapely.linestrings(np.stack([self._start, ends], axis=1))
        met = shapely.intersection(ways, grown)
        away = shapely.distance(shapely.points(self._start), met)
        return np.where(shapely.is_empty(met), self._travel, np.nan_to_num(away, nan=0.0))

    def _novelty(self, contacts: Sequence[Contact], stops: Floats) -> Floats:
        """Share (n,) of a gain that is to be had where the tip has not been, or not just there."""
        ends = np.array([item.end_mm for item in contacts]).reshape(-1, 2)
        ways = ends - np.array([item.start_mm for item in contacts]).reshape(-1, 2)
        touched = np.array([item.touched for item in contacts], dtype=bool)
        offset = ends - self._start[:, None]
        along = np.einsum("nkj,nj->nk", offset, self._heading)
        beside = np.abs(
            offset[..., 0] * self._heading[:, None, 1] - offset[..., 1] * self._heading[:, None, 0]
        )
        alike = self._heading @ ways.T > _SAME_WAY_COS * np.linalg.norm(ways, axis=1)
        beyond = along - stops[:, None]
        there = (touched & (np.abs(beyond) < _UNSURE_MM)) | (alike & (beyond > 0))
        away = np.where(there, beside, np.inf).min(axis=1, initial=np.inf)
        result: Floats = np.clip((away - _SAME_PLACE_MM) / _SPACING_MM, 0.0, 1.0)
        return result


@dataclass(frozen=True, eq=False)
class TouchTargets:
    """Places (n, 2) on an outline where touches are wanted; how far they are from others there (n,), mm; and
    what each is worth (n,).
    """

    places_mm: Floats
    apart_mm: Floats
    worth: Floats


def touch_targets(felt: FeltOutline, nominal: shapely.Polygon, tolerance_mm: float) -> TouchTargets:
    """Touches that are wanted between neighbours on the outline.

    Where a tip may pass between two of them, or where bounds are further apart than the tolerance.
    """
    ring = nominal.exterior
    at, gaps, is_open = _neighbours(felt, ring)
    bounds, away = deficits_mm(felt, nominal)
    after = np.searchsorted(at, shapely.line_locate_point(ring, shapely.points(bounds))) - 1
    worst = np.zeros(len(at))
    np.maximum.at(worst, after, away)  # before the first is after the last
    worth = np.where(is_open, _LINK_WORTH, np.minimum(worst - tolerance_mm, _MOST_WORTH))
    parts = np.maximum(np.ceil(gaps / (_LINK_SHARE * felt.radius_mm)), 2).astype(int)
    rows = np.flatnonzero((worth > 0) & (gaps >= parts * _SAME_PLACE_MM))
    row = np.repeat(rows, parts[rows] - 1)
    number = np.concatenate([np.empty(0), *(np.arange(1, parts[k]) for k in rows)])
    apart = gaps[row] / parts[row]
    places = shapely.line_interpolate_point(ring, np.mod(at[row] + number * apart, ring.length))
    return TouchTargets(shapely.get_coordinates(places).reshape(-1, 2), apart, worth[row])


def open_places_mm(felt: FeltOutline, nominal: shapely.Polygon) -> Floats:
    """Middles (k, 2) of those stretches of an outline where a tip may pass between neighbouring touches."""
    at, gaps, is_open = _neighbours(felt, nominal.exterior)
    middles = np.mod(at + gaps / 2, nominal.exterior.length)[is_open]
    found = shapely.line_interpolate_point(nominal.exterior, middles)
    result: Floats = shapely.get_coordinates(found).reshape(-1, 2)
    return result


def _neighbours(felt: FeltOutline, ring: shapely.LinearRing) -> tuple[Floats, Floats, Bools]:
    """Touches (n,) that prove places not to be free, in order along a ring: where each is, and how far it is
    from there to the next, mm; and whether a tip may pass between the two. One at 0 if there are none.
    """
    barriers = np.array(felt.touched.barriers(felt.radius_mm))
    proving = ~shapely.is_empty(barriers)
    at = shapely.line_locate_point(ring, shapely.points(felt.touched.middles_mm[proving]))
    if len(at) < 2:
        return np.append(at, 0.0)[:1], np.array([ring.length]), np.ones(1, dtype=bool)
    order = np.argsort(at)
    at, barriers = at[order], barriers[proving][order]
    gaps = np.diff(at, append=at[:1] + ring.length)
    return at, gaps, ~shapely.intersects(barriers, np.roll(barriers, -1))
