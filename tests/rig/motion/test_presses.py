"""Presses of slides and arms, quasi-static touch."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
import shapely

from palpate.base.errors import DeviceError, SafetyStop
from palpate.base.geometry import Floats
from palpate.calibration.measurements import LEG_FREE, LEG_IN, LEG_OUT, PressMeasurement, Probe, ServoPath
from palpate.config import load_rig
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.servo_state import ServoState
from palpate.drivers.emulators.mechanics import ArmTruth
from palpate.drivers.kinematics import Turn
from palpate.drivers.tactile.patches import ContactPatch
from palpate.rig.bench import connect
from palpate.rig.motion.creep import measure_quasi_statically
from palpate.rig.motion.guarded_approach import carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.press import _PressMechanics
from palpate.rig.motion.touch import ApproachState, Touch
from palpate.rig.reach.approaches import reach_of
from support.benches.presses import FRICTION_A, HARD_N, ProbedRig, probed_rig
from support.benches.session import emulated_session
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Presses of two fingers at once on the emulated bench, against where they really touch.


def test_two_fingers_press_at_once() -> None:
    """In one test, because a press takes seconds: what comes of it is looked at from all sides."""
    with probed_rig(2) as rig:
        rig.put_disc()
        contacts = rig.head_on()
        presses = rig.prober.press(contacts, 4)
        assert rig.waits()
    assert [press.finger for press in presses] == ["f1", "f2"]
    for press, contact in zip(presses, contacts, strict=True):
        assert press.placing == 4
        check_legs(press)
        check_counts(press)
        check_currents(press)
        check_places(press, contact.end_mm)
    assert 1.5 < rig.hardest_n() <= HARD_N
    assert not any(rig.session.torque().values())
    assert rig.session.rest(0.5) < 0.01


def check_legs(press: PressMeasurement) -> None:
    assert set(press.leg) == {LEG_FREE, LEG_IN, LEG_OUT}
    assert (np.diff(press.leg) >= 0).all()
    assert press.counts.shape == (len(press.leg), 8, 20)
    assert press.travel_mm.shape == press.push_n.shape == press.leg.shape


def check_counts(press: PressMeasurement) -> None:
    """They grow with the dent, and end where they began."""
    felt = press.counts.sum(axis=(1, 2))
    noise = felt[press.leg == LEG_FREE][:50].std()
    going_in = felt[press.leg == LEG_IN]
    assert (np.diff(going_in) > -6 * noise).all()
    assert going_in[-1] > 50 * noise
    assert abs(felt[press.leg == LEG_OUT][-10:].mean()) < 3 * noise


def check_currents(press: PressMeasurement) -> None:
    """They push out going in, and pull going back."""
    current = press.push_n / press.newton_per_a[1]
    assert np.median(current[press.leg == LEG_FREE]) == pytest.approx(FRICTION_A, rel=0.15)
    assert press.free_a[1] == pytest.approx(FRICTION_A, rel=0.15)
    assert math.isnan(press.free_a[0]), "the aim stands"
    assert current[press.leg == LEG_IN].max() > 1.3 * FRICTION_A
    assert np.median(current[press.leg == LEG_OUT][-30:]) == pytest.approx(-FRICTION_A, rel=0.15)
    # 4.1 N·m at 2.3 A (e-Manual), and 100 mm a turn.
    assert press.newton_per_a == pytest.approx((0.0, 4.1 / 2.3 * 2 * math.pi / 0.1))


def check_places(press: PressMeasurement, contact_mm: float) -> None:
    """The contact is felt where it really is: a few tenths of a newton late, and between two looks."""
    first = press.travel_mm[press.leg == LEG_IN][0]
    assert 0.0 < first - contact_mm < 0.4
    assert contact_mm - press.travel_mm[-1] > 1.5


@pytest.fixture
def alone() -> Iterator[ProbedRig]:
    with probed_rig(1) as rig:
        rig.put_disc()
        yield rig


def test_an_array_that_falls_silent_ends_a_press(alone: ProbedRig) -> None:
    """Its cable is cut as soon as it touches."""
    contacts = alone.head_on()
    cable, finger = alone.session.cables["mock://f1"], alone.session.bench.fingers[0]

    def cut() -> None:
        cable.cut = cable.cut or finger.press is not None

    alone.session.clock.on_tick = cut
    with pytest.raises(
        DeviceError, match=r"tactile array f1 .* has sent nothing for 0.15 s while fingers moved"
    ):
        alone.prober.press(contacts, 0)
    alone.hand.close()
    assert not any(alone.session.torque().values())
    assert alone.hardest_n() <= HARD_N


def push_aside_once_it_touches(rig: ProbedRig) -> None:
    """From the first contact on, the first finger's aim is pushed harder than its current can hold."""
    finger = rig.session.bench.fingers[0]
    aim, touched = finger.servos[0], [False]

    def push(_rad: float, rad_s: float) -> float:
        touched[0] = touched[0] or finger.press is not None
        return 2.0 - 0.5 * rad_s if touched[0] else 0.0

    aim.hold(push)


