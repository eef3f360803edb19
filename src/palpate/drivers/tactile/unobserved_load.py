"""How much load an array may not show: on taxels that cannot be seen, and beyond its edge.

Loads in, limits out. Used by `pads` and `cylinder` for the bounds of centroid and force. Two things limit
hidden load. Crosstalk: a share of it shows on the neighbours. And the shape of one contact: the pressure
between a convex part and an elastic skin is log-concave, and so are the loads of cells in a line,
F(j)² ≥ F(j-1) F(j+1) (Prékopa, Acta Scientiarum Mathematicarum 34, 1973: marginals and convolutions of
log-concave functions are log-concave). So a load that has fallen from cell to cell goes on falling, at least
by the same ratio.
"""

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["crosstalk_limit_n", "load_beyond_edge", "log_concave_limit_n"]

_STEADY = 0.9  # a ratio above it may go on for ever


def crosstalk_limit_n(shown_n: Floats, least_share: float) -> Floats:
    """The most that each cell can bear, (n, r, c) N.

    `shown_n` (n, r, c): the most that its neighbours really show, inf where they cannot be seen;
    `least_share`: the least share of a load that appears on each neighbour.
    """
    if least_share <= 0:
        return np.full_like(shown_n, np.inf)
    padded = np.pad(shown_n / least_share, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    result: Floats = np.minimum.reduce(
        [padded[:, 1:-1, 2:], padded[:, 1:-1, :-2], padded[:, 2:, 1:-1], padded[:, :-2, 1:-1]]
    )
    return result


def log_concave_limit_n(low_n: Floats, high_n: Floats) -> Floats:
    """The most that each cell of a log-concave load can bear, (n, r, c) N; inf where nothing says.

    `low_n`, `high_n` (n, r, c): limits of the other cells' loads; 0 and inf where they cannot be seen.
    """
    edges = ((0, 0), (2, 2), (2, 2))
    low, high = np.pad(low_n, edges), np.pad(high_n, edges, constant_values=np.inf)
    inner = slice(2, -2)
    limits = []
    for near, far in ((slice(3, -1), slice(4, None)), (slice(1, -3), slice(0, -4))):
        limits.append(_ratio(high[:, inner, near], low[:, inner, far]))
        limits.append(_ratio(high[:, near, inner], low[:, far, inner]))
    result: Floats = np.minimum.reduce(limits)
    return result


def _ratio(near: Floats, far: Floats) -> Floats:
    known = (far > 0) & np.isfinite(near)
    square = np.where(known, near, 0.0) ** 2
    return np.where(known, square / np.where(known, far, 1.0), np.inf)


def load_beyond_edge(outer_n: Floats, inner_n: Floats) -> tuple[Floats, Floats]:
    """Load beyond an edge, and how many cells beyond the outermost one it is centred at most; both (n,).

    `outer_n`: the most that the outermost line of cells bears; `inner_n`: the least that the next one does.
    Falling by the same ratio for ever is the most that a log-concave load can do. Both are inf where it does
    not fall.
    """
    falls = outer_n < _STEADY * inner_n
    none = outer_n <= 0
    ratio = np.where(falls & ~none, outer_n / np.where(falls, inner_n, 1.0), 0.0)
    load = np.where(falls, outer_n * ratio / (1 - ratio), np.inf)
    reach = np.where(falls, 1 / (1 - ratio), np.inf)
    return np.where(none, 0.0, load), np.where(none, 0.0, reach)
