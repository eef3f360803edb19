"""Model of touches for planning: outcomes at sampled poses, their similarity, and the hazard of each touch.

Hypotheses are represented by some configurations of their regions. Stops and normals at these are exact but
for the facets of arcs; plans are compared by them. Guaranteed enclosures over whole regions are those of
`prediction`. An approach is hazardous where it may move the part: slide it, or worse, tip or roll it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.approach import Approach, Rays, in_object_frame, near_edges, offset_from_rays
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.hypotheses import Bounds, Hypotheses
from palpate.recognizer.pad_face import strip_extents
from palpate.recognizer.pose_region import Cells, corner_mask
from palpate.recognizer.strip_trees import StripForest
from palpate.recognizer.tables import Table


@dataclass(frozen=True)
class Resolution:
    """Resolution of the rig: stops and normals that differ by less may be indistinguishable.

    `normal_half_rad`: an ordinary touch measures the normal to within this, either way; π if not at all.
    """

    distance_mm: float
    normal_half_rad: float


@dataclass(frozen=True, eq=False)
class TouchOutcomes:
    """Outcomes of c approaches at each of p poses, all (c, p).

    `hit`; where hit, `travel` mm before the stop, `normal` rad, outward in W, and `facing`: cosine between
    the travel and the inward normal. `margin` mm: how far sideways the object would have to move for the
    approach just to miss it (negative: just to touch it). Pads measure no normal: theirs is their face's.
    """

    hit: Bools
    travel: Floats
    normal: Floats
    facing: Floats
    margin: Floats

    def select(self, rows: Ints, poses: Ints) -> "TouchOutcomes":
        """Outcomes of approaches `rows` and `poses` (indices)."""
        return TouchOutcomes(
            self.hit[rows].take(poses, axis=1),
            self.travel[rows].take(poses, axis=1),
            self.normal[rows].take(poses, axis=1),
            self.facing[rows].take(poses, axis=1),
            self.margin[rows].take(poses, axis=1),
        )


def touch_outcomes(
    catalogue: Catalogue, poses: Cells, anchor_mm: Floats, approaches: Sequence[Approach]
) -> TouchOutcomes:
    """Outcomes of approaches for poses, which are cells without extent."""
    shape = (len(approaches), len(poses))
    travel, normal, margin = np.full(shape, np.inf), np.zeros(shape), np.zeros(shape)
    for finger in dict.fromkeys(approach.finger for approach in approaches):
        rows = np.array([k for k, approach in enumerate(approaches) if approach.finger == finger])
        start, heading = in_object_frame(poses, anchor_mm, [approaches[k] for k in rows])
        state = np.repeat(poses.state, len(rows))
        rays = Rays(state, start.reshape(-1, 2), heading.reshape(-1, 2), np.zeros(len(state)))
        point = finger.face_point
        edges, strips = catalogue.outlines(point), catalogue.outline_strips(point)
        aside = _margin(edges, rays)
        if finger.face_half_mm:
            first, _ = strip_extents(edges, rays, finger.face_half_mm)
            travel[rows] = first.reshape(len(poses), len(rows)).T
            normal[rows] = np.array([[approaches[k].direction_rad + np.pi] for k in rows])
            margin[rows] = aside.reshape(len(poses), len(rows)).T + finger.face_half_mm
            continue
        crossing = np.flatnonzero(aside > 0)
        at, edge = _first_crossing(edges, strips, rays.select(crossing))
        pose, which = np.divmod(crossing, len(rows))
        travel[rows[which], pose] = at
        normal[rows[which], pose] = edges.normal_rad[edge] + poses.lo[pose]
        margin[rows] = aside.reshape(len(poses), len(rows)).T
    reach = np.array([approach.travel_mm for approach in approaches])[:, None]
    hit = travel <= reach
    normal = np.where(hit, normal, 0.0)
    direction = np.array([approach.direction_rad for approach in approaches])[:, None]
    return TouchOutcomes(hit, np.where(hit, travel, 0.0), normal, np.abs(np.cos(normal - direction)), margin)


@dataclass(frozen=True, eq=False)
class Blur:
    """Blur of outcomes at p poses by the tolerances of their states: stops (p,) mm, normals (p,) rad."""

    distance_mm: Floats
    normal_rad: Floats

    @classmethod
    def of(cls, catalogue: Catalogue, poses: Cells, fingers: Iterable[Finger]) -> "Blur":
        """Blur for touches of these fingers."""
        tolerance = np.array([item.tolerance_mm for item in catalogue.states])
        turned = np.max([catalogue.edges(item.face_point).mean_turn_rad for item in fingers], axis=0)
        normals = np.where(tolerance > 0, turned, 0.0)
        return cls(tolerance[poses.state], normals[poses.state])

    def of_pairs(self, first: Ints, second: Ints) -> "Blur":
        """Blur (n,) of the differences of pairs of poses."""
        return Blur(
            self.distance_mm[first] + self.distance_mm[second],
            self.normal_rad[first] + self.normal_rad[second],
        )


def similarity(
    outcome: TouchOutcomes,
    first: Ints,
    second: Ints,
    resolution: Resolution,
    rows: Ints,
    blur: Blur | None = None,
) -> Floats:
    """Similarity (c, n) of the outcomes of approaches `rows` (c,) at poses `first` and `second` (n,).

    1 if nothing differs, 1/e where the rig can just distinguish them. Two hits differ by where they stop, as
    seen along the surface's normal, or by their normals. A hit and a miss differ by how far the object would
    have to move sideways to turn one into the other: a graze is no sure sign of anything, and both its
    outcomes carry an error. `blur` (n,): of the pairs, beside the resolution.
    """
    distance, half_range = np.array(resolution.distance_mm), np.array(resolution.normal_half_rad)
    if blur is not None:
        distance, half_range = distance + blur.distance_mm, half_range + blur.normal_rad
    one, two = outcome.select(rows, first), outcome.select(rows, second)
    along = np.minimum(one.facing, two.facing) * np.abs(one.travel - two.travel) / distance
    # Normals are off by a chord: nearly the angle where that is small, and it grows with it.
    half = outcome.normal[rows] / 2
    sin, cos = np.sin(half), np.cos(half)
    chord = sin.take(first, axis=1) * cos.take(second, axis=1)
    chord -= cos.take(first, axis=1) * sin.take(second, axis=1)
    # From a quarter turn on any two normals may be one.
    within = np.where(half_range < np.pi / 2, np.sin(np.minimum(half_range, np.pi / 2)), np.inf)
    turned = np.abs(chord) / within
    aside = np.abs(one.margin - two.margin) / (2 * distance)
    off = np.where(one.hit & two.hit, np.maximum(along, turned), 0.0)
    off = np.where(one.hit != two.hit, aside, off)
    result: Floats = np.exp(-(off**2))
    return result


def _margin(edges: EdgeSet, rays: Rays) -> Floats:
    """Depth of each ray's line (r,) inside of the outline's extent, sideways; negative outside of it."""
    offset = rays.heading[:, 0] * rays.start[:, 1] - rays.heading[:, 1] * rays.start[:, 0]
    left = np.arctan2(rays.heading[:, 0], -rays.heading[:, 1])
    return np.minimum(
        edges.support(rays.state, left) - offset, edges.support(rays.state, left + np.pi) + offset
    )


def _first_crossing(edges: EdgeSet, strips: StripForest, rays: Rays) -> tuple[Floats, Ints]:
    """First crossing of rays into the outline: travel (r,), infinite where there is none, and edge (r,)."""
    ray, edge = near_edges(edges, strips, rays)
    rel = edges.start[edge] - rays.start[ray]
    facing = np.sum(rays.heading[ray] * edges.normal[edge], axis=1)
    enters = (facing < -1e-12) & (
        (offset_from_rays(rays, ray, edges.start[edge]) > 0)
        != (offset_from_rays(rays, ray, edges.end[edge]) > 0)
    )
    ray, edge = ray[enters], edge[enters]
    at = np.sum(rel[enters] * edges.normal[edge], axis=1) / facing[enters]
    ahead = at >= 0
    ray, edge, at = ray[ahead], edge[ahead], at[ahead]
    travel, which = np.full(len(rays), np.inf), np.zeros(len(rays), np.int64)
    np.minimum.at(travel, ray, at)
    nearest = at == travel[ray]
    which[ray[nearest]] = edge[nearest]
    return travel, which


_TOTAL_POSES = 160  # in all; shared out among the hypotheses
_MAX_POSES_EACH, _MIN_POSES_EACH = 48, 1
_CORNER_SHARE = 0.7  # of the way from a cell's middle to its corners
_GOAL_SHARE = 0.4  # of the goals: bounds are twice as wide, and they hold more than one touch can resolve
_MAX_PAIRS = 12_000


@dataclass(frozen=True)
class Goals:
    """Bounds narrower than these, either way, are fine enough. Raises InputError unless both are over 0."""

    position_mm: float
    orientation_rad: float

    def __post_init__(self) -> None:
        try:
            is_over_0 = self.position_mm > 0 and self.orientation_rad > 0
        except TypeError:
            is_over_0 = False
        if not is_over_0:
            raise InputError(f"goals must be numbers over 0, in mm and rad: {self}")

    def are_met_by(self, bounds: Bounds) -> bool:
        """Return whether bounds are fine enough."""
        return (
            bounds.position_half_mm <= self.position_mm
            and bounds.orientation_half_rad <= self.orientation_rad
        )


@dataclass(frozen=True, eq=False)
class SampledPoses:
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


def sampled_poses(hypotheses: Hypotheses) -> SampledPoses:
    """Sample of configurations of every hypothesis.

    Half of a hypothesis's weight is its share of the volume; the other half is its state's probability alone,
    because a well-bounded hypothesis has little volume and is none the less likely for it.
    """
    share = max(_MIN_POSES_EACH, min(_MAX_POSES_EACH, _TOTAL_POSES // max(len(hypotheses), 1)))
    if share == 1:
        return witness_poses(hypotheses)
    own, spread = witness_poses(hypotheses), _spread(hypotheses, share - 1)
    cells = Cells.join([own.cells, spread])
    owner = np.concatenate([own.owner, np.repeat(own.owner, share - 1)])
    return SampledPoses(cells, owner, own.weight[owner] / share)


def witness_poses(hypotheses: Hypotheses) -> SampledPoses:
    """Every hypothesis's own configuration."""
    regions = hypotheses.regions
    count = len(hypotheses)
    cells = Cells(
        np.zeros(count, np.int64), hypotheses.state, regions.theta, regions.theta, regions.position[:, None]
    )
    return SampledPoses(cells, np.arange(count), _weights(hypotheses))


