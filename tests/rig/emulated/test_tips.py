"""The emulated rig with balls, pads and long tips."""

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from palpate.base.errors import DeviceError, InputError
from palpate.base.tips import TipShape
from palpate.base.vocabulary import IdentificationVerdict, PartMotion
from palpate.config import RigFile, load_contacts, load_rig
from palpate.drivers.emulators.finger import facing_row_shares
from palpate.drivers.emulators.part import IN_PLACE
from palpate.drivers.emulators.skin import Skin
from palpate.drivers.emulators.tip import separation_mm
from palpate.drivers.tactile.description import Description, Shape
from palpate.jobs.recognition import plan
from palpate.recognizer import Catalogue, Finger
from palpate.rig.arrays import extractor_of, pad_problem, shape_warning, threshold_problem
from palpate.rig.bench import connect
from palpate.rig.catalogue.finger_model import contact_bound_mm
from palpate.rig.catalogue.reachability import finding_lines, overhangs_of
from palpate.rig.commissioning.calibration_run import steps_of
from palpate.rig.conversion import contacts_json, finger_of, grips_of
from palpate.rig.emulated.devices import description_of
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, outline_at
from palpate.rig.identification.identify import identify
from palpate.rig.identification.outcome import Identification
from palpate.rig.study.simulation import with_motion
from support.benches.rigs import firm_rig, quicken, small, small_objects, small_rig
from support.benches.session import emulated_session, identify_checked
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES
from support.oracles.array_contacts import describe
from support.oracles.upright_tips import (
    Block,
    Stack,
    drawn_stack,
    first_touch_of_ball,
    model_of,
    slices,
    triangles_of,
)

# ----------------------------------------------------------------------------------------------------
# Emulated balls: what stops them, and whole runs of rigs with balls.

BODY = shapely.box(-29, -14, 18, 12)
FOOT = Stack((Block(shapely.box(-26, -18, 26, 18), (0.0, 6.0)), Block(BODY, (6.0, 30.0))))
"""Its foot stands out on three sides, and its body on one by more than the ball's circles differ."""
OTHER = Stack((Block(shapely.box(-26, -22, 26, 22), (0.0, 6.0)), Block(BODY, (6.0, 30.0))))
LOW = Stack((Block(shapely.Polygon([(-25, -16), (24, -12), (2, 22)]), (0.0, 8.0)),))


def ball_rig(latitude_deg: float | None = None) -> RigFile:
    """The small rig with balls."""
    data = small_rig().model_dump(exclude_unset=True)
    for finger in data["fingers"]:
        finger["tip"] |= {"shape": "ball", "radius_mm": 5.0, "max_latitude_deg": latitude_deg}
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(30), range(6)))
def test_an_emulated_ball_stops_where_the_solid_does(seed: int) -> None:
    rng = np.random.default_rng([85, seed])
    stack = drawn_stack(rng, leaning=False)
    radius = float(rng.choice([3.0, 6.0]))
    height = float(rng.uniform(radius, stack.top_mm + 0.5 * radius))
    model = model_of(stack)
    found = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), height, 0.0, radius, TipShape.BALL)
    triangles, stopped = triangles_of(stack), 0
    for _ in range(12):
        angle = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(angle), math.sin(angle), 0.0])
        start = np.array([*rng.uniform(-20, 20, 2), height]) - 110.0 * heading
        travel = first_touch_of_ball(triangles, start, heading, radius)
        if math.isfinite(travel):
            assert found is not None
            assert found.disc_mm is not None
            gap = separation_mm(found, (start + travel * heading)[:2]) - found.disc_mm
            assert gap == pytest.approx(0.0, abs=2e-3), "chords of arcs"
            stopped += 1
    assert stopped or found is None or height > stack.top_mm


def test_beside_its_equator_a_ball_presses_less_aside() -> None:
    model = model_of(LOW)
    outline = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), 11.0, 0.0, 5.0, TipShape.BALL)
    assert outline is not None
    assert outline.disc_mm == pytest.approx(4.0)
    middle = (outline.start[0] + outline.end[0]) / 2
    along = (outline.end[0] - outline.start[0]) / math.dist(outline.end[0], outline.start[0])
    out = np.array([along[1], -along[0]])
    out = out if shapely.Polygon(outline.start).distance(shapely.Point(middle + out)) > 0 else -out
    press = Skin(4.0, 3.0).press(outline, middle + 3.9 * out, IN_PLACE, None)
    assert press is not None
    assert math.hypot(*press.load.force_n) == pytest.approx(3.0 * 0.1 * 0.8**2, rel=0.02)
    assert press.load.on_skin_n.sum() == pytest.approx(press.load.by_ray_n.sum() / 0.8)
    (force,) = press.on_part(middle + 3.9 * out, IN_PLACE, 11.0)
    assert 7.0 <= force.height_mm <= 8.0, "at the part's upper edge"


