"""Load at contacts, contacts under load, dragging."""

import math
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from palpate.base.geometry import Floats
from palpate.config import RigFile
from palpate.drivers.emulators.mechanics import CompliantJoint, JointCompliance
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import TipCalibration
from palpate.recognizer import Contact
from palpate.rig.bench import connect
from palpate.rig.conversion import deflection_mm, deflection_rad, shear_rad
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.load_meter import TIP_FRICTION, LoadMeter, TouchStage, friction_factor
from palpate.rig.motion.touch import Touch
from support.benches.rigs import small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session, random_grip, shape_of
from support.oracles.array_contacts import describe

# ----------------------------------------------------------------------------------------------------
# Loads on the part by touches: what the meter makes of forces and travels, and what a run reports.

STIFFNESS = 3.0
PERIOD_S = 0.004


def pressed(meter: LoadMeter, begun_s: float, depth_mm: float, force_n: float | None = None) -> float:
    """In at 5 mm/s from 1 mm before the part, and out again; reads 20 ms apart. Returns when it is over."""
    turn_s = (1 + depth_mm) / 5
    count = math.ceil(2 * turn_s / PERIOD_S) + 1
    for k in range(count):
        t = k * PERIOD_S
        travel = 5 * min(t, 2 * turn_s - t)
        if k % 5 == 0 or k == count - 1:
            meter.see(travel, begun_s + t)
        spring = STIFFNESS * max(travel - 1, 0.0)
        meter.feel(spring if force_n is None else min(spring, force_n), begun_s + t + PERIOD_S)
    return begun_s + count * PERIOD_S


def test_a_press_and_release_has_its_peak_its_travel_and_its_work() -> None:
    meter = LoadMeter(0.3, PERIOD_S)
    meter.begin(TouchStage.QUICK, 0.0)
    pressed(meter, 0.0, 0.5)
    (load,) = meter.loads()
    assert load.stage is TouchStage.QUICK
    assert load.peak_force_n == pytest.approx(1.5, rel=0.05)
    assert load.travel_mm == pytest.approx(0.5, abs=0.05)
    assert load.work_mj == pytest.approx(STIFFNESS * 0.5**2 / 2, rel=0.1)
    assert (load.begun_s, load.ended_s) == pytest.approx((0.2, 0.4), abs=2 * PERIOD_S)


def test_a_part_that_slides_gets_more_work_than_its_peak_force_lets_expect() -> None:
    meter = LoadMeter(0.3, PERIOD_S)
    meter.begin(TouchStage.QUICK, 0.0)
    pressed(meter, 0.0, 2.0, force_n=0.4)
    (load,) = meter.loads()
    assert load.peak_force_n == pytest.approx(0.4)
    assert load.travel_mm == pytest.approx(2.0, abs=0.05)
    assert load.work_mj == pytest.approx(0.4 * 2.0, rel=0.1)


def test_every_touch_is_a_load_of_its_own_and_what_is_not_felt_is_none() -> None:
    meter = LoadMeter(0.3, PERIOD_S)
    meter.begin(TouchStage.QUICK, 0.0)
    end = pressed(meter, 0.0, 0.5)
    meter.begin(TouchStage.SLOW, end + PERIOD_S)
    end = pressed(meter, end + PERIOD_S, 0.02)  # 0.06 N: below half of what counts as a contact
    meter.begin(TouchStage.SLOW, end + PERIOD_S)
    pressed(meter, end + PERIOD_S, 0.1)
    assert [load.stage for load in meter.loads()] == [TouchStage.QUICK, TouchStage.SLOW]
    assert meter.loads()[1].peak_force_n == pytest.approx(0.3, rel=0.1)
    assert not LoadMeter(0.3, PERIOD_S).loads()


def counts(rng: np.random.Generator, above: float = 0.0) -> np.ndarray:
    return np.round(rng.normal(100.0 + above, 2.0, (4, 6))).astype(np.uint16)


