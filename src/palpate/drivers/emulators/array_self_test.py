"""How an emulated array examines its own taxels: SELF_TEST of `docs/tactile-protocol.md`. Part of `array`.

As arrays do that can switch a test signal in place of the skin: the counts must rise with it, and keep still.
"""

import numpy as np

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.messages import BadTaxel, TaxelFault

__all__ = ["examine"]

_SAMPLES = 16
_SIGNAL = 0.75  # of the full scale
_LEAST_RISE = 1 / 8  # of the largest count; far below the signal, whatever a taxel's gain
_MOST_NOISE = 1 / 32  # of the largest count, standard deviation


def examine(taxels: Taxels) -> tuple[BadTaxel, ...]:
    """Return the taxels that do not follow a test signal or do not keep still under it, row by row."""
    d = taxels.description
    nothing = np.zeros((d.rows, d.cols))
    rest = np.stack([taxels.counts(nothing) for _ in range(_SAMPLES)])
    test = np.stack([taxels.counts(nothing + _SIGNAL * d.full_scale_n) for _ in range(_SAMPLES)])
    stuck = test.mean(axis=0) - rest.mean(axis=0) < _LEAST_RISE * d.max_count
    high = rest.mean(axis=0) > d.max_count / 2
    kind = np.zeros((d.rows, d.cols), dtype=np.int64)
    kind[test.std(axis=0) > _MOST_NOISE * d.max_count] = TaxelFault.UNSTEADY
    kind[stuck & high] = TaxelFault.STUCK_HIGH
    kind[stuck & ~high] = TaxelFault.STUCK_LOW
    return tuple(BadTaxel(int(i), int(j), TaxelFault(kind[i, j])) for i, j in np.argwhere(kind))
