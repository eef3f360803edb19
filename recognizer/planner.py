"""The next approach (memo §3.2, third strategy): which reachable touches tell the hypotheses apart best.

From hypotheses and the approaches that the rig can reach to a grip. Every hypothesis is represented by some
configurations of its region; for each candidate approach the stop and the surface normal are predicted for
each of them. Two configurations that would feel alike stay confused; the grip that leaves the least expected
confusion is chosen, finger by finger. Configurations of one hypothesis count as well, so that the same rule
goes on to sharpen the pose when only one hypothesis is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.recognizer.arrays import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.hypotheses import Hypothesis
from palpate.recognizer.recognise import Recognition
from palpate.recognizer.region import Cells
from palpate.recognizer.segments import cross
from palpate.recognizer.sweep import Approach, sweep

__all__ = ["Candidate", "Grip", "Prediction", "Resolution", "plan_grip", "separable"]

_POSES = 160  # configurations in all; shared out among the hypotheses
_MOST_POSES, _LEAST_POSES = 24, 4
_OUT = 0.7  # of the way from a cell's middle to its corners
_HOPELESS = 1e-3  # a further finger must take at least this share of confusion away


@dataclass(frozen=True, eq=False)
class Candidate:
    """An approach that the rig can reach with one of its fingers."""

    finger_index: int
    approach: Approach


@dataclass(frozen=True)
class Resolution:
    """What the rig can feel: stops and normals that differ by less may look alike."""

    distance_mm: float
    normal_rad: float


@dataclass(frozen=True)
class Prediction:
    """What an approach will meet under one hypothesis, over its whole region.

    The travel before the stop lies in [`earliest_mm`, `latest_mm`]; `latest_mm` is infinite if it may miss,
    `earliest_mm` is infinite if it must.
    """

    earliest_mm: float
    latest_mm: float


@dataclass(frozen=True, eq=False)
class Grip:
    """Approaches to carry out together, and what each of the hypotheses says will happen.

    `predictions[a][h]` belongs to approach a and hypothesis h. `decisive`: whatever happens, at most one
    hypothesis survives it: every two of them have disjoint predictions for some approach. `confusion`:
    expected share of weight that will still feel alike, from 0 to 1.
    """

    candidates: tuple[Candidate, ...]
    predictions: tuple[tuple[Prediction, ...], ...]
    decisive: bool
    confusion: float


def plan_grip(
    recognition: Recognition,
    candidates: Sequence[Candidate],
    compatible: Bools,
    resolution: Resolution,
    used: Sequence[int] = (),
) -> Grip | None:
    """Choose approaches, at most one for each finger, that leave the least confusion; None if none helps.

    `compatible` (n, n): whether two candidates can be carried out together. `used`: candidates not to choose,
    because they were carried out before: what they can tell they have told.
    """
    poses, weight = _poses(recognition.hypotheses)
    likeness = _likeness(recognition, poses, candidates, resolution)
    joint = np.ones((len(poses), len(poses)))
    pair_weight = weight[:, None] * weight
    open_to = np.ones(len(candidates), dtype=bool)
    open_to[list(used)] = False
    chosen: list[int] = []
    confusion = 1.0
    while open_to.any():
        scores = np.where(open_to, np.einsum("cij,ij->c", likeness, joint * pair_weight), np.inf)
        best = int(np.argmin(scores))
        if scores[best] > confusion * (1 - _HOPELESS):
            break
        chosen.append(best)
        confusion = float(scores[best])
        joint = joint * likeness[best]
        open_to &= compatible[best]
    if not chosen:
        return None
    picked = tuple(candidates[k] for k in chosen)
    predictions = tuple(predict(recognition, item.approach) for item in picked)
    return Grip(picked, predictions, _decisive(predictions), confusion)


def predict(recognition: Recognition, approach: Approach) -> tuple[Prediction, ...]:
    """What `approach` will meet under each hypothesis, enclosed over its whole region."""
    result = []
    for hypothesis in recognition.hypotheses:
        stops = sweep(recognition.catalogue, hypothesis.cells, recognition.anchor_mm, [approach])
        earliest, latest = float(stops.earliest.min()), float(stops.latest.max())
        result.append(
            Prediction(
                earliest if earliest <= approach.travel_mm else np.inf,
                latest if latest <= approach.travel_mm else np.inf,
            )
        )
    return tuple(result)


def separable(recognition: Recognition, candidates: Sequence[Candidate], resolution: Resolution) -> bool:
    """Whether some candidate may tell two of the hypotheses apart.

    It may if, for the hypotheses' own configurations, the stops or the normals differ by more than the rig's
    resolution, or one is hit and the other missed. If not, what is left is indistinguishable.
    """
    poses = _joined([_witness_cell(item) for item in recognition.hypotheses])
    return bool(np.any(_likeness(recognition, poses, candidates, resolution) < np.exp(-1.0)))


def _decisive(predictions: Sequence[Sequence[Prediction]]) -> bool:
    count = len(predictions[0])
    return all(any(_disjoint(row[a], row[b]) for row in predictions) for a in range(count) for b in range(a))


def _disjoint(a: Prediction, b: Prediction) -> bool:
    return a.latest_mm < b.earliest_mm or b.latest_mm < a.earliest_mm


def _poses(hypotheses: Sequence[Hypothesis]) -> tuple[Cells, Floats]:
    """Configurations to predict for, as cells without extent, and the weight of each (they sum to 1).

    Half of a hypothesis's weight is its share of the volume; the other half is the same for all, because a
    well-bounded hypothesis has little volume and is none the less likely for it.
    """
    share = max(_LEAST_POSES, min(_MOST_POSES, _POSES // max(len(hypotheses), 1)))
    parts, weights = [], []
    for hypothesis in hypotheses:
        part = _spread(hypothesis, share)
        parts.append(part)
        weight = (hypothesis.weight + 1 / len(hypotheses)) / 2
        weights.append(np.full(len(part), weight / len(part)))
    return _joined(parts), np.concatenate(weights)


def _spread(hypothesis: Hypothesis, count: int) -> Cells:
    """The configuration of a hypothesis, and some between its cells' middles and their corners.

    Not the corners themselves: cells are a little larger than what they enclose, and a plan made for
    configurations that are not there would never end.
    """
    cells = hypothesis.cells
    vertices = cells.polygon.shape[1]
    total = len(cells) * vertices
    pick: Ints = np.unique(np.linspace(0, total - 1, count - 1).astype(np.int64))
    row, corner = pick // vertices, (pick % vertices + pick // vertices) % vertices
    theta = cells.middle[row] + np.where(pick % 2 == 0, -_OUT, _OUT) * cells.half_width[row]
    middle = cells.centre[row]
    position = middle + _OUT * (cells.polygon[row, corner] - middle)
    at = Cells(cells.node[row], cells.state[row], theta, theta, position[:, None])
    return _joined([_witness_cell(hypothesis), at])


def _witness_cell(hypothesis: Hypothesis) -> Cells:
    theta = np.array([hypothesis.configuration.theta_rad])
    state = np.array([hypothesis.state_index])
    return Cells(np.zeros(1, np.int64), state, theta, theta, hypothesis.witness_mm[None, None])


def _joined(parts: Sequence[Cells]) -> Cells:
    """Poses of several hypotheses in one; each has a single position."""
    return Cells(
        np.concatenate([part.node for part in parts]),
        np.concatenate([part.state for part in parts]),
        np.concatenate([part.lo for part in parts]),
        np.concatenate([part.hi for part in parts]),
        np.concatenate([part.polygon for part in parts]),
    )


def _likeness(
    recognition: Recognition, poses: Cells, candidates: Sequence[Candidate], resolution: Resolution
) -> Floats:
    """How alike two poses feel to each candidate, (c, p, p): 1 if nothing differs, 1/e at the resolution."""
    result = np.empty((len(candidates), len(poses), len(poses)))
    for index, candidate in enumerate(candidates):
        felt = _felt(recognition.catalogue, poses, recognition.anchor_mm, candidate.approach)
        result[index] = np.exp(-(_difference(felt, resolution) ** 2))
    return result


def _difference(felt: "_Felt", resolution: Resolution) -> Floats:
    """How differently poses feel, pair by pair (p, p), in units of what the rig can just tell.

    Two hits differ by where they stop, as seen along the surface's normal, or by their normals. A hit and a
    miss differ by how far the object would have to move sideways to turn one into the other: a graze is no
    sure sign of anything, and both its outcomes carry an error.
    """
    facing = np.minimum(felt.facing[:, None], felt.facing)
    apart = facing * np.abs(felt.travel[:, None] - felt.travel) / resolution.distance_mm
    turned = np.abs((felt.normal[:, None] - felt.normal + np.pi) % (2 * np.pi) - np.pi)
    sideways = np.abs(felt.margin[:, None] - felt.margin) / (2 * resolution.distance_mm)
    both = felt.hit[:, None] & felt.hit
    one = felt.hit[:, None] != felt.hit
    result: Floats = np.where(both, np.maximum(apart, turned / resolution.normal_rad), 0.0)
    return np.where(one, sideways, result)


@dataclass(frozen=True, eq=False)
class _Felt:
    """What an approach feels for each of p poses.

    `hit` (p,); where hit, `travel` (p,) mm before the stop, `normal` (p,) rad, outward in W, and `facing`
    (p,): cosine between the travel and the inward normal. `margin` (p,) mm: how far the path is from just
    missing (negative: from just touching) the object, sideways.
    """

    hit: Bools
    travel: Floats
    normal: Floats
    facing: Floats
    margin: Floats


def _felt(catalogue: Catalogue, poses: Cells, anchor_mm: Floats, approach: Approach) -> _Felt:
    """Predict an approach for poses without extent."""
    edges = catalogue.outlines(approach.finger)
    travel, normal = np.full(len(poses), np.inf), np.zeros(len(poses))
    margin = np.full(len(poses), -np.inf)
    point = np.asarray(approach.start_mm) - anchor_mm
    cos, sin = np.cos(poses.lo), np.sin(poses.lo)
    start = np.column_stack([cos * point[0] + sin * point[1], cos * point[1] - sin * point[0]])
    start -= poses.polygon[:, 0]
    relative = approach.direction_rad - poses.lo
    heading = np.column_stack([np.cos(relative), np.sin(relative)])
    for state in np.unique(poses.state):
        rows = np.flatnonzero(poses.state == state)
        block = slice(int(edges.first[state]), int(edges.first[state + 1]))
        if block.stop == block.start:
            continue
        at, which = _first_crossing(
            start[rows], heading[rows], edges.start[block], edges.direction[block], edges.length[block]
        )
        rel = edges.start[block] - start[rows][:, None]
        offset = cross(heading[rows][:, None], rel)
        margin[rows] = np.minimum(offset.max(axis=1), -offset.min(axis=1))
        travel[rows] = at
        normal[rows] = edges.normal_rad[block][which] + poses.lo[rows]
    hit = travel <= approach.travel_mm
    # Where no edge is high enough there is nothing to graze either.
    margin = np.maximum(margin, -approach.travel_mm)
    normal = np.where(hit, normal, 0.0)
    facing = np.abs(np.cos(normal - approach.direction_rad))
    return _Felt(hit, np.where(hit, travel, 0.0), normal, facing, margin)


def _first_crossing(
    start: Floats, heading: Floats, begin: Floats, direction: Floats, length: Floats
) -> tuple[Floats, Ints]:
    """First crossing of rays (m, 2) into edges (n, 2) from outside: travel (m,) and edge (m,)."""
    rel = begin - start[:, None]
    facing = cross(heading[:, None], direction)
    inward = facing < -1e-12  # facing is heading · outward normal
    safe = np.where(inward, facing, 1.0)
    travel = cross(rel, direction[None]) / safe
    along = cross(rel, heading[:, None]) / safe
    hits = inward & (travel >= 0) & (along >= -1e-9) & (along <= length + 1e-9)
    travel = np.where(hits, travel, np.inf)
    which = np.argmin(travel, axis=1)
    return travel[np.arange(len(travel)), which], which
