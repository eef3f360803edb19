"""What an emulated part weighs and stands on, and the engine that it gets."""

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from firm_rig import firm_rig

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.config import load_objects, load_rig, shipped_objects
from palpate.config.emulation import EmulatedPartConfig
from palpate.drivers.emulators.part import Displacement, QuasiStaticPart, StillPart
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.part_truth import PartTruth, draw_part, part_of, support_of
from palpate.rig.emulated.scene import Placement, displace, draw_placement, shape_of

OBJECTS = load_objects(shipped_objects())
TRUTH = PartTruth("quasi-static", 0.2, 0.3, 0.0, 0, 5)


def box(x: float, y: float, wide: float, deep: float) -> Polygon:
    corners = np.array([[0, 0], [wide, 0], [wide, deep], [0, deep]], dtype=np.float64)
    return Polygon(corners + np.array([x, y]), ())


def stack(*sections: tuple[tuple[float, float], Polygon]) -> Placement:
    state = State("standing", tuple(Section(z, (polygon,)) for z, polygon in sections))
    return Placement(ObjectModel("stack", (state,)), state, 3.0, -4.0, 0.7)


STEP = stack(((0, 10), box(0, 0, 60, 40)), ((10, 30), box(0, 0, 30, 40)))
STEP_CENTRE = (22.5, 20.0)  # equal areas times heights, centres at 30 and 15


# GEOS 3.14.1 gives it a smallest rectangle without width.
WITHOUT_RECTANGLE = (
    (32.481932217931316, -18.966823687124695),
    (6.363249223168923, 35.049973687572646),
    (-47.65354815152842, 8.931290692810252),
    (-41.12387740283782, -4.572908650864083),
    (-0.6112793718148111, 15.016103595207714),
    (12.448062125566386, -11.992295092140957),
    (-28.06453590545662, -31.581307338212753),
    (-21.53486515676602, -45.08550668188708),
)


def drawn(seed: int, **keys: Any) -> PartTruth:
    part = draw_part(EmulatedPartConfig.model_validate({"engine": "still"} | keys), None, seed)
    assert part is not None
    return part


def test_masses_are_drawn_log_uniformly_and_frictions_uniformly() -> None:
    many = [
        drawn(seed, mass_kg=(0.05, 1.0), friction=(0.15, 0.5), tip_friction=(0.0, 0.6)) for seed in range(400)
    ]
    assert np.median([part.mass_kg for part in many]) == pytest.approx(math.sqrt(0.05), rel=0.2)
    assert np.median([part.friction for part in many]) == pytest.approx(0.325, rel=0.1)
    assert np.median([part.tip_friction for part in many]) == pytest.approx(0.3, rel=0.2)
    assert all(0.05 <= part.mass_kg <= 1 and 0.15 <= part.friction <= 0.5 for part in many)
    assert drawn(3, mass_kg=(0.05, 1.0)).friction == 0.3
    assert drawn(3, mass_kg=0.4).mass_kg == 0.4


def test_what_a_scene_says_goes_before_the_draw() -> None:
    config = EmulatedPartConfig(engine="still", mass_kg=(0.1, 0.2), friction=0.3)
    part = draw_part(config, replace(STEP, mass_kg=0.7, friction=0.5), 1)
    assert part is not None
    assert (part.mass_kg, part.friction, part.slip_n) == (0.7, 0.5, pytest.approx(0.7 * 0.5 * 9.80665))


@pytest.mark.parametrize("feet", [0, 3, 5, 12])
@pytest.mark.parametrize("seed", range(4))
def test_loads_balance_about_the_centre_of_mass(feet: int, seed: int) -> None:
    support = support_of(replace(TRUTH, feet=feet, seed=seed), STEP)
    base = shape_of(STEP, STEP.state.sections[0])
    c, s = math.cos(0.7), math.sin(0.7)
    x, y = STEP_CENTRE
    assert support.centre_mm == pytest.approx([c * x - s * y + 3, s * x + c * y - 4])
    assert shapely.contains_xy(base, *support.feet_mm.T).all()
    assert support.share.min() > 0
    assert support.share.sum() == pytest.approx(1)
    if feet:
        assert len(support.share) == feet
        assert support.share.max() > 1.2 * support.share.min()


