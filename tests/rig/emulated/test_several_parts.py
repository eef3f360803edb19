"""Several parts on one emulated table: scenes, what a tip between them feels, and truth."""

import json
import math
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.base.tips import TipShape
from palpate.config import RigFile, load_objects, load_rig, load_scene, shipped_objects
from palpate.config.emulation import EmulatedPartConfig
from palpate.config.writers import file_text
from palpate.drivers.emulators import (
    IN_PLACE,
    Displacements,
    Parts,
    PointForce,
    Skin,
    StillParts,
    separation_mm,
)
from palpate.rig.bench import choose_placements
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.driven_tips import noise_of
from palpate.rig.emulated.hidden_truth import draw_parts, parts_of
from palpate.rig.emulated.mujoco_bodies import convex_pieces
from palpate.rig.emulated.scene import Placement, displace, draw_placement
from palpate.rig.emulated.table import check_apart, draw_placements, outlines_beside, placements_of
from palpate.rig.fingers import resolution_of
from palpate.rig.reach.approaches import reach_of
from palpate.rig.study.pushing_touches import PushingTouches
from palpate.rig.study.simulated_touches import SimulatedTouches
from support.benches.rigs import firm_rig, quick_bench, small_objects
from support.benches.session import emulated_session, run_checked
from support.campaign.sampling import sample
from support.commands.command import Here

RIG = load_rig(firm_rig())
OBJECTS = load_objects(shipped_objects())


def block(x_mm: float, y_mm: float, theta_rad: float = 0.0, **sizes: Any) -> Placement:
    """A block with its middle at a place."""
    half = sizes.get("wide_mm", 40.0) / 2
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    state = State("flat", (Section(sizes.get("z_mm", (0.0, 20.0)), (Polygon(corners, ()),)),))
    return Placement(ObjectModel(sizes.get("name", "block"), (state,)), state, x_mm, y_mm, theta_rad)


# ----------------------------------------------------------------------------------------------------
# Scene files.

PART: dict[str, Any] = {"object": "plate", "configuration": {"x": 1.0, "y": -2.5, "theta": 0.3}}
ONE = {"format": "palpate/scene@1"} | PART
OTHER: dict[str, Any] = {"object": "tee", "configuration": {"x": 90.0, "y": 0.0, "theta": 0.0}}


def written(folder: Path, content: dict[str, Any]) -> Path:
    (folder / "scene.json").write_text(json.dumps(content), encoding="utf-8")
    return folder / "scene.json"


def several(*parts: dict[str, Any]) -> dict[str, Any]:
    return {"format": "palpate/scene@1", "parts": list(parts)}