def test_a_finger_is_taken_to_go_forward_until_it_is_stopped_and_not_while_it_stands() -> None:
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0, step_mm=0.02)
    meter.begin(TouchStage.SLOW, 0.0)
    for k in range(200):
        t = k * PERIOD_S
        travel = 5 * min(t, 0.4)
        if k % 5 == 0:
            meter.see(round(travel / 0.02) * 0.02, t)
        meter.feel(STIFFNESS * max(travel - 1.8, 0.0), t + PERIOD_S)
        if k == 100:
            meter.stopped(t)
    meter.measured(0.7)
    trace = meter.trace()
    assert trace is not None
    assert trace.felt
    pressed = trace.force_n > 0
    # From 0.05 N on: what is left of 0.2 mm, as much faster as allowed, and what a tip takes to stand.
    assert 0.18 < trace.advance_mm[pressed].sum() < 0.27
    assert trace.advance_mm[-90:].sum() == 0.0
    assert trace.measured_s == 0.7


def test_a_frame_that_may_be_old_belongs_to_wherever_the_tip_may_have_been() -> None:
    """Frames that may be up to 80 ms old, on a way that is free for 1 mm."""
    traces = []
    for late_s in (0.0, 0.08):
        meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0)
        meter.late_by(late_s)
        meter.begin(TouchStage.SLOW, 0.0, free_mm=1.0, free_within_mm=0.5)
        for k in range(200):
            meter.see(5 * k * PERIOD_S, k * PERIOD_S)
            meter.feel(0.2 if k >= 150 else 0.0, (k + 1) * PERIOD_S)
        trace = meter.trace()
        assert trace is not None
        traces.append(trace)
    fresh, old = traces
    assert (fresh.time_bound_s, old.time_bound_s) == pytest.approx((PERIOD_S, 0.04))
    assert fresh.unfelt_mm - old.unfelt_mm == pytest.approx(5 * (0.08 - 2 * PERIOD_S), abs=5.1 * PERIOD_S)
    assert old.free_within_mm.sum() == pytest.approx(fresh.free_within_mm.sum(), abs=1.0)
    assert meter.may_touch(0.0)
    begins = LoadMeter(0.3, PERIOD_S)
    begins.begin(TouchStage.QUICK, 0.0, free_mm=10.0)
    for travel, at_s in ((12.0, 1.0), (5.0, 1.2), (4.0, 1.3)):
        begins.see(travel, at_s)
    assert not begins.may_touch(1.25)
    assert begins.may_touch(1.1), "frames of the time before are still to come"


def test_the_mean_of_quiet_frames_hides_less_and_a_free_way_is_known() -> None:
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0)
    meter.begin(TouchStage.SLOW, 0.0, free_mm=1.0, free_within_mm=0.5)
    for k in range(200):
        meter.see(5 * k * PERIOD_S, k * PERIOD_S)
        meter.feel(0.2 if k == 150 else 0.0, (k + 1) * PERIOD_S, 0.01 if k == 120 else 0.0)
    trace = meter.trace()
    assert trace is not None
    assert (trace.free_within_mm[:47] == 0.5).all()
    assert not trace.free_within_mm[53:].any()
    assert trace.unnoticed_n[60] == pytest.approx(0.05 / 8)
    assert trace.unnoticed_n[170] == pytest.approx(0.05 / 7)
    assert np.flatnonzero(trace.force_n).tolist() == [*range(57, 121), 150]
    assert trace.force_n[[57, 120, 150]] == pytest.approx([0.01, 0.01, 0.2])


def test_means_of_counts_are_of_the_newest_quiet_frames() -> None:
    rng = np.random.default_rng(4)
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05)
    frames: list[np.ndarray] = []
    for k in range(300):
        frame = counts(rng)
        if k in (40, 41, 200):
            assert meter.quiet_mean(frame, 0.06) is None
            frames = []
            continue
        frames = [*frames, frame][-64:]
        found = meter.quiet_mean(frame, 0.04)
        assert found is not None
        assert found[1] == len(frames)
        assert found[0] == pytest.approx(np.mean(frames, axis=0))


