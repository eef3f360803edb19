"""Objects that cannot be told apart, and the regions reached."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from shapely import affinity

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.tips import TipShape
from palpate.cad.planar_congruence import PlanarMotion, stack_distance_mm
from palpate.config import load_objects, load_rig
from palpate.rig.catalogue.finger_model import AtHeight, RigFingers, finger_heights_text, rig_fingers
from palpate.rig.catalogue.section_stack import StateSections, join_ranges, state_sections
from palpate.rig.catalogue.separating_heights import (
    MAX_SEPARATING_TRIED,
    SeparatingHeights,
    separating_heights,
)
from palpate.rig.catalogue.twins import (
    Likeness,
    ReachedRegion,
    StatePair,
    fill_unreached,
    find_twins,
    is_certainly_within,
    may_be_within,
    measure_regions,
    unreached_region,
)
from support.benches.parts import (
    BOUND_MM,
    L_SHAPE,
    fingers_at,
    mirrored,
    moved,
    polygon,
    rectangle,
    section,
    stacked_part,
    states_of,
)
from support.benches.rigs import firm_rig
from support.commands.repository import EXAMPLES, SHARED_OUTLINES, needs_shared_outlines

# ----------------------------------------------------------------------------------------------------
# What fingers cannot tell apart, and the heights that would: against cases known by hand and brute force.

LIMIT = 2 * BOUND_MM


@pytest.fixture
def states(tmp_path: Path) -> Any:
    return partial(states_of, tmp_path)


def compared(found: tuple[StateSections, ...], *heights: float) -> StatePair | None:
    """The only pair of two states, if it is listed at all."""
    pairs = find_twins(found, fingers_at(*heights))
    return pairs[0] if pairs else None


def told(pair: StatePair | None) -> SeparatingHeights:
    assert pair is not None
    return separating_heights(pair)


def test_parts_that_differ_low_down_feel_the_same_and_a_low_finger_would_tell(states: Any) -> None:
    foot, leg = rectangle(60, 20), rectangle(8, 20)
    found = states(
        stacked_part("a", section(0, 8, foot), section(8, 40, leg)),
        stacked_part("b", section(0, 5, moved(foot, 1.0, 7, -3)), section(5, 40, moved(leg, 1.0, 7, -3))),
    )
    pair = compared(found, 10)
    assert pair is not None
    assert pair.likeness is Likeness.SAME
    assert pair.apart_mm == pytest.approx(0.0, abs=1e-6)
    assert told(pair) == SeparatingHeights(((5.0, 8.0),), 3, 3, True)
    assert compared(found, 10, 6) is None
    both = compared(found, 10, 4)
    assert both is not None
    assert both.likeness is Likeness.SAME


def balls_at(*heights: float) -> RigFingers:
    """Fingers whose tips are balls of 5 mm."""
    return RigFingers(
        "balls", tuple(AtHeight(height, 5.0, ("f",), 5.0, TipShape.BALL) for height in heights), BOUND_MM
    )


def test_further_balls_are_suggested_at_heights_at_which_they_tell(states: Any) -> None:
    """One above the step tells; one beside it meets what stands out below, the same of both."""
    block, within = rectangle(60, 40), moved(rectangle(30, 20), 0.0, 15, 10)
    found = states(
        stacked_part("a", section(0, 60, block)),
        stacked_part("b", section(0, 25, block), section(25, 60, within)),
    )
    (pair,) = find_twins(found, balls_at(10))
    heights = told(pair).heights_mm
    assert heights
    for low, high in heights:
        assert low == high > 25
        assert find_twins(found, balls_at(10, low)) == ()
    assert len(find_twins(found, balls_at(10, 22))) == 1


def test_a_ball_is_not_sent_into_a_groove_that_only_a_disc_gets_into(states: Any) -> None:
    groove = section(27, 28, moved(rectangle(56, 36), 0.0, 2, 2))
    block = rectangle(60, 40)
    found = states(
        stacked_part("a", section(0, 40, block)),
        stacked_part("b", section(0, 27, block), groove, section(28, 40, block)),
    )
    assert told(compared(found, 10)).heights_mm == ((27.0, 28.0),)
    (pair,) = find_twins(found, balls_at(10))
    assert told(pair).heights_mm == ()


def test_a_rig_of_balls_and_upright_tips_gets_an_upright_one_more() -> None:
    mixed = RigFingers("mixed", (*balls_at(10).at, AtHeight(12, 6.0, ("g",), 3.0)), BOUND_MM)
    assert mixed.another(20.0) == AtHeight(20.0, 6.0, ("",), 3.0)
    assert balls_at(10, 20).another(30.0) == AtHeight(30.0, 5.0, ("",), 5.0, TipShape.BALL)


def test_mirror_images_are_told_apart_unless_they_are_images_by_a_turn_too(states: Any) -> None:
    isosceles = [[0.0, 0.0], [40.0, 0.0], [20.0, 60.0]]
    assert (
        compared(
            states(
                stacked_part("a", section(0, 20, L_SHAPE)),
                stacked_part("b", section(0, 20, mirrored(L_SHAPE))),
            ),
            10,
        )
        is None
    )
    same = compared(
        states(
            stacked_part("a", section(0, 20, isosceles)),
            stacked_part("b", section(0, 20, mirrored(isosceles))),
        ),
        10,
    )
    assert same is not None
    assert same.likeness is Likeness.SAME


@pytest.mark.parametrize(
    ("wider", "tolerances", "likeness"),
    [
        (0.0, (0.0, 0.0), Likeness.SAME),
        (0.3, (0.1, 0.21), Likeness.SAME),
        (0.3, (0.1, 0.19), Likeness.DOUBTFUL),
        (0.9 * LIMIT, (0.0, 0.0), Likeness.DOUBTFUL),
        (1.1 * LIMIT, (0.0, 0.0), None),
        (1.1 * LIMIT, (0.1, 0.1), Likeness.DOUBTFUL),
    ],
)
def test_tolerances_and_bounds_decide_how_alike_is_alike(
    states: Any, wider: float, tolerances: tuple[float, float], likeness: Likeness | None
) -> None:
    """A wider by 2 w is off by w all along both sides, whatever the motion."""
    a = stacked_part("a", section(0, 20, rectangle(60, 20)), tolerance=tolerances[0])
    b = stacked_part(
        "b", section(0, 20, moved(rectangle(60, 20 + 2 * wider), 2.0, -9, 4)), tolerance=tolerances[1]
    )
    pair = compared(states(a, b), 10)
    assert (None if pair is None else pair.likeness) is likeness
    if pair is not None:
        assert pair.apart_mm == pytest.approx(wider, abs=1e-4)
        assert pair.within_mm == pytest.approx(sum(tolerances) + LIMIT)


def test_holes_and_slots_that_no_tip_gets_into_are_not_felt(states: Any) -> None:
    block = stacked_part("block", section(0, 20, rectangle(70, 40)))

    def slotted(width: float) -> dict[str, Any]:
        slot = [[35 + width / 2, 40], [35 + width / 2, 15], [35 - width / 2, 15], [35 - width / 2, 40]]
        return stacked_part("slotted", section(0, 20, [[0, 0], [70, 0], [70, 40], *slot, [0, 40]]))

    bored = stacked_part(
        "bored", section(0, 20, rectangle(70, 40), holes=[moved(polygon(40, 12), 0, 35, 20)])
    )
    same = compared(states(block, bored), 10)
    assert same is not None
    assert same.likeness is Likeness.SAME
    assert told(same).heights_mm == ()
    narrow = compared(states(block, slotted(6)), 10)
    assert narrow is not None
    assert narrow.likeness is Likeness.DOUBTFUL
    # a tip of 5 mm dips 5 − √(5² − 3²) = 1 mm into the mouth; a shift by half of that leaves half of it
    assert narrow.apart_mm == pytest.approx(0.5, abs=0.01)
    slit = compared(states(block, slotted(0.03)), 10)
    assert slit is not None
    assert slit.apart_mm == pytest.approx(0.0, abs=1e-3)
    assert compared(states(block, slotted(11)), 10) is None


def test_what_lies_below_all_fingers_is_the_same_to_them(states: Any) -> None:
    found = states(
        stacked_part("a", section(0, 4, rectangle(30, 30))), stacked_part("b", section(0, 3, polygon(40, 20)))
    )
    pair = compared(found, 10)
    assert pair is not None
    assert (pair.likeness, pair.apart_mm) == (Likeness.SAME, None)
    assert told(pair).heights_mm == ((0.0, 4.0),)
    taller = states(
        stacked_part("a", section(0, 4, rectangle(30, 30))),
        stacked_part("b", section(0, 12, rectangle(30, 30))),
    )
    assert compared(taller, 10) is None
    low = compared(taller, 2)
    assert told(low).heights_mm == ((4.0, 12.0),)


def test_one_motion_has_to_fit_at_all_heights(states: Any) -> None:
    """Each section alone fits, but not both with one turn."""
    low, high = rectangle(60, 20, -30, -10), rectangle(40, 10, -20, -5)
    found = states(
        stacked_part("a", section(0, 10, low), section(10, 20, high)),
        stacked_part("b", section(0, 10, low), section(10, 20, moved(high, 0.4, 0, 0))),
    )
    for height in (5, 15):
        pair = compared(found, height)
        assert pair is not None
        assert pair.likeness is Likeness.SAME
        other = (10.0, 20.0) if height == 5 else (0.0, 10.0)
        assert told(pair).heights_mm == (other,)
    assert compared(found, 5, 15) is None


def test_symmetric_alternatives_are_not_forgotten(states: Any) -> None:
    """On a square or a disc the bar's direction tells nothing: another turn fits as well."""
    bar = rectangle(30, 8, -15, -4)
    for base, turn in ((rectangle(50, 50, -25, -25), math.pi / 2), (polygon(180, 30), 0.7)):
        found = states(
            stacked_part("a", section(0, 12, base), section(12, 20, bar)),
            stacked_part("b", section(0, 12, base), section(12, 20, moved(bar, turn, 0, 0))),
        )
        pair = compared(found, 5)
        assert pair is not None
        assert pair.likeness is Likeness.SAME
        assert told(pair).heights_mm == ()
    square = rectangle(50, 50, -25, -25)
    corner = moved(L_SHAPE, 0, -20, -20)
    found = states(
        stacked_part("a", section(0, 12, square), section(12, 20, corner)),
        stacked_part("b", section(0, 12, square), section(12, 20, mirrored(corner))),
    )
    assert told(compared(found, 5)).heights_mm == ((12.0, 20.0),)


