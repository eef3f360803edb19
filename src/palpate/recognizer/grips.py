"""Grips: approaches to carry out together, with the predictions of every hypothesis and a certificate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.vocabulary.short_repr import ShortRepr
from palpate.recognizer.measurement_model import Resolution, similarity, touch_outcomes
from palpate.recognizer.poses import witness_poses
from palpate.recognizer.prediction import Predictions, predict
from palpate.recognizer.rays import Approach
from palpate.recognizer.recognition import Recognition

__all__ = [
    "FREE_MARGIN_MM",
    "FingerApproach",
    "Grip",
    "PredictedApproach",
    "Reachable",
    "fits_together",
    "make_grip",
    "predict_approach",
    "twins",
]

_CLASSED = 200  # pairs among which twins are looked for; where more are confused, not all are twins
_AT_ONCE = 500_000  # outcomes to compare: bounds the temporary arrays to tens of MB
_FEW = 8
FREE_MARGIN_MM = 2.0  # before the earliest predicted stop, for a part that earlier touches have nudged
_PERCEPTIBLE = np.exp(-1.0)  # similarity of what the rig can just distinguish


@dataclass(frozen=True, eq=False, repr=False)
class FingerApproach(ShortRepr, Approach):
    """An approach that one of a rig's fingers can carry out, with its turning stage at `stage_rad`.

    `fast_mm`: travel through space that is proven free, so that the finger need not search on it.
    `touch_mm_s`: the finger meets the part at this speed at most; None: as the rig does.
    """

    finger_index: int
    stage_rad: float = 0.0
    fast_mm: float = 0.0
    touch_mm_s: float | None = None

    def up_to(self, travel_mm: float) -> Self:
        """The same approach, for `travel_mm` at most."""
        return replace(self, travel_mm=min(travel_mm, self.travel_mm))


class Reachable(Protocol):
    """All approaches of a rig, and which of them go together."""

    @property
    def approaches(self) -> Sequence[FingerApproach]:
        """All (n), of all fingers."""
        ...

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """Whether approach `one` can be carried out with each of `others` (m,), going this far at most."""
        ...

    def seconds(self, travels_mm: Floats) -> Floats:
        """How long each approach (n,) takes, going this far (n,)."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Grip(ShortRepr):
    """Approaches to carry out together, and what each of the hypotheses says will happen.

    `travels_mm`: how far each finger has to go, if it meets nothing. `predictions` are (approaches,
    hypotheses). `decisive`: whatever happens, hypotheses of one class survive, the class being what no
    reachable approach tells apart; a certificate as long as no touch is blunter than its approach's
    position bound and the resolution's normal range. `remaining`: expected share of what needs telling
    apart that will still be indistinguishable, 0 to 1. `seconds`: estimated time of the motion.
    """

    approaches: tuple[FingerApproach, ...]
    travels_mm: tuple[float, ...]
    predictions: Predictions
    decisive: bool
    remaining: float
    seconds: float

    @property
    def limited_approaches(self) -> tuple[FingerApproach, ...]:
        """The approaches, none longer than its finger has to go, fast where no hypothesis has anything."""
        free = np.maximum(self.predictions.earliest.min(axis=1) - FREE_MARGIN_MM, 0.0)
        rows = zip(self.approaches, self.travels_mm, free.tolist(), strict=True)
        return tuple(replace(item.up_to(far), fast_mm=min(far, fast)) for item, far, fast in rows)


@dataclass(frozen=True, eq=False, repr=False)
class PredictedApproach(ShortRepr):
    """Approach `index` with its predictions (1, hypotheses) and the travel after which it meets nothing."""

    index: int
    predictions: Predictions
    travel_mm: float


def predict_approach(recognition: Recognition, reachable: Reachable, index: int) -> PredictedApproach:
    """Prediction for approach `index`, and how far it has to go."""
    approaches = [reachable.approaches[index]]
    found = predict(recognition.catalogue, recognition.hypotheses, recognition.anchor_mm, approaches)
    return PredictedApproach(index, found, float(found.needed_mm(approaches)[0]))