def test_both_forms_of_a_scene_have_entries(tmp_path: Path) -> None:
    one = load_scene(written(tmp_path, ONE))
    two = load_scene(written(tmp_path, several(PART, OTHER | {"objects": "own.json"})))
    assert one.entries == two.entries[:1]
    assert [item.object for item in two.entries] == ["plate", "tee"]
    assert two.entries[1].objects == str(tmp_path / "own.json")
    assert json.loads(file_text(one)) == ONE
    (tmp_path / "again.json").write_text(file_text(two), encoding="utf-8")
    assert load_scene(tmp_path / "again.json") == two


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (ONE | {"parts": [OTHER]}, 'parts: is there beside "object"; give one object, or a list of parts'),
        ({"format": "palpate/scene@1"}, 'the key "object" is missing; or give several objects as "parts"'),
        (several(*[PART] * 9), "parts: has 9 values; it must have at most 8"),
        (several(), "parts: "),
        (several(PART, OTHER | {"state": 3}), "parts[1].state: is 3; it must be a text"),
        (several(PART, {"object": "tee"}), 'parts[1]: the key "configuration" is missing'),
    ],
)
def test_a_scene_has_exactly_one_form(tmp_path: Path, content: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scene(written(tmp_path, content))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_parts_that_overlap_are_refused_by_their_names(tmp_path: Path) -> None:
    names = [model.name for model in OBJECTS.objects[:2]]
    states = [model.states[0].name for model in OBJECTS.objects[:2]]
    at = {"configuration": {"x": 0.0, "y": 0.0, "theta": 0.0}}
    parts = [{"object": name, "state": state} | at for name, state in zip(names, states, strict=True)]
    scene = load_scene(written(tmp_path, several(*parts)))
    with pytest.raises(
        InputError, match=rf'parts\[0\] \("{names[0]}"\) and parts\[1\] \("{names[1]}"\) overlap'
    ):
        placements_of(scene, OBJECTS)


def test_parts_may_touch_and_reach_over_each_other() -> None:
    turned = 0.7
    beside = 40.0 * np.array([math.cos(turned), math.sin(turned)])
    check_apart([block(0.0, 0.0, turned), block(*beside, turned)])
    check_apart([block(0.0, 0.0), block(5.0, 5.0, z_mm=(20.0, 30.0))])
    with pytest.raises(InputError):
        check_apart([block(0.0, 0.0, turned), block(*(0.999 * beside), turned)])
    with pytest.raises(InputError):
        check_apart([block(0.0, 0.0), block(5.0, 5.0, z_mm=(19.0, 30.0))])


# ----------------------------------------------------------------------------------------------------
# What a tip feels.


def felt(*placements: Placement) -> tuple[Floats, Floats]:
    """Force on the first finger's tip, where it stands at the start, and what its taxels bear."""
    bench = emulate(RIG, placements, 3).bench
    finger, sampled = bench.fingers[0], []
    finger.array.sample = lambda _, force_n: sampled.append(force_n)  # type: ignore[method-assign]
    finger.touch(bench.parts.displacements)
    finger.sample(0.0)
    return np.zeros(2) if finger.press is None else finger.press.force_n, sampled[0]


def against_the_tip(bearing_deg: float, dent_mm: float) -> Placement:
    """A narrow block with a face that dents the tip from a bearing, counted from where its array looks."""
    finger = emulate(RIG, (), 3).bench.fingers[0]
    angle = finger.facing_rad + finger.truth.array_heading_rad + math.radians(bearing_deg)
    away = finger.truth.tip_radius_mm - dent_mm + 2.0
    x, y = finger.centre_mm + away * np.array([math.cos(angle), math.sin(angle)])
    return block(x, y, angle, wide_mm=4.0)


def test_a_tip_between_two_parts_feels_both() -> None:
    left, right = against_the_tip(45.0, 0.2), against_the_tip(-45.0, 0.3)
    check_apart([left, right])
    (left_n, left_taxels), (right_n, right_taxels) = felt(left), felt(right)
    assert np.hypot(*left_n) > 0.3
    both_n, both_taxels = felt(left, right)
    assert both_n == pytest.approx(left_n + right_n)
    assert both_taxels == pytest.approx(left_taxels + right_taxels)
    columns = np.flatnonzero(both_taxels.sum(axis=0))
    assert np.diff(columns).max() > 2, "two patches"


def test_a_tip_that_is_pinched_feels_its_skin_but_no_force() -> None:
    pinched_n, _ = felt(against_the_tip(90.0, 0.2), against_the_tip(-90.0, 0.2))
    assert np.hypot(*pinched_n) < 1e-3


@pytest.mark.parametrize(
    ("gap_mm", "share"), sample([(0.0, 1e-6), (0.2, 0.02), (0.5, 0.1)], [(0.0, 1e-6), (0.5, 0.1)])
)
def test_skin_across_a_joint_is_pressed_once(gap_mm: float, share: float) -> None:
    """Two walls in line push like one, and a rigid tip stops at the same place as beside two parts."""
    turned = 0.7
    along = np.array([math.cos(turned), math.sin(turned)])
    out = np.array([-along[1], along[0]])
    pair = [block(*(side * (20 + gap_mm / 2) * along), turned) for side in (-1, 1)]
    beside = 10.0, 0.0, 5.0, TipShape.CYLINDER
    joint, nothing = outlines_beside(pair, StillParts(2), *beside)
    (wall,) = outlines_beside([block(0.0, 0.0, turned, wide_mm=80.0)], StillParts(1), *beside)
    assert joint is not None
    assert nothing is None
    assert wall is not None
    skin, apart_in_motion = Skin(5.0, 3.0), in_motion(pair)
    for aside in (0.0, 0.1, 0.3, 1.0, 5.0):
        pressed = skin.press(joint, aside * along + 24.8 * out, IN_PLACE, None)
        alone = skin.press(wall, aside * along + 44.8 * out, IN_PLACE, None)
        assert pressed is not None
        assert alone is not None
        assert pressed.load.force_n @ out == pytest.approx(alone.load.force_n @ out, rel=share)
        centre = aside * along + 25.3 * out
        apart = [separation_mm(one, centre) for one in outlines_beside(pair, apart_in_motion, *beside) if one]
        assert separation_mm(joint, centre) == pytest.approx(min(apart), abs=1e-5)


def in_motion(placements: Sequence[Placement]) -> Parts:
    return parts_of(draw_parts(MOVING, placements, 1), placements)


# ----------------------------------------------------------------------------------------------------
# Grips without devices.


@pytest.mark.parametrize("slides", [False, True])
def test_simulated_grips_stop_at_the_first_of_several_parts(*, slides: bool) -> None:
    """Whatever each part alone lets a finger reach, the nearest stop of them is the one that is met."""
    turned = draw_placements(small_objects(), 3, 70.0, np.random.default_rng(5), 125.0)
    reach = reach_of(RIG)
    own = reach.of_finger(0)

    def ends(placements: Sequence[Placement]) -> list[tuple[bool, float]]:
        found = []
        for k in range(0, len(own), 3):
            approach, rng = reach.approaches[own[k]], np.random.default_rng(k)
            touches = SimulatedTouches(placements, resolution_of(RIG), rng)
            if slides:
                noise = [noise_of(RIG, finger) for finger in RIG.fingers]
                still = StillParts(len(placements))
                touches = PushingTouches(RIG, placements, still, 0.3, noise, rng)  # type: ignore[assignment]
            (touch,) = touches([approach])
            assert bool(touch.loads) == (slides and touch.contact.touched)
            found.append((touch.contact.touched, math.dist(touch.contact.end_mm, approach.start_mm)))
        return found

    together, alone = ends(turned), [ends([lies]) for lies in turned]
    for k, (touched, way) in enumerate(together):
        first = min(item[k][1] for item in alone)
        assert touched == any(item[k][0] for item in alone)
        assert way == pytest.approx(first, abs=0.3 if slides else 1e-9), "noise is drawn frame by frame"
    assert sum(touched for touched, _ in together) > 5


# ----------------------------------------------------------------------------------------------------
# Runs.


@pytest.mark.slow
@pytest.mark.parametrize("seed", sample([2, 3], [2]))
def test_touches_of_parts_that_touch_claim_what_is_true(seed: int) -> None:
    first, *others = draw_placements(
        small_objects(), 3, 45.0, np.random.default_rng(seed), 90.0, gap_mm=(0.0, 0.5)
    )
    session = emulated_session(seed=seed, placement=first, others=others)
    touches = run_checked(session, 4, seed)
    assert sum(touch.contact.touched for touch in touches) > 5


def test_a_run_beside_a_second_part_knows_the_truth_of_both(tmp_path: Path, here: Here) -> None:
    rig, _ = quick_bench(tmp_path)
    outlines = {"chip": [[0, 0], [34, 0], [34, 22], [0, 22]], "fin": [[0, 0], [30, 4], [10, 28]]}
    models = [{"name": name, "height": 20.0, "outline": ring} for name, ring in outlines.items()]
    parts = tmp_path / "parts.json"
    parts.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": models}))
    small = list(outlines)
    at = [{"x": -42.0, "y": -12.0, "theta": 0.3}, {"x": 18.0, "y": -14.0, "theta": 0.5}]
    entries = [{"object": name, "configuration": pose} for name, pose in zip(small, at, strict=True)]
    scene = written(tmp_path, several(*entries))
    done = here("identify", "--rig", rig, "--objects", parts, "--scene", scene, "--seed", 7, "--json")
    truth = done.json["truth"]
    others = truth["others"]
    assert {truth["object"], *(other["object"] for other in others)} == set(small)
    assert [other["configuration"] for other in others] == [at[small.index(others[0]["object"])]]
    again = here("replay", tmp_path / done.json["session"])
    assert (again.code, again.err) == (0, "")


# ----------------------------------------------------------------------------------------------------
# Tables that are drawn.


def shapes(lies: Placement) -> list[shapely.Geometry]:
    """Sections in W, made here from the corners."""
    c, s = math.cos(lies.theta_rad), math.sin(lies.theta_rad)
    turn, shift = np.array([[c, s], [-s, c]]), [lies.x_mm, lies.y_mm]
    return [
        shapely.union_all([shapely.Polygon(item.outer @ turn + shift) for item in section.polygons])
        for section in lies.state.sections
    ]


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    st.integers(2, 5), st.sampled_from([None, (0.0, 0.5), (0.0, 0.0), (11.0, math.inf)]), st.integers(0, 999)
)
def test_drawn_parts_lie_as_far_apart_as_asked_and_never_overlap(
    count: int, gap_mm: tuple[float, float] | None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    placements = draw_placements(small_objects(), count, 90.0, rng, 130.0, gap_mm)
    outlines = [shapely.union_all(shapes(lies)) for lies in placements]
    for one, other in combinations(outlines, 2):
        assert shapely.intersection(one, other).area < 0.05
        assert gap_mm is None or shapely.distance(one, other) >= gap_mm[0]
    if gap_mm is not None:
        for number in range(1, count):
            nearest = min(shapely.distance(outlines[number], other) for other in outlines[:number])
            assert nearest <= gap_mm[1] + 0.002
    assert all(np.hypot(*shapely.get_coordinates(item).T).max() <= 130.0 for item in outlines)
    assert all(np.hypot(*shapely.get_coordinates(item.centroid)[0]) <= 90.0 for item in outlines)


def test_one_drawn_part_lies_as_ever_and_too_many_are_refused() -> None:
    rngs = np.random.default_rng(4), np.random.default_rng(4)
    assert draw_placements(OBJECTS, 1, 20.0, rngs[0], 125.0) == (
        draw_placement(OBJECTS, 20.0, rngs[1], 125.0),
    )
    with pytest.raises(InputError, match="no room was found for 3 parts with their middles within 20 mm"):
        draw_placements(OBJECTS, 3, 20.0, rngs[0])


def test_a_rig_file_says_how_many_parts_its_table_holds() -> None:
    assert RIG.emulation is not None

    def counts(parts: object) -> list[int]:
        data = RIG.model_dump(mode="json", exclude_unset=True)
        data["emulation"] |= {"parts": parts, "placement_radius_mm": 80.0}
        rig = RigFile.model_validate(data)
        return [len(choose_placements(rig, small_objects(), None, seed)) for seed in range(12)]

    assert set(counts(2)) == {2}
    assert set(counts([1, 3])) == {1, 2, 3}
    for wrong in (0, 9, [2, 2], 1.5):
        with pytest.raises(ValidationError):
            counts(wrong)


# ----------------------------------------------------------------------------------------------------
# Parts that are pushed into each other.

MOVING = EmulatedPartConfig(engine="mujoco", mass_kg=0.15, friction=0.3)
SLIP_N = 0.15 * 0.3 * 9.80665


def pushed(placements: Sequence[Placement], force_n: Floats, seconds: float) -> tuple[Placement, ...]:
    """Where parts come to lie with a force on the first one's middle, at the height of the table."""
    parts = parts_of(draw_parts(MOVING, placements, 1), placements)
    at = np.array([placements[0].x_mm, placements[0].y_mm])

    def tips(displacements: Displacements) -> list[list[PointForce]]:
        found: list[list[PointForce]] = [[] for _ in placements]
        found[0].append(PointForce(displacements[0].place(at), 0.0, force_n))
        return found

    for _ in range(round(seconds * 1000)):
        parts.step(tips, True, 1e-3)
    return tuple(displace(lies, by) for lies, by in zip(placements, parts.displacements, strict=True))


def test_two_blocks_in_contact_slide_as_one_of_twice_the_mass() -> None:
    force_n, seconds = 1.2, 0.4
    one, other = pushed([block(0.0, 0.0), block(40.0, 0.0)], np.array([force_n, 0.0]), seconds)
    way_mm = 0.5 * (force_n - 2 * SLIP_N) / 0.3 * seconds**2 * 1000
    assert (one.x_mm, other.x_mm - 40.0) == pytest.approx((way_mm, way_mm), rel=0.05)


def test_a_block_that_is_pushed_slides_up_to_another_which_holds_it() -> None:
    """More than one bears, less than two do: it has picked up speed over 0.2 mm, which is soon gone."""
    one, other = pushed([block(0.0, 0.0), block(40.2, 0.0)], np.array([1.5 * SLIP_N, 0.0]), 0.3)
    assert 0.2 < one.x_mm < 0.6
    assert 0.0 < other.x_mm - 40.2 < 0.4
    alone = pushed([block(0.0, 0.0), block(40.2, 50.0)], np.array([1.5 * SLIP_N, 0.0]), 0.3)
    assert alone[0].x_mm > 10.0
    assert alone[1].configuration == block(40.2, 50.0).configuration


@settings(max_examples=3, deadline=None, derandomize=True, database=None)
@given(st.integers(0, 999))
def test_parts_that_are_pushed_together_turn_but_do_not_overlap(seed: int) -> None:
    placements = draw_placements(small_objects(), 3, 70.0, np.random.default_rng(seed), gap_mm=(0.0, 0.5))
    centres = [shapely.get_coordinates(shapes(lies)[0].centroid)[0] for lies in placements]
    towards = centres[1] - centres[0]
    moved = pushed(placements, 2.0 * towards / np.hypot(*towards), 0.25)
    assert moved[1].configuration != placements[1].configuration
    for one, other in combinations([shapely.union_all(shapes(lies)) for lies in moved], 2):
        assert shapely.intersection(one, other).buffer(-0.02).is_empty


def _push_on(parts: Parts, press: Callable[[Displacements, float], Sequence[Sequence[PointForce]]]) -> None:
    for depth in np.arange(2.5, 9.0, 0.1).tolist():
        parts.step(lambda at, depth=depth: press(at, depth), True, 1e-3)


def test_the_quasi_static_engine_moves_parts_until_one_is_pushed_into_another() -> None:
    two = [block(0.0, 0.0), block(43.0, 0.0)]
    config = EmulatedPartConfig(engine="quasi-static", mass_kg=0.15, friction=0.3)
    parts = parts_of(draw_parts(config, two, 1), two)

    def press(displacements: Displacements, depth_mm: float) -> Sequence[Sequence[PointForce]]:
        """A soft tip that stands in the first part's left wall."""
        force = 3.0 * max(depth_mm - displacements[0].shift_mm[0], 0.0)
        return [PointForce(np.array([-20.0, 0.0]), 10.0, np.array([force, 0.0]))], []

    for depth in np.arange(0.0, 2.5, 0.1).tolist():
        parts.step(lambda at, depth=depth: press(at, depth), True, 1e-3)
    assert parts.displacements[0].shift_mm[0] > 1.5
    assert parts.displacements[1].is_none
    with pytest.raises(InputError, match='"block" was pushed into "block"; let it be "mujoco"'):
        _push_on(parts, press)


@settings(max_examples=30, deadline=None, derandomize=True, database=None)
@given(st.integers(0, 999), st.sampled_from(load_objects(shipped_objects()).objects))
def test_convex_pieces_are_convex_and_make_up_the_shape(seed: int, model: ObjectModel) -> None:
    theta = float(np.random.default_rng(seed).uniform(-3, 3))
    (shape,) = shapes(Placement(model, model.states[0], 3.0, 4.0, theta))
    holed = shapely.difference(shape, shape.centroid.buffer(4.0))
    pieces = [shapely.Polygon(corners) for corners in convex_pieces(holed)]
    assert all(piece.convex_hull.area == pytest.approx(piece.area) for piece in pieces)
    assert shapely.symmetric_difference(shapely.union_all(pieces), holed).area < 0.1
    assert sum(piece.area for piece in pieces) == pytest.approx(holed.area, abs=0.1)
