"""Skin that sticks, shears and slips: against Coulomb's law, and no path in contact gives energy back."""

import math
from itertools import pairwise

import numpy as np
import pytest

from palpate.base.geometry import Floats
from palpate.drivers.emulators.skin import Shear, shear_skin
from palpate.drivers.emulators.tip import PartSection, tip_load

RADIUS, STIFFNESS = 5.0, 3.0
ALONG = 0.7 * STIFFNESS
SQUARE = [[0, 0], [40, 0], [40, 40], [0, 40]]
NOTCH = [[0, 0], [40, 0], [40, 40], [28, 40], [20, 30], [12, 40], [0, 40]]
KNIFE = [[0, 0], [20, 3], [0, 6]]


def section(corners: list[list[float]]) -> PartSection:
    start = np.array(corners, dtype=np.float64)
    return PartSection(start, np.roll(start, -1, axis=0), 20.0)


def forces(outline: PartSection, path: Floats, friction: float) -> tuple[Floats, list[Shear | None]]:
    """Force (n, 2) on a tip along a path (n, 2) beside a part at rest, and how the skin is sheared."""
    found, skin = [], list[Shear | None]()
    state: Shear | None = None
    for centre in path:
        load = tip_load(outline, centre, RADIUS, STIFFNESS)
        state = load and shear_skin(
            state, load, centre, 0.0, radius_mm=RADIUS, stiffness_n_per_mm=STIFFNESS, friction=friction
        )
        skin.append(state)
        found.append(np.zeros(2) if load is None or state is None else load.force_n + state.force_n)
    return np.array(found), skin


def given_back_mj(path: Floats, force: Floats) -> float:
    """Work of the forces on a tip along a path."""
    return float(np.sum((force[1:] + force[:-1]) / 2 * np.diff(path, axis=0)))


def straight(*corners: tuple[float, float], step_mm: float = 0.005) -> Floats:
    legs = [
        np.linspace(a, b, max(2, round(math.dist(a, b) / step_mm)), endpoint=False)
        for a, b in pairwise(corners)
    ]
    return np.vstack([*legs, corners[-1:]])


def test_skin_sticks_shears_and_slips_on_a_wall() -> None:
    path = straight((10, 45.5), (10, 44.8), (11, 44.8))
    force, skin = forces(section(SQUARE), path, 0.5)
    normal = force[-1][1]
    assert normal == pytest.approx(STIFFNESS * 0.2, rel=0.05)
    at = np.searchsorted(path[:, 0], 10.05)
    assert force[at][0] == pytest.approx(-ALONG * (path[at][0] - 10), rel=0.01)
    assert force[-1][0] == pytest.approx(-0.5 * normal)
    last = skin[-1]
    assert last is not None
    assert last.point_mm == pytest.approx([11, 40], abs=0.01)
    assert abs(last.angle_rad) == pytest.approx(0.5 * normal / ALONG / RADIUS)
    # The wall is below the tip, at −π/2; the skin that sticks there was further to the right before.
    assert last.angle_rad > 0


def test_a_part_that_turns_under_a_tip_carries_the_skin_along() -> None:
    outline, centre = section(SQUARE), np.array([10.0, 44.8])
    load = tip_load(outline, centre, RADIUS, STIFFNESS)
    assert load is not None
    keys = {"radius_mm": RADIUS, "stiffness_n_per_mm": STIFFNESS, "friction": 0.5}
    before = shear_skin(None, load, centre, 0.0, **keys)
    # In the part's frame the tip's axis stays where it is, and the tip turns against the wall.
    after = shear_skin(before, load, centre, 0.01, **keys)
    assert abs(after.shear_mm) == pytest.approx(0.01 * 4.8, rel=0.01)


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.6])
@pytest.mark.parametrize(
    ("corners", "at"),
    [(SQUARE, (10.0, 44.6)), (SQUARE, (43.3, 43.2)), (NOTCH, (20.0, 37.0)), (KNIFE, (24.6, 3.4))],
)
def test_closed_loops_give_back_no_energy(
    corners: list[list[float]], at: tuple[float, float], friction: float
) -> None:
    """From free space into contact, about in it at random, and back the same way."""
    rng = np.random.default_rng(1)
    middle = np.array(at)
    out = middle + (middle - np.mean(corners, axis=0)) * 0.2
    points = [tuple(middle + rng.uniform(-0.35, 0.35, 2)) for _ in range(5)]
    path = straight(tuple(out), *points, tuple(out))
    force, _ = forces(section(corners), path, friction)
    assert np.hypot(*force.T).max() > 0.3
    assert given_back_mj(path, force) < 1e-3
    if friction == 0:
        assert given_back_mj(path, force) > -1e-3