def test_a_press_that_leaves_its_line_is_stopped(alone: ProbedRig) -> None:
    contacts = alone.head_on()
    push_aside_once_it_touches(alone)
    with pytest.raises(SafetyStop, match=r"finger f1 is \d\.\d mm off"):
        alone.prober.press(contacts, 0)
    alone.hand.close()
    assert not any(alone.session.torque().values())
    assert alone.hardest_n() <= HARD_N


# ----------------------------------------------------------------------------------------------------
# What an arm's servos say of a press: force by virtual work, beside torques by levers; one on the bench.

ARMS = load_rig(EXAMPLES / "two-link-rig.toml")
ALONE = ARMS.model_copy(update={"fingers": ARMS.fingers[:1]})
NM_PER_A = 4.1 / 2.3  # e-Manual of the XM430-W350
GEAR = 3.0


def test_push_is_what_torques_at_both_joints_do() -> None:
    """A force that grows along the way, plus friction that is each joint's own: by levers, not by rates."""
    friction_a = np.array([0.03, 0.02])
    with connect(emulated_session(seed=1, rig=ALONE, empty=True).bench_rig) as hand:
        finger = hand.fingers[0]
        arm = finger.kinematics
        assert isinstance(arm, ArmKinematics)
        run = ApproachState.of(finger, reach_of(ALONE, aims=13).approaches[4], Turn())
        travel = np.linspace(40.0, 43.0, 120)
        servos = np.array([arm.servos_rad(run.line, float(at)) for at in travel])
        force_n = np.maximum(0.0, 3.0 * (travel - 42.0))
        leg = np.where(force_n == 0, LEG_FREE, LEG_IN)
        against = run.line.direction_rad + math.pi
        current = np.empty((len(travel), 2))
        for k, (near, far) in enumerate(servos.tolist()):
            tip = complex(*arm.centre_mm((near, far)))
            axes = (complex(*arm.base_mm), complex(*arm.elbow_mm((near, far))))
            pushed = force_n[k] * complex(math.cos(against), math.sin(against))
            torques = [((tip - axis).conjugate() * pushed).imag / 1000 / GEAR for axis in axes]
            current[k] = -np.array(torques) / NM_PER_A
        current += friction_a * np.sign(servos[-1] - servos[0])
        drive = _PressMechanics(run, servos, current, leg.astype(np.int64))
    assert drive.travel_mm == pytest.approx(travel, abs=1e-6)
    assert np.abs(drive.aside_mm).max() < 1e-6
    assert drive.free_a == pytest.approx(friction_a)
    free_n = drive.push_n[leg == LEG_FREE]
    assert np.ptp(free_n) < 0.02
    assert drive.push_n[leg == LEG_IN] - free_n[-1] == pytest.approx(force_n[leg == LEG_IN], abs=0.01)