def pairs_to_distinguish(poses: SampledPoses, hypotheses: Hypotheses, goals: Goals) -> Pairs:
    """Pairs of different hypotheses, and pairs of one that are further apart than is fine enough.

    Hypotheses that are `near_equal` count as one. Where there are too many pairs, some that are drawn in
    proportion to their weight: always the same ones.
    """
    first, second = np.triu_indices(len(poses.owner), 1)
    weight = poses.weight[first] * poses.weight[second]
    if len(first) > _MAX_PAIRS:
        rng = np.random.default_rng(len(first))
        drawn = rng.choice(len(first), _MAX_PAIRS, p=weight / weight.sum())
        first, second, weight = first[drawn], second[drawn], np.ones(_MAX_PAIRS)
    other = ~near_equal(hypotheses, goals)[poses.owner[first], poses.owner[second]]
    coarse = ~other & _are_coarse(poses, hypotheses, goals, first, second)
    # Both kinds count for half: a grip that rules out hypotheses should also narrow what is left.
    for kind in (other, coarse):
        weight[kind] /= float(weight[kind].sum()) or 1.0
    needed = other | coarse
    first, second, weight = first[needed], second[needed], weight[needed]
    return Pairs(first, second, weight / (float(weight.sum()) or 1.0))


def near_equal(hypotheses: Hypotheses, goals: Goals) -> Bools:
    """Pairs of hypotheses (h, h): states of one object whose configurations agree within `goals`.

    Every hypothesis with itself is one.
    """
    catalogue = hypotheses.constraints.catalogue
    names = [catalogue.states[k].object_name for k in hypotheses.state.tolist()]
    _, item = np.unique(names, return_inverse=True)
    first, second = np.triu_indices(len(names), 1)
    same = (item[first] == item[second]) & (hypotheses.state[first] != hypotheses.state[second])
    first, second = first[same], second[same]
    away, turned = distances_between(witness_poses(hypotheses), hypotheses, first, second)
    near = (away <= goals.position_mm) & (turned <= goals.orientation_rad)
    result: Bools = np.eye(len(names), dtype=bool)
    result[first[near], second[near]] = result[second[near], first[near]] = True
    return result


