"""Whether two fingers are apart, by the loop's way and by whole arrays; judged by shapely."""

import numpy as np
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from palpate.drivers.kinematics import FingerBody
from palpate.rig.reach.swept_volume import capsules_of, gap_mm, is_apart

COORDINATE = st.floats(-200, 200).map(lambda value: round(value, 3))
POINT = st.tuples(COORDINATE, COORDINATE)
CAPSULES = st.lists(st.tuples(POINT, POINT, st.floats(1, 20)), min_size=1, max_size=3)


def body(capsules: list[tuple[tuple[float, float], tuple[float, float], float]]) -> FingerBody:
    starts, ends, widths = zip(*capsules, strict=True)
    return FingerBody(np.array(starts), np.array(ends), np.array(widths))


@given(CAPSULES, CAPSULES, st.floats(0.5, 30))
def test_fingers_are_apart_as_shapely_says(one: list, other: list, clearance_mm: float) -> None:
    free = min(
        shapely.LineString([a, b]).distance(shapely.LineString([c, d])) - width - wide
        for a, b, width in one
        for c, d, wide in other
    )
    assume(abs(free - clearance_mm) > 1e-6)
    assert is_apart(body(one), body(other), clearance_mm) == (free >= clearance_mm)
    nearest = gap_mm(capsules_of([body(one)]), capsules_of([body(other)])).min()
    assert abs(nearest - free) < 1e-6
