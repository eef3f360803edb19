"""Approaches of fingers, and fingers kept apart."""

import itertools
import math
import tomllib
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.config import RigFile, SlideFingerConfig, load_rig
from palpate.drivers.kinematics import FingerBody
from palpate.recognizer.planner import FingerApproach
from palpate.rig.conversion import line_of
from palpate.rig.mechanisms import kinematics_of
from palpate.rig.mechanisms.slide import slide_kinematics
from palpate.rig.mechanisms.swept_volume import capsules_of, gap_mm, is_apart
from palpate.rig.reach.approaches import Reach, reach_of
from support.benches.rigs import firm_rig

# ----------------------------------------------------------------------------------------------------
# Approaches that the reach offers are free: of fingers, of obstacles; with bodies sampled in between.

POST = [[30.0, 95.0], [42.0, 95.0], [42.0, 107.0], [30.0, 107.0]]


def rig_with(**changes: Any) -> RigFile:
    data = tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    return RigFile.model_validate(data | changes)


def random_rig(rng: np.random.Generator) -> RigFile:
    """Two to four fingers of different sizes round the table, with a post or two where none stands."""
    data = tomllib.loads(firm_rig().read_text(encoding="utf-8"))
    count = int(rng.integers(2, 5))
    bearing = rng.uniform(0, 2 * math.pi) + np.arange(count) * 2 * math.pi / count
    fingers = []
    for k, at in enumerate(bearing + rng.uniform(-0.2, 0.2, count)):
        finger = tomllib.loads(firm_rig().read_text(encoding="utf-8"))["fingers"][0]
        away = rng.uniform(185.0, 230.0)
        finger["name"] = f"f{k}"
        finger["base_mm"] = [away * math.cos(at), away * math.sin(at)]
        finger["heading_deg"] = math.degrees(at) % 360 - 180 + rng.uniform(-8, 8)
        finger["aim"]["dxl_id"], finger["slide"]["dxl_id"] = 10 * k + 1, 10 * k + 2
        finger["array"]["port"] = f"mock://f{k}"
        finger["tip"]["radius_mm"] = rng.uniform(2.0, 8.0)
        finger["slide"]["range_mm"] = [45.0, rng.uniform(200.0, 330.0)]
        fingers.append(finger)
    posts = []
    for k in range(int(rng.integers(0, 3))):
        at, away = rng.uniform(0, 2 * math.pi), rng.uniform(20.0, 200.0)
        middle = np.array([math.cos(at), math.sin(at)]) * away
        corners = [(middle + 8 * np.array([math.cos(a), math.sin(a)])).tolist() for a in (0.3, 2.0, 4.5)]
        posts.append({"name": f"p{k}", "outline_mm": corners})
    data |= {"fingers": fingers, "obstacles": posts}
    data["closing"]["clearance_mm"] = rng.uniform(0.0, 8.0)
    return RigFile.model_validate(data)


def some_rigs(count: int, seed: int) -> list[RigFile]:
    """Random rigs that are valid and in which every finger can wait."""
    rng = np.random.default_rng(seed)
    found: list[RigFile] = []
    while len(found) < count:
        try:
            rig = random_rig(rng)
            reach_of(rig, aims=3)
        except (ValueError, InputError):
            continue
        found.append(rig)
    return found


def kept(rigs: list[RigFile]) -> list[Any]:
    """Every third of them, the others in the campaign."""
    return [
        pytest.param(rig, marks=[pytest.mark.campaign] * (number % 3 > 0)) for number, rig in enumerate(rigs)
    ]


def body(rig: RigFile, approach: FingerApproach, travel: float, rng: np.random.Generator) -> shapely.Geometry:
    """A slide from base to tip, somewhere within the bounds of base and heading."""
    spec = rig.fingers[approach.finger_index]
    turn = kinematics_of(spec).direction_bound_rad * rng.uniform(-1, 1)
    shift = spec.bounds.base_mm * np.array([math.cos(a := rng.uniform(0, 7)), math.sin(a)])
    base = np.array(spec.base_mm)
    length = math.dist(spec.base_mm, approach.start_mm) + travel
    angle = approach.direction_rad + turn
    tip = base + shift + length * np.array([math.cos(angle), math.sin(angle)])
    return shapely.LineString([base + shift, tip]).buffer(spec.tip.radius_mm, quad_segs=32)


