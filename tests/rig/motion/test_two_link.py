"""Two-link arms on the emulated bench: touches, ways, reach, runs to a verdict, and every way out."""

import math
import tomllib
from typing import Any

import numpy as np
import pytest
import shapely
from emulated_session import EmulatedSession, emulated_session, identify_checked, shape_of
from repository import EXAMPLES
from sampling import sample
from touch_check import check_touch

from palpate.base.errors import DeviceError, InputError
from palpate.base.geometry.plane import distance_range
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import ArmFingerConfig, ObjectsFile, RigFile, load_objects, load_rig, shipped_objects
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.bench import choose_placement, connect
from palpate.rig.conversion import arm_kinematics, line_of
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, reach_of

EXAMPLE = EXAMPLES / "two-link-rig.toml"
ARMS = load_rig(EXAMPLE)
REACH = reach_of(ARMS)
SMALL = ARMS.model_copy(update={"workspace": ARMS.workspace.model_copy(update={"radius_mm": 70.0})})
"""The same arms round a smaller table, for runs: their ways are shorter."""


def arm() -> tuple[ArmFingerConfig, ArmKinematics]:
    spec = ARMS.fingers[0]
    assert isinstance(spec, ArmFingerConfig)
    return spec, arm_kinematics(spec)


def middle_grip(rng: np.random.Generator, reach: Reach = REACH) -> list[FingerApproach]:
    """One way of each arm that passes not too far from the middle."""
    grip = []
    for finger in range(3):
        near = []
        for index in reach.of_finger(finger):
            line = line_of(reach.approaches[index])
            if math.hypot(*line.point_mm(line.travel_mm((0.0, 0.0)))) < 30.0:
                near.append(index)
        grip.append(reach.approaches[int(rng.choice(near))])
    return grip


def run_checked(session: EmulatedSession, grips: int, seed: int) -> list[Touch]:
    """Some grips; every touch, every way and every force compared with the bench's truth."""
    assert session.placement is not None
    shape = shape_of(session.placement)
    rng, reach = np.random.default_rng(seed), reach_of(session.rig)
    tracks: list[list[np.ndarray]] = [[] for _ in session.bench.fingers]
    centres: list[np.ndarray] = []

    def look() -> None:
        for track, finger in zip(tracks, session.bench.fingers, strict=True):
            track.append(finger.centre_mm)

    def remember(stage: GripPhase) -> None:
        if stage is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    session.clock.on_tick = look
    every: list[Touch] = []
    with connect(session.bench_rig) as hand:
        hand.prepare()
        for _ in range(grips):
            for track in tracks:
                track.clear()
            touches = carry_out_grip(hand, middle_grip(rng, reach), remember)
            for touch in touches:
                check_touch(shape, touch, centres[touch.finger_index], 5.0)
                check_way(touch, np.array(tracks[touch.finger_index]))
            every += touches
    assert all(finger.hardest_n <= session.rig.closing.max_force_n for finger in session.bench.fingers)
    assert not any(session.torque().values())
    return every


def check_way(touch: Touch, track: np.ndarray) -> None:
    """The whole way that is claimed to be free, the true tip went, to within the bound of the path."""
    contact = touch.contact
    shares = np.linspace(0.0, 1.0, 200)[:, None]
    claimed = (1 - shares) * np.array(contact.start_mm) + shares * np.array(contact.end_mm)
    away = np.hypot(*np.moveaxis(claimed[:, None] - track, 2, 0)).min(axis=1)
    assert contact.path_bound_mm is not None
    assert away.max() <= contact.path_bound_mm
    assert contact.path_bound_mm <= 1.6, "still of use"


@pytest.mark.parametrize(("number", "grips"), sample([(0, 1), (0, 2)], [(0, 1)]))
def test_every_touch_of_an_arm_is_within_its_bounds(number: int, grips: int) -> None:
    objects = load_objects(shipped_objects())
    one = ObjectsFile((objects.objects[number],))
    touches = run_checked(emulated_session(seed=50 + number, rig=SMALL, objects=one), grips, number)
    assert sum(touch.contact.touched for touch in touches) >= 2