@pytest.mark.parametrize("seed", sample(range(6), [0]))
def test_stepped_and_low_parts_are_identified_by_balls(seed: int) -> None:
    models = [model_of(stack, name) for stack, name in ((FOOT, "foot"), (OTHER, "other"), (LOW, "low"))]
    truth = models[(0, 2)[seed % 2]]
    placement = Placement(truth, truth.states[0], 4.0, -3.0, 0.7 + seed)
    session = emulated_session(seed=seed, rig=ball_rig(), placement=placement)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        result = identify(hand, Catalogue(models))
    assert not any(session.torque().values())
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert result.recognition is not None
    assert {item.state.object_name for item in result.recognition.hypotheses} == {truth.name}
    assert compare_answer(placement, result.recognition.hypotheses).inside_bounds


def test_the_rig_files_ball_is_the_recognisers() -> None:
    assert {finger_of(finger) for finger in ball_rig().fingers} == {Finger(5.0, 10.0, shape=TipShape.BALL)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"length_mm": 12.0}, "a ball has a radius only"),
        ({"radius_mm": 12.0}, r"is 12, too much at height_mm \(10\)"),
        ({"radius_bound_mm": 0.7}, "at most 0.1 of radius_mm"),
        ({"shape": "cylinder", "max_latitude_deg": 20.0}, "is for balls"),
    ],
)
def test_balls_that_cannot_be(changes: dict[str, float], message: str) -> None:
    data = ball_rig().model_dump(exclude_unset=True)
    data["fingers"][0]["tip"] |= changes
    with pytest.raises(ValueError, match=message):
        RigFile.model_validate(data)


def test_a_study_refuses_balls() -> None:
    with pytest.raises(InputError, match="its tip is a ball"):
        with_motion(ball_rig(), small_objects(), PartMotion.STILL)


def test_states_that_balls_meet_obliquely_are_named_before_anything_moves() -> None:
    low, box = model_of(LOW, "low"), model_of(Stack((Block(BODY, (0.0, 30.0)),)), "box")
    (line,) = finding_lines(ball_rig(), [low, box], "parts.json")
    assert "low, standing (finger f1, 24°): balls meet these beside their equators" in line
    assert "up to 0.4 times as much" in line
    step = model_of(
        Stack((Block(shapely.box(-30, -25, 30, 25), (0.0, 5.5)), Block(BODY, (5.5, 30.0)))), "step"
    )
    refused = (
        r'finger f1: object "step", state "standing": a ball of radius 5 mm at 10 mm may touch what stands'
    )
    with pytest.raises(InputError, match=refused):
        finding_lines(ball_rig(), [low, step], "parts.json")


def test_a_bound_on_the_latitude_makes_contacts_finer_and_is_held_to() -> None:
    low, box = model_of(LOW, "low"), model_of(Stack((Block(BODY, (0.0, 30.0)),)), "box")
    bounds = [contact_bound_mm(rig) for rig in (small_rig(), ball_rig(latitude_deg=0.0), ball_rig())]
    assert bounds[0] == bounds[1]
    assert bounds[1] is not None
    assert bounds[2] is not None
    assert bounds[1] < bounds[2]
    assert finding_lines(ball_rig(latitude_deg=0.0), [box], "parts.json") == []
    assert finding_lines(ball_rig(latitude_deg=24.0), [low], "parts.json")
    with pytest.raises(
        InputError, match=r'"low", state "standing": its ball may touch up to 23\.6° .* \(20\)'
    ):
        finding_lines(ball_rig(latitude_deg=20.0), [low], "parts.json")