def full(reach: Reach, index: int) -> float:
    return reach.approaches[index].travel_mm


@pytest.mark.parametrize("rig", kept(some_rigs(6, 1)), ids=range(6))
def test_approaches_that_go_together_keep_their_clearance(rig: RigFile) -> None:
    reach = reach_of(rig, aims=9)
    rng = np.random.default_rng(5)
    count = len(reach.approaches)
    others = np.arange(count)
    yes = no = 0
    for one in range(count):
        travels = np.array([full(reach, k) for k in range(count)]) * rng.uniform(0.6, 1.0, count)
        far = full(reach, one) * rng.uniform(0.6, 1.0)
        good = reach.together(one, far, others, travels)
        mine = [body(rig, reach.approaches[one], far * share, rng) for share in (0.0, 0.5, 1.0)]
        for other in rng.permutation(count)[:12]:
            if reach.finger[other] == reach.finger[one]:
                assert not good[other]
                continue
            ends = travels[other] * np.array([0.0, 0.5, 1.0])
            theirs = [body(rig, reach.approaches[other], end, rng) for end in ends]
            gap = min(a.distance(b) for a, b in itertools.product(mine, theirs))
            yes, no = yes + bool(good[other]), no + (not good[other])
            # The oracle's circles are drawn with chords, a few µm inside.
            assert not good[other] or gap >= rig.closing.clearance_mm - 0.02
            # Nor is more forbidden than the bounds ask for.
            assert good[other] or gap <= rig.closing.clearance_mm + 4 * max_bound(rig)
    assert yes > 20
    assert yes + no > 50


def max_bound(rig: RigFile) -> float:
    ends = [(kinematics_of(f), f.slide.range_mm[1]) for f in rig.fingers]
    bounds = []
    for kinematics, far in ends:
        servos = kinematics.servos_rad(kinematics.line(0.0, far), 0.0)
        bounds.append(
            kinematics.position_bound_mm(servos) + kinematics.cross_track_bound_mm(servos, 4 * math.pi / 2048)
        )
    return max(bounds)


@pytest.mark.parametrize("rig", kept(some_rigs(6, 2)), ids=range(6))
def test_nothing_stands_in_the_way_of_an_approach(rig: RigFile) -> None:
    """Neither an obstacle, nor any finger that waits at any of its own aims."""
    reach = reach_of(rig, aims=21)
    rng = np.random.default_rng(6)
    posts = [shapely.Polygon(item.outline_mm) for item in rig.obstacles]
    least = rig.closing.clearance_mm - 0.02
    waiting = {
        k: [body(rig, reach.approaches[i], 0.0, rng) for i in reach.of_finger(k)]
        for k in range(len(rig.fingers))
    }
    for approach in reach.approaches:
        here = body(rig, approach, approach.travel_mm, rng)
        assert all(here.distance(post) >= least for post in posts)
        for finger, bodies in waiting.items():
            if finger != approach.finger_index:
                assert all(here.distance(other) >= least for other in bodies)
        spec = rig.fingers[approach.finger_index]
        assert (
            math.dist(spec.base_mm, line_of(approach).point_mm(approach.travel_mm)) < spec.slide.range_mm[1]
        )
        assert math.hypot(*approach.start_mm) >= rig.workspace.radius_mm + spec.tip.radius_mm
        turn = math.degrees(approach.direction_rad) - spec.heading_deg
        lo, hi = spec.aim.range_deg
        assert lo - 1e-6 <= (turn + 180) % 360 - 180 <= hi + 1e-6


