"""Predictions: enclosures of where approaches stop, and on which normals, over whole regions (memo §3.2).

The same capsules decide afterwards what a touch rules out, so planner and recogniser cannot
disagree. The exact angle pockets of the predicted edges are in it: an interval that ends says that nothing
else is in the way, for every configuration of the region (docs/next-approach.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.approach import Approach, Facing, rays_of
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.hypotheses import Hypotheses
from palpate.recognizer.pad_face import face_points, strip_extents
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.steps import STEPS
from palpate.recognizer.tables import Table

_EARLY_END_MM = 1.0
"""A finger may end its travel this much early: only a stop before that is a sure one."""

_SPARE_TRAVEL_MM = 5.0  # beyond the furthest stop that is possible
_MOST_CELLS = 32_768  # of all hypotheses together; where there are more, coarser ones cover them
_LEAST_LEAN_RAD = 0.1  # by which a path may lean over its stated direction where it meets something


@dataclass(frozen=True)
class Prediction:
    """Outcome of one approach under one hypothesis, over its whole region.

    A stop comes after a travel in [`earliest_mm`, `latest_mm`]; `latest_mm` is infinite if the finger may
    miss. It cannot come after `furthest_mm`, and not at all if `earliest_mm` is infinite; then `furthest_mm`
    is 0. The surface's outward normal there lies in `normal_rad`, (lo, hi) in W; None if nothing is met.
    """

    earliest_mm: float
    latest_mm: float
    furthest_mm: float
    normal_rad: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Predictions(Table):
    """Predictions for a approaches and h hypotheses, all (a, h); see `Prediction`.

    `normal_lo` ≤ `normal_hi` rad in W; where nothing can be met, `furthest` is −∞ and the normals are 0.
    """

    earliest: Floats
    latest: Floats
    furthest: Floats
    normal_lo: Floats
    normal_hi: Floats

    def of(self, approach: int, hypothesis: int) -> Prediction:
        """One of them."""
        earliest, latest, furthest, lo, hi = (
            float(value[approach, hypothesis])
            for value in (self.earliest, self.latest, self.furthest, self.normal_lo, self.normal_hi)
        )
        if np.isinf(earliest):
            return Prediction(earliest, latest, 0.0, None)
        return Prediction(earliest, latest, furthest, (lo, hi))

    def of_approach(self, approach: int) -> tuple[Prediction, ...]:
        """Predictions for one approach under every hypothesis."""
        return tuple(self.of(approach, hypothesis) for hypothesis in range(self.earliest.shape[1]))

    def sufficient_travel_mm(self, approaches: Sequence[Approach]) -> Floats:
        """Travel (a,) after which nothing can be met any more, and a little further."""
        furthest = self.furthest.max(axis=1, initial=0.0) + _SPARE_TRAVEL_MM
        result: Floats = np.minimum(furthest, [approach.travel_mm for approach in approaches])
        return result

    def apart(self, normal_half_rad: float) -> Bools:
        """Mask of hypotheses (h, h) that no outcome of some approach can confuse, if touches are sharp.

        That is so where the stops are disjoint, or the normals further apart than two ranges of half-width
        `normal_half_rad` reach and neither may miss. Touches must not be blunter than that, nor than their
        approaches' position bounds.
        """
        before = self.latest[:, :, None] < self.earliest[:, None, :]
        sure = np.isfinite(self.latest)
        middle, half = (self.normal_lo + self.normal_hi) / 2, (self.normal_hi - self.normal_lo) / 2
        turned = np.abs(wrap_angle(middle[:, :, None] - middle[:, None, :]))
        leaning = turned > half[:, :, None] + half[:, None, :] + 2 * normal_half_rad
        either = before | before.transpose(0, 2, 1) | (leaning & sure[:, :, None] & sure[:, None, :])
        result: Bools = np.any(either, axis=0)
        return result


def predict(
    catalogue: Catalogue, hypotheses: Hypotheses, anchor_mm: Floats, approaches: Sequence[Approach]
) -> Predictions:
    """Enclose what each of the approaches meets anywhere in the region of each hypothesis."""
    cells, first = hypotheses.regions.coarse_cells(_MOST_CELLS)
    first = first[:-1]
    shape = (len(approaches), len(first))
    found = Predictions(*(np.zeros(shape) for _ in range(5)))
    for finger in dict.fromkeys(approach.finger for approach in approaches):
        rows = [k for k, approach in enumerate(approaches) if approach.finger == finger]
        some = [approaches[k] for k in rows]
        met = (_predict_faces if finger.face_half_mm else _predict_tips)(catalogue, cells, anchor_mm, some)
        for to, value, combine in (
            (found.earliest, met.earliest, np.minimum),
            (found.latest, met.latest, np.maximum),
            (found.furthest, met.furthest, np.maximum),
            (found.normal_lo, met.normal_lo, np.minimum),
            (found.normal_hi, met.normal_hi, np.maximum),
        ):
            to[rows] = combine.reduceat(value, first, axis=0).T
    travel = np.array([[approach.travel_mm] for approach in approaches])
    against = np.array([[approach.direction_rad + np.pi] for approach in approaches])
    met_at_all = (found.earliest <= travel) & np.isfinite(found.furthest)
    return Predictions(
        np.where(met_at_all, found.earliest, np.inf),
        np.where(found.latest <= travel - _EARLY_END_MM, found.latest, np.inf),
        np.where(met_at_all, np.minimum(found.furthest, travel), -np.inf),
        np.where(met_at_all, found.normal_lo + against, 0.0),
        np.where(met_at_all, found.normal_hi + against, 0.0),
    )


def _predict_faces(
    catalogue: Catalogue, cells: Cells, anchor_mm: Floats, approaches: Sequence[Approach]
) -> Predictions:
    """The same for flat faces. No stop is promised but those that points of the face, the evidence, prove."""
    points = [point for approach in approaches for point in face_points(approach)]
    latest = _predict_tips(catalogue, cells, anchor_mm, points).latest
    latest = latest.reshape(len(cells), len(approaches), -1).min(axis=2)
    finger = approaches[0].finger
    edges = catalogue.outlines(finger.face_point)
    rays = rays_of(edges, cells, anchor_mm, approaches)
    first, last = strip_extents(edges, rays, finger.face_half_mm + rays.rho)
    first, last, rho = (each.reshape(latest.shape) for each in (first, last, rays.rho))
    return Predictions(
        np.maximum(first - rho, 0.0),
        latest,
        np.minimum(last + rho, latest),
        np.full(latest.shape, -np.pi),
        np.full(latest.shape, np.pi),
    )


def _predict_tips(
    catalogue: Catalogue, cells: Cells, anchor_mm: Floats, approaches: Sequence[Approach]
) -> Predictions:
    """The same for k cells and m approaches of one kind of finger, (k, m).

    Normals count from against the travel.
    """
    edges, strips = catalogue.outlines(approaches[0].finger), catalogue.outline_strips(approaches[0].finger)
    rays = rays_of(edges, cells, anchor_mm, approaches)
    lean = np.array([2 * item.position_bound_mm / max(item.travel_mm, 1e-9) for item in approaches])
    lean = np.pi / 2 + np.maximum(_LEAST_LEAN_RAD, np.arcsin(np.minimum(lean, 1.0)))
    if approaches[0].finger.touches_vertices:
        lean = np.full(len(approaches), np.pi)  # on a vertex, the normal of either edge there
    against = np.array([item.direction_rad + np.pi for item in approaches])
    row, column = np.divmod(np.arange(len(rays)), len(approaches))
    # Where vertices may be off, so may normals, by anything if edges are short: nothing is said of them.
    vague = catalogue.has_tolerance(approaches[0].finger)[cells.state[row]]
    facing = Facing(against[column] - cells.middle[row], cells.half_width[row], lean[column], vague)
    stops = STEPS.enclose_stops(edges, strips, rays, facing)
    shape = (len(cells), len(approaches))
    return Predictions(*(each.reshape(shape) for each in stops))
