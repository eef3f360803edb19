"""Templates of column forces: the contact normals that can explain a row. Basis of `contact`'s bounds.

A cylindrical tip is taken as an elastic foundation: pressure in direction a is proportional to the depth
max(0, r - rho(a)), where rho is the distance from the tip's axis to the object along a. An object that is
convex around the contact is closest at one direction phi, and recedes on either side as a flat edge, as the
face behind a vertex, or as an edge that ends at a vertex; a notch is two edges at once. Tabulated over phi,
penetration and shape, those profiles, integrated over the columns and smeared by the crosstalk, are the
templates. All directions whose template fits the measurement within its errors are kept: their hull is the
normal range.

Pure arrays: no device, no clock. Angles in rad, lengths in mm, templates normalised to unit sum.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Bools, Floats, Singles

_REACH_RAD = math.radians(75.0)  # of a template on either side of its middle; no contact reaches as far
_MIN_REACH_COLUMNS, _MAX_REACH_COLUMNS = 3, 20  # columns
_STEPS_PER_COLUMN = 11
_MARGIN_COLUMNS = 0.75 / _STEPS_PER_COLUMN
"""What lies between one template and the next: to be added to a range on either side."""
_GRID_STEP_RAD = math.radians(0.2)
_TEMPLATES_AT_ONCE = 768
_GRID_COUNT = 750  # samples on either side: 150°
_MAX_DEPTH_RADII = 0.29  # penetration in tip radii
_DEPTHS_PER_E_FOLD = 6.6
_RECEDE_RAD = tuple(math.radians(a) for a in (0.0, 6.0, 12.0, 20.0, 30.0, 42.0, 58.0, 88.0))
_MAX_RECEDE_RAD = math.radians(155.0)  # vertices down to 25°
_END_RAD = tuple(math.radians(a) for a in (3.0, 6.0, 10.0, 14.0, 19.0, 24.0, 30.0))
_END_FALL_RAD = tuple(math.radians(a) for a in (25.0, 60.0))
_NOTCH_TURN_RAD = tuple(
    math.radians(a) for a in (3.0, 6.0, 10.0, 15.0, 22.0, 30.0, 45.0, 60.0, 75.0, 90.0, 120.0)
)
_NOTCH_SHARES = (1.0, 0.7, 0.45, 0.2)
_REFERENCE_DEPTH_RADII = 0.1  # tip radii at which linear and foundation stiffness agree


@dataclass(frozen=True)
class ColumnProfile:
    """Measured forces of the columns, each of shape (cols,): N, and the variance of its error in N².

    A column of infinite variance is not looked at. `missing_n` bounds the force of the patch that the array
    did not see; inf if that is unknown.
    """

    force_n: Floats
    variance: Floats
    first: int
    last: int
    missing_n: float


@dataclass(frozen=True)
class TemplateMatch:
    """Directions that explain a profile, relative to column 0's centre, and how well the best one does."""

    low_rad: float
    high_rad: float
    misfit: float
    one_edge: bool