def test_contacts_of_balls_in_files(tmp_path: Path) -> None:
    touch = {
        "finger": "f1",
        "touched": True,
        "height": 10.0,
        "tip_radius": 5.0,
        "tip_shape": "ball",
        "position_bound": 0.1,
        "centre": [20.0, 0.0],
        "approach": {"direction": math.pi, "start": [80.0, 0.0]},
    }
    path = tmp_path / "contacts.json"
    for change, message in (
        ({"tip_length": 4.0}, "a radius only"),
        ({"tip_radius": 11.0}, "too much for a ball"),
    ):
        path.write_text(_contacts(touch | change), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            load_contacts(path)
    path.write_text(_contacts(touch), encoding="utf-8")
    ((contact,),) = grips_of(load_contacts(path))
    assert contact.finger == Finger(5.0, 10.0, shape=TipShape.BALL)


def _contacts(touch: dict[str, object]) -> str:
    return json.dumps({"format": "palpate/contacts@1", "units": "mm, rad", "grips": [{"contacts": [touch]}]})


# ----------------------------------------------------------------------------------------------------
# Emulated pads: whole runs of rigs with pads, and what is refused before anything moves.

EXAMPLE = EXAMPLES / "pad-rig.toml"
Change = dict[str, object]


def pad_rig(tip: Change | None = None, array: Change | None = None, **other: Change) -> RigFile:
    """The example made small; `other`: changes of tables by their names."""
    data = tomllib.loads(quicken(small(EXAMPLE)))
    for finger in data["fingers"]:
        finger["tip"] |= tip or {}
        finger["array"] |= array or {}
    for table, changes in other.items():
        data[table] |= changes
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(2), [0]))
def test_parts_are_identified_by_pads(seed: int) -> None:
    session = emulated_session(seed=seed, rig=pad_rig(), objects=small_objects())
    result = identify_checked(session, Catalogue(small_objects().objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    touches = [touch for grip in result.grips for touch in grip]
    assert {touch.contact.finger for touch in touches} == {Finger(5.0, 10.0, shape=TipShape.PAD)}
    assert {contact.finger for touch in touches for contact in touch.evidence} == {Finger(0.0, 10.0)}
    for grip in contacts_json([[item for touch in grip for item in touch.evidence] for grip in result.grips])[
        "grips"
    ]:  # type: ignore[attr-defined]
        names = [contact["finger"] for contact in grip["contacts"]]
        assert len(set(names)) == len(names), "so files of contacts have them"


@pytest.mark.campaign
def test_wide_coarse_pads_that_are_off_by_their_bounds_still_find_the_truth() -> None:
    rig = pad_rig(
        tip={"width_mm": 16.0, "radius_bound_mm": 0.2, "length_mm": 6.0},
        array={"pitch_mm": 2.0, "heading_bound_deg": 1.0},
        emulation={"tip_radius_error_mm": 0.2, "array_heading_error_deg": 1.0},
    )
    session = emulated_session(seed=5, rig=rig, objects=small_objects())
    identify_checked(session, Catalogue(small_objects().objects))


def test_the_rig_files_pad_is_half_as_wide_either_way() -> None:
    rig = load_rig(EXAMPLE)
    assert {finger_of(finger) for finger in rig.fingers} == {Finger(5.0, 10.0, shape=TipShape.PAD)}
    assert {finger_of(finger).face_point for finger in rig.fingers} == {Finger(0.0, 10.0)}
    again = RigFile.model_validate(rig.model_dump())
    assert again == rig, "half of the width may be said again"


@pytest.mark.parametrize(
    ("tip", "array", "message"),
    [
        ({"width_mm": None}, {}, '"width_mm" is missing: a pad has that in place of radius_mm'),
        ({"shape": "cylinder"}, {}, 'is for shape = "pad"; a cylinder has radius_mm'),
        ({"shape": "cylinder", "width_mm": None}, {}, 'the key "radius_mm" is missing'),
        ({"radius_mm": 4.0}, {}, r"is 4, not half of width_mm \(10\); leave it out"),
        ({"max_friction": 0.3}, {}, "must be 0 for pads"),
        ({"max_latitude_deg": 20.0}, {}, "is for balls"),
        ({}, {"pitch_mm": None}, '"pitch_mm" is missing: how far apart the columns'),
        ({}, {"heading_deg": 10.0}, r"a pad looks along the slide \(0\)"),
        ({}, {"pitch_mm": 20.0}, r"is 20; it is at most tip.width_mm \(10\)"),
        ({}, {"coverage_deg": 180.0}, "is for cylinders and balls"),
    ],
)
def test_pads_that_cannot_be(tip: Change, array: Change, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pad_rig(tip, array)


def test_a_misspelt_shape_is_one_mistake(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    text = EXAMPLE.read_text(encoding="utf-8")
    rig.write_text(text.replace('shape = "pad"', 'shape = "Pad"'), encoding="utf-8")
    with pytest.raises(InputError, match='is "Pad"; allowed: "cylinder", "ball", "pad"') as caught:
        load_rig(rig)
    assert not hasattr(caught.value, "__notes__")


def test_a_flat_array_on_another_tip_is_warned_of() -> None:
    flat, round_ = array(Shape.FLAT, 20, 0.5), array(Shape.CYLINDER, 20, 0.1)
    for rig, description, warned in (
        (small_rig(), flat, True),
        (small_rig(), round_, False),
        (pad_rig(), flat, False),
    ):
        assert (shape_warning(rig.fingers[0], description) is not None) == warned


def test_cylinders_have_no_pitch() -> None:
    data = small_rig().model_dump(exclude_unset=True)
    data["fingers"][1]["array"]["pitch_mm"] = 1.0
    with pytest.raises(ValueError, match=r'is for tip\.shape = "pad"; the tip is a cylinder'):
        RigFile.model_validate(data)


def test_parts_that_move_are_refused() -> None:
    with pytest.raises(ValueError, match="how pads move parts is not known; hold parts down"):
        pad_rig(search={"part_holds_n": 5.0})
    with pytest.raises(ValueError, match="leave it out, so that parts lie still"):
        pad_rig(emulation={"part": {"engine": "quasi-static"}})
    models = [replace(model, holds_n=3.0) for model in small_objects().objects]
    with pytest.raises(
        InputError, match=r'object "ell" declares part_holds_n; finger f1: its tip is a pad, and'
    ):
        finding_lines(pad_rig(), models, "parts.json")
    assert finding_lines(pad_rig(), small_objects().objects, "parts.json") == []


def test_arms_with_pads_are_refused() -> None:
    data = tomllib.loads((EXAMPLES / "two-link-rig.toml").read_text(encoding="utf-8"))
    for finger in data["fingers"]:
        del finger["tip"]["radius_mm"]
        finger["tip"] |= {"shape": "pad", "width_mm": 8.0}
        finger["array"] |= {"pitch_mm": 0.5, "heading_deg": 0.0}
    with pytest.raises(ValueError, match="on an arm a pad turns as it travels"):
        RigFile.model_validate(data)


def test_what_is_not_done_with_pads_is_said() -> None:
    with pytest.raises(
        InputError, match="f1: its tip is a pad, and simulated touches are those of cylinders"
    ):
        with_motion(pad_rig(), small_objects(), PartMotion.STILL)
    with pytest.raises(InputError, match="pads cannot be calibrated"):
        steps_of(pad_rig(), ["fingers"])
    contacts = load_contacts(EXAMPLES / "contacts.json")
    with pytest.raises(InputError, match="which of them are of one touch"):
        plan(load_rig(EXAMPLE), None, contacts)


def array(shape: Shape, cols: int, pitch: float) -> Description:
    return describe(shape, 4, cols, pitch, 4.0, counts_per_n=2000.0)


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (array(Shape.CYLINDER, 20, 0.1), "is not flat"),
        (array(Shape.FLAT, 10, 1.0), "1 mm apart, more than array.pitch_mm"),
        (
            array(Shape.FLAT, 19, 0.5),
            "its 19 columns, 0.5 mm apart, reach from -4.75 to 4.75 mm across, and the pad's face, "
            "10 mm wide, from -5 to 5 at most",
        ),
        (array(Shape.FLAT, 24, 0.5), "must cover the face, and no more"),
        (array(Shape.FLAT, 20, 0.5), None),
        (array(Shape.FLAT, 21, 0.5), None),
    ],
)
def test_an_array_covers_its_pads_face(description: Description, message: str | None) -> None:
    rig = load_rig(EXAMPLE)
    found = pad_problem(rig.fingers[0], description)
    if message is None:
        assert found is None
        return
    assert found is not None
    assert message in found
    with pytest.raises(DeviceError, match="tactile array f1: "):
        extractor_of(rig, rig.fingers[0], description)


def test_an_array_covers_its_pads_height() -> None:
    description = array(Shape.FLAT, 20, 0.5)
    low, high = (pad_rig(tip={"length_mm": length}).fingers[0] for length in (16.0, 17.0))
    assert pad_problem(low, description) is None
    found = pad_problem(high, description)
    assert found is not None
    assert found.startswith(
        "its 4 rows, 4 mm apart, are 16 mm high, and the pad's face 17 mm (tip.length_mm)"
    )
    assert pad_problem(high, description_of(high, 0)) is None


def test_a_push_on_all_of_a_pad_is_felt_or_the_threshold_is_refused() -> None:
    rig = pad_rig()
    extractor = extractor_of(rig, rig.fingers[0], description_of(rig.fingers[0], 0))
    assert extractor.spread_hidden_n() == pytest.approx(80 * 4 * 2.0 / 2000, rel=1e-6), "4 σ of each taxel"
    assert threshold_problem(extractor, rig.closing, rig.fingers[0].tip) is None
    low = rig.closing.model_copy(update={"contact_force_n": 0.3})
    assert "press evenly on all of the pad" in (threshold_problem(extractor, low, rig.fingers[0].tip) or "")


def test_zeros_that_drift_on_a_way_count() -> None:
    still, drifting = pad_rig(), pad_rig(array={"drift_counts_per_s": 0.2})
    now, later = (
        extractor_of(rig, rig.fingers[0], description_of(rig.fingers[0], 0)).spread_hidden_n(10.0)
        for rig in (still, drifting)
    )
    tared = extractor_of(drifting, drifting.fingers[0], description_of(drifting.fingers[0], 0))
    assert later - tared.spread_hidden_n() == pytest.approx(80 * 2 * 0.2 * 10.0 / 2000), "either way"
    assert later > now
    assert "press evenly" in (threshold_problem(tared, drifting.closing, drifting.fingers[0].tip) or "")


def test_emulated_arrays_cover_the_face() -> None:
    finger = pad_rig(array={"pitch_mm": 0.3}).fingers[0]
    found = description_of(finger, 0)
    assert found.cols == 34
    assert np.diff(found.columns) == pytest.approx(10.0 / 34)
    assert math.isclose(found.columns[0] - 10.0 / 68, -5.0)
    assert pad_problem(finger, found) is None
    with pytest.raises(InputError, match=r"raise array\.pitch_mm"):
        description_of(pad_rig(array={"pitch_mm": 0.03}).fingers[0], 0)


def test_the_example_is_the_firm_rig_with_pads() -> None:
    firm, pads = (tomllib.loads(Path(path).read_text(encoding="utf-8")) for path in (firm_rig(), EXAMPLE))
    assert [item["base_mm"] for item in pads["fingers"]] == [item["base_mm"] for item in firm["fingers"]]


# ----------------------------------------------------------------------------------------------------
# Emulated tips of some length: what stops them, which rows of taxels feel it, and whole runs.

FOOT_OUTLINE = shapely.box(-30, -20, 30, 20)
BODY_OUTLINE = shapely.box(-22, -14, 38, 8)
"""It stands back from the foot on three sides, and out over it on one."""
STEPPED = Stack((Block(FOOT_OUTLINE, (0.0, 7.0)), Block(BODY_OUTLINE, (7.0, 30.0))))
OTHER_OUTLINE = Stack((Block(shapely.box(-26, -22, 26, 22), (0.0, 6.0)), Block(BODY_OUTLINE, (6.0, 30.0))))


def rig_with(length_mm: float | None, true_mm: float | None) -> RigFile:
    """The small rig with tips of a length, as its file says and in truth."""
    data = small_rig().model_dump(exclude_unset=True)
    if true_mm is not None:
        data["emulation"]["tip_length_mm"] = true_mm
    for finger in data["fingers"]:
        finger["tip"]["length_mm"] = length_mm
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(20), range(5)))
def test_outlines_along_a_tip_are_those_of_the_solid(seed: int) -> None:
    rng = np.random.default_rng([71, seed])
    stack = drawn_stack(rng, leaning=False)
    height = float(rng.uniform(2, stack.top_mm))
    half = float(rng.uniform(0.5, height))
    model = model_of(stack)
    found = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), height, half)
    assert found is not None
    lines = slices(stack, (height - half, height + half))
    middles = shapely.points((found.start + found.end) / 2)
    assert shapely.distance(lines, middles).max() < 1e-6, "every edge is one of a slice"
    outer = shapely.polygonize(list(shapely.linestrings(np.stack([found.start, found.end], axis=1))))
    assert lines.difference(outer.buffer(1e-6)).is_empty, "and no slice is outside of them"
    assert found.z_mm is not None
    for middle, (low, high) in zip(middles, found.z_mm, strict=True):
        at = (low + high) / 2
        assert height - half - 1e-9 <= low <= high <= height + half + 1e-9
        own = [block.at(at) for block in stack.blocks if block.z_mm[0] <= at <= block.z_mm[1]]
        assert min(shape.boundary.distance(middle) for shape in own) < 1e-6 or high - low > 3.0