def _are_coarse(
    poses: SampledPoses, hypotheses: Hypotheses, goals: Goals, first: Ints, second: Ints
) -> Bools:
    """Mask of pairs of poses of one object that are further apart than bounds that are fine enough allow."""
    away, turned = distances_between(poses, hypotheses, first, second)
    result: Bools = (away > _GOAL_SHARE * goals.position_mm) | (turned > _GOAL_SHARE * goals.orientation_rad)
    return result


def distances_between(
    poses: SampledPoses, hypotheses: Hypotheses, first: Ints, second: Ints
) -> tuple[Floats, Floats]:
    """Differences of pairs of poses of one object (n,): of x or y, whichever differs more (mm), and of θ."""
    origin = hypotheses.constraints.catalogue.origins_mm[poses.cells.state]
    x, y = (poses.cells.polygon[:, 0] - origin).T
    cos, sin = np.cos(poses.cells.lo), np.sin(poses.cells.lo)
    place = np.column_stack([cos * x - sin * y, sin * x + cos * y])
    away: Floats = np.abs(place[first] - place[second]).max(axis=1)
    return away, np.abs(wrap_angle(poses.cells.lo[first] - poses.cells.lo[second]))


def _weights(hypotheses: Hypotheses) -> Floats:
    prior = hypotheses.constraints.catalogue.prior[hypotheses.state]
    result: Floats = (hypotheses.weight + prior / prior.sum()) / 2
    return result