class TemplateSet:
    """Templates for one geometry: `pitch_rad` between columns, tip radius, stiffness (N per mm).

    `stiffness_bound` is the relative error of the stiffness, gains included. The force is allowed to grow
    with the penetration linearly or as the foundation's, whichever is wider. `least_depth` is the smallest
    penetration, in tip radii.

    Of m templates: `cells` (m, 2 · reach + 1) is the share of the force on each column of the window,
    `angle_columns` (m,) the direction from the window's middle, within half a column, `least_n` and `most_n`
    (m,) the forces that it can have; `one_edge` (m,): it has a single edge.
    """

    def __init__(
        self,
        *,
        pitch_rad: float,
        radius_mm: float,
        stiffness_n_per_mm: float,
        stiffness_bound: float,
        crosstalk: float,
        least_depth: float,
    ) -> None:
        self._pitch = pitch_rad
        self._reach = min(max(math.ceil(_REACH_RAD / pitch_rad), _MIN_REACH_COLUMNS), _MAX_REACH_COLUMNS)
        reach = self._reach
        steps = round(math.log(_MAX_DEPTH_RADII / least_depth) * _DEPTHS_PER_E_FOLD)
        levels = np.geomspace(least_depth, _MAX_DEPTH_RADII, steps + 1)
        depth_step = float(levels[1] / levels[0]) ** 0.25  # a quarter of the way from one depth to the next
        grid: Floats = np.arange(-_GRID_COUNT, _GRID_COUNT + 1, dtype=np.float64) * np.float64(_GRID_STEP_RAD)
        self._offsets = ((np.arange(_STEPS_PER_COLUMN) + 0.5) / _STEPS_PER_COLUMN - 0.5) * pitch_rad
        edges = (np.arange(2 * reach + 2) - reach - 0.5) * pitch_rad - self._offsets[:, None]
        place = edges / _GRID_STEP_RAD + _GRID_COUNT + 0.5  # the running sum stands between the samples
        left = np.clip(place.astype(int), 0, len(grid) - 1)
        share = np.clip(place - left, 0.0, 1.0)
        drawn = _Shapes(grid)
        parts: list[tuple[Singles, Floats, Floats, Floats]] = []
        for depth in levels.tolist():  # one after the other: all at once would take 300 MB, and longer
            shapes, other = drawn.at(depth)
            cumulative = np.pad(np.cumsum(shapes, axis=1) * _GRID_STEP_RAD, ((0, 0), (1, 0)))
            cells = np.diff(cumulative[:, left] * (1 - share) + cumulative[:, left + 1] * share, axis=2)
            cells = _smear(cells / cells.sum(axis=2, keepdims=True), crosstalk)
            by_window = cells.reshape(-1, 2 * reach + 1).astype(np.float32)
            parts.append((by_window, cumulative[:, -1].copy(), np.full(len(shapes), depth), other))
        self.cells: Singles
        self.cells, whole, depths, others = (np.concatenate(part) for part in zip(*parts, strict=True))
        self._squares = self.cells**2
        self._angles = np.tile(self._offsets, len(whole))
        self.angle_columns: Floats = self._angles / pitch_rad
        self.one_edge: Bools = np.repeat(others == 0, _STEPS_PER_COLUMN)
        linear = stiffness_n_per_mm * radius_mm * depths
        flat = _flat(_RotatedDirection(grid), _REFERENCE_DEPTH_RADII).sum() * _GRID_STEP_RAD
        founded = whole / flat * stiffness_n_per_mm * radius_mm * _REFERENCE_DEPTH_RADII
        lowest = np.minimum(linear, founded) * (1 - stiffness_bound) / depth_step
        highest = np.maximum(linear + stiffness_n_per_mm * radius_mm * others, founded) * (
            1 + stiffness_bound
        )
        self.least_n: Floats = np.repeat(lowest, _STEPS_PER_COLUMN)
        self.most_n: Floats = np.repeat(highest, _STEPS_PER_COLUMN)

    def match(self, profile: ColumnProfile, slack: float) -> TemplateMatch | None:
        """Return the hull of directions whose misfit is within `slack` of the best, if any is possible.

        Misfit is the sum of squared errors over their variances, the amplitude being free.
        """
        total = float(profile.force_n[profile.first : profile.last + 1].sum())
        allowed = np.ones(len(self.cells), dtype=bool)
        if math.isfinite(profile.missing_n):
            allowed = (self.least_n <= total + profile.missing_n) & (total <= self.most_n)
        keep = np.flatnonzero(allowed)
        if not len(keep):
            return None
        cells, squares = self.cells[keep], self._squares[keep]
        beyond = 1 if math.isfinite(profile.missing_n) else 3
        centres = np.arange(profile.first - beyond, profile.last + beyond + 1)
        misfits = _misfits(profile, centres, cells, squares)
        best = float(misfits.min())
        where, which = np.nonzero(misfits <= best + slack)
        angles = centres[where] * self._pitch + self._angles[keep[which]]
        margin = _MARGIN_COLUMNS * self._pitch  # half a step, and what lies between the shapes
        return TemplateMatch(
            low_rad=float(angles.min()) - margin,
            high_rad=float(angles.max()) + margin,
            misfit=best,
            one_edge=bool(self.one_edge[keep[which]].any()),
        )


template_set = lru_cache(maxsize=8)(TemplateSet)
"""The templates for one geometry; made once for the tips of a rig, which are mostly alike."""


def _misfits(profile: ColumnProfile, centres: NDArray[np.int_], cells: Singles, squares: Singles) -> Floats:
    """Squared errors over variances of templates centred in each column, shape (centres, templates)."""
    reach = cells.shape[1] // 2
    columns = centres[:, None] + np.arange(-reach, reach + 1)
    inside = (columns >= 0) & (columns < len(profile.force_n))
    place = np.where(inside, columns, 0)
    weight = np.where(inside, 1 / profile.variance[place], 0.0)
    force = np.where(inside, profile.force_n[place], 0.0)
    # Columns that a window does not reach count as unexplained: the power is that of the whole array.
    power = float((profile.force_n**2 / profile.variance).sum())
    along = _product(cells, weight * force)
    norm = _product(squares, weight)
    misfits: Floats = power - np.maximum(along, 0.0) ** 2 / np.maximum(norm, 1e-30)
    return misfits