@pytest.mark.parametrize("late_s", [0.004, 0.01, 0.018])
def test_all_of_the_way_back_counts_from_where_a_tip_turns_after_the_order_to_stop(late_s: float) -> None:
    """At 20 mm/s it goes on for up to 0.4 mm, and the part is still pressed while it comes back as far."""
    step_mm, stop_s = 0.0244, 0.2
    turn_s = stop_s + late_s

    def travel(t: float) -> float:
        return 20 * min(t, turn_s) - min(max(95 * (t - turn_s), 0.0) * (t - turn_s) / 2, 3.0)

    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=20.0, step_mm=step_mm)
    meter.begin(TouchStage.QUICK, 0.0)
    for k in range(200):
        t = k * PERIOD_S
        if k % 5 == 0:
            meter.see(round(travel(t) / step_mm) * step_mm, t)
        meter.feel(0.5 if travel(t) > 3.9 else 0.0, t + PERIOD_S)
    meter.stopped(stop_s)
    trace = meter.trace()
    assert trace is not None
    assert 3.0 - step_mm / 2 < trace.retreat_mm.sum() < 3.0 + 2 * step_mm


@pytest.mark.parametrize(("step_mm", "every"), [(0.0244, 5), (0.153, 1)])
@pytest.mark.parametrize("faster", [0.0, 2.0, 5.0])
def test_a_finger_that_is_faster_than_its_touch_has_gone_as_far_as_it_is_seen(
    faster: float, step_mm: float, every: int
) -> None:
    """Where servos tell places by large steps, each is more than it goes from read to read."""
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=4.0, step_mm=step_mm)
    meter.begin(TouchStage.QUICK, 0.0)
    for k in range(250):
        t = k * PERIOD_S
        if k % every == 0 or k == 249:
            meter.see(round(4 * faster * t / step_mm) * step_mm, t)
        meter.feel(0.5, t + PERIOD_S)
    trace = meter.trace()
    assert trace is not None
    gone_mm = 4 * max(faster, 1.1) * (trace.time_s[-1] - trace.time_s[0])
    assert -2 * step_mm < trace.advance_mm.sum() - gone_mm < step_mm


@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_each_stage_counts_with_its_own_speed(late_s: float) -> None:
    """And where a frame may be of either, with that of the quicker one."""
    slow_s = 0.4
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=4.0, step_mm=0.02)
    meter.late_by(late_s)
    meter.begin(TouchStage.QUICK, 0.0)
    for k in range(200):
        t = k * PERIOD_S
        if k == 100:
            meter.begin(TouchStage.SLOW, t, touch_mm_s=1.0)
        meter.see(min(4.0 * t, 4.0 * slow_s + (t - slow_s)), t)
        meter.feel(0.5, t + PERIOD_S)
    meter.resume(0.9)
    trace = meter.trace()
    assert trace is not None
    slow = trace.time_s > slow_s + late_s / 2 + 3 * PERIOD_S
    assert set(trace.touch_mm_s[slow]) == {1.0}
    assert set(trace.touch_mm_s[trace.time_s < slow_s - late_s / 2]) == {4.0}
    assert trace.advance_mm[slow].sum() == pytest.approx(1.1 * PERIOD_S * slow.sum(), rel=0.05)
    true_mm = 4.0 * slow_s + (200 * PERIOD_S - slow_s)
    assert trace.advance_mm.sum() > true_mm


def test_a_tip_that_is_steered_sideways_drags_the_part_with_all_that_presses() -> None:
    """An arm wanders by half a step of its joints as it stands and goes back."""
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0, step_mm=0.15)
    meter.begin(TouchStage.SLOW, 0.0)
    meter.stopped(0.0)
    for k in range(100):
        meter.see(2.0, k * PERIOD_S, 0.1 * math.sin(k / 5))
        meter.feel(0.5, (k + 1) * PERIOD_S)
    trace = meter.trace()
    assert trace is not None
    true_mm = np.abs(np.diff(0.1 * np.sin(np.arange(100) / 5))).sum()
    assert trace.advance_mm[5:].sum() == pytest.approx(true_mm, rel=0.1)