@pytest.mark.slow
def test_an_arm_touches_and_presses_on_the_bench() -> None:
    """Where its true kinematics meet the disc, it feels it; its push grows as its array's counts do."""
    with probed_rig(1, seed=3, rig=ALONE) as rig:
        rig.put_disc()
        finger = rig.session.bench.fingers[0]
        truth, (outline,) = finger.truth, finger.outlines
        assert isinstance(truth, ArmTruth)
        assert outline is not None
        disc = shapely.Polygon(outline.start)
        number, contact_mm = nearest(truth, rig.prober.approaches, disc)
        (touched,) = rig.prober.touch([Probe(number, contact_mm + 8.0)], 2)
        (press,) = rig.prober.press([Probe(number, contact_mm)], 2)
    assert touched is not None
    assert (abs(touched.aim_way), abs(touched.elbow_way)) == (1, 1)
    flanks = (touched.aim_way * truth.shoulder.play_rad, touched.elbow_way * truth.elbow.play_rad)
    gap = disc.distance(shapely.Point(tip_of(truth, np.array(touched.servos_rad), flanks)))
    assert gap - truth.tip_radius_mm + touched.force_n / truth.stiffness_n_per_mm == pytest.approx(
        0, abs=0.06
    )
    assert set(press.leg) == {LEG_FREE, LEG_IN, LEG_OUT}
    assert press.free_a == pytest.approx((0.028, 0.028), abs=0.012), (
        "0.05 N·m of friction at 4.1 N·m for 2.3 A"
    )
    into = press.leg == LEG_IN
    counts_n = press.counts.sum(axis=(1, 2)) / finger.array.description.counts_per_n
    slope = np.polyfit(counts_n[into], press.push_n[into], 1)[0]
    assert slope == pytest.approx(1.0, abs=0.15)
    assert press.push_n[into].max() - press.push_n[press.leg == LEG_FREE].mean() > 2.0


def nearest(truth: ArmTruth, approaches: Sequence[ServoPath], disc: shapely.Polygon) -> tuple[int, float]:
    """The approach that meets the disc most head-on, and after how many mm."""
    found = []
    for number, item in enumerate(approaches):
        travels = np.linspace(0.0, item.length_mm, 400)
        places = [tip_of(truth, servos, (0.0, 0.0)) for servos in item.servos_at(travels)]
        gaps = np.array([disc.distance(shapely.Point(place)) for place in places]) - truth.tip_radius_mm
        if (gaps < 0).any():
            first = int(np.argmax(gaps < 0))
            way = np.subtract(places[first], places[first - 8])
            towards = np.subtract(disc.centroid.coords[0], places[first])
            cosine = float(way @ towards) / math.hypot(*way) / math.hypot(*towards)
            found.append((-cosine, number, float(travels[first])))
    _, number, contact_mm = min(found)
    return number, contact_mm


def tip_of(truth: ArmTruth, servos: Floats, flanks: tuple[float, float]) -> tuple[float, float]:
    """True tip centre for servo angles, joints behind by `flanks`."""
    first = truth.heading_rad + (servos[0] - truth.shoulder.zero_rad) / GEAR - flanks[0]
    second = first + (servos[1] - truth.elbow.zero_rad) / GEAR - flanks[1]
    x, y = truth.base_mm
    x += truth.upper_mm * math.cos(first) + truth.fore_mm * math.cos(second)
    y += truth.upper_mm * math.sin(first) + truth.fore_mm * math.sin(second)
    return float(x), float(y)


# ----------------------------------------------------------------------------------------------------
# Measuring on the move, on the emulated bench: against where the shaft really was.

TICK = 2 * math.pi / 4096
SLIDE = 12