def _product(table: Singles, windows: Floats) -> Floats:
    """Each window with each template, shape (windows, templates).

    In pieces too small for the linear algebra library to start threads, which cost six times what they save.
    """
    right = windows.T.astype(np.float32)
    pieces = [table[i : i + _TEMPLATES_AT_ONCE] @ right for i in range(0, len(table), _TEMPLATES_AT_ONCE)]
    return np.concatenate(pieces).T.astype(np.float64)


class _RotatedDirection:
    """Angles (n,) turned by some angles, and their cosines; each is worked out once."""

    def __init__(self, angle: Floats) -> None:
        self.angle = angle
        self._known: dict[float, tuple[Bools, Floats]] = {}

    def by(self, turn: float) -> tuple[Bools, Floats]:
        """Mask of those within a right angle then, and their cosines, none below 1e-9."""
        if turn not in self._known:
            turned = self.angle + turn
            self._known[turn] = np.abs(turned) < math.pi / 2, np.maximum(np.cos(turned), 1e-9)
        return self._known[turn]


def _flat(angle: _RotatedDirection, depth: float, normal: float = 0.0) -> Floats:
    """Depth (tip radii) of a flat edge whose normal is at `normal`."""
    near, cosine = angle.by(-normal)
    return np.where(near, np.maximum(0.0, 1 - (1 - depth) / cosine), 0.0)


def _kinds(depth: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Shapes of the two sides of a contact, each (fall, end): it recedes by `fall` from `end` on.

    Vertices; a flat edge that ends on one side, finely; on both sides; and short edges beside a vertex. Ends
    beyond the dent are none.
    """
    width = math.acos(1 - depth)
    fine = [(fall, end) for end in _END_RAD if end < width for fall in _END_FALL_RAD]
    ends = [(_END_FALL_RAD[-1], end) for end in _END_RAD if end < width]
    few = ends[1::2]
    faces = [(recede, 0.0) for recede in _RECEDE_RAD]
    flat, slants = faces[0], faces[1:]
    pairs = [*product(faces, faces), *product(ends, ends), *product([flat], fine), *product(fine, [flat])]
    pairs += [*product(slants, few), *product(few, slants)]
    return [pair for pair in pairs if pair[0][0] + pair[1][0] <= _MAX_RECEDE_RAD]


def _side(angle: _RotatedDirection, depth: float, recede: float, end: float) -> Floats:
    """Depth on one side (angle >= 0) of the closest direction.

    The surface is flat from the closest point to `end`, and recedes by `recede` from there.
    """
    near, cosine = angle.by(recede)
    if end > 0:
        start = (1 - depth) / math.cos(end)
        beyond = 1 - start * math.cos(end + recede) / cosine
        falling = np.where(near, np.maximum(0.0, beyond), 0.0)
        return np.where(angle.angle <= end, _flat(angle, depth), falling)
    slope = 1 - (1 - depth) * math.cos(recede) / cosine
    return np.where(near, np.maximum(0.0, slope), 0.0)


class _Shapes:
    """Depth profiles of all kinds of contact over a grid of angles, in tip radii."""

    def __init__(self, grid: Floats) -> None:
        self._tip = int(np.abs(grid).argmin())
        self._all_round, self._one_side = _RotatedDirection(grid), _RotatedDirection(grid[self._tip :])

    def at(self, depth: float) -> tuple[Floats, Floats]:
        """Profiles (n, grid) of contacts of a penetration, and the penetration (n,) of a second edge."""
        pairs = _kinds(depth)
        kinds = {kind for pair in pairs for kind in pair}
        nothing = np.zeros(self._tip)
        sides = {kind: np.concatenate((nothing, _side(self._one_side, depth, *kind))) for kind in kinds}
        shapes: list[Floats] = []
        for left, right in pairs:
            shape = np.maximum(sides[right], sides[left][::-1])
            shape[self._tip] = depth
            shapes.append(shape)
        first = _flat(self._all_round, depth)
        notches = [(turn, share) for turn in _NOTCH_TURN_RAD for share in _NOTCH_SHARES]
        shapes += [
            np.maximum(first, _flat(self._all_round, share * depth, side))
            for turn, share in notches
            for side in (turn, -turn)
        ]
        second = np.repeat([share * depth for _, share in notches], 2)
        return np.stack(shapes), np.concatenate((np.zeros(len(pairs)), second))


def _smear(cells: Floats, share: float) -> Floats:
    out = cells * (1 - 2 * share)
    out[..., 1:] += share * cells[..., :-1]
    out[..., :-1] += share * cells[..., 1:]
    return out
