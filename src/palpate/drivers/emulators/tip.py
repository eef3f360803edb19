"""An elastic fingertip against outlines: from its position to the force on it and on its taxels.

Stands behind the emulated array and the emulated slide. The tip is a cylinder of compliant skin (an elastic
foundation; Johnson, Contact Mechanics, ch. 4.3): the skin yields along the radius, and how far it has to
yield in each direction is how far the object reaches into the undeformed circle. Each stretch of skin that is
touched pushes back from the nearest point of the object to the axis, with a force that depends on the deepest
dent only: it has a potential, so that no path in contact gives energy back. In a wide notch one stretch has
two deepest dents and a valley between them, where the notch's corner is: the valley counts once only, which
keeps the potential continuous. Taxels see the force spread over the stretch in proportion to the dents. On a
flat wall what they see adds up to stiffness times the deepest dent; as they look in different directions, a
little of it cancels out on the axis.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Floats, Ints

_RAYS = 1440  # directions in which dents are taken, a quarter of a degree apart: a corner dents only a few
_STEP_RAD = 2 * math.pi / _RAYS
_ANGLES: Floats = np.arange(_RAYS, dtype=np.float64) * _STEP_RAD
_PARALLEL_MM = 1e-12  # mm: a ray runs along an edge, or nearly
_OCCLUSION_MM = 0.03  # a point is hidden by what is nearer by more; rays miss corners by a little less
_HEADINGS: Floats = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_HEADING_OF = tuple(map(tuple, _HEADINGS.tolist()))


@dataclass(frozen=True, eq=False)
class PartSection:
    """Section of the part on the table: straight edges from `start` to `end`, each (n, 2) mm in W, and its
    top.

    `z_mm` (n, 2): from which height to which each of them stands beside the tip; None: all along it. Beside
    a ball: what a disc of `disc_mm` meets when the ball touches, and `upright` (n,), the cosine of the
    latitude at which the ball touches each; None: the tip is a disc of its own radius all along.
    """

    start: Floats
    end: Floats
    top_mm: float
    z_mm: Floats | None = None
    disc_mm: float | None = None
    upright: Floats | None = None

    @cached_property
    def along(self) -> Floats:
        """Vectors from each edge's start to its end, (n, 2) mm."""
        result: Floats = self.end - self.start
        return result

    @cached_property
    def square(self) -> Floats:
        """Squared lengths (n,) mm²."""
        result: Floats = np.einsum("ij,ij->i", self.along, self.along)
        return result

    @cached_property
    def edges(self) -> list[tuple[float, ...]]:
        """Each edge's start (x, y), its way (x, y), the way of the edge that ends there (x, y), its square.

        Where none ends at its start, its own way counts for that.
        """
        ends = {point: k for k, point in enumerate(map(tuple, self.end.tolist()))}
        before = [ends.get(point, k) for k, point in enumerate(map(tuple, self.start.tolist()))]
        columns = (self.start, self.along, self.along[before], self.square[:, None])
        return list(map(tuple, np.hstack(columns).tolist()))


@dataclass(frozen=True, eq=False)
class TipLoad:
    """Force (2,) N on the tip in W, and its share by direction: N per ray at angles `angle` (m,) in W.

    Shares are worked out when they are asked for: arrays sample a few of the loads that mechanics go through.
    `turns_rad`: by how much the rays have been turned, in order.
    """

    force_n: Floats
    contact: "SkinContact"
    turns_rad: tuple[float, ...] = ()

    @cached_property
    def angle(self) -> Floats:
        """Directions (m,) rad in W of the rays."""
        result = _ANGLES
        for turn_rad in self.turns_rad:
            result = result + turn_rad
        return result

    @property
    def by_ray_n(self) -> Floats:
        """Load of each ray (m,)."""
        return self.contact.by_ray_n

    @property
    def on_skin_n(self) -> Floats:
        """Force on the skin at each ray (m,): more than its load where a ball touches obliquely."""
        upright = self.contact.upright
        return self.by_ray_n if upright is None else self.by_ray_n / upright

    def point_mm(self, centre_mm: Floats) -> Floats:
        """Point at which it acts: on the tip's axis."""
        return centre_mm

    def height_mm(self, middle_mm: float) -> float:
        """Mean height of the force: `middle_mm`, if the outline does not say where its edges stand."""
        z_mm = self.contact.heights_mm
        if z_mm is None:
            return middle_mm
        return float(np.average(z_mm.mean(axis=1), weights=np.maximum(self.by_ray_n, 1e-12)))

    def rotate(self, force_n: Floats, turn_rad: float) -> "TipLoad":
        """Load with another force on the tip, and the rays turned on."""
        return TipLoad(force_n, self.contact, (*self.turns_rad, turn_rad))