# ----------------------------------------------------------------------------------------------------
# Contacts of tips that stick and slip, on joints that give way: within the bounds that a rig file declares.
#
# The judge knows the outline and where the emulated tips really were, and works with shapely alone.

MM_PER_N, DEG_PER_N, FRICTION = 0.1, 0.03, 0.6


def rig_under_load(
    *,
    friction: float = 0.0,
    deflection: float = 0.0,
    holds: tuple[float, float] | None = None,
    play_deg: float = 0.02,
    declare: bool = True,
    fingers: int = 3,
) -> RigFile:
    """The small rig with tips that stick and joints that give way, and whether its fingers declare it."""
    data: dict[str, Any] = small_rig().model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {
        "deflection_mm_per_n": deflection,
        "aim_backlash_deg": play_deg,
        "part": {"engine": "still", "tip_friction": friction},
    }
    if holds is not None:
        data["emulation"]["play_holds_n"] = list(holds)
    del data["fingers"][fingers:]
    for finger in data["fingers"]:
        finger["aim"]["backlash_deg"] = play_deg
        finger["tip"]["max_friction"] = FRICTION
        finger["bounds"] |= {"deflection_mm_per_n": MM_PER_N, "deflection_deg_per_n": DEG_PER_N}
    rig = RigFile.model_validate(data)
    if declare:
        return rig
    silent = [
        finger.model_copy(
            update={
                "tip": finger.tip.model_copy(update={"max_friction": 0.0}),
                "bounds": finger.bounds.model_copy(
                    update={"deflection_mm_per_n": 0.0, "deflection_deg_per_n": 0.0}
                ),
            }
        )
        for finger in rig.fingers
    ]
    return rig.model_copy(update={"fingers": silent})


def one_grip(session: EmulatedSession, seed: int) -> list[tuple[Touch, np.ndarray]]:
    """A random grip, and where tips really were as it was measured."""
    centres: list[np.ndarray] = []

    def remember(stage: GripPhase) -> None:
        if stage is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    with connect(session.bench_rig) as hand:
        touches = session.grip(hand, random_grip(session, np.random.default_rng(seed)), remember)
    return [(touch, centres[touch.finger_index]) for touch in touches]


def outside(shape: shapely.Polygon, contact: Contact, centre: np.ndarray, radius: float) -> str | None:
    """What of a contact is not true; None if all is."""
    way = shapely.LineString([contact.start_mm, contact.end_mm])
    assert contact.path_bound_mm is not None
    if shapely.distance(way, shape) < radius - contact.path_bound_mm:
        return "way"
    if not contact.touched:
        return None
    foot = shapely.shortest_line(shape.boundary, shapely.Point(centre)).coords[0]
    normal = math.atan2(centre[1] - foot[1], centre[0] - foot[0])
    touching = (foot[0] + radius * math.cos(normal), foot[1] + radius * math.sin(normal))
    if shapely.distance(shapely.Point(touching), shape) > radius - 1e-6:
        if math.dist(touching, contact.end_mm) > contact.position_bound_mm:
            return "position"
        return None if _holds(contact, normal) else "normal"
    # In a notch: some place nearby where a tip would just touch has to fit.
    rim = shapely.segmentize(shapely.buffer(shape, radius, quad_segs=256).boundary, 0.01)
    near = shapely.points(shapely.get_coordinates(rim))
    near = near[shapely.distance(near, shapely.Point(contact.end_mm)) <= contact.position_bound_mm]
    for point in near:
        foot = shapely.shortest_line(shape.boundary, point).coords[0]
        if _holds(contact, math.atan2(point.y - foot[1], point.x - foot[0])):
            return None
    return "notch"