def fits_together(reachable: Reachable, one: PredictedApproach, chosen: Sequence[PredictedApproach]) -> bool:
    """Whether a candidate can be carried out together with all that are chosen."""
    others = np.array([item.index for item in chosen], dtype=np.int64)
    travels = np.array([item.travel_mm for item in chosen])
    return bool(reachable.together(one.index, one.travel_mm, others, travels).all())


def make_grip(
    recognition: Recognition,
    reachable: Reachable,
    chosen: Sequence[PredictedApproach],
    resolution: Resolution,
    remaining: float,
) -> Grip:
    """The grip of certain candidates, with what it promises."""
    indices = [item.index for item in chosen]
    predictions = Predictions.joined([item.predictions for item in chosen])
    travels = np.zeros(len(reachable.approaches))
    travels[indices] = [item.travel_mm for item in chosen]
    return Grip(
        tuple(reachable.approaches[k] for k in indices),
        tuple(item.travel_mm for item in chosen),
        predictions,
        _decisive(recognition, reachable, predictions, resolution),
        remaining,
        float(reachable.seconds(travels)[indices].max()),
    )


def twins(
    recognition: Recognition, reachable: Reachable, resolution: Resolution, used: Bools | None = None
) -> Bools:
    """Twins: pairs of hypotheses (h, h) that no remaining approach distinguishes at their configurations.

    Their stops and normals agree to within the rig's resolution, or both are missed. `used` (n,): candidates
    that have been carried out.
    """
    count = len(recognition.hypotheses)
    alike = np.ones((count, count), dtype=bool)
    left = np.ones(len(reachable.approaches), dtype=bool) if used is None else ~used
    first, second = np.triu_indices(count, 1)
    if left.any() and len(first):
        same = _alike(recognition, reachable, resolution, np.flatnonzero(left), first, second)
        alike[first, second] = alike[second, first] = same
    return alike


def _alike(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    rows: Ints,
    first: Ints,
    second: Ints,
) -> Bools:
    """Which pairs of hypotheses, `first` and `second` (n,), none of the candidates `rows` tells apart."""
    approaches = [reachable.approaches[k] for k in rows.tolist()]
    poses = witness_poses(recognition.hypotheses)
    outcome = touch_outcomes(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    # Most pairs differ for one of the first few that touch much: few are left for the others.
    order = np.argsort(-outcome.hit.sum(axis=1), kind="stable")
    left = np.arange(len(first))
    for begin in range(0, len(rows), _FEW):
        some = order[begin : begin + _FEW]
        kept = [
            piece[
                similarity(outcome, first[piece], second[piece], resolution, some).min(axis=0) >= _PERCEPTIBLE
            ]
            for piece in np.array_split(left, 1 + len(left) * _FEW // _AT_ONCE)
        ]
        left = np.concatenate(kept)
    result: Bools = np.zeros(len(first), dtype=bool)
    result[left] = True
    return result


def _decisive(
    recognition: Recognition, reachable: Reachable, predictions: Predictions, resolution: Resolution
) -> bool:
    """Whether a grip distinguishes every two hypotheses that some reachable approach distinguishes.

    Where touches may be spurious nothing is certain.
    """
    if recognition.max_spurious:
        return False
    apart = predictions.apart(resolution.normal_half_rad)
    first, second = np.nonzero(np.triu(~apart, 1))
    if not len(first):
        return True
    if len(first) > _CLASSED:
        return False
    # Survivors of an outcome are confused two by two; if these are twins two by two, they are one class.
    # A few approaches distinguish most others, which is soon seen.
    count = len(reachable.approaches)
    for rows in (np.unique(np.linspace(0, count - 1, 3 * _FEW).astype(np.int64)), np.arange(count)):
        if not _alike(recognition, reachable, resolution, rows, first, second).all():
            return False
    return True