def separation_mm(outline: PartSection, centre_mm: Floats) -> float:
    """Distance from a point to the nearest edge (mm); the inside of the outline counts as outside."""
    away = _to_edges(outline, centre_mm)
    return float(np.sqrt(np.min(np.einsum("ij,ij->i", away, away))))


def _to_edges(outline: PartSection, centre_mm: Floats) -> Floats:
    """Shortest way (n, 2) in mm from each edge to a point."""
    rel = centre_mm - outline.start
    share = np.einsum("ij,ij->i", rel, outline.along) / outline.square
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    result: Floats = rel - share[:, None] * outline.along
    return result


def tip_load(
    outline: PartSection, centre_mm: Floats, radius_mm: float, stiffness_n_per_mm: float
) -> TipLoad | None:
    """Load of the outline on a tip with its axis at `centre_mm` in W; None if it does not touch it."""
    # Served on real ports, this runs for every finger in every millisecond: far edges are left out first, and
    # dents are taken in the few directions on which the force depends.
    away = _to_edges(outline, centre_mm)
    square = np.einsum("ij,ij->i", away, away)
    near = np.flatnonzero(square <= radius_mm**2)
    if not len(near):
        return None
    contact = SkinContact(outline, near, away[near], square[near], centre_mm, radius_mm, stiffness_n_per_mm)
    if not contact.is_touched():
        return None
    push = np.array([sum(x for x, _, _ in contact.pushes), sum(y for _, y, _ in contact.pushes)])
    return TipLoad(stiffness_n_per_mm * push, contact)


