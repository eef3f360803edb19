"""Template search for many profiles at once: only templates that can fit are compared, those in one product.

For whole recordings. A template can only fit if its force is possible and if its centroid is where the
profile's is: within six standard deviations, for by Cauchy and Schwarz's inequality any other has a misfit
above 36, and a best one above 20 counts for nothing. (The window is that of the errors without what alike
templates differ by. That adds at most 0.75 of a column's variance, since templates' own error is in it, so
that 36 becomes 36 / 1.75: still above 20.) So templates are kept by force, in slabs, and in each slab in the
order of the fraction of a column that their centroid is at. Profiles with the same force and fraction share
one stretch of a slab. Templates that differ by less than some hundredths of their strongest column are taken
as one, with all their directions, and what they differ by is added to the profile's errors.
"""

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints, Singles
from palpate.drivers.tactile.templates import MARGIN_COLUMNS, TemplateSet

WINDOW_SIGMAS = 6.0
_FORCE_BINS = 24
_PHASE_BINS = 16
_WINDOW_WIDTHS_COLUMNS = (
    0.25,
    0.5,
    1.0,
    2.0,
)  # columns: profiles whose windows are about as wide go together
_OUT_OF_REACH_COLUMNS = np.float32(64)  # columns, more than any direction is from its window's middle
_MISFITS_AT_ONCE = 1 << 17  # misfits that fit a processor's cache
_SHIFT_COLUMNS = 2  # columns: as far as the widest window reaches, in whole ones
_MERGE_SHARE = 0.03  # of the strongest column: templates alike within half of it are one
_TAIL_SHARE = 1e-4  # of a template's force: less than this in an outer column is left off


@dataclass(frozen=True, eq=False)
class ProfileBatch:
    """Measured forces of columns and the variances of their errors, both (n, cols); infinite: not looked at.

    `total_n` (n,) is the patch's force, of which `missing_n` (n,) more may not have been seen. Its `centroid`
    (n,) in columns from column 0 is within `window` (n,), `WINDOW_SIGMAS` of its error.
    """

    force_n: Floats
    variance: Floats
    total_n: Floats
    missing_n: Floats
    centroid: Floats
    window: Floats


@dataclass(frozen=True, eq=False)
class MatchBatch:
    """Directions that explain profiles, `low` … `high` (n,) in columns from column 0, and the best `misfit`
    (n,), infinite where there is none. `one_edge` (n,): a single edge is among what fits.
    """

    low: Floats
    high: Floats
    misfit: Floats
    one_edge: Bools


@dataclass(frozen=True, eq=False)
class _Slab:
    """Templates by `phase` (m,), ascending in a slab; `cells` (m, width) are the columns about the whole one
    before their centroid, and the directions `low` … `high` (m,) count from there too.
    """

    phase: Floats
    cells: Singles
    squares: Singles
    low: Singles
    high: Singles
    least_n: Singles
    most_n: Singles
    one_edge: Bools

    def rows(self, which: slice | Ints) -> "_Slab":
        """Some of the templates."""
        return _Slab(**{f.name: getattr(self, f.name)[which] for f in fields(_Slab)})


