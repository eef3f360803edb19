"""Evidence beyond bounds: touches that matched their predictions although they could have failed to.

Bounds prove which of the catalogue's objects was touched, but not that the object is in the catalogue at
all, nor that it has not moved. Kinds of *strangers*, objects outside the catalogue, differ by how far, and
over what length, their outlines deviate from what the hypotheses say (`outline_deviations`). Each touch that
agrees reduces the probability of kinds that would rarely have agreed (docs/next-approach.md; fitted by
benchmarks/fit_strangers.py). The smallest detectable shift of the part follows from predictions, or from
recognising anew.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.approach import Approach, approach_lines
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.outline_deviations import (
    Deviations,
    OutlinePlaces,
    OutlineTouches,
    agreement,
    in_centred_frame,
    places_on_outlines,
)
from palpate.recognizer.outline_features import Features, feature_agreement
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.prediction import Predictions
from palpate.recognizer.recognition import Motion, Recognition

STRANGER_KINDS = Deviations(
    sigma_mm=np.array([5.0, 2.0, 0.7, 0.3, 0.3]),
    length_mm=np.array([25.0, 25.0, 25.0, 20.0, 20.0]),
    scale=np.array([0.0, 0.0, 0.0, 0.07, 0.03]),
)
"""Kinds of strangers: unlike all parts; like one, but for 2 mm or 0.7 mm; 7 % or 3 % off its size."""

ALTERED_KINDS = Features(share=np.array([0.06, 0.12]), depth_mm=np.array([2.5, 4.0]))
"""More kinds: a part with one feature moved, added or missing, over so much of its outline."""

KINDS = len(STRANGER_KINDS.scale) + len(ALTERED_KINDS.share)

# Weights of the kinds of what differs by 2 mm over a fifth of its outline, and of what differs by less: that
# is unlike all where its first contacts were taken for those of another part.
_DIFFERENT_WEIGHT = np.array([0.9959, 0.0023, 0.0, 0.0018, 0.0, 0.0, 0.0])
_ALTERED_WEIGHT = np.array([0.54, 0.0, 0.009, 0.0, 0.008, 0.019, 0.424])
_CLEAR_PROBABILITY = np.array([0.652, *np.ones(6)])  # that a path to an agreeing place is free, too
_OVERLAP_EXPONENT = 0.352
# Fitted by benchmarks/fit_strangers.py to touches of drawn outlines against catalogues of drawn outlines.

_MAX_HYPOTHESES = 16  # the heaviest: others are as likely to be agreed with as these
_MAX_PROBABILITY, _LEAST_WEIGHT = 1.0 - 1e-9, 1e-300
_UNKNOWN_MM, _UNKNOWN_RAD = 300.0, 30.0  # of what was not measured
_LEAST_FACING = 0.3  # least cosine with which a stop counts across its surface
_PATH_STEPS = 64  # of a path that is looked along for where it passes nearest
_GRID_TRAVELS, _GRID_TURNS = 129, 65  # of the grid on which predictions are counted
_MODEL_NOISE_MM, _MODEL_NOISE_RAD = 0.05, 0.02  # keep Cholesky's factor from degenerating


@dataclass(frozen=True, eq=False)
class StrangerTerms:
    """Agreement of t touches with h hypotheses, each touch by a stranger of m kinds.

    `passing` (t, m, h): probability that a touch agrees with a hypothesis. `distinct` (t,): effective number
    of the `count` hypotheses, by where they predict the touch.
    """

    passing: Floats
    distinct: Floats
    count: int

    def with_any(self, clear: Floats = _CLEAR_PROBABILITY, overlap: float = _OVERLAP_EXPONENT) -> Floats:
        """Probability (t, m) that a touch agrees with some hypothesis.

        Distinct predictions are not independent: as many are as a power of their number, `overlap`. `clear`
        (m,): probability that nothing of the stranger is in the way to a place that agrees.
        """
        each = np.clip(self.passing * clear[:, None], 0.0, _MAX_PROBABILITY)
        number = np.maximum(self.distinct, 1.0) ** overlap / each.shape[2]
        result: Floats = 1.0 - np.exp(np.log1p(-each).sum(axis=2) * number[:, None])
        return result


@dataclass(frozen=True, eq=False)
class StrangerEvidence:
    """Evidence of strangers by touches after the first recognition.

    `agreed` (m,), by kind: the probability of all touches that agreed.
    """

    agreed: Floats

    @classmethod
    def none(cls) -> "StrangerEvidence":
        """Before any prediction."""
        return cls(np.ones(KINDS))

    @property
    def probability(self) -> float:
        """Probability that a stranger which agreed with the first contacts agreed with all touches since.

        A stranger that differs by 2 mm or more over a fifth of its outline from every part.
        """
        return min(float(_DIFFERENT_WEIGHT @ self.agreed), 1.0)

    @property
    def altered_probability(self) -> float:
        """The same of a stranger that differs by less, as a part does of which one feature was altered."""
        return min(float(_ALTERED_WEIGHT @ self.agreed), 1.0)

    @property
    def different_kinds(self) -> Floats:
        """Posterior weight (m,) of each kind of those that differ so much."""
        return _share(_DIFFERENT_WEIGHT * self.agreed)

    @property
    def altered_kinds(self) -> Floats:
        """Posterior weight (m,) of each kind of those that differ by less."""
        return _share(_ALTERED_WEIGHT * self.agreed)

    def after(self, passing: Floats) -> "StrangerEvidence":
        """Once touches have agreed; `passing` (t, m)."""
        return replace(self, agreed=self.agreed * passing.prod(axis=0))


def _share(weight: Floats) -> Floats:
    result: Floats = weight / max(weight.sum(), _LEAST_WEIGHT)
    return result


def stranger_terms(
    before: Recognition, approaches: Sequence[Approach], normal_half_rad: Floats, predictions: Predictions
) -> StrangerTerms:
    """Outcomes that strangers which agree with `before` would give `approaches` (t), one after the other.

    `predictions` (t, h) are those of `before`; `normal_half_rad` (t,): half of the normal's range that each
    touch measures.
    """
    rows = np.arange(min(len(before.hypotheses), _MAX_HYPOTHESES))
    coming = _predicted_touches(before, approaches, normal_half_rad, predictions, rows)
    every = _known_touches(before, rows).append(coming)
    kinds = agreement(every, STRANGER_KINDS), feature_agreement(every, ALTERED_KINDS)
    passing = np.concatenate(kinds)[:, :, -len(approaches) :].transpose(2, 0, 1)
    return StrangerTerms(passing, _distinct_predictions(predictions, normal_half_rad), len(before.hypotheses))


@dataclass(frozen=True, eq=False)
class CandidateTouches:
    """n touches of which some may be made next: what strangers that agree with all contacts make of them.

    `known`: what was touched before, by the first hypothesis; `each` (1, n): the candidates.
    """

    known: OutlineTouches
    each: OutlineTouches

    def agreement(self, chosen: Sequence[int]) -> Floats:
        """Probability (m, n) that each candidate agrees, after those chosen (indices) have.

        1 of parts with one altered feature: touches are not chosen for these.
        """
        known = self.known
        for index in chosen:
            known = known.append(self.each.column(index))
        single = self.each.map(lambda item: item.swapaxes(0, 1))
        every = known.map(lambda item: np.repeat(item, len(single.inward_mm), axis=0))
        result: Floats = np.ones((KINDS, len(single.inward_mm)))
        result[: len(STRANGER_KINDS.scale)] = agreement(every.append(single), STRANGER_KINDS)[:, :, -1]
        result *= _CLEAR_PROBABILITY[:, None]
        return result


def candidate_touches(
    before: Recognition, approaches: Sequence[Approach], normal_half_rad: float, predictions: Predictions
) -> CandidateTouches:
    """Touches that may be made next; `predictions` (n, h) are those of `before`. Pads measure no normals."""
    first = np.zeros(1, np.int64)
    measures = np.array([item.finger.tip.measures_normal for item in approaches], dtype=bool)
    halves = np.where(measures, normal_half_rad, math.pi)
    return CandidateTouches(
        _known_touches(before, first), _predicted_touches(before, approaches, halves, predictions, first)
    )


def _distinct_predictions(predictions: Predictions, normal_half_rad: Floats) -> Floats:
    """Effective number of predictions (t,) of all hypotheses: what they cover together, over their mean.

    All that predict nothing to be met count as one.
    """
    result = np.ones(len(normal_half_rad))
    for row, half in enumerate(normal_half_rad.tolist()):
        hit = np.isfinite(predictions.earliest[row])
        if not hit.any():
            continue
        first, last = predictions.earliest[row, hit], predictions.furthest[row, hit]
        lo, hi = predictions.normal_lo[row, hit] - half, predictions.normal_hi[row, hit] + half
        travel = np.linspace(first.min(), last.max() + 1e-6, _GRID_TRAVELS)
        turn = np.linspace(lo.min(), hi.max() + 1e-6, _GRID_TURNS)
        stops = (first[:, None] < travel[1:]) & (last[:, None] >= travel[:-1])
        turns = (lo[:, None] < turn[1:]) & (hi[:, None] >= turn[:-1])
        together = np.any(stops[:, :, None] & turns[:, None], axis=0).sum()
        result[row] = together / np.mean(stops.sum(axis=1) * turns.sum(axis=1)) + (not hit.all())
    return result


def _known_touches(before: Recognition, rows: Ints) -> OutlineTouches:
    """The touches that the hypotheses `rows` (h,) agree with; whatever agreed there agrees."""
    known = [item for item in before.contacts if item.touched]
    regions = before.hypotheses.regions
    points = np.array([item.end_mm for item in known]) - before.anchor_mm
    own = in_centred_frame(points, regions.theta[rows], regions.position[rows])
    states = before.hypotheses.state[rows]
    places = places_on_outlines(before.catalogue, states, [item.finger.span_mm for item in known], own)
    shape = places.along.shape
    noise_mm = np.broadcast_to([item.position_bound_mm / 2 + _MODEL_NOISE_MM for item in known], shape)
    noise_rad = np.broadcast_to([_normal_spread(item) + _MODEL_NOISE_RAD for item in known], shape)
    wide = np.full(shape, np.inf)
    return OutlineTouches(places, wide, wide, wide, noise_mm, noise_rad, noise_mm, noise_rad)


def _normal_spread(contact: Contact) -> float:
    """Standard deviation of a measured normal (rad): it is anywhere in its range."""
    if contact.normal is None:
        return _UNKNOWN_RAD
    return (contact.normal.hi_rad - contact.normal.lo_rad) / math.sqrt(12.0)


def _predicted_touches(
    before: Recognition,
    approaches: Sequence[Approach],
    normal_half_rad: Floats,
    predictions: Predictions,
    rows: Ints,
) -> OutlineTouches:
    """Touches to be made, as the hypotheses `rows` (h,) predict them: (h, t).

    Where a hypothesis predicts no stop, it agrees with whatever leaves the path free; where it predicts that
    there may be none, with whatever ends further inward.
    """
    earliest, latest, furthest, lo, hi = (
        getattr(predictions, name)[:, rows].T
        for name in ("earliest", "latest", "furthest", "normal_lo", "normal_hi")
    )
    hits = np.isfinite(earliest)
    first, last = np.where(hits, earliest, 0.0), np.where(hits, furthest, 0.0)
    places = _predicted_places(before, approaches, rows, hits, (first + last) / 2)
    heading = (
        np.array([item.direction_rad for item in approaches]) - before.hypotheses.regions.theta[rows, None]
    )
    facing = np.abs(np.cos(heading) * places.normal[..., 0] + np.sin(heading) * places.normal[..., 1])
    window = (last - first) / 2 * np.maximum(facing, _LEAST_FACING) + 1e-3
    bound = np.array([item.position_bound_mm for item in approaches])
    radius = np.array([item.finger.tip_radius_mm for item in approaches])
    sure = hits & np.isfinite(latest)
    noise_mm = np.broadcast_to(bound / 2, window.shape)
    noise_rad = np.broadcast_to(normal_half_rad / math.sqrt(3.0), window.shape)
    return OutlineTouches(
        places,
        np.where(sure, window, np.inf),
        np.where(hits, window, np.maximum(places.gap - radius, 0.0) + bound),
        np.where(sure, (hi - lo) / 2 + normal_half_rad, np.inf),
        noise_mm,
        noise_rad,
        np.where(sure, noise_mm + _MODEL_NOISE_MM, _UNKNOWN_MM),
        np.where(sure, noise_rad + _MODEL_NOISE_RAD, _UNKNOWN_RAD),
    )


def _predicted_places(
    before: Recognition, approaches: Sequence[Approach], rows: Ints, hits: Bools, stop_mm: Floats
) -> OutlinePlaces:
    """Places where paths that stop after `stop_mm` (h, t) touch the hypotheses `rows` (h,), where they do.

    Where they do not, the places that they pass nearest.
    """
    regions, states = before.hypotheses.regions, before.hypotheses.state[rows]
    theta, position = regions.theta[rows], regions.position[rows]
    start, angle = approach_lines(approaches)
    start, ahead = start - before.anchor_mm, np.column_stack([np.cos(angle), np.sin(angle)])
    spans = [item.finger.span_mm for item in approaches]
    at = stop_mm.copy()
    for column in np.flatnonzero(~hits.all(axis=0)).tolist():
        along = np.linspace(0.0, approaches[column].travel_mm, _PATH_STEPS)
        path = in_centred_frame(start[column] + along[:, None] * ahead[column], theta, position)
        gap = places_on_outlines(before.catalogue, states, [spans[column]] * _PATH_STEPS, path).gap
        at[:, column] = np.where(hits[:, column], at[:, column], along[np.argmin(gap, axis=1)])
    ends = in_centred_frame(start + at[..., None] * ahead, theta, position)
    return places_on_outlines(before.catalogue, states, spans, ends)


_SHIFT_BEARINGS = 90
_MAX_SHIFT_MM = 50.0  # a part that is further off has been put elsewhere
_ROUNDING_RAD = 1e-9


def detectable_shift_mm(predictions: Predictions, normal_rad: Floats, direction_rad: Floats) -> float:
    """Smallest shift (mm) of the part before a grip that its touches are guaranteed to detect.

    `predictions` (a, h), `normal_rad` and `direction_rad` (a,): the surfaces that were met, and the travels.
    On a straight surface a shift moves the stop by its component along the normal; it is detected if that
    leaves the predicted interval. Infinite if no predicted contact is certain.
    """
    latest, earliest = predictions.latest.max(axis=1), predictions.earliest.min(axis=1)
    facing = np.abs(np.cos(normal_rad - direction_rad))
    # A way of less than its bounds has no direction to speak of: along it nothing may be predicted at all.
    sure = np.isfinite(latest) & np.isfinite(earliest) & (facing > 0)
    bearing = np.arange(_SHIFT_BEARINGS) * (math.pi / _SHIFT_BEARINGS)
    along = np.abs(np.cos(bearing[:, None] - normal_rad[sure]))
    with np.errstate(divide="ignore"):
        hidden = (latest[sure] - earliest[sure]) * facing[sure] / along
    return float(hidden.min(axis=1, initial=np.inf).max())


def recognised_shift_mm(before: Recognition, contacts: Sequence[Contact]) -> float:
    """Smallest shift (mm) of the part, 50 mm at most, before `contacts` that they certainly show.

    They are recognised as those of a part that was shifted, by 50 mm at most, and not turned, after what was
    known `before`. No configuration that is left is further from the earlier ones. Infinite if some shift of
    nearly 50 mm explains them.
    """
    catalogue = before.catalogue
    shift = np.full(len(catalogue.states), _MAX_SHIFT_MM)
    after = before.extend(contacts, Motion(shift, np.zeros_like(shift)))
    furthest = _furthest_mm(catalogue, before.cells, after.cells)
    return furthest if furthest < _MAX_SHIFT_MM else math.inf


def _furthest_mm(catalogue: Catalogue, before: Cells, after: Cells) -> float:
    """Largest distance of centroids in equally turned configurations of one state; 0: there are none."""
    furthest = 0.0
    for number in np.unique(after.state).tolist():
        state = catalogue.states[number]
        turn = 2 * math.pi / state.symmetry.order
        old, new = (cells.select(cells.state == number) for cells in (before, after))
        (old_mm, old_off), (new_mm, new_off) = map(_centroids_mm, (old, new))
        for k in range(len(new)):
            apart = np.abs((old.middle - new.middle[k] + turn / 2) % turn - turn / 2)
            alike = (apart <= old.half_width + new.half_width[k] + _ROUNDING_RAD) | state.state.is_round
            away = np.hypot(*(old_mm - new_mm[k]).T) + old_off + new_off[k]
            furthest = max(furthest, float(away[alike].max(initial=0.0)))
    return furthest


def _centroids_mm(cells: Cells) -> tuple[Floats, Floats]:
    """Centroids (k, 2) in W, from the anchor, at the middles of cells, and how far off they are at most."""
    cos, sin = np.cos(cells.middle), np.sin(cells.middle)
    x, y = cells.centre.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y]), cells.displacement(np.zeros(len(cells)))