@dataclass(frozen=True, eq=False)
class SkinContact:
    """A tip's skin where it meets an outline: dents, and what the axis and the taxels feel of them.

    `near` (n,): edges that reach into the undeformed circle; `away` (n, 2) mm: from their nearest points to
    the axis, and that squared, `square` (n,).
    """

    outline: PartSection
    near: Ints
    away: Floats
    square: Floats
    centre_mm: Floats
    radius_mm: float
    stiffness_n_per_mm: float

    def is_touched(self) -> bool:
        """True if any ray is dented: those about the nearest point first."""
        x, y = self.away[np.argmin(self.square)].tolist()
        towards = math.floor(math.atan2(-y, -x) / _STEP_RAD)
        about = (ray % _RAYS for ray in range(towards - 1, towards + 3))
        return any(self._dent(ray) > 0 for ray in about) or len(self._dented_rays[0]) > 0

    @cached_property
    def pushes(self) -> list[tuple[float, float, int]]:
        """Deepest dents, and valleys between them taken off: push (x, y) and ray of each.

        They are pushes towards the axis in mm of a flat wall's stiffness.

        Along the boundary the distance to the axis is least at feet on edges and at corners that stick out,
        and greatest at corners of notches.
        """
        feet: list[tuple[float, float, float]] = []
        corners: list[tuple[float, float, float]] = []
        centre_x, centre_y = self.centre_mm.tolist()
        edges, upright = self.outline.edges, self.outline.upright
        for k, (foot_x, foot_y) in zip(self.near.tolist(), self.away.tolist(), strict=True):
            start_x, start_y, along_x, along_y, before_x, before_y, square = edges[k]
            x, y = centre_x - start_x, centre_y - start_y
            # Beside its equator a ball's skin is dented by a share, and the same share of its force is aside.
            share = 1.0 if upright is None else float(upright[k]) ** 2
            ahead, behind = x * along_x + y * along_y, x * before_x + y * before_y
            if 0 < ahead < square:
                feet.append((foot_x, foot_y, share))
            # Either way from a corner the distance grows if it sticks out, and shrinks in a notch.
            if ahead <= 0 and behind >= 0:
                corners.append((x, y, share))
            elif ahead > 0 and behind < 0:
                corners.append((x, y, -share))
        return [push for point in (*feet, *corners) if (push := self._push(*point)) is not None]

    def _push(self, x: float, y: float, weight: float) -> tuple[float, float, int] | None:
        """Push of a point that is (x, y) mm from the axis, None if it does not touch."""
        # numpy's functions of plain numbers: they agree with those of arrays to the last bit, math's do not.
        distance = float(np.hypot(x, y))
        dent = self.radius_mm - distance
        if not dent > 0 or distance == 0:
            return None
        ray = round(float(np.arctan2(-y, -x)) / _STEP_RAD) % _RAYS
        if max(self._dent(ray), 0.0) >= dent + _OCCLUSION_MM:
            return None  # what dents the skin further in that direction hides it
        share = weight * dent * _not_cancelled(dent, self.radius_mm) / distance
        return x * share, y * share, ray

    @cached_property
    def by_ray_n(self) -> Floats:
        """Load of each ray (m,): every stretch leaves the same force on the axis as its pushes."""
        looked, dent = self._dented_rays
        stretch = _stretches(looked)
        share = _shares(stretch, dent)
        pushes = np.array(self.pushes, dtype=np.float64).reshape(-1, 3)
        push = pushes[:, :2]
        # The ray nearest to a corner may just miss it; then the one beside it is dented.
        ray = pushes[:, 2].astype(np.int64)
        stretches = _on_rays(looked, stretch, -1).astype(np.int64)
        beside = np.maximum(stretches[ray - 1], stretches[(ray + 1) % _RAYS])
        of = np.where(stretches[ray] >= 0, stretches[ray], beside)
        count = int(stretch.max()) + 1
        force = _sum_by_stretch(of[of >= 0], push[of >= 0], count)
        spread = _sum_by_stretch(stretch, share[:, None] * _HEADINGS[looked], count)
        scale = np.hypot(force[:, 0], force[:, 1]) / np.maximum(np.hypot(spread[:, 0], spread[:, 1]), 1e-12)
        return _on_rays(looked, self.stiffness_n_per_mm * share * scale[stretch])

    @cached_property
    def heights_mm(self) -> Floats | None:
        """Heights (_RAYS, 2) between which each ray's edge stands; None: all along the tip."""
        if self.outline.z_mm is None:
            return None
        looked, _ = self._dented_rays
        found = np.zeros((_RAYS, 2))
        found[looked] = self.outline.z_mm[self.near][self._nearest]
        return found

    @cached_property
    def upright(self) -> Floats | None:
        """Cosine (_RAYS,) of the latitude at which a ball is touched at each ray; None: it is none."""
        if self.outline.upright is None:
            return None
        return _on_rays(self._dented_rays[0], self.outline.upright[self.near][self._nearest], 1.0)

    @cached_property
    def _nearest(self) -> Ints:
        """Index of the near edge that each touched ray (m,) meets first."""
        looked, _ = self._dented_rays
        found: Ints = np.argmin(_reaches(self._edges, self.centre_mm, _HEADINGS[looked]), axis=1)
        return found

    @cached_property
    def _dented_rays(self) -> tuple[Ints, Floats]:
        """Rays (m,) that are dented, in order, and their dents (mm)."""
        looked = _rays_towards(self.away, self.square, self.radius_mm)
        dent = self._dents(looked)
        return looked[dent > 0], dent[dent > 0]

    def _dent(self, ray: int) -> float:
        """Dent of the skin (mm) by edges in a direction; like `_dents`, quicker for a few."""
        x, y = _HEADING_OF[ray]
        nearest = math.inf
        for start_x, start_y, along_x, along_y, cross in self._near_edges:
            turn = x * along_y - y * along_x
            if abs(turn) < _PARALLEL_MM:
                continue
            distance = cross / turn
            if 0 <= distance < nearest and 0 <= (start_x * y - start_y * x) / turn <= 1:
                nearest = distance
        return self.radius_mm - nearest

    @cached_property
    def _near_edges(self) -> list[tuple[float, float, float, float, float]]:
        """Near edges from the axis: start (x, y), way (x, y), and the cross product of the two."""
        centre_x, centre_y = self.centre_mm.tolist()
        found = []
        for k in self.near.tolist():
            start_x, start_y, along_x, along_y, *_ = self.outline.edges[k]
            x, y = start_x - centre_x, start_y - centre_y
            found.append((x, y, along_x, along_y, x * along_y - y * along_x))
        return found

    def _dents(self, ray: Ints) -> Floats:
        """Dent of the skin (mm) by edges in directions (m,); negative where there is none."""
        result: Floats = self.radius_mm - _reach(self._edges, self.centre_mm, _HEADINGS[ray])
        return result

    @cached_property
    def _edges(self) -> PartSection:
        return PartSection(self.outline.start[self.near], self.outline.end[self.near], self.outline.top_mm)


