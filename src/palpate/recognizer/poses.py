"""Sampled poses: configurations that represent hypotheses in planning, and pairs that need distinguishing."""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.hypotheses import Bounds, Hypotheses
from palpate.recognizer.region import Cells, corners
from palpate.recognizer.tables import Table

__all__ = ["Goals", "Pairs", "Poses", "pairs_to_distinguish", "sampled_poses", "witness_poses"]

_POSES = 160  # in all; shared out among the hypotheses
_MOST_POSES, _LEAST_POSES = 48, 1
_OUT = 0.7  # of the way from a cell's middle to its corners
_FINE = 0.4  # of the goals: bounds are twice as wide, and they hold more than one touch can resolve
_MOST_PAIRS = 12_000


@dataclass(frozen=True)
class Goals:
    """Bounds narrower than these, either way, are fine enough."""

    position_mm: float
    orientation_rad: float

    def met_by(self, bounds: Bounds) -> bool:
        """Whether bounds are fine enough."""
        return (
            bounds.position_half_mm <= self.position_mm
            and bounds.orientation_half_rad <= self.orientation_rad
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """p configurations, as cells without extent, of hypotheses `owner` (p,). The `weight` (p,) sums to 1."""

    cells: Cells
    owner: Ints
    weight: Floats


@dataclass(frozen=True, eq=False)
class Pairs(Table):
    """n pairs of poses to distinguish, `first` and `second` (n,). Their `weight` (n,) sums to 1."""

    first: Ints
    second: Ints
    weight: Floats


def sampled_poses(hypotheses: Hypotheses) -> Poses:
    """Some configurations of every hypothesis.

    Half of a hypothesis's weight is its share of the volume; the other half is the same for all, because a
    well-bounded hypothesis has little volume and is none the less likely for it.
    """
    share = max(_LEAST_POSES, min(_MOST_POSES, _POSES // max(len(hypotheses), 1)))
    if share == 1:
        return witness_poses(hypotheses)
    own, spread = witness_poses(hypotheses), _spread(hypotheses, share - 1)
    cells = Cells.joined([own.cells, spread])
    owner = np.concatenate([own.owner, np.repeat(own.owner, share - 1)])
    return Poses(cells, owner, own.weight[owner] / share)


def witness_poses(hypotheses: Hypotheses) -> Poses:
    """Every hypothesis's own configuration."""
    regions = hypotheses.regions
    count = len(hypotheses)
    cells = Cells(
        np.zeros(count, np.int64), hypotheses.state, regions.theta, regions.theta, regions.position[:, None]
    )
    return Poses(cells, np.arange(count), _weights(hypotheses))


def pairs_to_distinguish(poses: Poses, hypotheses: Hypotheses, goals: Goals) -> Pairs:
    """Pairs of different hypotheses, and pairs of one that are further apart than is fine enough.

    Where there are too many, some that are drawn in proportion to their weight: always the same ones.
    """
    first, second = np.triu_indices(len(poses.owner), 1)
    weight = poses.weight[first] * poses.weight[second]
    if len(first) > _MOST_PAIRS:
        rng = np.random.default_rng(len(first))
        drawn = rng.choice(len(first), _MOST_PAIRS, p=weight / weight.sum())
        first, second, weight = first[drawn], second[drawn], np.ones(_MOST_PAIRS)
    other = poses.owner[first] != poses.owner[second]
    coarse = ~other & _coarse(poses, hypotheses, goals, first, second)
    # Both kinds count for half: a grip that rules out hypotheses should also narrow what is left.
    for kind in (other, coarse):
        weight[kind] /= float(weight[kind].sum()) or 1.0
    needed = other | coarse
    first, second, weight = first[needed], second[needed], weight[needed]
    return Pairs(first, second, weight / (float(weight.sum()) or 1.0))


def _coarse(poses: Poses, hypotheses: Hypotheses, goals: Goals, first: Ints, second: Ints) -> Bools:
    """Whether two poses of one object are further apart than bounds that are fine enough allow."""
    origin = hypotheses.constraints.catalogue.origins_mm[poses.cells.state]
    x, y = (poses.cells.polygon[:, 0] - origin).T
    cos, sin = np.cos(poses.cells.lo), np.sin(poses.cells.lo)
    place = np.column_stack([cos * x - sin * y, sin * x + cos * y])
    away = np.abs(place[first] - place[second]).max(axis=1)
    turned = np.abs(wrap_angle(poses.cells.lo[first] - poses.cells.lo[second]))
    result: Bools = (away > _FINE * goals.position_mm) | (turned > _FINE * goals.orientation_rad)
    return result


def _weights(hypotheses: Hypotheses) -> Floats:
    return (hypotheses.weight + 1 / len(hypotheses)) / 2


def _spread(hypotheses: Hypotheses, count: int) -> Cells:
    """`count` configurations of each hypothesis, one after the other, between cells' middles and corners.

    Not the corners themselves: cells are a little larger than what they enclose, and a plan made for
    configurations that are not there would never end.
    """
    cells, first = hypotheses.regions.cells, hypotheses.regions.first
    sizes = corners(cells.polygon).sum(axis=1)
    begin = np.cumsum(np.append(0, sizes))
    last = begin[first[1:]] - begin[first[:-1]] - 1
    pick = (last[:, None] * np.linspace(0, 1, count)).astype(np.int64).ravel()
    at = np.repeat(begin[first[:-1]], count) + pick
    row = np.searchsorted(begin, at, side="right") - 1
    # The corners of one cell after the other: of neighbouring cells others.
    corner = (at - begin[row] + row) % sizes[row]
    theta = cells.middle[row] + np.where(pick % 2 == 0, -_OUT, _OUT) * cells.half_width[row]
    position = cells.centre[row] + _OUT * (cells.polygon[row, corner] - cells.centre[row])
    return Cells(cells.node[row], cells.state[row], theta, theta, position[:, None])