def test_a_disc_meets_one_section_as_before() -> None:
    model = model_of(STEPPED)
    placement = Placement(model, model.states[0], 3.0, 4.0, 0.3)
    disc = outline_at(placement, 10.0)
    assert disc is not None
    assert disc.z_mm is None
    assert len(disc.start) == 4
    assert outline_at(placement, 40.0, 5.0) is None
    low = outline_at(placement, 40.0, 12.0)
    assert low is not None, "its lower end is beside the body"


def test_rows_that_face_a_section_bear_its_force() -> None:
    rows = np.arange(3.0, 18.0, 2.0)
    shares = facing_row_shares(rows, np.array([[4.0, 7.0], [7.0, 16.0], [7.2, 8.8]]))
    assert shares.sum(axis=1) == pytest.approx(1.0)
    assert (shares[0] > 0).tolist() == [False, True, True, False, False, False, False, False]
    assert (shares[1] > 0).sum() == 5
    assert (shares[2] > 0).sum() == 1, "between two rows: the nearest one"


def test_a_foot_presses_at_its_height() -> None:
    model = model_of(STEPPED)
    outline = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), 10.0, 6.0)
    assert outline is not None
    press = Skin(5.0, 3.0).press(outline, np.array([-34.5, 0.0]), IN_PLACE, None)
    assert press is not None
    (force,) = press.on_part(np.array([-34.5, 0.0]), IN_PLACE, 10.0)
    assert force.height_mm == pytest.approx(5.5), "from 4 to 7 mm"
    assert press.load.force_n[0] < 0


