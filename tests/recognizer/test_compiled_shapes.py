"""The compiled kernel measures, clips and groups cells as numpy does, and as shapely and scipy do."""

import numpy as np
import pytest
import shapely
from kernel_switch import needs_kernel, without_kernel
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.base.geometry import Floats
from palpate.recognizer.connected_components import Boxes, component_labels
from palpate.recognizer.pose_region import Cells, divide_longest
from palpate.recognizer.witness_search import position_boxes

pytestmark = needs_kernel


def drawn_cells(rng: np.random.Generator, count: int) -> Cells:
    """Convex polygons of 1 to 9 vertices, of sizes from 1 nm to 100 mm, padded to one more than the most."""
    rows: list[Floats] = []
    for _ in range(count):
        points = rng.normal(0, 10 ** rng.uniform(-6, 2), (int(rng.integers(1, 12)), 2)) + rng.normal(0, 50, 2)
        hull = shapely.MultiPoint(points).convex_hull
        ring = (
            points[:1]
            if hull.geom_type != "Polygon"
            else np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]
        )
        rows.append(ring[:9])
    most = max(map(len, rows)) + 1
    polygon = np.array(
        [np.concatenate([ring, np.repeat(ring[:1], most - len(ring), axis=0)]) for ring in rows]
    )
    lo = rng.uniform(-10, 10, count)
    nothing = np.zeros(count, np.int64)
    return Cells(nothing, nothing, lo, lo + 10 ** rng.uniform(-9, 0.9, count), polygon)


@pytest.mark.parametrize("seed", range(20))
def test_shapes_are_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = drawn_cells(rng, int(rng.integers(1, 200)))
    origin, anchor = rng.normal(0, 30, (len(cells), 2)), rng.normal(0, 30, 2)
    found = (cells.centre, cells.radius, cells.volume, *position_boxes(cells, origin, anchor))
    area = [shapely.convex_hull(shapely.MultiPoint(polygon)).area for polygon in cells.polygon]
    with without_kernel():
        again = Cells(cells.node, cells.state, cells.lo, cells.hi, cells.polygon)
        expected = (again.centre, again.radius, again.volume, *position_boxes(again, origin, anchor))
    assert np.array_equal(found[0], expected[0])
    assert np.array_equal(found[2], expected[2]), "which of two cells is larger does not depend on the kernel"
    for one, two in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(found[2], np.array(area) * (cells.hi - cells.lo), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_boxes_contain_every_position(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = drawn_cells(rng, 50)
    lo, hi = position_boxes(cells, np.zeros((50, 2)), np.zeros(2))
    for theta in np.linspace(cells.lo, cells.hi, 40):
        c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
        x, y = cells.polygon[..., 0], cells.polygon[..., 1]
        for axis, value in enumerate((c * x - s * y, s * x + c * y)):
            assert np.all((value >= lo[:, axis, None]) & (value <= hi[:, axis, None]))


@pytest.mark.parametrize("seed", range(20))
def test_parts_are_the_same_and_cover_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = drawn_cells(rng, int(rng.integers(1, 60)))
    lever, parts = 10 ** rng.uniform(-1, 3), int(rng.integers(2, 6))
    found, owner = divide_longest(cells, lever, parts)
    with without_kernel():
        again = Cells(cells.node, cells.state, cells.lo, cells.hi, cells.polygon.copy())
        expected, other = divide_longest(again, lever, parts)
    assert np.array_equal(owner, other)
    np.testing.assert_allclose(found.lo, expected.lo)
    np.testing.assert_allclose(found.centre, expected.centre, rtol=0, atol=1e-9)
    covered = np.bincount(owner, found.volume, minlength=len(cells))
    np.testing.assert_allclose(covered, cells.volume, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2, 30, 160, 161, 400, 3000])
@pytest.mark.parametrize("seed", range(4))
def test_groups_are_the_same(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = np.sort(rng.integers(0, 4, count))
    turn = 2 * np.pi / np.array([1, 2, 3, 6])[state]
    size = 10 ** rng.uniform(-2, 0)
    half = rng.uniform(0, 0.3 * size, count)
    lo = rng.uniform(-5, 5, (count, 2))
    boxes = Boxes(state, rng.uniform(-9, 9, count), half, turn, lo, lo + rng.uniform(0, size * 3, (count, 2)))
    found = component_labels(boxes)
    with without_kernel():
        assert np.array_equal(found, component_labels(boxes))
    if 0 < count <= 400:
        one, two = np.nonzero(
            (state[:, None] == state) & boxes.meet(np.arange(count)[:, None], np.arange(count)[None])
        )
        links = coo_array((np.ones(len(one)), (one, two)), shape=(count, count))
        assert np.array_equal(found, connected_components(links, directed=False)[1])
