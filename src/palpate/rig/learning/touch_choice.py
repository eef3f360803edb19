"""Choice of the next touches of an unknown part: where bounds of its outline are furthest apart.

Until something is known of the outline, fingers go where `exploration` sends them. Then every approach is
taken to stop at the outline between the bounds, and to bring the bounds together near there, and beside its
way. A grip is made of the approaches that bring most, one for each finger, as far as they go together.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer import Contact, FingerApproach
from palpate.rig.identification.exploration import fast_to_workspace
from palpate.rig.learning.felt_outline import FeltOutline
from palpate.rig.learning.learned_model import deficits_mm, gaps_mm
from palpate.rig.reach.approaches import Reach

_TOUCHED_REACH_MM = 1.0  # a touch brings bounds together so far to either side
_NEAR_MM = 20.0  # what is further away does not matter once tips have passed all round
_GAP_SHARE = 0.6  # of the tip's radius: contacts are to be no further apart than twice as much
_GAP_WEIGHT = 10.0
_AFTER_MM = 10.0  # a finger goes on so far beyond where it is taken to stop
_SAME_PLACE_MM, _SPACING_MM = 0.5, 2.0  # touches that are nearer tell nothing more, or less
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
        gains = self._gains(felt, nominal, tolerance_mm, stops)
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
            worth = np.where(worth[best] > 0, 0.0, worth)
            kept: Bools = self._reach.together(chosen[-1], float(far[chosen[-1]]), open_rows, far[open_rows])
            open_rows, worth = open_rows[kept], worth[kept]
        if not chosen:
            return 0.0, []
        seconds = float(self._reach.seconds(stops)[chosen].max())
        return gained / (seconds + _GRIP_S), chosen

    def _stops_mm(self, felt: FeltOutline, nominal: shapely.Polygon) -> Floats:
        """Travels (n,) at which approaches are taken to stop: all of the way if they miss."""
        grown = nominal.buffer(felt.radius_mm)
        ends = self._start + self._heading * self._travel[:, None]
        ways = shapely.linestrings(np.stack([self._start, ends], axis=1))
        met = shapely.intersection(ways, grown)
        away = shapely.distance(shapely.points(self._start), met)
        return np.where(shapely.is_empty(met), self._travel, np.nan_to_num(away, nan=0.0))

    def _novelty(self, contacts: Sequence[Contact], stops: Floats) -> Floats:
        """Share (n,) of a gain that is to be had where the tip has not been, or not just there."""
        ends = np.array([item.end_mm for item in contacts if item.touched]).reshape(-1, 2)
        offset = ends - self._start[:, None]
        along = np.einsum("nkj,nj->nk", offset, self._heading)
        beside = np.abs(
            offset[..., 0] * self._heading[:, None, 1] - offset[..., 1] * self._heading[:, None, 0]
        )
        there = np.abs(along - stops[:, None]) < _UNSURE_MM
        away = np.where(there, beside, np.inf).min(axis=1, initial=np.inf)
        result: Floats = np.clip((away - _SAME_PLACE_MM) / _SPACING_MM, 0.0, 1.0)
        return result

    def _gains(
        self, felt: FeltOutline, nominal: shapely.Polygon, tolerance_mm: float, stops: Floats
    ) -> Floats:
        """Gain of each approach (n,) at each place (p,) along the bounds, mm."""
        places, away = deficits_mm(felt, nominal)
        wrong = np.flatnonzero((away > tolerance_mm) & (away < _NEAR_MM))
        places, away = places[wrong], away[wrong] - tolerance_mm
        between, gap = gaps_mm(felt, nominal)
        wide = np.flatnonzero(gap > _GAP_SHARE * felt.radius_mm)
        places, away = (
            np.concatenate([places, between[wide]]),
            np.concatenate([away, _GAP_WEIGHT * gap[wide]]),
        )
        offset = places - self._start[:, None]
        along = np.clip(np.einsum("npj,nj->np", offset, self._heading), 0.0, stops[:, None])
        beside = np.linalg.norm(offset - along[..., None] * self._heading[:, None], axis=2)
        hits = stops < self._travel
        near = beside <= felt.radius_mm + np.where(hits, _TOUCHED_REACH_MM, 0.0)[:, None]
        inside = along < stops[:, None] - 2 * felt.radius_mm  # beside the way, not where it stops
        passed = inside & (beside <= felt.radius_mm)
        result: Floats = np.where((near & ~inside) | passed, away, 0.0)
        return result
