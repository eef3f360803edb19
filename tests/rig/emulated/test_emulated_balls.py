"""Emulated balls: what stops them, and whole runs of rigs with balls."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from ball_tips import first_touch_of_ball, triangles_of
from emulated_session import emulated_session
from quick_rig import small_objects, small_rig
from sampling import sample
from upright_tips import Block, Stack, drawn_stack, model_of

from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, TipShape
from palpate.config import RigFile, load_contacts
from palpate.drivers.emulators.part import IN_PLACE
from palpate.drivers.emulators.skin import Skin
from palpate.drivers.emulators.tip import separation_mm
from palpate.recognizer import Catalogue, Finger
from palpate.rig.bench import connect
from palpate.rig.catalogue.finger_model import contact_bound_mm
from palpate.rig.catalogue.reachability import finding_lines
from palpate.rig.conversion import finger_of, grips_of
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, outline_at
from palpate.rig.identification.loop import identify
from palpate.rig.study.simulation import with_motion

BODY = shapely.box(-29, -14, 18, 12)
FOOT = Stack((Block(shapely.box(-26, -18, 26, 18), (0.0, 6.0)), Block(BODY, (6.0, 30.0))))
"""Its foot stands out on three sides, and its body on one by more than the ball's circles differ."""
OTHER = Stack((Block(shapely.box(-26, -22, 26, 22), (0.0, 6.0)), Block(BODY, (6.0, 30.0))))
LOW = Stack((Block(shapely.Polygon([(-25, -16), (24, -12), (2, 22)]), (0.0, 8.0)),))


def ball_rig(radius_mm: float = 5.0, latitude_deg: float | None = None) -> RigFile:
    """The small rig with balls."""
    data = small_rig().model_dump(exclude_unset=True)
    for finger in data["fingers"]:
        finger["tip"] |= {"shape": "ball", "radius_mm": radius_mm, "max_latitude_deg": latitude_deg}
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(30), range(6)))
def test_an_emulated_ball_stops_where_the_solid_does(seed: int) -> None:
    rng = np.random.default_rng([85, seed])
    stack = drawn_stack(rng, leaning=False)
    radius = float(rng.choice([3.0, 6.0]))
    height = float(rng.uniform(radius, stack.top_mm + 0.5 * radius))
    model = model_of(stack)
    found = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), height, 0.0, radius)
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
    outline = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), 11.0, 0.0, 5.0)
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


@pytest.mark.parametrize("seed", sample(range(6), range(2)))
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
        ({"radius_mm": 12.0}, r"is 12, more than height_mm \(10\)"),
        ({"radius_bound_mm": 0.7}, "at most a tenth of radius_mm"),
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
    for change, message in ({"tip_length": 4.0}, "a radius only"), ({"tip_radius": 11.0}, "more than height"):
        path.write_text(_contacts(touch | change), encoding="utf-8")
        with pytest.raises(InputError, match=message):
            load_contacts(path)
    path.write_text(_contacts(touch), encoding="utf-8")
    ((contact,),) = grips_of(load_contacts(path))
    assert contact.finger == Finger(5.0, 10.0, shape=TipShape.BALL)


def _contacts(touch: dict[str, object]) -> str:
    return json.dumps({"format": "palpate/contacts@1", "units": "mm, rad", "grips": [{"contacts": [touch]}]})