def test_a_height_at_which_one_is_not_known_leaves_it_open(states: Any) -> None:
    bar = section(9, 11, rectangle(30, 20))
    known = {"heights": [[9, 11], [24, 26]], "height": 40.0}
    a = stacked_part("a", bar, section(24, 26, rectangle(10, 10)), **known)
    b = stacked_part("b", section(0, 40, rectangle(30, 20)))
    pair = compared(states(a, b), 10, 15)
    assert pair is not None
    assert (pair.likeness, [at.height_mm for at in pair.compared]) == (Likeness.UNKNOWN, [10])
    assert not told(pair).known
    assert told(pair).heights_mm == ((24.0, 26.0),)
    nowhere = compared(states(a, b), 15)
    assert nowhere is not None
    assert (nowhere.likeness, nowhere.apart_mm, nowhere.compared) == (Likeness.UNKNOWN, None, ())
    assert compared(states(a, b), 15, 25) is None  # what is known tells enough


def test_discs_of_chords_feel_the_same_at_any_turn(states: Any) -> None:
    """The chords' own tolerance is nothing: only the right turn brings corners onto corners."""
    found = states(
        stacked_part(
            "a",
            section(0, 12, polygon(180, 30)),
        ),
        stacked_part(
            "b",
            section(0, 12, polygon(180, 30, math.radians(1.0))),
        ),
    )
    pair = compared(found, 10)
    assert pair is not None
    assert pair.likeness is Likeness.SAME