def _holds(contact: Contact, normal_rad: float) -> bool:
    if contact.normal is None:
        return True
    return (normal_rad - contact.normal.lo_rad) % math.tau <= contact.normal.hi_rad - contact.normal.lo_rad


def judged(seed: int, **load: Any) -> list[tuple[str | None, Touch]]:
    """One grip on a bench of a seed, each contact with what of it is not true."""
    session = emulated_session(seed=seed, rig=rig_under_load(**load), objects=small_objects())
    assert session.placement is not None
    shape = shape_of(session.placement)
    return [(outside(shape, touch.contact, centre, 5.0), touch) for touch, centre in one_grip(session, seed)]


LOADS = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 10**6),
        "friction": st.floats(0.0, FRICTION),
        "deflection": st.floats(0.0, MM_PER_N),
        "holds": st.none() | st.tuples(st.floats(0.0, 0.2), st.floats(0.3, 1.0)),
        "play_deg": st.floats(0.02, 0.2),
    }
)
WORST = {"seed": 3, "friction": FRICTION, "deflection": MM_PER_N, "holds": (0.0, 0.01), "play_deg": 0.2}
FEW = settings(derandomize=True, database=None, suppress_health_check=list(HealthCheck))


@settings(FEW, max_examples=1)
@given(LOADS)
@example(WORST)
def test_contacts_are_within_their_bounds_whatever_tips_and_joints_do(load: dict[str, Any]) -> None:
    assert [what for what, _ in judged(**load, fingers=2) if what] == []


@pytest.mark.campaign
@settings(FEW, max_examples=40)
@given(LOADS)
def test_contacts_of_many_loads_are_within_their_bounds(load: dict[str, Any]) -> None:
    assert [what for what, _ in judged(**load, fingers=2) if what] == []


def test_what_is_declared_widens_contacts_by_so_much() -> None:
    """The rule of docs/recogniser.md, with its numbers."""
    tip = small_rig().fingers[0].tip.model_copy(update={"max_friction": 0.5})
    assert math.degrees(shear_rad(tip, 0.2)) == pytest.approx(0.716, abs=0.001)
    finger = rig_under_load().fingers[0]
    assert deflection_mm(finger, 0.5) == pytest.approx(0.05 * math.hypot(1, FRICTION))
    assert deflection_rad(finger, 0.5) == pytest.approx(math.radians(0.015) * math.hypot(1, FRICTION))
    [(_, wide)], [(_, narrow)] = (judged(1, declare=declare, fingers=1) for declare in (True, False))
    assert wide.patch is not None
    assert wide.patch == narrow.patch, "declared or not, the same is measured"
    assert wide.contact.end_mm == narrow.contact.end_mm
    assert wide.contact.normal is not None
    assert narrow.contact.normal is not None
    pressing = wide.patch.force_n + wide.patch.force_bound_n
    turned = shear_rad(finger.tip, pressing) + deflection_rad(finger, pressing)
    assert wide.contact.normal.hi_rad - narrow.contact.normal.hi_rad == pytest.approx(turned)
    assert narrow.contact.normal.lo_rad - wide.contact.normal.lo_rad == pytest.approx(turned)
    widened = wide.contact.position_bound_mm - narrow.contact.position_bound_mm
    assert deflection_mm(finger, pressing) < widened < deflection_mm(finger, pressing) + 0.02


@pytest.mark.parametrize("stiffness", [1.0, 3.0, 300.0])
def test_a_joint_bends_as_far_as_its_tip_pushes_it(stiffness: float) -> None:
    """A spring against a spring, whatever the two stiffnesses."""
    lever, softness, dent = 150.0, 0.1, 0.2
    joint = CompliantJoint(0.0, 0.0, JointCompliance(softness / lever**2, math.inf), stiffness)
    for _ in range(200):
        joint.step(1e-3, 0.0, stiffness * (dent - lever * joint.at), lever)
    bent = dent * softness * stiffness / (1 + softness * stiffness)
    assert lever * joint.at == pytest.approx(bent, abs=1e-5)
    for _ in range(200):
        joint.step(1e-3, 0.0, 0.0, lever)
    assert joint.at == 0.0