def _spread(hypotheses: Hypotheses, count: int) -> Cells:
    """`count` configurations of each hypothesis, one after the other, between cells' middles and corners.

    Not the corners themselves: cells are a little larger than what they enclose, and a plan made for
    configurations that are not there would never end.
    """
    cells, first = hypotheses.regions.cells, hypotheses.regions.first
    sizes = corner_mask(cells.polygon).sum(axis=1)
    begin = np.cumsum(np.append(0, sizes))
    last = begin[first[1:]] - begin[first[:-1]] - 1
    pick = (last[:, None] * np.linspace(0, 1, count)).astype(np.int64).ravel()
    at = np.repeat(begin[first[:-1]], count) + pick
    row = np.searchsorted(begin, at, side="right") - 1
    # The corners of one cell after the other: of neighbouring cells others.
    corner = (at - begin[row] + row) % sizes[row]
    theta = cells.middle[row] + np.where(pick % 2 == 0, -_CORNER_SHARE, _CORNER_SHARE) * cells.half_width[row]
    position = cells.centre[row] + _CORNER_SHARE * (cells.polygon[row, corner] - cells.centre[row])
    return Cells(cells.node[row], cells.state[row], theta, theta, position[:, None])


class PushLimits(Protocol):
    """Limits of how states of a catalogue may be pushed."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        """Heights (n, D) up to which a push only slides states (n,), infinite if at all.

        Directions are inward normals of the surface that is pushed, at 2πk/D in the object frame.
        """
        ...

    def slide_shares(self, states: Ints) -> Floats:
        """Share (n, 2) of what holds states (n,): what a touch through the middle takes of it, and what a mm
        off the middle adds; 0 where nothing is known to slide.
        """
        ...

    def touch_mm_s(self, states: Ints) -> float:
        """Speed at which a finger meets a part in one of `states` (n,)."""
        ...


def push_hazard(
    limits: PushLimits,
    approaches: Sequence[Approach],
    poses: SampledPoses,
    anchor_mm: Floats,
    outcome: TouchOutcomes,
) -> Floats:
    """Hazard (n,) of approaches, 0 to 1, over the poses.

    0 for one that cannot move the part at all, 1 for one under which it may roll away: the share of its
    height that is above the safe one, or by how much it exceeds what holds the part, if that is more.
    """
    tipping = _tipping(limits, approaches, poses, outcome)
    result: Floats = (
        np.maximum(tipping, _sliding(limits, approaches, poses, anchor_mm, outcome)) @ poses.weight
    )
    return result


def _sliding(
    limits: PushLimits,
    approaches: Sequence[Approach],
    poses: SampledPoses,
    anchor_mm: Floats,
    outcome: TouchOutcomes,
) -> Floats:
    """Excess (n, p) of approaches over what holds the part, relative to what they take of it."""
    shares = limits.slide_shares(poses.cells.state)
    if not shares.any():
        return np.zeros(outcome.hit.shape)
    start = np.array([item.start_mm for item in approaches]) - anchor_mm
    along = np.array([[np.cos(item.direction_rad), np.sin(item.direction_rad)] for item in approaches])
    at = start[:, None] + np.where(outcome.hit, outcome.travel, 0.0)[..., None] * along[:, None]
    cos, sin = np.cos(poses.cells.lo), np.sin(poses.cells.lo)
    x = cos * at[..., 0] + sin * at[..., 1] - poses.cells.centre[:, 0]
    y = cos * at[..., 1] - sin * at[..., 0] - poses.cells.centre[:, 1]
    taken = shares[:, 0] + shares[:, 1] * np.hypot(x, y)
    return np.where(outcome.hit & (taken > 1.0), 1 - 1 / np.maximum(taken, 1.0), 0.0)


def _tipping(
    limits: PushLimits, approaches: Sequence[Approach], poses: SampledPoses, outcome: TouchOutcomes
) -> Floats:
    """Share (n, p) of the approaches' height that is above the safe one."""
    states, row = np.unique(poses.cells.state, return_inverse=True)
    table = limits.safe_heights_mm(states)
    if np.isinf(table).all():
        return np.zeros(outcome.hit.shape)
    count = table.shape[1]
    inward = outcome.normal + np.pi - poses.cells.lo
    column = np.round(inward * (count / (2 * np.pi))).astype(np.int64) % count
    # A tip of some length may push with its upper end alone.
    height = np.array([item.finger.span_mm[1] for item in approaches])[:, None]
    above = np.maximum(height - table[row, column], 0.0) / np.maximum(height, 1e-9)
    return np.where(outcome.hit, above, 0.0)