def test_a_post_beside_the_way_cuts_off_the_aims_behind_it() -> None:
    free = reach_of(rig_with())
    reach = reach_of(rig_with(obstacles=[{"name": "post", "outline_mm": POST}]))
    # Finger 0 stands at (0, 190) and looks down; the post is to the left of its ways, seen along them.
    kept = [math.degrees(reach.approaches[k].direction_rad) + 90 for k in reach.of_finger(0)]
    assert min(kept) == pytest.approx(-35.0)
    assert max(kept) == pytest.approx(35.0)
    short = [k for k in reach.of_finger(0) if full(reach, k) < 60.0]
    assert 3 <= len(short) <= 12
    assert max(full(free, k) for k in free.of_finger(0)) == pytest.approx(
        max(full(reach, k) for k in reach.of_finger(0))
    )
    close_by = [[12.0, 138.0], [20.0, 138.0], [20.0, 146.0], [12.0, 146.0]]
    barred = reach_of(rig_with(obstacles=[{"name": "post", "outline_mm": close_by}]))
    # Here it stands where the finger waits: no aim beyond it can be turned to.
    assert max(math.degrees(barred.approaches[k].direction_rad) + 90 for k in barred.of_finger(0)) < 10


def test_a_finger_without_room_is_named() -> None:
    post = {"name": "post", "outline_mm": [[9.1, 150.0], [20.0, 150.0], [20.0, 170.0]]}
    with pytest.raises(InputError, match='rig "firm-bench": finger "f1" has no room where it waits'):
        reach_of(rig_with(obstacles=[post]))


def test_time_grows_with_the_way_and_the_aim() -> None:
    reach = reach_of(load_rig(firm_rig()))
    own = reach.of_finger(0)
    near, far = (reach.seconds(np.full(len(reach.approaches), travel)) for travel in (50.0, 150.0))
    assert far - near == pytest.approx(2 * 100.0 / 20.0)
    assert near[own[0]] > near[own[20]]
    assert near[own[0]] == pytest.approx(near[own[-1]])


def test_every_approach_is_within_its_servos_ranges_from_end_to_end() -> None:
    """Also at the ends of the aim's range, where rounding once put a goal just beyond it."""
    rig = load_rig(firm_rig())
    reach = reach_of(rig)
    for approach in reach.approaches:
        spec = rig.fingers[approach.finger_index]
        assert isinstance(spec, SlideFingerConfig)
        kinematics = slide_kinematics(spec)
        ends = sorted(kinematics.aim_servo_rad(math.radians(value)) for value in spec.aim.range_deg)
        for travel in (0.0, approach.travel_mm):
            aim, slide = kinematics.servos_rad(line_of(approach), travel)
            assert ends[0] < aim < ends[1]
            assert spec.slide.range_mm[0] < kinematics.distance_mm(slide) < spec.slide.range_mm[1]


# ----------------------------------------------------------------------------------------------------
# Whether two fingers are apart, by the loop's way and by whole arrays; judged by shapely.

COORDINATE = st.floats(-200, 200).map(lambda value: round(value, 3))
POINT = st.tuples(COORDINATE, COORDINATE)
CAPSULES = st.lists(st.tuples(POINT, POINT, st.floats(1, 20)), min_size=1, max_size=3)


def body_of_capsules(capsules: list[tuple[tuple[float, float], tuple[float, float], float]]) -> FingerBody:
    starts, ends, widths = zip(*capsules, strict=True)
    return FingerBody(np.array(starts), np.array(ends), np.array(widths))


@given(CAPSULES, CAPSULES, st.floats(0.5, 30))
def test_fingers_are_apart_as_shapely_says(one: list, other: list, clearance_mm: float) -> None:
    free = min(
        shapely.LineString([a, b]).distance(shapely.LineString([c, d])) - width - wide
        for a, b, width in one
        for c, d, wide in other
    )
    assume(abs(free - clearance_mm) > 1e-6)
    assert is_apart(body_of_capsules(one), body_of_capsules(other), clearance_mm) == (free >= clearance_mm)
    nearest = gap_mm(capsules_of([body_of_capsules(one)]), capsules_of([body_of_capsules(other)])).min()
    assert abs(nearest - free) < 1e-6
