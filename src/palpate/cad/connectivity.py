"""Connected components of a graph: numbers items by the component that they belong to."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.base.geometry import Ints

__all__ = ["component_of"]


def component_of(first: Ints, second: Ints, count: int) -> Ints:
    """Number (count,) of each item's component, from 0; `first` (k,) are linked with `second` (k,)."""
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    labels: Ints = connected_components(links, directed=False)[1].astype(np.int64)
    return labels
