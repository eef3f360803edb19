"""Measurement model: outcomes of touches at single configurations, and how similar two of them are.

Stops and normals are exact but for the facets of arcs. Plans are compared by them; guaranteed enclosures over
whole regions are those of `prediction`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.pad_face import strip_extents
from palpate.recognizer.rays import Approach, Rays, in_object_frame, near_edges, offset_from_rays
from palpate.recognizer.region import Cells
from palpate.recognizer.strip_trees import StripForest

__all__ = ["Resolution", "TouchOutcomes", "similarity", "touch_outcomes"]


@dataclass(frozen=True)
class Resolution:
    """Resolution of the rig: stops and normals that differ by less may be indistinguishable.

    `normal_half_rad`: an ordinary touch measures the normal to within this, either way.
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
        """Those of approaches `rows` and of `poses` (indices)."""
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
        if finger.is_pad:
            first, _ = strip_extents(edges, rays, finger.tip_radius_mm)
            travel[rows] = first.reshape(len(poses), len(rows)).T
            normal[rows] = np.array([[approaches[k].direction_rad + np.pi] for k in rows])
            margin[rows] = aside.reshape(len(poses), len(rows)).T + finger.tip_radius_mm
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


def similarity(
    outcome: TouchOutcomes, first: Ints, second: Ints, resolution: Resolution, rows: Ints
) -> Floats:
    """Similarity (c, n) of the outcomes of approaches `rows` (c,) at poses `first` and `second` (n,).

    1 if nothing differs, 1/e where the rig can just distinguish them. Two hits differ by where they stop, as
    seen along the surface's normal, or by their normals. A hit and a miss differ by how far the object would
    have to move sideways to turn one into the other: a graze is no sure sign of anything, and both its
    outcomes carry an error.
    """
    one, two = outcome.select(rows, first), outcome.select(rows, second)
    along = np.minimum(one.facing, two.facing) * np.abs(one.travel - two.travel) / resolution.distance_mm
    # Normals are off by a chord: nearly the angle where that is small, and it grows with it.
    half = outcome.normal[rows] / 2
    sin, cos = np.sin(half), np.cos(half)
    chord = sin.take(first, axis=1) * cos.take(second, axis=1)
    chord -= cos.take(first, axis=1) * sin.take(second, axis=1)
    turned = np.abs(chord) / np.sin(resolution.normal_half_rad)
    aside = np.abs(one.margin - two.margin) / (2 * resolution.distance_mm)
    off = np.where(one.hit & two.hit, np.maximum(along, turned), 0.0)
    off = np.where(one.hit != two.hit, aside, off)
    result: Floats = np.exp(-(off**2))
    return result


def _margin(edges: EdgeSet, rays: Rays) -> Floats:
    """How far each ray's line (r,) runs inside of the outline's extent, sideways; negative outside of it."""
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
