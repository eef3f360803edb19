"""Truth of the emulated rig: fresh, calibrated, of the part."""

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.calibration.frame_alignment import BasePose, align_to_nominal
from palpate.config import (
    ArmFingerConfig,
    RigFile,
    SlideFingerConfig,
    load_objects,
    load_rig,
    shipped_objects,
)
from palpate.config.calibration_overlay import frame_offset_bound_mm
from palpate.config.emulation import EmulatedPartConfig
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.drivers.emulators.part import Displacement, QuasiStaticPart, StillParts
from palpate.drivers.kinematics import Turn
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.finger_truth import dead_taxels
from palpate.rig.emulated.ground_truth import in_hand_frame
from palpate.rig.emulated.hidden_truth import PartTruth, draw_parts, parts_of, support_of
from palpate.rig.emulated.scene import Placement, displace, draw_placement, shape_of
from palpate.rig.mechanisms import mechanism_of
from support.benches.rigs import firm_rig
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# What emulated rigs draw: within what is declared, up to it, and apart from what seeds drew before.

FRESH = load_rig(EXAMPLES / "fresh-rig.toml")
BENCH = load_rig(firm_rig())


def truths_of(seed: int) -> list[FingerTruth]:
    fingers = emulate(FRESH, (), seed).bench.fingers
    return [finger.truth for finger in fingers if isinstance(finger.truth, FingerTruth)]


def slides() -> list[SlideFingerConfig]:
    return [finger for finger in FRESH.fingers if isinstance(finger, SlideFingerConfig)]


def test_fresh_fingers_are_off_by_what_is_declared_and_no_more() -> None:
    """Distances from the drawing, as the file tells them: zero at Goal Position 0, mm per turn."""
    shares = []
    for seed in range(20):
        for spec, truth in zip(slides(), truths_of(seed), strict=True):
            per_turn = truth.mm_per_rad * 2 * math.pi
            at_zero = truth.zero_mm - per_turn / 2
            shares.append(
                (
                    (truth.tip_radius_mm - spec.tip.radius_mm) / spec.tip.radius_bound_mm,
                    math.degrees(truth.array_heading_rad) / spec.array.heading_bound_deg,
                    (at_zero - spec.slide.zero_mm) / spec.slide.zero_bound_mm,
                    (per_turn / spec.slide.mm_per_turn - 1) / spec.slide.mm_per_turn_spread,
                )
            )
    drawn = np.array(shares)
    assert np.abs(drawn).max() <= 1.0 + 1e-9
    assert (drawn.min(axis=0) < -0.8).all()
    assert (drawn.max(axis=0) > 0.8).all()
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 0.4


def test_what_fresh_rigs_add_leaves_the_other_draws_alone() -> None:
    """The same file without the newer errors draws the same bases, headings, plays and stiffnesses."""
    assert FRESH.emulation is not None
    newer = ("tip_radius_error_mm", "array_heading_error_deg", "zero_error_mm", "mm_per_turn_error")
    plain = FRESH.emulation.model_copy(update=dict.fromkeys((*newer, "dead_taxels"), 0))
    without = emulate(FRESH.model_copy(update={"emulation": plain}), (), 3)
    for one, other in zip(emulate(FRESH, (), 3).bench.fingers, without.bench.fingers, strict=True):
        assert one.truth.base_mm == other.truth.base_mm
        assert one.truth.heading_rad == other.truth.heading_rad
        assert one.truth.stiffness_n_per_mm == other.truth.stiffness_n_per_mm
        assert one.truth.tip_radius_mm != other.truth.tip_radius_mm == 5.0
        assert one.array.description == other.array.description, "it believes what the drawing says"