def test_a_force_takes_up_play_once_friction_no_longer_holds_it() -> None:
    joint = CompliantJoint(0.001, 0.0, JointCompliance(0.0, 0.2), 3.0)
    for push, at in ((0.2, 0.0), (-0.2, 0.0), (0.3, 0.001), (-0.1, 0.001), (-0.3, -0.001)):
        for _ in range(200):
            joint.step(1e-3, 0.0, push, 150.0)
        assert joint.at == pytest.approx(at)
    joint.step(1e-3, 0.01, 0.0, 150.0)
    assert joint.at == pytest.approx(0.009), "and the servo takes it along from its flank"
    still = CompliantJoint(0.001, 0.0, None, 3.0)
    still.step(1e-3, 0.0, 5.0, 150.0)
    assert still.at == 0.0


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ({"friction": 0.7}, "is 0.7, beyond the bound fingers\\[0\\].tip.max_friction = 0.6"),
        ({"deflection": 0.2}, "beyond the bound fingers\\[0\\].bounds.deflection_mm_per_n = 0.1"),
        ({"holds": (0.3, 0.1)}, "the first value must be below the second"),
    ],
)
def test_emulated_loads_stay_within_what_is_declared(load: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        rig_under_load(**load)


# ----------------------------------------------------------------------------------------------------
# What a tip may drag the part with as it goes back: by where its array feels it.

COUNTS_PER_N, FORCE_N, NOISE_COUNTS = 1000.0, 0.5, 2.0
ARRAY = describe(Shape.CYLINDER, 4, 8, math.radians(24), 2.0, counts_per_n=COUNTS_PER_N, radius_mm=6.0)
LAST_TWO = np.array([0.0] * 6 + [math.inf] * 2)
LAST_FOUR = np.array([0.0] * 4 + [math.inf] * 4)


def dragging_n(column: int, drags: Floats | None) -> float:
    """Of a force on one column, after a while in which nothing was felt."""
    calibration = TipCalibration(gain=np.ones((4, 8)), noise_counts=NOISE_COUNTS)
    extractor = ContactExtractor(ARRAY, calibration)
    rng = np.random.default_rng(5)

    def frame(number: int, force_n: float) -> TactileFrame:
        counts = 100 + rng.normal(0.0, NOISE_COUNTS, (4, 8))
        counts[:, column] += force_n * COUNTS_PER_N / 4
        at_s = number / 250
        return TactileFrame(number, at_s, at_s, counts.round().astype(np.uint16))

    extractor.tare([frame(number, 0.0) for number in range(64)])
    meter = LoadMeter(FORCE_N, 0.004, extractor.least_force_n, noise_share=extractor.noise_share, drags=drags)
    for number in range(64, 128):
        force, readings = extractor.sense(frame(number, 0.0))
        assert meter.quiet_mean(readings, force) is not None
    touched = frame(128, FORCE_N)
    force, readings = extractor.sense(touched)
    assert force == pytest.approx(FORCE_N, rel=0.1)
    assert meter.quiet_mean(readings, force) is None
    return meter.dragging_n(extractor, touched, readings)


@pytest.mark.parametrize("column", [6, 7])
def test_the_back_counts_whole_also_where_it_is_too_narrow_to_be_looked_at_by_itself(column: int) -> None:
    assert dragging_n(column, LAST_TWO) >= friction_factor(TIP_FRICTION) * FORCE_N * 0.98
    assert math.isinf(dragging_n(column, LAST_FOUR))


@pytest.mark.parametrize("drags", [LAST_TWO, LAST_FOUR])
def test_what_presses_ahead_drags_no_more_than_noise_may_hide(drags: Floats) -> None:
    assert 0.0 < dragging_n(1, drags) < 0.1 * FORCE_N


def test_all_of_a_force_counts_where_nothing_is_known_of_the_columns() -> None:
    assert math.isinf(dragging_n(1, None))
