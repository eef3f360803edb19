"""Several parts on one table: how touches are divided among them, and whole runs on the emulated bench."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from jsonschema import Draft202012Validator

import palpate
from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.schema import schema_text
from palpate.jobs.recognition import contact_record
from palpate.jobs.session import open_session
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.emulated.scene import Placement
from palpate.rig.emulated.table import draw_placements
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.divisions import Division, GripDivider, PartSearch, TakenGrip, as_free_way
from palpate.rig.identification.identify import begin_search
from palpate.rig.identification.occupied_room import Core
from palpate.rig.identification.outcome import Identification
from palpate.rig.identification.part_count import PartCount
from palpate.rig.identification.several_parts import SeveralSearch
from palpate.rig.motion.load_meter import LoadTrace
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from palpate.rig.study.simulated_touches import SimulatedTouches
from palpate.views.sessions_text import replay_lines, replay_out
from support.benches.rigs import firm_rig
from support.campaign.sampling import sample
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    grip,
    holding_truth,
    outlines,
    stop,
)

RIG = load_rig(firm_rig())
OBJECTS = load_objects(shipped_objects())
CATALOGUE = Catalogue(OBJECTS.objects)
REACH = reach_of(RIG)


# ----------------------------------------------------------------------------------------------------
# How many.


@pytest.mark.parametrize(
    ("text", "most", "exactly"), [("2", 2, True), ("up-to-3", 3, False), (8, 8, True), ("up-to-1", 1, False)]
)
def test_a_count_is_exact_or_a_limit(text: str | int, most: int, exactly: bool) -> None:
    count = PartCount.parse(text)
    assert (count.most, count.exactly) == (most, exactly)
    assert PartCount.parse(str(count)) == count


@pytest.mark.parametrize("text", ["0", "9", "up-to-", "up to 2", "-1", "2.0", "", "many", "²"])
def test_other_counts_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="allowed: a number from 1 to 8, or up-to-"):
        PartCount.parse(text)


# ----------------------------------------------------------------------------------------------------
# Divisions.


def searching() -> PartSearch:
    return PartSearch(begin_search(RIG, REACH, CATALOGUE), frozenset())


@pytest.mark.parametrize("seed", range(3))
def test_the_true_division_and_the_true_places_are_never_lost(seed: int) -> None:
    """By contacts that shapely works out, each as far off as its bounds allow."""
    rng = np.random.default_rng([seed, 51])
    models = outlines(SHIPPED_OBJECTS)
    parts = [Placed(models[seed], -25.0, 52.0, 0.4 + seed), Placed(models[5 - seed], 20.0, -55.0, 2.0 - seed)]
    every = shapely.union_all([item.shape for item in parts])
    assert shapely.disjoint(*(item.shape for item in parts))
    divisions, untouched = [Division(())], searching()
    owned: list[set[tuple[int, int]]] = [set(), set()]
    for number in range(1, 7):
        met = grip(_Both(every), rng, half_range=math.radians(10), at_bound=True, aim=0.7)  # type: ignore[arg-type]
        touches = [Touch(k, item, None, (math.nan, math.nan)) for k, item in enumerate(met)]
        for k, item in enumerate(met):
            if item.touched:
                owned[_owner(item.start_mm, item.end_mm, parts)].add((number, k))
        divisions, untouched = GripDivider(TakenGrip((), touches, untouched.search.bounds)).divide(
            divisions, untouched, PartCount(2)
        )
        true = [
            item
            for item in divisions
            if {p.touched for p in item.parts} == {frozenset(o) for o in owned if o}
        ]
        assert len(true) == 1
        for part in true[0].parts:
            (placed,) = [item for item, own in zip(parts, owned, strict=True) if own == part.touched]
            assert part.recognition is None or holding_truth(part.recognition, placed) is not None


def test_two_touches_further_apart_than_any_part_is_wide_are_of_two_parts() -> None:
    lying = (_placed("tr-1", -75.0, 0.0), _placed("tr-1", 75.0, 0.0))
    simulated = SimulatedTouches(lying, resolution_of(RIG), np.random.default_rng(2))
    every = [touch for item in REACH.approaches[::5] for touch in simulated([item]) if touch.contact.touched]
    left = min(every, key=lambda touch: touch.contact.end_mm[0])
    right = max(every, key=lambda touch: touch.contact.end_mm[0])
    assert math.dist(left.contact.end_mm, right.contact.end_mm) > 190.0
    nothing = searching()
    grip = TakenGrip((), [left, right], nothing.search.bounds)
    divisions, _ = GripDivider(grip).divide([Division(())], nothing, PartCount(2))
    assert [{part.touched for part in item.parts} for item in divisions] == [
        {frozenset({(1, 0)}), frozenset({(1, 1)})}
    ]


class _Both:
    """What `grip` asks of a placed object, for two."""

    def __init__(self, shape: shapely.Geometry) -> None:
        self.shape = shape


def _owner(start: tuple[float, float], end: tuple[float, float], parts: list[Placed]) -> int:
    """The part that stops a tip: contacts are off by 0.3 mm, parts are further apart."""
    away = [shapely.distance(item.shape, shapely.Point(end)) for item in parts]
    assert abs(away[0] - away[1]) > 1.0
    return int(np.argmin(away))


def test_a_touch_of_another_part_is_a_free_way() -> None:
    simulated = SimulatedTouches([_placed("tr-1", 0.0, 0.0)], resolution_of(RIG), np.random.default_rng(1))
    (touch,) = simulated([REACH.approaches[20]])
    seen = as_free_way(touch, None)
    assert touch.contact.touched
    assert not seen.contact.touched
    assert (seen.contact.start_mm, seen.contact.end_mm) == (touch.contact.start_mm, touch.contact.end_mm)
    assert seen.contact.free_path_bound_mm == touch.contact.free_path_bound_mm


def _placed(name: str, x: float, y: float, theta: float = 0.3) -> Placement:
    (model,) = [item for item in OBJECTS.objects if item.name == name]
    return Placement(model, model.states[0], x, y, theta)


# ----------------------------------------------------------------------------------------------------
# Searches with simulated touches.


def found(placements: tuple[Placement, ...], count: PartCount, seed: int) -> Identification:
    """What a search for several parts comes to; no touch may come to a part that was to be kept away from."""
    search = SeveralSearch(begin_search(RIG, REACH, CATALOGUE), count)
    touches = SimulatedTouches(placements, resolution_of(RIG), np.random.default_rng(seed))
    verdict, limit = None, None
    while verdict is None and limit is None:
        verdict, approaches = search.next()
        if verdict is None:
            for item in approaches:  # quick only where nothing is
                shapes = [lies.region_within(item.finger.span_mm) for lies in placements]
                heading = item.direction_rad
                first = min(stop(s, np.array(item.start_mm), heading, 5.0, 300.0) for s in shapes)
                assert item.fast_mm <= first
            search.take(approaches, tuple(touches(approaches)))
            limit = search.limit(0.0)
    return search.conclude(verdict, limit)


@pytest.mark.parametrize("seed", sample(range(4), [0]))
def test_two_parts_are_found_and_none_is_outside_its_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    placements = draw_placements(OBJECTS, 2, 125.0, rng, 125.0, (0.0, 40.0))
    result = found(placements, PartCount(2), seed)
    assert result.outcome in (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)
    assert result.table is not None
    assert result.table.is_complete
    assert all(result.table.agreed)
    left = list(placements)
    for part in result.table.parts:
        assert part.recognition is not None
        inside = [lies for lies in left if _is_inside(part, lies)]
        assert inside
        left.remove(inside[0])
    assert not left
    cores = [Core(part.recognition.hypotheses[0]) for part in result.table.parts if part.recognition]
    assert not cores[0].overlaps(cores[1])


def _is_inside(part: Identification, lies: Placement) -> bool:
    assert part.recognition is not None
    placed = Placed(lies.model, lies.x_mm, lies.y_mm, lies.theta_rad)
    return holding_truth(part.recognition, placed) is not None


def test_what_is_left_of_the_table_has_room_for_no_more() -> None:
    """One part, where up to two may be: the rest is swept until nothing of the catalogue fits into it."""
    lies = _placed("tr-3", 5.0, 10.0)
    result = found((lies,), PartCount(2, exactly=False), 3)
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert result.table is not None
    assert len(result.table.parts) == 1
    assert result.table.is_complete
    narrowest = min(
        float(shapely.length(shapely.maximum_inscribed_circle(shape, 0.01)))
        for shape in (Placement(m, m.states[0], 0, 0, 0).region_within((5.0, 15.0)) for m in OBJECTS.objects)
    )
    assert result.table.rest_mm < narrowest + RIG.fingers[0].tip.radius_mm


def test_a_part_of_no_catalogue_is_not_named() -> None:
    only = Catalogue([item for item in OBJECTS.objects if item.name != "hand"])
    search = SeveralSearch(begin_search(RIG, REACH, only), PartCount(2))
    lying = (_placed("hand", -10.0, 58.0), _placed("tr-1", 5.0, -60.0))
    touches = SimulatedTouches(lying, resolution_of(RIG), np.random.default_rng(5))
    verdict, limit = None, None
    while verdict is None and limit is None:
        verdict, approaches = search.next()
        if verdict is None:
            search.take(approaches, tuple(touches(approaches)))
            limit = search.limit(0.0)
    assert search.conclude(verdict, limit).outcome in (
        IdentificationVerdict.UNKNOWN,
        IdentificationVerdict.UNRESOLVED,
    )


# ----------------------------------------------------------------------------------------------------
# Parts that slide.

SLIDING = load_rig(shipped_rig())
ON_SLIDING = reach_of(SLIDING)


def press(force_n: float, work_mj: float) -> LoadTrace:
    """A finger that presses with a constant force while it is measured, and did so much work before."""
    time_s = np.arange(0.0, 3.0, 1 / SLIDING.closing.sample_rate_hz)
    pressed = (time_s >= 1.0) & (time_s < 1.1)
    advance_mm = np.where(pressed, work_mj / max(force_n, 1e-9) / pressed.sum(), 0.0)
    none = np.zeros(len(time_s))
    return LoadTrace(
        time_s,
        1 / SLIDING.closing.sample_rate_hz,
        np.where(pressed, force_n, 0.0),
        np.cumsum(advance_mm),
        advance_mm,
        *(none, none, none, none, none),
        1.1,
        math.inf,
        *(none, none),
        ~pressed,
    )


def lightly(placements: Sequence[Placement], grip: Sequence[FingerApproach], seed: int) -> list[Touch]:
    """Touches that press nothing."""
    made = SimulatedTouches(placements, resolution_of(SLIDING), np.random.default_rng(seed))(grip)
    return [replace(touch, trace=press(0.0, 0.0)) for touch in made]


def test_a_part_that_another_was_pushed_into_is_not_lost() -> None:
    """By 1.5 mm, which its own touches cannot have done."""
    rng = np.random.default_rng(4)
    lying = draw_placements(OBJECTS, 2, 125.0, rng, 125.0, (0.1, 0.5))
    search = SeveralSearch(begin_search(SLIDING, ON_SLIDING, CATALOGUE), PartCount(2))
    verdict = None
    while verdict is None:
        verdict, grip = search.next()
        if verdict is None:
            search.take(grip, tuple(lightly(lying, grip, len(search.made_grips))))
    assert len(search.divisions) == 1
    gap = shapely.shortest_line(*(item.region_within((0.0, 20.0)) for item in lying))
    way = np.diff(shapely.get_coordinates(gap), axis=0)[0]
    ahead = way / np.hypot(*way)
    moved = [_shift(lying[0], 1.5 * ahead + way), _shift(lying[1], 1.5 * ahead)]
    pushing, beside = _grip_on(moved, -ahead), _grip_on(moved[::-1], ahead)
    assert pushing.finger_index != beside.finger_index
    grip = (pushing, beside)
    pressed, light = lightly(moved, grip, 99)
    search.take(grip, (replace(pressed, trace=press(2.0, 0.3)), light))
    number = len(search.made_grips)
    for k, lies in enumerate(moved):
        (part,) = [item for item in search.divisions[0].parts if (number, k) in item.touched]
        placed = Placed(lies.model, lies.x_mm, lies.y_mm, lies.theta_rad)
        known = part.search.evidence.recognition
        assert known is not None
        assert holding_truth(known, placed) is not None


def _shift(lies: Placement, by: np.ndarray) -> Placement:
    return replace(lies, x_mm=lies.x_mm + float(by[0]), y_mm=lies.y_mm + float(by[1]))


def _grip_on(lying: Sequence[Placement], facing: np.ndarray) -> FingerApproach:
    """The approach that meets the first of two parts most squarely on a side that faces so."""

    def squareness(item: FingerApproach) -> float:
        start, heading = np.array(item.start_mm), item.direction_rad
        first, second = (
            stop(lies.region_within(item.finger.span_mm), start, heading, 5.0, 300.0) for lies in lying
        )
        along = np.array([math.cos(heading), math.sin(heading)])
        return float(-along @ facing) if first < second else -1.0

    return max(ON_SLIDING.approaches, key=squareness)


# ----------------------------------------------------------------------------------------------------
# Runs on the emulated bench.


def test_two_parts_on_the_emulated_bench_and_their_replay(recorded: Callable[[str], Path]) -> None:
    folder = recorded("two parts")
    out = json.loads((folder / "result.json").read_text())
    Draft202012Validator(json.loads(schema_text("identification"))).validate(out)
    assert out["verdict"] == "identified"
    assert {part["object"] for part in out["parts"]} == {"tr-1", "grip"}
    assert all(part["truth"]["inside_bounds"] for part in out["parts"])
    assert out["table"]["asked"] == "2"
    assert out["table"]["divisions"] == 1
    assert (folder / "picture.svg").read_text().count("<svg") == 1
    replayed = open_session(folder).replay()
    assert replayed.difference is None
    assert replayed.complete
    assert replayed.run is not None
    named = replay_lines(open_session(folder).log, replay_out(open_session(folder).log, replayed, "0", ""))
    assert "tr-1" in named[0]
    assert "grip, flat" in named[0]


def test_grip_by_grip_they_are_found_as_in_one_run(recorded: Callable[[str], Path]) -> None:
    """The same touches, to the last bit, and bounds; a plan that is not carried out changes nothing."""
    folder = recorded("two parts")
    seed = open_session(folder).header["seed"]
    out = json.loads((folder / "result.json").read_text())
    with palpate.open_rig(folder / "rig.toml", seed=seed).connect(scene=folder / "scene.json") as rig:
        recognition = rig.recognise(folder / "objects.json", parts=2)
        while approaches := rig.plan(recognition):
            assert rig.plan(recognition, palpate.Goals(0.1, 0.01))
            recognition = recognition.extend(rig.grip(approaches))
    kept = contact_record(folder / "contacts.json").grips
    assert [tuple(grip) for grip in recognition.grips] == [tuple(grip) for grip in kept]
    assert (recognition.verdict, recognition.goal_met) == (out["verdict"], out["goal_met"])
    found = [item.hypotheses[0] for item in recognition.parts]
    assert [item.state.object_name for item in found] == [part["object"] for part in out["parts"]]
    for item, part in zip(found, out["parts"], strict=True):
        assert item.bounds.x_mm == pytest.approx(part["bounds"]["x"], abs=2e-6)
        assert item.bounds.theta_rad == pytest.approx(part["bounds"]["theta"], abs=2e-6)


def test_flat_faces_and_own_strategies_are_refused() -> None:
    pads = Path(__file__).parents[3] / "examples" / "pad-rig.toml"
    with palpate.open_rig(pads) as rig, pytest.raises(InputError, match="flat face"):
        rig.identify(parts=2)
    with palpate.open_rig(firm_rig()) as rig, pytest.raises(InputError, match="one part"):
        rig.identify(parts=2, strategy=lambda *_: None)