def test_slides_start_where_the_host_takes_them_for_retracted() -> None:
    for spec, finger in zip(slides(), emulate(FRESH, (), 2).bench.fingers, strict=True):
        aim, slide = mechanism_of(spec).start_rad(FRESH.clear_radius_mm)
        assert [servo.shaft_rad for servo in finger.servos] == [aim, slide]
        # 1 mm out of the retracted end by the file's numbers: 46 mm = 40 mm + 100 mm · 0.06 turns.
        assert slide + math.pi == pytest.approx(0.06 * 2 * math.pi)


def test_arms_draw_tips_and_arrays_too() -> None:
    rig = load_rig(EXAMPLES / "two-link-rig.toml")
    assert rig.emulation is not None
    off = {"tip_radius_error_mm": 0.3, "array_heading_error_deg": 2.0}
    changed = rig.model_copy(update={"emulation": rig.emulation.model_copy(update=off)})
    for spec, finger in zip(rig.fingers, emulate(changed, (), 1).bench.fingers, strict=True):
        assert isinstance(spec, ArmFingerConfig)
        assert 0 < abs(finger.truth.tip_radius_mm - spec.tip.radius_mm) <= 0.3
        assert 0 < abs(math.degrees(finger.truth.array_heading_rad) - spec.array.heading_deg) <= 2.0


def test_dead_taxels_are_where_touches_are_felt() -> None:
    d = emulate(FRESH, (), 0).bench.fingers[0].array.description
    # 20 columns over 270°: 13.5° apart, four and a half steps to either side are 60.75°.
    felt = {(row, col) for row in range(8) for col in range(6, 14)}
    assert set(dead_taxels(d, len(felt), np.random.default_rng(0))) == felt
    assert dead_taxels(d, 0, np.random.default_rng(0)) == ()
    with pytest.raises(InputError, match=r"^emulation.dead_taxels: is 65; an emulated array has 64 taxels"):
        dead_taxels(d, 65, np.random.default_rng(0))


def test_another_seed_is_another_array() -> None:
    ids = [
        finger.array.description.unique_id
        for seed in range(3)
        for finger in emulate(BENCH, (), seed).bench.fingers
    ]
    assert len(set(ids)) == 9
    assert ids[0][:8] == b"f1\0\0\0\0\0\0"
    assert {len(item) for item in ids} == {16}
    again = emulate(BENCH, (), 0).bench.fingers[0].array.description
    assert again.unique_id == ids[0]


# ----------------------------------------------------------------------------------------------------
# The truth in the frame that a calibrated hand speaks of, which is not quite the emulated table's.

PLACEMENT = draw_placement(load_objects(shipped_objects()), 20.0, np.random.default_rng(4))


def moved(point: tuple[float, float], angle: float, shift: tuple[float, float]) -> tuple[float, float]:
    at = complex(*point) * complex(math.cos(angle), math.sin(angle)) + complex(*shift)
    return at.real, at.imag


def test_a_hand_that_stands_as_drawn_but_elsewhere_takes_the_part_along() -> None:
    """All fingers turned and shifted as one, and the part with them: the hand sees no difference."""
    angle, shift = 0.04, (2.0, -1.5)
    truths = [
        replace(
            truth,
            base_mm=moved(spec.base_mm, angle, shift),
            heading_rad=math.radians(spec.heading_deg) + angle,
        )
        for spec, truth in zip(FRESH.fingers, truths_of(0), strict=True)
    ]
    x, y = moved((PLACEMENT.x_mm, PLACEMENT.y_mm), angle, shift)
    elsewhere = replace(PLACEMENT, x_mm=x, y_mm=y, theta_rad=PLACEMENT.theta_rad + angle)
    assert pose(in_hand_frame(elsewhere, FRESH, truths)) == pytest.approx(pose(PLACEMENT))


