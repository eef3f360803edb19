import math

import numpy as np
import pytest
import shapely
from shapely import affinity

from palpate.base.geometry import Floats
from palpate.config import load_objects, load_rig, shipped_objects, shipped_rig

EDGES = {"tr-1": 22, "tr-2": 26, "tr-3": 14, "grip": 14, "gator": 49, "hand": 66}
"""Edge counts of Memo 705, Table I (tr-1 lists half of its edges there)."""

ORDERS = {"tr-1": 2}


def outlines() -> dict[str, Floats]:
    return {
        model.name: model.states[0].sections[0].polygons[0].outer
        for model in load_objects(shipped_objects()).objects
    }


def mismatch(first: shapely.Polygon, second: shapely.Polygon) -> float:
    return float(first.symmetric_difference(second).area / first.area)


def test_names_edge_counts_and_heights_are_the_memo_s() -> None:
    assert {name: len(outline) for name, outline in outlines().items()} == EDGES
    for model in load_objects(shipped_objects()).objects:
        assert [state.name for state in model.states] == ["flat"]
        assert model.states[0].sections[0].z_mm == (0.0, 20.0)


@pytest.mark.parametrize("name", EDGES)
def test_outlines_are_simple_counter_clockwise_centred_and_of_a_size_to_be_felt(name: str) -> None:
    outline = outlines()[name]
    ring = shapely.LinearRing(outline)
    assert ring.is_simple
    assert ring.is_ccw
    centre = shapely.Polygon(outline).centroid
    assert math.hypot(centre.x, centre.y) < 0.1
    assert np.all(np.ptp(outline, axis=0) >= 40)
    assert np.all(np.ptp(outline, axis=0) <= 120)
    edges = np.roll(outline, -1, axis=0) - outline
    assert np.hypot(*edges.T).min() >= 2
    following = np.roll(edges, -1, axis=0)
    turns = np.arctan2(
        edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0], (edges * following).sum(axis=1)
    )
    assert np.degrees(np.abs(turns)).min() > 1, "collinear edges would be one edge"


@pytest.mark.parametrize("name", EDGES)
def test_rotational_symmetry_is_as_stated_and_no_part_is_its_own_mirror_image(name: str) -> None:
    part = shapely.Polygon(outlines()[name])
    for order in range(2, 7):
        turned = affinity.rotate(part, 360 / order, origin=part.centroid)
        if ORDERS.get(name) == order:
            assert mismatch(part, turned) < 1e-9
        else:
            assert mismatch(part, turned) > 0.05
    mirrored = affinity.scale(part, -1, 1, origin=part.centroid)
    assert (
        min(mismatch(part, affinity.rotate(mirrored, angle, origin=part.centroid)) for angle in range(360))
        > 0.05
    )


def test_tr_1_maps_edge_k_onto_edge_k_plus_11() -> None:
    outline = outlines()["tr-1"]
    np.testing.assert_array_equal(np.roll(outline, -11, axis=0), -outline)


@pytest.mark.parametrize("name", EDGES)
def test_every_part_fits_the_bench_wherever_it_is_put(name: str) -> None:
    rig = load_rig(shipped_rig())
    assert rig.emulation is not None
    extent = np.hypot(*outlines()[name].T).max() + rig.emulation.placement_radius_mm
    assert extent + 2 * rig.fingers[0].tip.radius_mm < rig.workspace.radius_mm