def test_of_finely_cut_parts_some_ranges_are_tried_and_it_is_said(states: Any) -> None:
    def pyramid(name: str, top: float) -> dict[str, Any]:
        return stacked_part(name, *(section(k, k + 1, rectangle(60, 40 - top * k)) for k in range(100)))

    pair = compared(states(pyramid("a", 0.2), pyramid("b", 0.3)), 2)
    assert pair is not None
    found = told(pair)
    assert (found.tried, found.ranges) == (MAX_SEPARATING_TRIED, 100)
    # sides are 0.05 mm further apart with every mm: more than twice the bound from 21 mm on
    assert min(low for low, _ in found.heights_mm) == pytest.approx(21, abs=2)
    assert max(high for _, high in found.heights_mm) == 100


@settings(max_examples=60, derandomize=True)
@given(st.integers(0, 10**6), st.floats(0.01, 3.0))
def test_measures_never_rule_out_what_lies_near(seed: int, off: float) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 20)))
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(5, 40, (len(angle), 1))
    first = shapely.make_valid(shapely.Polygon(ring))
    push = rng.normal(size=ring.shape)
    push *= off * rng.uniform(0, 1, (len(ring), 1)) / np.hypot(*push.T)[:, None]
    second = affinity.rotate(shapely.make_valid(shapely.Polygon(ring + push)), rng.uniform(0, 360))
    sizes = measure_regions([first, affinity.translate(second, *rng.normal(0, 50, 2))])
    if first.is_valid and first.geom_type == second.geom_type == "Polygon":
        assert may_be_within(sizes[0], sizes[1], np.array(off))