def test_a_drawn_hand_sees_the_part_elsewhere_by_what_its_fingers_are_off() -> None:
    for seed in range(3):
        truths = truths_of(seed)
        there = in_hand_frame(PLACEMENT, FRESH, truths)
        # The middle of the bases goes to the middle of the drawn ones; the part is as far from it as it was.
        drawn = np.mean([finger.base_mm for finger in FRESH.fingers], axis=0)
        built = np.mean([truth.base_mm for truth in truths], axis=0)
        before = math.dist((PLACEMENT.x_mm, PLACEMENT.y_mm), built)
        assert math.dist((there.x_mm, there.y_mm), drawn) == pytest.approx(before)
        assert 0 < abs(there.theta_rad - PLACEMENT.theta_rad) < math.radians(3.0)
        assert (there.model, there.state) == (PLACEMENT.model, PLACEMENT.state)


def pose(placement: Placement) -> tuple[float, float, float]:
    return placement.x_mm, placement.y_mm, placement.theta_rad


def test_a_stage_turns_about_where_its_centre_bound_allows_in_the_calibrations_frame() -> None:
    """Points of the ring, by the drawing's centre and by the true one, in the frame of the calibration."""
    data = FRESH.model_dump(mode="json", exclude_unset=True)
    rng, widest = np.random.default_rng(6), 0.0
    for seed in range(40):
        centre = tuple(rng.uniform(-8.0, 8.0, 2).tolist())
        stage = {"centre_mm": centre, "dxl_id": 1, "model": "XM430-W350", "gear_ratio": 5.0}
        stage |= {"range_deg": [-30.0, 30.0], "backlash_deg": 0.0, "zero_deg": 180.0, "bound_deg": 0.0}
        rig = RigFile.model_validate(data | {"stage": stage})
        assert rig.stage is not None
        truths = truths_of(seed)
        drawn = [BasePose(item.base_mm, math.radians(item.heading_deg)) for item in rig.fingers]
        frame = align_to_nominal(drawn, [BasePose(item.base_mm, item.heading_rad) for item in truths])
        bound = frame_offset_bound_mm(rig, rig.stage.centre_mm)
        true_centre = frame.point_mm(rig.stage.centre_mm)
        assert math.dist(true_centre, rig.stage.centre_mm) <= bound
        angle = float(rng.uniform(-0.52, 0.52))
        point = tuple(rng.uniform(-60.0, 60.0, 2).tolist())
        believed = Turn(rig.stage.centre_mm, angle, 0.0, bound)
        off = math.dist(believed.point_mm(point), Turn(true_centre, angle).point_mm(point))
        assert off <= believed.position_bound_mm(point) + 1e-9
        widest = max(widest, off)
    assert widest > 0.3, "more than such rigs' contacts are bounded by"


# ----------------------------------------------------------------------------------------------------
# What an emulated part weighs and stands on, and the engine that it gets.

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
    (part,) = draw_parts(EmulatedPartConfig.model_validate({"engine": "still"} | keys), [STEP], seed)
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
    (part,) = draw_parts(config, [replace(STEP, mass_kg=0.7, friction=0.5)], 1)
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
    assert isinstance(parts_of([replace(TRUTH, engine="still")], [STEP]), StillParts)
    assert isinstance(parts_of([TRUTH], [STEP]), QuasiStaticPart)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"mujoco.* -m pip install .*\[physics\]'"):
        parts_of([replace(TRUTH, engine="mujoco")], [STEP])


def test_a_displaced_part_lies_where_its_points_are() -> None:
    displacement = Displacement(np.array([10.0, 5.0]), np.array([1.0, -2.0]), 0.3)
    after = displace(STEP, displacement)
    before = shapely.get_coordinates(shape_of(STEP, STEP.state.sections[0]))
    expected = [displacement.place(point) for point in before]
    found = shapely.get_coordinates(shape_of(after, STEP.state.sections[0]))
    assert found == pytest.approx(np.array(expected))


def test_no_table_stands_still_as_before_and_draws_nothing() -> None:
    rig = load_rig(firm_rig())
    made = emulate(rig, [draw_placement(OBJECTS, 20.0, np.random.default_rng(1))], 1)
    assert made.parts == ()
    assert isinstance(made.bench.parts, StillParts)