class TemplateSlabs:
    """The templates of a set in the order in which profiles ask for them."""

    def __init__(self, templates: TemplateSet) -> None:
        cells = templates.cells
        reach = cells.shape[1] // 2
        centroid = cells @ np.arange(-reach, reach + 1) / cells.sum(axis=1)
        whole = np.floor(centroid).astype(np.int64)
        most = int(np.abs(whole).max()) + 1 + _SHIFT_COLUMNS
        centred = _shift_cells(np.pad(cells, ((0, 0), (most, most))), -whole)
        middle = reach + most
        loaded = np.flatnonzero((centred > _TAIL_SHARE).any(axis=0))
        self._half = int(np.abs(loaded - middle).max()) + _SHIFT_COLUMNS  # to move by
        centred = centred[:, middle - self._half : middle + self._half + 1]
        one, count = _group_alike(centred)
        least, largest = templates.least_n, templates.most_n
        angle = templates.angle_columns - whole
        self._all = _Slab(
            phase=np.bincount(one, centroid - whole) / count,
            cells=(means := _means(centred, one, count)),
            squares=means**2,
            low=_extremes(np.minimum, angle, one, len(count)),
            high=_extremes(np.maximum, angle, one, len(count)),
            least_n=_extremes(np.minimum, least, one, len(count)),
            most_n=_extremes(np.maximum, largest, one, len(count)),
            one_edge=np.bincount(one, templates.one_edge) > 0,
        )
        self._edges: Floats = np.geomspace(float(least.min()), float(largest.max()), _FORCE_BINS + 1)
        self._slabs: dict[tuple[int, int], _Slab] = {}

    def match(self, profiles: ProfileBatch, slack: float) -> MatchBatch:
        """Hulls of the directions whose misfit is within `slack` of the best, and that misfit."""
        p = profiles
        n = len(p.centroid)
        matches = MatchBatch(
            np.full(n, np.inf), np.full(n, -np.inf), np.full(n, np.inf), np.zeros(n, dtype=bool)
        )
        first, last = (self._force_bin(each) for each in (p.total_n, p.total_n + p.missing_n))
        asked = np.flatnonzero((first >= 0) & (first < _FORCE_BINS))
        phase = np.floor((p.centroid - np.floor(p.centroid)) * _PHASE_BINS).astype(np.int64)
        width = np.searchsorted(_WINDOW_WIDTHS_COLUMNS, p.window)
        asked = asked[width[asked] < len(_WINDOW_WIDTHS_COLUMNS)]
        group = (first * _FORCE_BINS + np.minimum(last, _FORCE_BINS - 1)) * _PHASE_BINS + phase
        group = group * len(_WINDOW_WIDTHS_COLUMNS) + width
        order = asked[np.argsort(group[asked], kind="stable")]
        ends = np.flatnonzero(np.diff(group[order], append=-1)) + 1
        for begin, end in zip([0, *ends], ends, strict=False):
            rows = order[begin:end]
            stretch = self._stretch(p, rows, int(first[rows[0]]), min(int(last[rows[0]]), _FORCE_BINS - 1))
            count = max(_MISFITS_AT_ONCE // max(len(stretch.phase), 1), 1)
            for at in range(0, len(rows), count):
                self._match_piece(p, rows[at : at + count], stretch, slack, matches)
        return matches

    def _force_bin(self, force_n: Floats) -> Ints:
        result: Ints = np.searchsorted(self._edges, force_n, side="right") - 1
        return result

    def _stretch(self, p: ProfileBatch, rows: Ints, first: int, last: int) -> _Slab:
        """The templates that can fit some of the profiles `rows`."""
        slab = self._slabs.get((first, last))
        if slab is None:
            slab = self._slabs[first, last] = self._slab(first, last)
        fraction = p.centroid[rows] - np.floor(p.centroid[rows])
        width = float(p.window[rows].max())
        part = slice(*np.searchsorted(slab.phase, [fraction.min() - width, fraction.max() + width]))
        return slab.rows(part)

    def _slab(self, first: int, last: int) -> _Slab:
        """Templates whose force can be from bin `first` to bin `last`."""
        every = self._all
        here = np.flatnonzero((every.least_n <= self._edges[last + 1]) & (every.most_n >= self._edges[first]))
        # One column to the left and to the right of where they are, and on as far as windows reach.
        turns = np.arange(-_SHIFT_COLUMNS, _SHIFT_COLUMNS + 1)
        rows, turn = np.tile(here, len(turns)), np.repeat(turns, len(here))
        phase = every.phase[rows] + turn
        order = np.argsort(phase, kind="stable")
        order = order[
            (phase[order] >= -_WINDOW_WIDTHS_COLUMNS[-1]) & (phase[order] < 1 + _WINDOW_WIDTHS_COLUMNS[-1])
        ]
        rows, turn = rows[order], turn[order]
        slab = every.rows(rows)
        return replace(
            slab,
            phase=phase[order],
            cells=(cells := _shift_cells(slab.cells, turn)),
            squares=cells**2,
            low=slab.low + turn.astype(np.float32),
            high=slab.high + turn.astype(np.float32),
        )

    def _match_piece(
        self, p: ProfileBatch, rows: Ints, stretch: _Slab, slack: float, matches: MatchBatch
    ) -> None:
        base = np.floor(p.centroid[rows]).astype(np.int64)
        columns = base[:, None] + np.arange(-self._half, self._half + 1)
        inside = (columns >= 0) & (columns < p.force_n.shape[1])
        place = np.where(inside, columns, 0)
        force = p.force_n[rows]
        variance = p.variance[rows] + (_MERGE_SHARE / math.sqrt(12) * force.max(axis=1, keepdims=True)) ** 2
        weight = 1 / variance
        power = (force**2 * weight).sum(axis=1)
        near = np.where(inside, np.take_along_axis(weight, place, axis=1), 0.0)
        gain = (near * np.take_along_axis(force, place, axis=1)).astype(np.float32) @ stretch.cells.T
        gain *= gain
        norm = near.astype(np.float32) @ stretch.squares.T
        norm += np.float32(1e-20)  # where no column of a template is looked at
        gain /= norm
        total = p.total_n[rows, None].astype(np.float32)
        possible = stretch.least_n <= total + p.missing_n[rows, None].astype(np.float32)
        possible &= total <= stretch.most_n
        gain *= possible
        best = gain.max(axis=1, initial=0)
        fits = gain >= (best - np.float32(slack))[:, None]
        fits &= possible
        found = fits.any(axis=1)
        at = rows[found]
        # Products and largest values are several times as fast as choosing among infinities.
        low = _OUT_OF_REACH_COLUMNS - (fits * (_OUT_OF_REACH_COLUMNS - stretch.low)).max(axis=1, initial=0)
        high = (fits * (_OUT_OF_REACH_COLUMNS + stretch.high)).max(axis=1, initial=0) - _OUT_OF_REACH_COLUMNS
        matches.low[at] = (low + base - MARGIN_COLUMNS)[found]
        matches.high[at] = (high + base + MARGIN_COLUMNS)[found]
        matches.misfit[at] = (power - best)[found]
        matches.one_edge[at] = (fits & stretch.one_edge).any(axis=1)[found]


def _group_alike(cells: Singles) -> tuple[Ints, Ints]:
    """For each template the number of the one that it is taken for, and how many each of those stands for."""
    grains = np.rint(cells / (_MERGE_SHARE * cells.max(axis=1, keepdims=True))).astype(np.int8)
    rows = np.ascontiguousarray(grains).view(np.dtype((np.void, grains.shape[1]))).ravel()
    _, one, count = np.unique(rows, return_inverse=True, return_counts=True)
    return one, count


def _means(cells: Singles, one: Ints, count: Ints) -> Singles:
    sums = np.stack([np.bincount(one, column) for column in cells.T], axis=1)
    return (sums / count[:, None]).astype(np.float32)


def _extremes(pick: np.ufunc, values: Floats, one: Ints, count: int) -> Singles:
    """The least or the largest of the values of each group."""
    start = np.inf if pick is np.minimum else -np.inf
    out = np.full(count, start, dtype=np.float32)
    pick.at(out, one, values.astype(np.float32))
    return out


def _shift_cells(cells: Singles, by: Ints) -> Singles:
    """Each row `by` (m,) columns on; the outer columns must be empty where something would fall off."""
    width = cells.shape[1]
    place = np.arange(width)[None, :] - by[:, None]
    inside = (place >= 0) & (place < width)
    result: Singles = np.where(inside, np.take_along_axis(cells, np.where(inside, place, 0), axis=1), 0)
    return np.ascontiguousarray(result, dtype=np.float32)