def test_measures_tell_a_square_from_a_longer_one_and_from_nothing() -> None:
    shapes = [shapely.box(0, 0, 20, 20), shapely.box(0, 0, 20, 24), shapely.Polygon()]
    sizes = measure_regions(shapes)
    assert not may_be_within(sizes[0], sizes[1], np.array(0.5))
    assert may_be_within(sizes[0], sizes[1], np.array(4.0))
    assert not may_be_within(sizes[0], sizes[2], np.array(100.0))
    assert may_be_within(sizes[2], sizes[2], np.array(0.0))


@needs_shared_outlines
def test_pairs_that_are_told_apart_fit_in_no_way_that_brute_force_finds() -> None:
    found = state_sections(load_objects(SHARED_OUTLINES))[:50]
    fingers = fingers_at(10, bound=2.0)
    listed = {(pair.first.state.name, pair.second.state.name) for pair in find_twins(found, fingers)}
    regions = [fill_unreached(state.region_at(10), 5.0) for state in found]
    near = 0
    for i, first in enumerate(regions):
        for k in range(i + 1, len(regions)):
            if abs(first.area / regions[k].area - 1) < 0.1 and _brute_apart(first, regions[k]) < 4.0:
                near += 1
                assert (found[i].name, found[k].name) in listed
    assert near, "no pair tests anything"


def _brute_apart(first: shapely.Geometry, second: shapely.Geometry) -> float:
    """How far off the best of turns by 4° leaves two regions, centres of area together."""
    centred = [affinity.translate(item, -item.centroid.x, -item.centroid.y) for item in (first, second)]
    turned = [affinity.rotate(centred[0], angle, origin=(0, 0)) for angle in range(0, 360, 4)]
    return float(
        np.min(shapely.hausdorff_distance(shapely.boundary(turned), centred[1].boundary, densify=0.2))
    )


@pytest.mark.parametrize("seed", range(3))
def test_what_no_tip_reaches_agrees_with_a_flood_of_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(6, 40, (14, 1))
    hole = shapely.Point(0, 0).buffer(3)
    region = shapely.Polygon(ring).difference(hole)
    step, radius = 0.25, 5.0
    axis = np.arange(-60, 60, step)
    x, y = np.meshgrid(axis, axis)
    inside = shapely.contains_xy(region, x, y)
    free = ndimage.distance_transform_edt(~inside) * step >= radius
    label, _ = ndimage.label(free)
    centres = label == label[0, 0]
    covered = ndimage.distance_transform_edt(~centres) * step <= radius
    expected = ~inside & ~covered
    found = shapely.contains_xy(unreached_region(region, radius), x, y)
    assert expected.sum() * step**2 > 5
    differs = ndimage.binary_erosion(expected ^ found, iterations=3)
    assert not differs.any()


def test_convex_regions_are_reached_all_over() -> None:
    assert unreached_region(shapely.box(0, 0, 30, 10), 5.0).is_empty
    assert unreached_region(shapely.Polygon(), 5.0).is_empty
    assert unreached_region(shapely.Polygon(L_SHAPE), 5.0).area == pytest.approx(
        (1 - math.pi / 4) * 25, rel=0.01
    )


