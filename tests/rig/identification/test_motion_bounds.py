"""Motion bounds: what supports do to forces and work, what loads allow, and searches for parts that move."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from palpate.base.vocabulary import IdentificationVerdict, Strategy
from palpate.config import RigFile, load_rig
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag
from palpate.recognizer import Catalogue, FingerApproach, Motion, StrangerEvidence
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.grip_choice import GripChooser
from palpate.rig.identification.grip_evidence import GripEvidence
from palpate.rig.identification.identify import search
from palpate.rig.identification.motion_bounds import MotionBounds, _Pushed
from palpate.rig.identification.pushing_mechanics import StateSupport, support_of
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.load_meter import TIP_FRICTION, LoadTrace, drag_shares, friction_factor
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from support.benches.rigs import firm_rig
from support.campaign.sampling import sample
from support.devices.array_tips import felt_patch
from support.oracles.plans import SimulatedTouches
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    holding_truth,
    outlines,
    place_within,
    turned,
    unit,
)

SIX = outlines(SHIPPED_OBJECTS)
CATALOGUE = Catalogue(SIX)
RIG = load_rig(firm_rig())
REACH = reach_of(RIG)
HEIGHT_MM = RIG.fingers[0].height_mm
ANSWERS = (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)


def declared(holds_n: float | None, support_mm: float | None = None) -> RigFile:
    search_table = RIG.search.model_copy(update={"part_holds_n": holds_n, "part_support_mm": support_mm})
    return RIG.model_copy(update={"search": search_table})


def assert_bounds_all_rotations(
    support: StateSupport,
    resting: np.ndarray,
    load: np.ndarray,
    vertices: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Whatever the centre of rotation, speeds are within what the mean speed of the resting points allows."""
    reach = np.hypot(*vertices.T).max()
    for _ in range(300):
        centre = rng.normal(size=2) * reach * rng.choice([0.1, 1.0, 10.0])
        slide = load @ np.hypot(*(resting - centre).T)
        assert np.hypot(*centre) <= support.shift * slide + 1e-9
        assert support.turn_rad_per_mm * slide >= 1.0 - 1e-9
        assert np.hypot(*(vertices - centre).T).max() <= support.leverage * slide + 1e-9


@pytest.mark.parametrize("row", range(6))
def test_an_evenly_loaded_base_bounds_every_rotation(row: int) -> None:
    rng = np.random.default_rng(row)
    item = CATALOGUE.states[row]
    outline = item.state.sections[0].polygons[0].outer - item.origin_mm
    points = rng.uniform(outline.min(axis=0), outline.max(axis=0), (20_000, 2))
    inside = points[shapely.contains_xy(shapely.Polygon(outline), points)]
    support = support_of(item, declared(0.3).search, HEIGHT_MM)
    even = np.full(len(inside), 1 / len(inside))
    assert_bounds_all_rotations(support, inside, even, outline, rng)


def test_any_feet_that_are_as_wide_as_declared_are_bounded() -> None:
    """Feet with loads as the weight asks for, and a push at the fingers' height."""
    rng = np.random.default_rng(6)
    tried = 0
    for trial in range(80):
        row = trial % 6
        item = CATALOGUE.states[row]
        outline = item.state.sections[0].polygons[0].outer - item.origin_mm
        feet = rng.choice(outline, int(rng.integers(3, 7))) + rng.normal(size=2)
        mean = HEIGHT_MM / 2 * rng.uniform() * unit(rng.uniform(0, 2 * math.pi))
        balance = np.vstack([feet.T, np.ones(len(feet))])
        found = linprog(rng.uniform(size=len(feet)), A_eq=balance, b_eq=[*mean, 1.0])
        near = np.linspace(outline.min(axis=0), outline.max(axis=0), 60)
        grid = np.stack(np.meshgrid(*near.T), axis=-1).reshape(-1, 2)
        if not found.success:
            continue
        wide = (np.hypot(*np.moveaxis(feet[None] - grid[:, None], 2, 0)) @ found.x).min()
        if wide < 5.0:
            continue
        tried += 1
        limits = declared(0.3, 0.95 * float(wide)).search
        assert_bounds_all_rotations(support_of(item, limits, HEIGHT_MM), feet, found.x, outline, rng)
    assert tried > 20


def test_an_object_goes_before_the_rig() -> None:
    heavy = replace(SIX[0], holds_n=2.0, support_mm=9.0)
    item = Catalogue([heavy]).states[0]
    assert support_of(item, declared(0.3).search, HEIGHT_MM).holds_n == 2.0
    assert support_of(item, declared(None).search, HEIGHT_MM).turn_rad_per_mm == pytest.approx(1 / 9.0)


