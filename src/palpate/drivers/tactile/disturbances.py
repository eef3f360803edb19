"""Disturbances of an array's readings that no contact makes: interference, lines and single wires that jump.

Motors and supplies move all taxels alike, a multiplexer's line one row, a loose wire one taxel, and all of
them come and go from one frame to the next. A contact presses a few neighbouring taxels and changes them
gradually; so each frame is compared with those around it, and a row or an array by the quartiles of
its taxels.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Counts, Floats

_BLOCK_FRAMES = 64  # frames that are compared with their own median
_SIGMAS = 8.0
_SIGMA_OF_MEDIAN = 1.48  # standard deviation over the median absolute one
_QUARTILE_NOISE = 1.4  # standard deviation of a quartile, over that of a mean
_MIN_NOISE_COUNTS = 0.3  # of a taxel whose noise is lost in rounding
_ROUNDING_COUNTS = 1.5  # that quartiles of rounded counts may jump by
_MIN_GROUP_TAXELS = 4  # of which a contact never presses three quarters
_JUMP_SHARE = 1 / 8  # of the largest count: no contact grows and goes by that much within a frame
_LEAST_JUMPS = 2  # of a taxel: a tip that brushes past something may do it once


@dataclass(frozen=True)
class Disturbances:
    """Disturbed frames of `frames`, and by how many counts at most.

    `common`: frames in which all taxels moved alike; `rows`: and those of each row that moved by itself;
    `taxels`: and of each taxel (row, column) that jumped for a single frame, more than once.
    """

    frames: int
    common: int
    common_counts: float
    rows: dict[int, int]
    row_counts: float
    taxels: dict[tuple[int, int], int]

    def __bool__(self) -> bool:
        """True if there are any."""
        return bool(self.common or self.rows or self.taxels)


def find_disturbances(counts: Counts | Floats, usable: Bools, max_count: int) -> Disturbances:
    """Look through frames (n, rows, cols), in order, of an array of whose taxels most touch nothing."""
    away = np.concatenate([_off_median(part) for part in _blocks(np.asarray(counts, dtype=float))])
    noise = _SIGMA_OF_MEDIAN * float(np.median(np.abs(away[:, usable]))) if usable.any() else 0.0
    noise = max(noise, _MIN_NOISE_COUNTS)
    seen = np.where(usable, away, np.nan)
    common = _shift(seen.reshape(len(seen), 1, -1), noise)[:, 0]
    is_common = common != 0
    seen -= common[:, None, None]
    row = _shift(seen, noise)
    row[2 * np.count_nonzero(row, axis=1) >= seen.shape[1]] = 0.0
    row_off = row != 0
    alone = np.zeros_like(seen, dtype=bool)
    limit = max(_JUMP_SHARE * max_count, 2 * _SIGMAS * noise)
    middle, before, after = seen[1:-1], seen[:-2], seen[2:]
    alone[1:-1] = middle - np.fmax(before, after) > limit
    alone[1:-1] |= np.fmin(before, after) - middle > limit
    alone &= ~row_off[:, :, None]
    jumps = alone.sum(axis=0)
    return Disturbances(
        frames=len(counts),
        common=int(is_common.sum()),
        common_counts=float(np.abs(common).max(initial=0.0, where=is_common)),
        rows={int(k): int(row_off[:, k].sum()) for k in np.flatnonzero(row_off.any(axis=0))},
        row_counts=float(np.abs(row).max(initial=0.0, where=row_off)),
        taxels={(int(i), int(j)): int(jumps[i, j]) for i, j in np.argwhere(jumps >= _LEAST_JUMPS)},
    )


def _shift(seen: Floats, noise: float) -> Floats:
    """Counts by which three quarters of the taxels of each group moved at least, (n, groups); 0 for noise.

    `seen` (n, groups, taxels), nan where a taxel is not usable. A quarter is what no contact leaves alone.
    """
    usable = np.isfinite(seen[0]).sum(axis=1)
    judged = usable >= _MIN_GROUP_TAXELS
    ordered = np.sort(seen, axis=2)  # nan come last
    result = np.zeros(seen.shape[:2])
    for side, quarter in ((1, usable // 4), (-1, usable - 1 - usable // 4)):
        at = side * np.take_along_axis(ordered, np.maximum(quarter, 0)[None, :, None], axis=2)[:, :, 0]
        at -= np.median(at, axis=0)
        limit = _SIGMAS * _QUARTILE_NOISE * noise / np.sqrt(np.maximum(usable, 1)) + _ROUNDING_COUNTS
        result = np.where(judged & (at > limit), side * at, result)
    return result


def _blocks(counts: Floats) -> list[Floats]:
    return np.array_split(counts, max(len(counts) // _BLOCK_FRAMES, 1))


def _off_median(counts: Floats) -> Floats:
    result: Floats = counts - np.median(counts, axis=0)
    return result
