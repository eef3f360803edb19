"""All overlapping boxes are found, each pair once; the oracle looks at every pair."""

import numpy as np
import pytest

from palpate.cad.mesh_topology import overlapping_pairs


@pytest.mark.parametrize("count", [0, 1, 3, 5, 17, 100, 600])
def test_pairs_are_those_that_overlap_and_are_of_different_groups(count):
    rng = np.random.default_rng(count)
    lo = rng.uniform(0, 10, (count, 3))
    hi = lo + rng.uniform(0, 4, (count, 3))
    group = rng.integers(-1, 3, count)
    found = [tuple(sorted(pair)) for pairs in overlapping_pairs(lo, hi, group) for pair in pairs.tolist()]
    expected = {
        (j, i)
        for i in range(count)
        for j in range(i)
        if (lo[i] <= hi[j]).all() and (lo[j] <= hi[i]).all() and not group[i] == group[j] >= 0
    }
    assert len(found) == len(set(found))
    assert set(found) == expected