def test_an_approach_is_carried_out_within_its_bound() -> None:
    """Planned for a line and a bound: the true tip stays within it, until something stops it."""
    session = emulated_session(rig=ARMS, empty=True)
    grip = middle_grip(np.random.default_rng(9))[:1]
    track: list[np.ndarray] = []
    session.clock.on_tick = lambda: track.append(session.bench.fingers[0].centre_mm)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        carry_out_grip(hand, grip, lambda stage: track.clear() if stage is GripPhase.CLOSING else None)
    line = line_of(grip[0])
    bound = min(item.position_bound_mm for item in REACH.approaches)
    start, end = np.array([line.start_mm]), np.array([line.point_mm(grip[0].travel_mm)])
    points = np.array(track)
    off, _ = distance_range(points, points, np.repeat(start, len(points), 0), np.repeat(end, len(points), 0))
    assert off.max() <= bound
    assert off.max() > 0.0


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("seed", [7])
def test_arms_identify(seed: int) -> None:
    objects = load_objects(shipped_objects())
    session = emulated_session(seed=seed, rig=SMALL, objects=objects)
    result = identify_checked(session, Catalogue(objects.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED


def test_a_dead_elbow_ends_the_run_with_torque_off() -> None:
    session = emulated_session(rig=ARMS)
    dead = session.bench.fingers[1].servos[1]
    session.clock.after(3.0, dead.power_off)
    grip = middle_grip(np.random.default_rng(1))
    with pytest.raises(DeviceError, match="servo 22"), connect(session.bench_rig) as hand:
        session.grip(hand, grip)
    torque = session.torque()
    assert not any(on for dxl_id, on in torque.items() if dxl_id != 22)
    assert session.rest(1.0) < 0.05


def test_a_catalogue_with_a_part_that_is_too_high_is_refused() -> None:
    data: dict[str, Any] = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for finger in data["fingers"]:
        finger["links"]["links_height_mm"] = 20.0
    rig = RigFile.model_validate(data)
    wanted = 'object "tr-1" is 20 mm high; the links of finger "a1" pass 20 mm above the table'
    with pytest.raises(InputError, match=wanted):
        choose_placement(rig, load_objects(shipped_objects()), None, 1)


def test_no_arm_meets_a_post() -> None:
    """Links and tip, sampled on every way and at every place where the tip may wait."""
    post = np.array([[-72.0, 95.0], [-62.0, 95.0], [-62.0, 105.0], [-72.0, 105.0]])
    data: dict[str, Any] = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    rig = RigFile.model_validate(data | {"obstacles": [{"name": "post", "outline_mm": post.tolist()}]})
    reach = reach_of(rig, aims=21)
    free = reach_of(ARMS, aims=21)
    longest = [sum(full.approaches[k].travel_mm for k in full.of_finger(0)) for full in (reach, free)]
    assert 0.1 * longest[1] < longest[0] < 0.9 * longest[1]
    shape = shapely.Polygon(post)
    spec, k = arm()
    own = [reach.approaches[index] for index in reach.of_finger(0)]
    starts = [math.atan2(item.start_mm[1], item.start_mm[0]) for item in own]
    radius = math.hypot(*own[0].start_mm)
    places = [
        (radius * math.cos(at), radius * math.sin(at)) for at in np.linspace(min(starts), max(starts), 60)
    ]
    places += [line_of(item).point_mm(at) for item in own for at in np.linspace(0.0, item.travel_mm, 15)]
    for place_mm in places:
        servos = k.servos_at(place_mm)
        links = shapely.LineString([spec.base_mm, k.elbow_mm(servos), place_mm]).buffer(8.0)
        gap = min(links.distance(shape), shapely.Point(place_mm).buffer(5.0).distance(shape))
        assert gap >= rig.closing.clearance_mm


def test_arms_that_go_together_stay_apart() -> None:
    """Postures of both, sampled on their ways: links and tips never nearer than the clearance."""
    rng = np.random.default_rng(2)
    kinematics = [arm_kinematics(spec) for spec in ARMS.fingers if isinstance(spec, ArmFingerConfig)]
    count = len(REACH.approaches)
    travels = np.array([item.travel_mm for item in REACH.approaches]) * rng.uniform(0.4, 1, count)
    yes = no = 0
    for one in rng.permutation(count)[:25]:
        good = REACH.together(int(one), float(travels[one]), np.arange(count), travels)
        for other in rng.permutation(count)[:12]:
            a, b = int(REACH.finger[one]), int(REACH.finger[other])
            if a == b:
                assert not good[other]
                continue
            gap = math.inf
            for mine in np.linspace(0.0, travels[one], 12):
                for theirs in np.linspace(0.0, travels[other], 12):
                    p = kinematics[a].body(
                        kinematics[a].servos_rad(line_of(REACH.approaches[int(one)]), float(mine)), 5.0
                    )
                    q = kinematics[b].body(
                        kinematics[b].servos_rad(line_of(REACH.approaches[int(other)]), float(theirs)), 5.0
                    )
                    i, j = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
                    apart, _ = distance_range(p.start[i], p.end[i], q.start[j], q.end[j])
                    gap = min(gap, float((apart - p.half_width[i] - q.half_width[j]).min()))
            assert not good[other] or gap >= ARMS.closing.clearance_mm
            yes, no = yes + bool(good[other]), no + (not good[other])
    assert yes > 20
    assert no > 20