@dataclass(eq=False)
class Watched:
    """A rig whose slide is watched while it creeps: where the shaft was (ticks) whenever the host looked."""

    rig: ProbedRig
    shaft: list[float] = field(default_factory=list)
    read: list[float] = field(default_factory=list)
    rested: float = math.nan

    def measure(
        self, hand: Hand, runs: Sequence[ApproachState]
    ) -> list[tuple[ApproachState, ContactPatch | None]]:
        self.shaft.clear()
        self.read.clear()
        self.rested = runs[0].servos[1] / TICK
        states = hand.states

        def watched(servos: Sequence[Servo]) -> dict[int, ServoState]:
            found = states(servos)
            self.shaft.append(self.rig.session.servos[SLIDE].shaft_rad / TICK)
            self.read.append(found[SLIDE].position_rad / TICK)
            return found

        hand.states = watched  # type: ignore[method-assign]
        try:
            return measure_quasi_statically(hand, runs)
        finally:
            hand.states = states  # type: ignore[method-assign]

    def touch(self, oblique: int) -> Touch:
        """Touch on an approach so many beside the one that meets the disc head-on."""
        rig, hand = self.rig, self.rig.hand
        (contact,) = rig.head_on()
        reach = reach_of(hand.rig, aims=81)
        number = reach.of_stage(reach.middle_rad)[contact.approach + oblique]
        (touch,) = carry_out_grip(hand, [reach.approaches[number]], lambda _: None, self.measure)
        return touch


@pytest.fixture(scope="module")
def watched() -> Iterator[Watched]:
    with probed_rig(1) as rig:
        rig.put_disc()
        yield Watched(rig)


@pytest.mark.parametrize("oblique", sample([0, 6, -9], [6]))
def test_rounding_averages_out(watched: Watched, oblique: int) -> None:
    """Eight steps count, from the third on; resting positions are off by up to half a step."""
    touch = watched.touch(oblique)
    gone = np.abs(np.round(np.array(watched.read) - watched.rested))
    counted = (gone >= 3) & (gone <= 10)
    assert counted.sum() > 30
    assert touch.servos[1] / TICK == pytest.approx(np.array(watched.shaft)[counted].mean(), abs=0.06)
    assert touch.patch is not None
    assert 0.3 < touch.patch.force_n < 1.5
    assert watched.rig.waits()


def test_a_slide_that_cannot_go_on_is_measured_where_it_rests(watched: Watched) -> None:
    """Its current is no more than friction needs."""
    rig = watched.rig
    allowed_a = rig.goal_current(SLIDE) * 2.69e-3  # unit of Goal Current (e-Manual)

    def weakened(
        hand: Hand, runs: Sequence[ApproachState]
    ) -> list[tuple[ApproachState, ContactPatch | None]]:
        slide = runs[0].finger.drive.closing_servos[0]
        slide.set_goal_current_a(0.02)
        try:
            return measure_quasi_statically(hand, runs)
        finally:
            slide.set_goal_current_a(allowed_a)

    watched.measure = weakened  # type: ignore[method-assign]
    try:
        touch = watched.touch(0)
    finally:
        del watched.measure
    assert touch.patch is not None
    contact = rig.prober.approaches[rig.head_on()[0].approach]
    assert touch.servos[1] == pytest.approx(rig.contact_rad(contact), abs=0.02)


def test_a_creep_that_presses_too_hard_stops_everything() -> None:
    with probed_rig(1) as rig:
        rig.put_disc()
        watched = Watched(rig)
        closing = rig.hand.rig.closing.model_copy(update={"max_force_n": 0.75})

        def careful(
            hand: Hand, runs: Sequence[ApproachState]
        ) -> list[tuple[ApproachState, ContactPatch | None]]:
            hand._array_guard._closing = closing
            return measure_quasi_statically(hand, runs)

        watched.measure = careful  # type: ignore[method-assign]
        with pytest.raises(SafetyStop, match=r"finger f1 felt 0\.\d N, above max_force_n = 0.75 N"):
            watched.touch(0)
        rig.hand.close()
        assert not any(rig.session.torque().values())
        assert rig.hardest_n() < HARD_N