def touched(load: LoadTrace | None, finger: int = 0) -> Touch:
    placed = Placed(SIX[0], 0.0, 0.0, 0.0)
    rows = [k for k, item in enumerate(REACH.approaches) if item.finger_index == finger]
    aim = REACH.approaches[REACH.of_finger(finger, REACH.middle_rad)[len(rows) // 2 % 7]]
    found = SimulatedTouches(REACH, placed, np.random.default_rng(1))([aim])[0]
    return replace(found, contact=replace(found.contact, touched=True), trace=load)


def press(
    force_n: float, work_mj: float, *, begin_s: float = 1.0, last_s: float = 0.1, unnoticed_n: float = 0.0
) -> LoadTrace:
    """A press of constant force that does some work, and lasts until after the measurement."""
    time_s = np.arange(0.0, 3.0, 1 / RIG.closing.sample_rate_hz)
    pressed = (time_s >= begin_s) & (time_s < begin_s + last_s)
    advance_mm = np.where(pressed, work_mj / max(force_n, 1e-9) / max(pressed.sum(), 1), 0.0)
    hidden = np.full(len(time_s), unnoticed_n)
    force = np.where(pressed, force_n, 0.0)
    return LoadTrace(
        time_s,
        1 / RIG.closing.sample_rate_hz,
        force,
        np.cumsum(advance_mm),
        advance_mm,
        hidden,
        *np.zeros((3, len(time_s))),
        np.full(len(time_s), 1.5),
        begin_s + 0.8 * last_s,
        math.inf,
        *np.zeros((2, len(time_s))),
        ~pressed,
    )


def patch_beside_dead_taxels(shown_n: float, most_n: float) -> ContactPatch:
    flags = frozenset({PatchFlag.DEAD_NEIGHBOUR})
    return felt_patch(force_n=shown_n, force_bound_n=most_n - shown_n, flags=flags)


def test_where_taxels_are_left_out_forces_count_with_what_the_patch_may_bear() -> None:
    bounds = MotionBounds(declared(2.0), CATALOGUE)
    touch = touched(press(0.1, 0.004))
    plain = bounds.peak_force_n([touch])
    blind = replace(touch, patch=patch_beside_dead_taxels(0.1, 0.7))
    assert 1.0 <= bounds.peak_force_n([blind]) / (friction_factor(TIP_FRICTION) * 0.7) < 1.1
    assert plain < bounds.peak_force_n([blind]) / 3
    unknown = replace(touch, patch=patch_beside_dead_taxels(0.1, math.inf))
    assert math.isinf(bounds.peak_force_n([unknown]))
    assert bounds.of_grip([unknown]).within(np.arange(len(CATALOGUE.states))) is None


def test_light_touches_move_nothing_heavier_ones_by_their_work() -> None:
    bounds = MotionBounds(declared(2.0), CATALOGUE)
    light = bounds.of_grip([touched(press(0.1, 0.004))])
    assert not any((light.before, light.after, light.whole))
    one, two = (bounds.of_grip([touched(press(2.0, work))]) for work in (1.0, 2.0))
    assert (one.before.shift_mm >= 0.8 * 1.0 / 2.0).all()
    assert (two.before.shift_mm > 1.5 * one.before.shift_mm).all()
    assert (one.after.shift_mm <= one.whole.shift_mm).all()
    assert one.within(np.arange(6)) is not None


def test_a_finger_that_goes_back_moves_what_it_drags() -> None:
    """By the work of dragging it over the way back, once it is measured; it only leaves what is ahead."""
    bounds = MotionBounds(declared(0.3), CATALOGUE)
    trace = press(1.0, 0.0, last_s=0.5)
    way_mm = np.where(trace.time_s > trace.measured_s, 0.02, 0.0)
    left = bounds.of_grip([touched(replace(trace, retreat_mm=way_mm, dragging_n=0 * trace.force_n + 1e-9))])
    dragged = replace(trace, retreat_mm=way_mm, dragging_n=0.5 * trace.force_n)
    found = bounds.of_grip([touched(dragged)])
    work_mj = 0.5 * 0.02 * (1.5 - trace.measured_s) * RIG.closing.sample_rate_hz
    assert (found.after.shift_mm - left.after.shift_mm >= work_mj / 0.3).all()
    assert (found.before.shift_mm == left.before.shift_mm).all()


def test_work_on_the_way_back_depends_on_where_it_presses() -> None:
    """A tip that goes back, pressed with 1 N at an angle, with friction as large as it may be either way."""
    angles = np.radians(np.arange(0.0, 90.0, 0.5))
    normal = np.column_stack([np.cos(angles), np.sin(angles)])  # from the tip to the part; ahead is x
    along = np.column_stack([-normal[:, 1], normal[:, 0]])
    works = [-(normal + mu * along)[:, 0] for mu in np.linspace(-TIP_FRICTION, TIP_FRICTION, 29)]
    assert drag_shares(angles) == pytest.approx(np.maximum(np.max(works, axis=0), 0.0), abs=1e-12)
    assert np.isinf(drag_shares(np.radians([90.1, 120.0, 179.0]))).all()


def with_fingers(rig: RigFile, table: str, **values: float) -> RigFile:
    """The same rig, with other values in a table of each finger."""
    fingers = [
        item.model_copy(update={table: getattr(item, table).model_copy(update=values)})
        for item in rig.fingers
    ]
    return rig.model_copy(update={"fingers": tuple(fingers)})


def test_more_friction_than_usual_counts_if_the_rig_file_allows_for_it() -> None:
    """Tips that may have 1.4: they drag where they are pressed from 36° on, and push as much more."""
    trace, rigs = press(1.0, 0.5), (declared(0.3), with_fingers(declared(0.3), "tip", max_friction=1.4))
    (few,), (more,) = (MotionBounds(rig, CATALOGUE).loads([touched(trace)]) for rig in rigs)
    larger = math.hypot(1, 1.4) / math.hypot(1, 0.7)
    assert more.work_mj.sum() / few.work_mj.sum() == pytest.approx(larger)
    assert more.at_contact_n.max() / few.at_contact_n.max() == pytest.approx(larger)
    angle = math.radians(40.0)
    assert drag_shares(np.array([angle]), 1.4) == pytest.approx(1.4 * math.sin(angle) - math.cos(angle))


def test_what_carries_a_tip_stores_energy_beside_its_skin() -> None:
    """Skin of stiffness k, sheared with 2 k / 3 at least along its surface, on a carrier that yields."""
    trace, stiff = press(1.0, 0.0), declared(0.3)
    soft = with_fingers(stiff, "bounds", deflection_mm_per_n=0.2)
    stored = [
        float(MotionBounds(rig, CATALOGUE).loads([touched(trace)])[-1].stored_mj.max())
        for rig in (stiff, soft)
    ]
    tip, pressed_n = RIG.fingers[0].tip, 1 / 0.7
    least = tip.stiffness_n_per_mm * (1 - tip.stiffness_spread)
    skin_mj = pressed_n**2 / (2 * least) * (1 + TIP_FRICTION**2 / (2 / 3))
    assert stored[0] >= skin_mj
    assert stored[1] - stored[0] >= 0.2 * pressed_n**2 * (1 + TIP_FRICTION**2) / 2


def test_forces_add_up_where_they_are_at_the_same_time() -> None:
    bounds = MotionBounds(declared(2.0), CATALOGUE)
    most = bounds.supports.leverage.max()
    force = 2.0 / most / 2.5
    one, other = touched(press(force, 0.2)), touched(press(force, 0.2), 1)
    later = touched(press(force, 0.2, begin_s=2.0), 1)
    assert not bounds.of_grip([one]).whole
    assert not bounds.of_grip([one, later]).whole
    assert bounds.of_grip([one, other]).whole


@given(
    st.lists(
        st.tuples(st.booleans(), st.booleans(), st.floats(0, 1), st.floats(0, 1)), min_size=2, max_size=9
    ),
    st.data(),
)
def test_dissipation_is_the_least_of_all_intervals_that_hold_the_motion(
    rows: list[tuple[bool, bool, float, float]], data: st.DataObject
) -> None:
    """Beside every way to choose periods that hold all in which the part may move."""
    moving, listed, work, stored = (np.array(column) for column in zip(*rows, strict=True))
    periods = np.flatnonzero(moving | listed)
    begin, end = sorted(data.draw(st.integers(0, len(rows))) for _ in range(2))
    pushed = _Pushed(periods, moving[periods][None], work, stored)

    def cost(held: Sequence[bool]) -> float:
        begun = [k for k in range(begin, end) if held[k] and (k == begin or not held[k - 1])]
        return sum(stored[max(k - 1, 0)] for k in begun) + sum(work[begin:end] * held[begin:end])

    free = [k for k in range(begin, end) if not moving[k]]
    costs = []
    for chosen in itertools.product([False, True], repeat=len(free)):
        held = moving.copy()
        held[free] = chosen
        costs.append(cost(held))
    found = float(pushed.dissipation_mj(begin, end)[0])
    assert min(costs) - 1e-9 <= found <= cost(moving) + 1e-9


def test_without_a_declared_force_nothing_is_bounded_and_nothing_moves() -> None:
    bounds = MotionBounds(declared(None), CATALOGUE)
    assert not bounds.of_grip([touched(press(3.0, 9.0)), touched(None)]).whole
    assert bounds.holds_n(np.arange(6)) is None


def test_no_bound_where_loads_are_missing_and_a_wide_one_where_fingers_may_push_unnoticed() -> None:
    every = np.arange(6)
    assert MotionBounds(declared(2.0), CATALOGUE).of_grip([touched(None)]).within(every) is None
    bounds = MotionBounds(declared(0.3), CATALOGUE)
    creeping = replace(press(0.0, 0.0, unnoticed_n=0.1), advance_mm=np.full(750, 0.1))
    pushed = bounds.of_grip([touched(creeping)]).within(every)
    assert pushed is not None
    assert pushed[0] > 0.1 * 75.0 / 0.3


@pytest.mark.parametrize("lost", [0, 1, 3, 8])
def test_lost_frames_hide_no_work(lost: int) -> None:
    """A push of 5 N at 5 mm/s breaks a part loose that bears 3 N, when frames are lost; then 1 N is left."""
    period_s = 1 / RIG.closing.sample_rate_hz
    bounds = MotionBounds(declared(3.0), CATALOGUE)
    whole = press(5.0, 0.0)
    number = np.arange(len(whole.time_s))
    trace = replace(
        whole,
        force_n=np.where(number < 100, 0.0, np.where(number < 200, 5.0, 1.0)),
        travel_mm=5 * whole.time_s,
        # It stood while it pressed, went on as the part broke loose, and stood again.
        advance_mm=np.where((number >= 200) & (number <= 200 + lost), 5 * period_s, 0.0),
    )
    kept = (number < 200) | (number >= 200 + lost)
    passed = np.diff(number[kept], prepend=number[kept][0] - 1)
    names = (
        "time_s",
        "force_n",
        "travel_mm",
        "unnoticed_n",
        "zero_doubt_n",
        "any_zero_doubt_n",
        "free_within_mm",
        "touch_mm_s",
        "retreat_mm",
        "dragging_n",
        "quiet",
    )
    left = {name: value[kept] for name in names if np.ndim(value := getattr(trace, name)) == 1}
    gappy = replace(trace, **left, advance_mm=trace.advance_mm[kept] * passed)
    work_mj = sum(float(load.work_mj.sum()) for load in bounds.loads([touched(gappy)])[-1:])
    # Until the next frame it may have pushed with 5 N all the way.
    assert work_mj >= 5.0 * 5 * (lost + 1) * period_s
    moved = bounds.of_grip([touched(gappy)]).within(np.arange(6))
    assert moved is not None
    assert moved[0] >= (5.0 - 3.0) * 5 * (lost + 1) * period_s / 3.0


def test_ways_that_were_free_are_not_of_a_part_that_has_moved_too_far() -> None:
    """A finger that may push unnoticed on a way that was free, of a part moved by less."""
    bounds = MotionBounds(declared(0.5), CATALOGUE)
    states = np.array([0])
    reach = bounds.supports.leverage[0]

    def moved(work_mj: float, within_mm: float) -> float:
        trace = replace(press(0.3, work_mj), unnoticed_n=np.full(750, 0.2))
        near = np.convolve(trace.force_n, np.ones(11), mode="same") > 0  # it stands about its press
        advance_mm = np.where(near, trace.advance_mm, 0.1)
        trace = replace(trace, advance_mm=advance_mm, free_within_mm=np.full(750, within_mm))
        found = bounds.of_grip([touched(trace)]).within(states)
        assert found is not None
        return found[0]

    for within_mm, work_mj in ((2.0, 0.15), (5.0, 0.3)):
        assert moved(work_mj, within_mm) * reach < within_mm
        assert moved(work_mj, within_mm / 4) > 50.0
        assert moved(work_mj, 0.0) > 50.0


@dataclass
class MovingTable:
    """A part that moves by all that the bounds of a grip's loads allow, before it is measured and after."""

    rig: RigFile
    placed: Placed
    rng: np.random.Generator
    load: LoadTrace

    def __call__(self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None]) -> list[Touch]:
        tell(GripPhase.CLOSING)
        bounds = MotionBounds(self.rig, CATALOGUE)
        every = [touched(self.load, finger=item.finger_index) for item in grip]
        motion = bounds.of_grip(every)
        self._move(motion.before)
        felt = [
            replace(touch, trace=self.load) for touch in SimulatedTouches(REACH, self.placed, self.rng)(grip)
        ]
        self._move(motion.after)
        return felt

    def _move(self, motion: Motion) -> None:
        row = [item.object_name for item in CATALOGUE.states].index(self.placed.model.name)
        centre, theta = CATALOGUE.origins_mm[row], self.placed.theta
        share = self.rng.choice([-1.0, 1.0])
        at = self.placed.on_table(centre) + float(motion.shift_mm[row]) * unit(
            self.rng.uniform(0, 2 * math.pi)
        )
        theta += share * float(motion.turn_rad[row])
        x, y = at - turned(centre, theta)
        self.placed = replace(self.placed, x=float(x), y=float(y), theta=theta)


@pytest.mark.parametrize("work", sample([0.02, 0.06], [0.06]))
@pytest.mark.parametrize("seed", sample(range(12), [0]))
def test_a_part_that_moves_within_its_bounds_is_inside_the_answers(seed: int, work: float) -> None:
    rng = np.random.default_rng([30, seed])
    rig = declared(1.0)
    table = MovingTable(rig, place_within(SIX[seed % 6], rng), rng, press(0.4, work))
    result = search(rig, REACH, table, CATALOGUE, seed=seed)
    assert result.outcome in (*ANSWERS, IdentificationVerdict.UNRESOLVED)
    assert result.assumed_holds_n == 1.0
    assert all(bound is not None and bound[0] > 0 for bound in result.motions)
    assert not result.hold_contradicted
    assert result.recognition is not None
    assert holding_truth(result.recognition, table.placed) is not None


def test_a_part_that_fingers_may_push_unnoticed_is_called_moving() -> None:
    rig = declared(0.3)
    rng = np.random.default_rng(31)
    creeping = replace(press(0.4, 0.02, unnoticed_n=0.1), advance_mm=np.full(750, 0.1))
    table = MovingTable(declared(50.0), place_within(SIX[2], rng), rng, creeping)
    result = search(rig, REACH, table, CATALOGUE)
    assert result.outcome is IdentificationVerdict.MOVING
    assert max(bound[0] for bound in result.motions if bound is not None) > 10.0


def test_a_part_that_is_pushed_before_every_grip_is_moving_and_contradicts_what_it_holds() -> None:
    ends = []
    for seed in range(4):
        rng = np.random.default_rng([32, seed])

        def pushed(
            grip: Sequence[FingerApproach],
            tell: Callable[[GripPhase], None],
            rng: np.random.Generator = rng,
            seed: int = seed,
        ) -> list[Touch]:
            tell(GripPhase.CLOSING)
            felt = SimulatedTouches(REACH, place_within(SIX[seed], rng), rng)(grip)
            return [replace(touch, trace=press(0.1, 0.004)) for touch in felt]

        result = search(declared(2.0), REACH, pushed, CATALOGUE, seed=seed)
        ends.append(result.outcome)
        assert result.hold_contradicted == bool(result.moved_before)
    assert ends.count(IdentificationVerdict.MOVING) >= 3, ends


def test_where_a_force_is_declared_no_grip_is_spent_on_detecting_shifts() -> None:
    chooser = GripChooser(RIG, REACH, Strategy.PLANNED, np.random.default_rng(0))
    evidence = GripEvidence(CATALOGUE, resolution_of(RIG))
    evidence.strangers = StrangerEvidence(0.0 * StrangerEvidence.none().agreed)
    assert not chooser.is_confirmed(evidence)
    assert chooser.is_confirmed(replace(evidence, is_bounded=True))


def test_bounds_that_motion_widens_again_are_no_gain() -> None:
    """The same three touches, with the same motion in between, again and again."""
    rng = np.random.default_rng(33)
    placed = place_within(SIX[2], rng)
    touches = SimulatedTouches(REACH, placed, rng)
    every = [item for item in REACH.approaches if touches([item])[0].contact.touched]
    grip = [next(item for item in every if item.finger_index == k) for k in range(3)]
    evidence = GripEvidence(CATALOGUE, resolution_of(RIG))
    count = len(CATALOGUE.states)
    motion = Motion(np.full(count, 0.3), np.full(count, 0.01))
    idle = []
    for _ in range(5):
        evidence.add([touch.contact for touch in touches(grip)], motion)
        idle.append(evidence.idle)
    assert idle[-1] >= 3, idle
    assert evidence.recognition is not None
    assert holding_truth(evidence.recognition, placed) is not None