def test_the_files_length_is_the_truth_unless_emulation_says_otherwise() -> None:
    halves = [
        emulated_session(rig=rig_with(said, true), empty=True).bench.fingers[0].truth.half_length_mm
        for said, true in ((None, None), (12.0, None), (12.0, 8.0), (None, 12.0), (None, 90.0))
    ]
    assert halves == [0.0, 6.0, 4.0, 6.0, 10.0]


def test_walls_that_are_not_upright_are_found() -> None:
    rig = rig_with(None, None)
    found = overhangs_of(
        rig, [model_of(STEPPED, "stepped"), model_of(Stack((Block(FOOT_OUTLINE, (0, 30)),)), "box")]
    )
    assert [item.object_name for item in found] == ["stepped"]
    assert found[0].out_mm == pytest.approx(math.hypot(8, 12))
    assert overhangs_of(rig_with(12.0, None), [model_of(STEPPED)]) == ()
    receding = Stack((Block(FOOT_OUTLINE, (0.0, 12.0)), Block(shapely.box(-22, -14, 18, 8), (12.0, 30.0))))
    assert overhangs_of(rig, [model_of(receding)]) == (), "nothing stands out of the section at 10 mm"


def ended(length_mm: float | None, seed: int) -> tuple[Identification, bool]:
    """A run with tips that are 12 mm long in truth, and whether its answer holds the truth."""
    models = [model_of(STEPPED, "stepped"), model_of(OTHER_OUTLINE, "other")]
    placement = Placement(models[0], models[0].states[0], 4.0, -3.0, 0.7 + seed)
    session = emulated_session(seed=seed, rig=rig_with(length_mm, 12.0), placement=placement)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        result = identify(hand, Catalogue(models))
    assert not any(session.torque().values())
    left = result.recognition.hypotheses if result.recognition else ()
    return result, compare_answer(placement, left).inside_bounds


@pytest.mark.parametrize("seed", sample(range(6), [0]))
def test_a_stepped_part_is_identified_by_tips_whose_length_is_known(seed: int) -> None:
    result, inside = ended(12.0, seed)
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert inside


@pytest.mark.campaign
def test_without_the_length_the_truth_is_lost() -> None:
    _, inside = ended(None, 0)
    assert not inside
