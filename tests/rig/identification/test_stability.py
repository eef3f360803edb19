"""Stability: which states slide when they are pushed, and which may tip or roll; MuJoCo judges it."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from palpate.base.geometry import Polygon, Section, State
from palpate.base.vocabulary import PushResponse
from palpate.config import load_rig, shipped_rig
from palpate.recognizer import Catalogue, recognise
from palpate.rig.identification.grip_choice import StabilityTable
from palpate.rig.identification.pushing_mechanics import INERTIA_RESERVE, MAX_TABLE_FRICTION, stability_of
from support.benches.rigs import firm_rig
from support.oracles.pushed_stack import Block, drawn_pushes, drawn_stack, state_of, worst_lean_rad
from support.oracles.shapely_touches import SHIPPED_OBJECTS, Placed, flat, grip, outlines

RIG = load_rig(shipped_rig())
HEIGHT = 10.0


def box(a: float, b: float, x: float = 0.0) -> Polygon:
    return Polygon(
        np.array([[x - a / 2, -b / 2], [x + a / 2, -b / 2], [x + a / 2, b / 2], [x - a / 2, b / 2]])
    )


def disc(radius: float) -> Polygon:
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    return Polygon(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def stacked(outline: Callable[[float], Polygon], top: float, pitch: float, at: float = 0.5) -> State:
    """Sections of a round wall, each taken at a share `at` of its heights."""
    lows = np.arange(0.0, top - 1e-9, pitch)
    return State(
        "lying",
        tuple(Section((z, min(z + pitch, top)), (outline(z + at * pitch),)) for z in lows.tolist()),
    )


def half_chord(radius: float, z: float) -> float:
    return math.sqrt(max(radius**2 - (z - radius) ** 2, 0.01))


def prism(a: float, b: float, height: float) -> State:
    return State("flat", (Section((0.0, height), (box(a, b),)),))


@pytest.mark.parametrize("pitch", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("at", [0.3, 0.5, 1.0])
def test_a_lying_cylinder_and_a_ball_may_roll(pitch: float, at: float) -> None:
    for radius in (8.0, 15.0, 30.0):
        lying = stacked(lambda z, r=radius: box(2 * half_chord(r, z), 60.0), 2 * radius, pitch, at)
        ball = stacked(lambda z, r=radius: disc(half_chord(r, z)), 2 * radius, pitch, at)
        for state in (lying, ball):
            found = stability_of(state, 0.05, [(HEIGHT, HEIGHT)])
            assert found.response is PushResponse.MAY_ROLL, (radius, found)
            assert found.why.startswith("may roll: its base reaches only")
        along, across = stability_of(lying, 0.05, [(HEIGHT, HEIGHT)]).safe_heights_mm()[[90, 0]]
        assert across == 0.0
        assert along >= across


def test_a_tall_narrow_block_may_tip_and_a_wide_plate_slides() -> None:
    narrow = stability_of(prism(12.0, 60.0, 50.0), 0.1, [(HEIGHT, HEIGHT)])
    assert narrow.response is PushResponse.MAY_TIP
    assert narrow.margin_mm == pytest.approx(5.9)
    assert "5.9 mm" in narrow.why
    assert "friction is above 0.47" in narrow.why  # 5.9 / (1.25 · 10), rounded down
    for state in (prism(80.0, 60.0, 12.0), prism(25.0, 25.0, 60.0)):
        slides = stability_of(state, 0.1, [(HEIGHT, HEIGHT)])
        assert (slides.response, slides.why) == (PushResponse.SLIDES, "")
        assert np.isinf(slides.safe_heights_mm()).all()


def test_the_highest_finger_that_touches_decides() -> None:
    state = prism(40.0, 40.0, 30.0)
    assert stability_of(state, 0.0, [(10.0, 10.0), (15.0, 15.0)]).response is PushResponse.SLIDES
    assert stability_of(state, 0.0, [(10.0, 10.0), (28.0, 28.0)]).response is PushResponse.MAY_TIP
    assert stability_of(state, 0.0, [(10.0, 10.0), (35.0, 35.0)]).response is PushResponse.SLIDES
    assert stability_of(prism(4.0, 4.0, 5.0), 0.0, [(10.0, 10.0)]).response is PushResponse.SLIDES


def test_feet_fillets_and_flanges_are_not_round_parts() -> None:
    fillet = stacked(lambda z: box(60 + 2 * half_chord(2.0, z), 60 + 2 * half_chord(2.0, z)), 2.0, 0.25)
    body = Section((2.0, 20.0), (box(64.0, 64.0),))
    rounded = stability_of(State("f", (*fillet.sections, body)), 0.05, [(HEIGHT, HEIGHT)])
    assert rounded.response is PushResponse.SLIDES
    assert rounded.margin_mm == pytest.approx(30.0, abs=0.6)
    flange = State("b", (Section((0.0, 15.0), (box(60.0, 60.0),)), Section((15.0, 30.0), (box(99.0, 99.0),))))
    assert stability_of(flange, 0.0, [(HEIGHT, HEIGHT)]).margin_mm == pytest.approx(30.0)
    feet = State("t", (Section((0.0, 2.0), (box(6.0, 50.0, -25.0), box(6.0, 50.0, 25.0))), replace(body)))
    assert stability_of(feet, 0.0, [(HEIGHT, HEIGHT)]).response is PushResponse.SLIDES


def test_what_the_file_says_of_tipping_counts_too() -> None:
    """As an import writes a lying cylinder: nothing is known where its wall is nearly level."""
    known = replace(
        stacked(lambda z: box(2 * half_chord(12.0, z + 0.1), 50.0), 23.8, 0.2),
        height_mm=24.0,
        heights_mm=((0.1, 23.9),),
        tipping_angle_rad=0.05,
    )
    sections = tuple(Section((s.z_mm[0] + 0.1, s.z_mm[1] + 0.1), s.polygons) for s in known.sections)
    assert (
        stability_of(replace(known, sections=sections), 0.08, [(HEIGHT, HEIGHT)]).response
        is PushResponse.MAY_ROLL
    )
    block = prism(40.0, 40.0, 40.0)
    assert stability_of(block, 0.0, [(HEIGHT, HEIGHT)]).response is PushResponse.SLIDES
    tips = stability_of(replace(block, tipping_angle_rad=0.2), 0.0, [(HEIGHT, HEIGHT)])
    assert tips.margin_mm == pytest.approx(20 * math.tan(0.2))


def test_a_base_that_is_not_known_is_not_taken_for_a_good_one() -> None:
    middle = State("s", (Section((9.5, 10.5), (box(40.0, 40.0),)),), None, None, 40.0, ((9.5, 10.5),))
    found = stability_of(middle, 0.0, [(HEIGHT, HEIGHT)])
    assert (found.response, found.margin_mm) == (PushResponse.MAY_TIP, 0.0)
    assert "a lowest section at 9.5 mm" in found.why
    tilt = math.atan(20 / 20)  # as a cube of 40 mm has it
    assert stability_of(
        replace(middle, tipping_angle_rad=tilt), 0.0, [(HEIGHT, HEIGHT)]
    ).margin_mm == pytest.approx(10)
    assert (
        stability_of(replace(middle, tipping_angle_rad=1.5), 0.0, [(HEIGHT, HEIGHT)]).response
        is PushResponse.SLIDES
    )
    beside = State(
        "s", (Section((0.0, 5.0), (box(20.0, 20.0),)), Section((5.0, 50.0), (box(20.0, 20.0, 15.0),)))
    )
    assert stability_of(beside, 0.0, [(HEIGHT, HEIGHT)]).margin_mm == 0.0


POINTS = st.lists(st.tuples(st.floats(-40, 40), st.floats(-40, 40)), min_size=4, max_size=12)


@example(points=[(0.0, 0.0), (0.0, 0.0), (3.0, 1.0), (7.5, 21.0)], tolerance=0.0, height=2.0)
@given(points=POINTS, tolerance=st.floats(0, 0.5), height=st.floats(2, 60))
@settings(max_examples=60)
def test_a_prism_slides_as_far_as_its_hull_reaches(
    points: list[tuple[float, float]], tolerance: float, height: float
) -> None:
    hull = shapely.MultiPoint(points).convex_hull
    assume(hull.area > 20.0)
    outline = Polygon(shapely.get_coordinates(hull)[:-1])
    state = State("flat", (Section((0.0, 70.0), (outline,)),))
    found = stability_of(state, tolerance, [(height, height)])
    edge = shapely.distance(hull.boundary, hull.centroid)
    assert found.margin_mm == pytest.approx(max(edge - tolerance, 0.0), abs=1e-6)
    assert (found.response is PushResponse.SLIDES) == (found.margin_mm >= height)
    heights = found.safe_heights_mm()
    if found.response is PushResponse.SLIDES:
        return
    centre = np.array([hull.centroid.x, hull.centroid.y])
    around = hull.buffer(1e-6)
    for row in range(0, len(heights), 15):
        for lean in (-math.atan(0.7), 0.0, 0.3):
            angle = 2 * math.pi * row / len(heights) + lean
            shift = (
                heights[row]
                * MAX_TABLE_FRICTION
                * INERTIA_RESERVE
                * np.array([math.cos(angle), math.sin(angle)])
            )
            assert shapely.contains_xy(around, *(centre + shift))


def test_shipped_parts_slide_on_the_shipped_rig() -> None:
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    table = StabilityTable(RIG, catalogue)
    assert [table.of(k).response for k in range(6)] == [PushResponse.SLIDES] * 6
    assert min(table.of(k).margin_mm for k in range(6)) > 18.0


def test_states_that_are_left_are_named_the_heaviest_first_and_once() -> None:
    models = [
        flat("slab", [(0, 0), (60, 0), (60, 12), (0, 12)]),
        flat("plate", [(0, 0), (90, 0), (90, 70), (0, 70)]),
    ]
    catalogue = Catalogue(models)
    table = StabilityTable(RIG, catalogue)
    named = []
    for model in models:
        placed = Placed(model, -20.0, -9.0, 0.4)
        found = recognise(catalogue, grip(placed, np.random.default_rng(3), fingers=3))
        named.append([(item.object_name, item.response) for item in table.not_bounded(found, math.inf)])
    assert named[0][0] == ("slab", PushResponse.MAY_TIP)
    assert len(named[0]) == 1
    assert ("plate", PushResponse.MAY_TIP) not in named[1]
    assert table.not_bounded(None, math.inf) == ()


def test_a_part_that_is_pushed_more_lightly_than_it_takes_to_tip_it_is_not_named() -> None:
    """A slab 12 mm wide tips when what pushes at 10 mm is more than six tenths of its weight."""
    slab = replace(flat("slab", [(0, 0), (60, 0), (60, 12), (0, 12)]), holds_n=2.0)
    found = recognise(Catalogue([slab]), grip(Placed(slab, -20.0, -9.0, 0.4), np.random.default_rng(3)))
    table = StabilityTable(RIG, Catalogue([slab]))
    assert table.not_bounded(found, 1.1) == ()  # 2 N / 0.8 · 6 mm, with a quarter in reserve, is 12 N mm
    assert len(table.not_bounded(found, 1.3)) == 1
    undeclared = StabilityTable(load_rig(firm_rig()), Catalogue([replace(slab, holds_n=None)]))
    assert len(undeclared.not_bounded(found, 0.1)) == 1


def test_mujoco_does_not_tip_what_slides_and_tips_what_may() -> None:
    leans = []
    for number in range(40):
        rng = np.random.default_rng([77, number])
        blocks = drawn_stack(rng)
        height = float(rng.uniform(4, min(30.0, blocks[-1].z[1] - 1)))
        if stability_of(state_of(blocks), 0.0, [(height, height)]).response is not PushResponse.SLIDES:
            continue
        friction = float(rng.uniform(0.1, MAX_TABLE_FRICTION))
        leans.append(worst_lean_rad(blocks, 0.15, friction, drawn_pushes(rng, blocks, height)))
        if len(leans) == 8:
            break
    assert len(leans) == 8
    assert max(leans) < math.radians(0.5)
    pin = (Block((0.0, 0.0), (10.0, 40.0), (0.0, 50.0)),)
    push = [replace(drawn_pushes(rng, pin, 20.0)[0], axis=0, aside=0.0, friction=0.1)]
    assert stability_of(state_of(pin), 0.0, [(20.0, 20.0)]).response is PushResponse.MAY_TIP
    assert worst_lean_rad(pin, 0.15, 0.5, push) > math.radians(2.0)