def test_drawn_parts_lie_inside_the_workspace_if_they_fit() -> None:
    outside = 0
    for seed in range(30):
        rngs = np.random.default_rng(seed), np.random.default_rng(seed)
        anywhere, inside = (
            draw_placement(OBJECTS, 60.0, rngs[0]),
            draw_placement(OBJECTS, 60.0, rngs[1], 80.0),
        )
        furthest = [
            shapely.hausdorff_distance(shape_of(lies, lies.state.sections[0]), shapely.Point(0, 0))
            for lies in (anywhere, inside)
        ]
        assert furthest[1] <= 80.0
        assert (anywhere == inside) is bool(furthest[0] <= 80.0)
        outside += furthest[0] > 80.0
    assert outside > 5
    never = draw_placement(OBJECTS, 20.0, np.random.default_rng(0), workspace_mm=5.0)
    assert never == draw_placement(OBJECTS, 20.0, np.random.default_rng(0))


def test_a_whole_base_is_spread_evenly_under_a_part_of_one_section() -> None:
    for seed in range(6):
        lies = draw_placement(OBJECTS, 20.0, np.random.default_rng(seed))
        support = support_of(TRUTH, lies)
        base = shape_of(lies, lies.state.sections[0])
        assert support.share.max() < 1.3 * support.share.min(), lies.model.name
        rng = np.random.default_rng(0)
        low, high = np.array(shapely.bounds(base)).reshape(2, 2)
        many = rng.uniform(low, high, (20000, 2))
        many = many[shapely.contains_xy(base, *many.T)]
        mean = np.hypot(*(many - many.mean(axis=0)).T).mean()
        assert support.median_distance_mm == pytest.approx(mean, rel=0.05)


def test_a_base_without_a_rectangle_is_covered_like_any_other() -> None:
    state = State("flat", (Section((0, 20), (Polygon(np.array(WITHOUT_RECTANGLE), ()),)),))
    lies = Placement(ObjectModel("jagged", (state,)), state, 0.0, 0.0, 0.0)
    usual = support_of(TRUTH, replace(lies, theta_rad=0.3))
    support = support_of(TRUTH, lies)
    assert 0.7 < len(support.share) / len(usual.share) < 1.4
    assert support.median_distance_mm == pytest.approx(usual.median_distance_mm, rel=0.05)


def test_a_part_that_would_fall_over_is_refused() -> None:
    falling = stack(((0, 10), box(0, 0, 20, 20)), ((10, 30), box(15, 0, 60, 20)))
    with pytest.raises(InputError, match="stack, standing: its centre of mass is not above its base"):
        support_of(TRUTH, falling)


def test_engines_by_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(part_of(replace(TRUTH, engine="still"), STEP), StillPart)
    assert isinstance(part_of(TRUTH, STEP), QuasiStaticPart)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"mujoco.* -m pip install .*\[physics\]'"):
        part_of(replace(TRUTH, engine="mujoco"), STEP)


def test_a_displaced_part_lies_where_its_points_are() -> None:
    displacement = Displacement(np.array([10.0, 5.0]), np.array([1.0, -2.0]), 0.3)
    after = displace(STEP, displacement)
    before = shapely.get_coordinates(shape_of(STEP, STEP.state.sections[0]))
    expected = [displacement.place(point) for point in before]
    found = shapely.get_coordinates(shape_of(after, STEP.state.sections[0]))
    assert found == pytest.approx(np.array(expected))


def test_no_table_stands_still_as_before_and_draws_nothing() -> None:
    rig = load_rig(firm_rig())
    made = emulate(rig, draw_placement(OBJECTS, 20.0, np.random.default_rng(1)), 1)
    assert made.part is None
    assert isinstance(made.bench.part, StillPart)
