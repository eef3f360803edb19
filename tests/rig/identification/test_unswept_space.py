"""Sweeping an untouched table: the part is found wherever it lies, or proven not to be there."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from firm_rig import firm_rig
from hypothesis import given
from hypothesis import strategies as st
from repository import EXAMPLES
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, outlines
from simulated_touches import SimulatedTouches

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile, load_rig
from palpate.recognizer import Catalogue, Contact, Finger
from palpate.rig.identification.exploration import (
    InscribedDisc,
    inscribed_discs,
    is_swept,
    sweeping_grip,
    unswept_places,
)
from palpate.rig.identification.loop import Identification, search
from palpate.rig.reach.approaches import reach_of

RIG = load_rig(firm_rig())
REACH = reach_of(RIG)
ARMS = load_rig(EXAMPLES / "two-link-rig.toml")
SIX = outlines(SHIPPED_OBJECTS)
TIP = Finger(5.0, 10.0)
LOW, HIGH = (10.0, 10.0), (20.0, 20.0)
"""Heights from which to which the tips of two fingers reach."""
RADIUS_MM = RIG.workspace.radius_mm
NOWHERE = Placed(SIX[0], 900.0, 900.0, 0.0)


def searched(
    placed: Placed, models: Sequence[ObjectModel], seed: int = 0, rig: RigFile = RIG
) -> Identification:
    reach = REACH if rig is RIG else reach_of(rig)
    touches = SimulatedTouches(reach, placed, np.random.default_rng([seed, 5]))
    return search(rig, reach, touches, Catalogue(models), seed=seed)


def miss(start: tuple[float, float], end: tuple[float, float], bound: float = 0.3) -> Contact:
    return Contact("f1", TIP, False, start, end, bound)


@pytest.mark.parametrize("rig", [RIG, ARMS], ids=["shipped", "arms"])
def test_an_empty_table_is_swept_within_the_grips_of_the_rig(rig: RigFile) -> None:
    result = searched(NOWHERE, SIX, rig=rig)
    assert result.outcome is IdentificationVerdict.UNRESOLVED
    assert result.swept
    assert len(result.grips) < rig.search.max_grips
    assert not any(touch.contact.touched for grip in result.grips for touch in grip)


def test_small_parts_cannot_be_ruled_out_in_a_few_grips() -> None:
    pin = flat("pin", [(0, 0), (3, 0), (3, 3), (0, 3)])
    result = searched(NOWHERE, [*SIX, pin])
    assert not result.swept
    assert len(result.grips) == RIG.search.max_grips


@pytest.mark.parametrize("seeds", sample([16, 40], [16]))
def test_a_part_near_the_rim_is_found_and_never_ruled_out(seeds: int) -> None:
    """Parts of half the size, anywhere near the rim: where the first grip, at the middle, misses them."""
    small = [flat(item.name, item.states[0].sections[0].polygons[0].outer / 2) for item in SIX]
    found = missed_at_first = 0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 77])
        model = small[int(rng.integers(len(small)))]
        placed = Placed(model, 0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))
        circle = shapely.minimum_bounding_circle(placed.shape)
        room = RADIUS_MM - shapely.minimum_bounding_radius(placed.shape)
        away, bearing = room * math.sqrt(rng.uniform(0.5, 1)), rng.uniform(0, 2 * math.pi)
        x, y = away * math.cos(bearing) - circle.centroid.x, away * math.sin(bearing) - circle.centroid.y
        result = searched(Placed(model, float(x), float(y), placed.theta), small, seed)
        missed_at_first += not any(touch.contact.touched for touch in result.grips[0])
        assert not result.swept, seed
        found += result.recognition is not None
    assert missed_at_first >= 0.25 * seeds
    assert found == seeds


@given(
    st.lists(st.tuples(*[st.integers(-140, 140)] * 4), max_size=12),
    st.floats(3.0, 30.0),
    st.tuples(st.floats(0, 1), st.floats(0, 2 * math.pi)),
)
def test_a_disc_that_no_tip_has_met_keeps_its_place(
    ways: list[tuple[int, int, int, int]], radius: float, at: tuple[float, float]
) -> None:
    """Brute force: a disc in the workspace that misses every swept tip has its centre in what is left."""
    away = (RADIUS_MM - radius) * at[0]
    centre = shapely.Point(away * math.cos(at[1]), away * math.sin(at[1]))
    misses = [miss(way[:2], way[2:]) for way in ways]
    gaps = [centre.distance(shapely.LineString([item.start_mm, item.end_mm])) for item in misses]
    (left,) = unswept_places(misses, {LOW: InscribedDisc(radius, frozenset({0}))}, RADIUS_MM).values()
    if all(gap >= 5.0 + radius for gap in gaps):
        assert left.distance(centre) < 1e-9
    if any(gap < (4.7 + radius) * 0.999 for gap in gaps):
        assert left.distance(centre) > 0


def test_discs_fit_inside_their_sections() -> None:
    notched = [(0, 0), (40, 0), (40, 10), (10, 10), (10, 30), (0, 30)]
    tolerant = ObjectModel("tolerant", flat("", notched).states, 1.0)
    (disc,) = inscribed_discs(
        Catalogue([flat("square", [(0, 0), (40, 0), (40, 40), (0, 40)])]), {TIP}
    ).values()
    assert 19.8 <= disc.radius_mm <= 20.0
    (disc,) = inscribed_discs(Catalogue([tolerant]), {TIP}).values()
    largest = 20 - 10 * math.sqrt(2)  # touches both outer sides and the inner corner
    assert largest - 1.2 <= disc.radius_mm <= largest - 1.0
    assert inscribed_discs(Catalogue([tolerant]), {Finger(5.0, 25.0)}) == {}, "nothing is there"


def test_a_part_thinner_than_its_tolerance_is_not_ruled_out() -> None:
    sheet = ObjectModel("sheet", flat("", [(0, 0), (60, 0), (60, 1), (0, 1)]).states, 0.8)
    (disc,) = inscribed_discs(Catalogue([sheet, *SIX]), {TIP}).values()
    assert disc.states == frozenset(range(7))
    assert disc.radius_mm < 0
    result = searched(NOWHERE, [sheet, *SIX])
    assert not result.swept
    assert len(result.grips) == RIG.search.max_grips


def test_states_at_other_heights_need_fingers_there() -> None:
    """Two fingers' heights: a state counts as ruled out once it is at one of them."""
    square = (Polygon(np.array([(0.0, 0.0), (60.0, 0.0), (60.0, 60.0), (0.0, 60.0)])),)
    low = ObjectModel("low", (State("s", (Section((0.0, 15.0), square),)),))
    high = ObjectModel("high", (State("s", (Section((15.5, 30.0), square),)),))
    discs = inscribed_discs(Catalogue([low, high]), {Finger(5.0, height) for height in (10.0, 20.0, 50.0)})
    assert {height: disc.states for height, disc in discs.items()} == {LOW: {0}, HIGH: {1}}
    nothing, room = shapely.Polygon(), shapely.Point(0, 0).buffer(50)
    assert not is_swept({LOW: nothing, HIGH: room}, discs)
    assert is_swept({LOW: nothing, HIGH: nothing}, discs)
    assert not is_swept({}, {}), "nothing can be felt, so nothing is proven"


def test_fingers_that_would_free_nothing_stay() -> None:
    discs = {LOW: InscribedDisc(10.0, frozenset({0}))}
    left = {LOW: shapely.Point(0, 60).buffer(5)}
    grip = sweeping_grip(REACH, [], left, discs)
    assert len(grip) == 1, "one way is enough"
    assert sweeping_grip(REACH, [], {LOW: shapely.Polygon()}, discs) == []