def _on_rays(ray: Ints, value: Floats | Ints, elsewhere: float = 0.0) -> Floats:
    result: Floats = np.full(_RAYS, elsewhere)
    result[ray] = value
    return result


def _rays_towards(away: Floats, square: Floats, radius_mm: float) -> Ints:
    """Rays, in order, that may meet edges: `away` (n, 2) from their nearest points, and that squared (n,).

    An edge at distance d from the axis is inside of the circle for at most acos(d / r) either way of its
    nearest point; all other rays reach the circle.
    """
    towards = np.arctan2(-away[:, 1], -away[:, 0]) / _STEP_RAD
    width = np.arccos(np.minimum(np.sqrt(square) / radius_mm, 1.0)) / _STEP_RAD + 2
    marked = np.zeros(_RAYS, dtype=bool)
    for middle, half in zip(towards.tolist(), width.tolist(), strict=True):
        first, last = math.ceil(middle - half), math.floor(middle + half)
        marked[np.arange(first, min(last, first + _RAYS - 1) + 1) % _RAYS] = True
    result: Ints = np.flatnonzero(marked)
    return result


def _reach(outline: PartSection, centre_mm: Floats, heading: Floats) -> Floats:
    """Distance (m,) from the centre to the first edge in each direction; infinite where there is none."""
    result: Floats = _reaches(outline, centre_mm, heading).min(axis=1)
    return result


def _reaches(outline: PartSection, centre_mm: Floats, heading: Floats) -> Floats:
    """Distance (m, n) from the centre to every edge in each direction; infinite where it does not meet it."""
    along = outline.along
    rel = outline.start - centre_mm
    turn = heading[:, None, 0] * along[None, :, 1] - heading[:, None, 1] * along[None, :, 0]
    parallel = np.abs(turn) < _PARALLEL_MM
    safe = np.where(parallel, 1.0, turn)
    distance = (rel[:, 0] * along[:, 1] - rel[:, 1] * along[:, 0]) / safe
    share = (rel[None, :, 0] * heading[:, None, 1] - rel[None, :, 1] * heading[:, None, 0]) / safe
    met = ~parallel & (distance >= 0) & (share >= 0) & (share <= 1)
    result: Floats = np.where(met, distance, np.inf)
    return result


def _stretches(ray: Ints) -> Ints:
    """Stretch (m,), a run of neighbouring rays, of each touched ray `ray` (m,), in order.

    The last ray and the first are neighbours too.
    """
    stretch: Ints = np.cumsum(np.diff(ray, prepend=ray[0] - 2) != 1) - 1
    if ray[0] == 0 and ray[-1] == _RAYS - 1:
        stretch[stretch == stretch[-1]] = 0
    return stretch


def _shares(stretch: Ints, dent: Floats) -> Floats:
    """Share of its stretch's deepest dent (mm) of each touched ray (m,)."""
    total = np.bincount(stretch, dent)
    deepest = np.zeros(len(total))
    np.maximum.at(deepest, stretch, dent)
    result: Floats = (deepest[stretch] * dent) / total[stretch]
    return result


def _sum_by_stretch(stretch: Ints, vector: Floats, count: int) -> Floats:
    """Sums (count, 2) of vectors (m, 2) over the stretches that they belong to (m,)."""
    return np.column_stack([np.bincount(stretch, vector[:, axis], count) for axis in (0, 1)])


def _not_cancelled(dent: float, radius_mm: float) -> float:
    """Share of the taxels' forces that a flat wall which dents the tip so deep leaves on its axis."""
    cos = min(max(1 - dent / radius_mm, 1e-6), 1 - 1e-9)
    half = float(np.arccos(cos))
    along = float(np.sin(half)) - cos * half
    return along / (half - cos * float(np.log(np.tan(np.pi / 4 + half / 2))))