def test_levels_join_what_is_the_same_and_say_what_meets(states: Any) -> None:
    box = rectangle(30, 20)
    (state,) = states(
        stacked_part(
            "a", section(5, 8, box), section(0, 5, box[1:] + box[:1]), section(8, 9, rectangle(10, 10, 40))
        )
    )
    assert [level.z_mm for level in state.levels] == [(0, 8), (8, 9)]
    assert state.steps_mm == (0, 8, 9)
    assert state.region_at(4).area == pytest.approx(600)
    assert state.region_at(8).area == pytest.approx(700)
    assert state.region_at(9.5).is_empty
    assert join_ranges([(3, 4), (0, 1), (1, 2)]) == ((0, 2), (3, 4))


def test_the_shipped_rig_has_one_height_and_a_bound_for_its_contacts() -> None:
    fingers = rig_fingers(load_rig(firm_rig()))
    assert finger_heights_text(fingers.at) == "10 mm (f1, f2, f3)"
    assert finger_heights_text(fingers_at(5, 8).at) == "5 mm (f1) and 8 mm (f2)"
    assert fingers.slimmest_mm == 5
    assert 0.5 < fingers.bound_mm < 2.0


def test_a_rig_whose_fingers_do_not_get_to_the_middle_has_no_bound() -> None:
    rig = load_rig(EXAMPLES / "two-link-rig.toml")
    assert rig_fingers(rig).bound_mm > 0
    far = [finger.model_copy(update={"base_mm": (2000.0, 0.0)}) for finger in rig.fingers]
    with pytest.raises(InputError, match="no finger gets to the middle"):
        rig_fingers(rig.model_copy(update={"fingers": tuple(far)}))


# ----------------------------------------------------------------------------------------------------
# The cheap proof that two outlines are near agrees with their exact distance, and is nearly always had.

HOLE = np.array(polygon(8, 5.0))


def star(rng: np.random.Generator) -> Floats:
    """Forty corners, about 20 mm from the origin."""
    angles = np.arange(40) * 2 * math.pi / 40
    ring: Floats = np.column_stack([np.cos(angles), np.sin(angles)])
    return ring * (20 + rng.uniform(-2, 2, (40, 1)))


@pytest.mark.parametrize("seed", range(40))
def test_what_is_sure_is_so(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ring = star(rng)
    turn, shift = rng.uniform(-math.pi, math.pi), rng.uniform(-30, 30, 2)
    c, s = math.cos(turn), math.sin(turn)
    there = [
        (points + rng.uniform(-0.8, 0.8, points.shape)) @ np.array([[c, s], [-s, c]]) + shift
        for points in (ring, HOLE)
    ]
    first, second = shapely.Polygon(ring, [HOLE]), shapely.Polygon(there[0], there[1:])
    exact = stack_distance_mm([first], [second], turn, shift)
    one, other, motion = ReachedRegion(first), ReachedRegion(second), PlanarMotion(turn, shift, 0.0)
    assert not is_certainly_within(one, other, motion, 0.995 * exact)
    assert is_certainly_within(one, other, motion, 1.05 * exact), "arcs are no coarser than that"


def test_a_hole_and_a_peak_are_seen_from_both_sides() -> None:
    plain = shapely.Polygon(rectangle(40, 30))
    holed = shapely.Polygon(rectangle(40, 30), [rectangle(4, 4, 18, 13)])
    still = PlanarMotion(0.0, np.zeros(2), 0.0)
    for first, second in ((plain, holed), (holed, plain)):
        assert not is_certainly_within(ReachedRegion(first), ReachedRegion(second), still, 2.0)
    assert is_certainly_within(ReachedRegion(plain), ReachedRegion(plain), still, 1e-3)


def test_nothing_is_near_nothing_else() -> None:
    still = PlanarMotion(0.0, np.zeros(2), 0.0)
    empty, square = ReachedRegion(shapely.Polygon()), ReachedRegion(shapely.Polygon(rectangle(4, 4)))
    assert not is_certainly_within(empty, square, still, 10.0)
    assert not is_certainly_within(square, empty, still, 10.0)
