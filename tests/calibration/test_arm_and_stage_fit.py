"""The fits of arms and of a stage."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotation_matrix
from palpate.calibration.arm_model import (
    ELBOW_PLAY,
    ELBOW_ZERO,
    ENCODERS,
    FORE,
    SHOULDER_PLAY,
    UPPER,
    ArmModel,
)
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
)
from palpate.calibration.finger_model import HEADING, RADIUS
from palpate.calibration.finger_step import calibrate_stage, place_disc
from palpate.calibration.frame_alignment import BasePose, align_fit, align_to_nominal, nominal_poses
from palpate.calibration.measurements import ReferenceDisc, ReferencePlate, TouchMeasurement
from palpate.calibration.rig_models import KnownFingers, nominal_models
from palpate.calibration.stage_fit import CENTRE, PLAY, StageFit, fit_stage, stage_touches
from palpate.config import RigFile, StageConfig, load_rig
from palpate.config.calibration_file import StageCalibration
from palpate.drivers.kinematics import TICK_RAD, Encoder
from support.benches.rigs import STAGE
from support.benches.touched_references import FRESH, PRIOR_SIGMA, SPECS, laid, met, models, servos_rad
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Fit of arms, by touches that are worked backwards: from a place on the reference to the servos of an arm.
#
# The arm's inverse kinematics here are closed forms of their own, with plays on the flanks from which joints
# came.

ARMS = load_rig(EXAMPLES / "fresh-arms.toml")
DISC = ReferenceDisc("disc", 25.0)
PLATE = ReferencePlate("plate", np.array([[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0]]))
PLACINGS = [
    ReferencePlacement(DISC, (0.0, 40.0)),
    ReferencePlacement(DISC, (-35.0, -20.0)),
    ReferencePlacement(DISC, (35.0, -20.0)),
    ReferencePlacement(PLATE, (0.0, -38.0)),
    ReferencePlacement(PLATE, (33.0, 19.0)),
    ReferencePlacement(PLATE, (-33.0, 19.0)),
]
ARM_SIGMA_MM = 0.02
TOUCHES = 8  # of each finger at each placing


def arm_models(encoder_deg: float = 0.0) -> list[ArmModel]:
    bounds = {"encoder_deg": encoder_deg}
    found = nominal_models([finger.replace_in_tables(bounds=bounds) for finger in ARMS.fingers])
    arms = [model for model in found if isinstance(model, ArmModel)]
    assert len(arms) == 3
    return arms


@dataclass(frozen=True, eq=False)
class Touched:
    """True values (3, 17), true poses (6, 3), and touches of them."""

    values: Floats
    poses: Floats
    touches: TouchArrays
    encoder_deg: float

    def fit(self) -> FingerFit:
        begin = self.poses + np.array([0.4, -0.3, 0.0])
        known = arm_models(self.encoder_deg)
        return fit_fingers(known, PLACINGS, self.touches, (np.array([m.prior for m in known]), begin))


def servos_of(model: ArmModel, own: Floats, centre: Floats, ways: Floats) -> Floats:
    """Servo angles (2,) that put the tip's true centre there (law of cosines; elbows bend to the left)."""
    x, y = centre - own[:2]
    bend = math.acos((x * x + y * y - own[UPPER] ** 2 - own[FORE] ** 2) / (2 * own[UPPER] * own[FORE]))
    first = math.atan2(y, x) - math.atan2(own[FORE] * math.sin(bend), own[UPPER] + own[FORE] * math.cos(bend))
    shoulder = math.remainder(first - own[HEADING], 2 * math.pi) + ways[0] * own[SHOULDER_PLAY]
    elbow = bend - own[ELBOW_ZERO] + ways[1] * own[ELBOW_PLAY]
    angles = model.zero_rad + model.gear_ratio * np.array([shoulder, elbow])
    encoders = (Encoder(tuple(waves)) for waves in own[model.encoders].reshape(2, 4).tolist())
    return np.array([encoder.read_rad(angle) for encoder, angle in zip(encoders, angles, strict=True)])


def touched_arms(seed: int, encoder_deg: float = 0.0) -> Touched:
    """Truth as likely as the priors say, touched on the side that faces each finger."""
    rng, known = np.random.default_rng(seed), arm_models(encoder_deg)
    own, encoders = slice(0, ENCODERS.start), rng.spawn(1)[0]
    values = np.array([m.prior for m in known])
    for row, m in zip(values, known, strict=True):
        row[own] = rng.multivariate_normal(m.prior[own], m.covariance[own, own])
        row[ENCODERS] = encoders.normal(0.0, np.sqrt(np.diag(m.covariance)[ENCODERS]))
    values[:, SHOULDER_PLAY : SHOULDER_PLAY + 2] = rng.uniform(0.3, 1.0, (3, 2)) * math.radians(0.02)
    poses = np.array([[*p.about_mm, 0.0] for p in PLACINGS]) + rng.uniform(-4, 4, (6, 3)) * [1, 1, 0.1]
    poses[:3, 2] = 0.0
    rows = []
    for number, placing in enumerate(PLACINGS):
        for finger, (model, own) in enumerate(zip(known, values, strict=True)):
            towards = math.atan2(*(own[:2] - poses[number, :2])[::-1])
            for turn in rng.uniform(-0.7, 0.7, TOUCHES):
                normal = np.array([math.cos(towards + turn), math.sin(towards + turn)])
                if placing.reference is PLATE:
                    normal, point = on_plate(poses[number], normal, float(rng.uniform(-25, 25)))
                else:
                    point = poses[number, :2] + DISC.radius_mm * normal
                dent = float(rng.uniform(0.1, 0.5))
                centre = point + (own[RADIUS] - dent + rng.normal(0, ARM_SIGMA_MM)) * normal
                ways = rng.choice([-1.0, 1.0], 2)
                rows.append((finger, number, *servos_of(model, own, centre, ways), *ways, dent))
    table = np.array(rows)
    whole, count = table[:, :2].astype(np.int64), len(table)
    given = TouchArrays(
        whole[:, 0],
        whole[:, 1],
        table[:, 2:4],
        table[:, 4:6],
        table[:, 6],
        np.full(count, ARM_SIGMA_MM),
        np.ones(count, dtype=bool),
    )
    return Touched(values, poses, given, encoder_deg)


def on_plate(pose: Floats, wanted: Floats, along_mm: float) -> tuple[Floats, Floats]:
    """The normal of the face that looks that way most, and a point on it."""
    turn = rotation_matrix(float(pose[2]))
    faces = turn @ np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    normal = faces[:, int(np.argmax(wanted @ faces))]
    return normal, pose[:2] + 40.0 * normal + along_mm * np.array([-normal[1], normal[0]])


def test_derivatives_of_arms_are_those_of_the_residuals() -> None:
    given = touched_arms(1, 1.5)
    own, there = given.values, given.poses
    _, _, _, rows = predict_residuals(arm_models(), PLACINGS, given.touches, own, there)
    step = 1e-6
    for finger in range(3):
        for column in range(own.shape[1]):
            off = np.zeros_like(own)
            off[finger, column] = step
            ahead, behind = (
                predict_residuals(arm_models(), PLACINGS, given.touches, own + side * off, there)[0]
                for side in (1.0, -1.0)
            )
            found = rows[:, finger * own.shape[1] + column]
            assert found == pytest.approx((ahead - behind) / (2 * step), abs=2e-5)


def test_true_values_leave_nothing_but_noise() -> None:
    given = touched_arms(2, 1.5)
    residual = predict_residuals(arm_models(), PLACINGS, given.touches, given.values, given.poses)[0]
    assert residual.std() == pytest.approx(ARM_SIGMA_MM, rel=0.2)


@pytest.mark.parametrize(("encoder_deg", "most_mm"), [(0.0, 0.2), (1.5, 0.5)])
def test_errors_of_arms_are_those_that_deviations_state(encoder_deg: float, most_mm: float) -> None:
    """Base, heading, radius, links and elbow in the hand frame, over several rigs: a chi-square test."""
    squares, largest = [], 0.0
    for seed in range(6):
        given = touched_arms(seed, encoder_deg)
        hand = align_fit(ARMS.fingers, given.fit())
        drawn = nominal_poses(ARMS.fingers)
        frame = align_to_nominal(drawn, [BasePose((v[0], v[1]), v[HEADING]) for v in given.values.tolist()])
        for finger in range(3):
            truth = given.values[finger].copy()
            there = frame.place(BasePose((truth[0], truth[1]), truth[HEADING]))
            truth[:2], truth[HEADING] = there.base_mm, there.heading_rad
            off = (hand.values[finger] - truth)[: ELBOW_ZERO + 1]
            off[HEADING] = math.remainder(off[HEADING], 2 * math.pi)
            own = hand.of(finger)[: ELBOW_ZERO + 1, : ELBOW_ZERO + 1]
            squares.append(float(off @ np.linalg.solve(own, off)))
            largest = max(largest, math.hypot(off[0], off[1]))
    freedom = 7 * len(squares)
    assert 0.005 < chi2.sf(sum(squares), freedom) < 0.995
    assert largest < most_mm


# ----------------------------------------------------------------------------------------------------
# Fit of the turning stage: a disc whose touches at several stage angles are worked out by closed forms.
#
# The ring's frame sees the disc turn back about the axis; where tips then meet it, `touched_references` says.

BACKLASH_DEG, BOUND_DEG, CENTRE_BOUND_MM = 0.1, 0.02, 1.0
STAGED = StageConfig(
    **STAGE | {"backlash_deg": BACKLASH_DEG, "bound_deg": BOUND_DEG, "centre_bound_mm": CENTRE_BOUND_MM}
)
RIG: RigFile = FRESH.model_copy(update={"stage": STAGED})
TOUR_DEG = (-30.0, -15.0, 0.0, 15.0, 30.0, 15.0, 0.0, -15.0, -30.0)
OFFSETS_MM = (-13.0, 11.0)
SIGMA_MM, FORCE_N = 0.008, 0.3
KNOWN = 0.01  # of what priors leave of a fresh rig's fingers: what a calibration of them leaves


@dataclass(frozen=True)
class Truth:
    """How a stage really is: its axis, its play, its gear, and how the disc slides at a stop."""

    centre_mm: Floats
    play_rad: float
    gear: float = 1.0
    slides_at: int | None = None
    slides_mm: tuple[float, float] = (0.0, 0.0)
    grown_mm: float = 0.0


def drawn_truth(rng: np.random.Generator) -> Truth:
    away, bearing = CENTRE_BOUND_MM * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    centre = np.array(STAGED.centre_mm) + away * np.array([math.cos(bearing), math.sin(bearing)])
    return Truth(centre, math.radians(rng.uniform(0, BACKLASH_DEG)))


def known_fingers() -> KnownFingers:
    """Fingers whose calibration has left little of what a drawing leaves."""
    found = models()
    sigma = np.tile(KNOWN * np.array(PRIOR_SIGMA), len(found))
    return KnownFingers(found, np.array([model.prior for model in found]), np.diag(sigma**2))


def touched(
    truth: Truth, rng: np.random.Generator, tour_deg: tuple[float, ...] = TOUR_DEG
) -> list[TouchMeasurement]:
    """Touches at all stops of a tour; fingers, angles, servos and surfaces are off as they may be."""
    known = known_fingers()
    off = rng.multivariate_normal(np.zeros(known.values.size), known.covariance)
    values = known.values + off.reshape(known.values.shape)
    about = np.array(place_disc(RIG, DISC)) + rng.uniform(-5, 5, 2)
    errors = {angle: math.radians(BOUND_DEG) * rng.uniform(-1, 1) for angle in set(tour_deg)}
    found, before = [], 0.0
    for stop, angle_deg in enumerate(tour_deg):
        way = int(np.sign(angle_deg - before))
        before = angle_deg
        step = TICK_RAD / STAGED.gear_ratio
        drive = math.radians(angle_deg) + rng.uniform(-1, 1) * step
        ring = truth.gear * drive - way * truth.play_rad + errors[angle_deg]
        slid = truth.slides_mm if truth.slides_at is not None and stop >= truth.slides_at else (0.0, 0.0)
        rel = about + np.array(slid) - truth.centre_mm
        c, s = math.cos(ring), math.sin(ring)
        seen = truth.centre_mm + np.array([c * rel[0] + s * rel[1], c * rel[1] - s * rel[0]])
        where = laid(DISC, float(seen[0]), float(seen[1]), 0.0, truth.grown_mm)
        for finger, offset in ((f, o) for f in range(len(values)) for o in OFFSETS_MM):
            own, to = values[finger], seen - values[finger][:2]
            direction = math.atan2(to[1], to[0]) + offset / math.hypot(*to)
            stiffness = SPECS[finger].tip.stiffness_n_per_mm
            meeting = met(own[:2], direction, where, own[3] - FORCE_N / stiffness + rng.normal(0, SIGMA_MM))
            assert meeting is not None
            aim, slide = servos_rad(own, finger, direction, meeting.travel_mm, 1.0)
            found.append(
                TouchMeasurement(
                    SPECS[finger].name,
                    stop,
                    (aim, slide),
                    1,
                    meeting.oblique_rad,
                    math.radians(3.0),
                    FORCE_N,
                    0.02,
                    stage_rad=round(drive / step) * step,
                    stage_way=way,
                )
            )
    return found


def fitted(touches: list[TouchMeasurement], disc: ReferenceDisc = DISC) -> StageFit:
    known = known_fingers()
    given_ = stage_touches(touches, STAGED, known.models, FRESH.fingers, disc)
    start = np.array([*STAGED.centre_mm, *place_disc(RIG, disc), 0.0])
    return fit_stage(known, given_, disc, start)


def calibrated(
    touches: list[TouchMeasurement], rig: RigFile = RIG, disc: ReferenceDisc = DISC
) -> StageCalibration:
    return calibrate_stage(rig, known_fingers(), FRESH.fingers, touches, disc, 0.0, 0.999)


def test_errors_are_those_that_deviations_state() -> None:
    """Axis and play over many rigs: a chi-square test of normalised errors, and the bounds."""
    squares = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        truth = drawn_truth(rng)
        touches = touched(truth, rng)
        fit = fitted(touches)
        off = np.array([*(fit.values[CENTRE] - truth.centre_mm), fit.values[PLAY] - truth.play_rad])
        own = fit.covariance[np.ix_([0, 1, PLAY], [0, 1, PLAY])]
        squares.append(float(off @ np.linalg.solve(own, off)))
        found = calibrated(touches)
        assert math.dist(found.centre_mm, truth.centre_mm) <= found.centre_bound_mm < 0.1
        bound_deg = found.backlash_deg + 3.3 * found.backlash_sigma_deg
        assert math.degrees(truth.play_rad) <= bound_deg
    assert 0.005 < chi2.sf(sum(squares), 3 * len(squares)) < 0.995


@given(seed=st.integers(0, 2**31), play=st.floats(0.0, BACKLASH_DEG), far=st.floats(0.0, 1.0))
@settings(max_examples=15)
def test_the_truth_is_within_its_bounds(seed: int, play: float, far: float) -> None:
    rng = np.random.default_rng(seed)
    truth = replace(drawn_truth(rng), play_rad=math.radians(play))
    truth = replace(truth, centre_mm=np.array(STAGED.centre_mm) + np.array([0.0, far]))
    found = calibrated(touched(truth, rng))
    assert math.dist(found.centre_mm, truth.centre_mm) <= 1.3 * found.centre_bound_mm
    assert abs(found.backlash_deg - play) <= 5 * found.backlash_sigma_deg


def test_a_disc_that_slides_is_noticed() -> None:
    """Along its rim as seen from the axis, where a slide looks like play, and towards the axis."""
    for stop in (1, 5, 8):
        for slides in ((0.15, 0.0), (0.0, 0.15), (0.1, -0.1)):
            rng = np.random.default_rng(stop)
            truth = replace(drawn_truth(rng), slides_at=stop, slides_mm=slides)
            with pytest.raises(InputError, match=r"the disc has moved by about 0\.\d\d mm"):
                fitted(touched(truth, rng))


def test_a_gear_that_is_another_is_noticed() -> None:
    for gear in (0.99, 1.02):
        rng = np.random.default_rng(3)
        with pytest.raises(InputError, match=r"turns (0\.9[89]|1\.0[12])\d\d times as far as its servo"):
            fitted(touched(replace(drawn_truth(rng), gear=gear), rng))


def test_one_wrong_touch_is_left_out() -> None:
    rng = np.random.default_rng(5)
    truth = drawn_truth(rng)
    touches = touched(truth, rng)
    aim, slide = touches[10].servos_rad
    touches[10] = replace(touches[10], servos_rad=(aim, slide + 0.02))
    found = calibrated(touches)
    assert found.outliers == 1
    assert math.dist(found.centre_mm, truth.centre_mm) <= found.centre_bound_mm


def test_a_disc_of_another_size_within_its_tolerance_shifts_no_axis() -> None:
    rng = np.random.default_rng(6)
    disc = replace(DISC, tolerance_mm=0.03)
    truth = replace(drawn_truth(rng), grown_mm=0.03)
    found = calibrated(touched(truth, rng), disc=disc)
    assert found.centre_bound_mm > 0.03
    assert math.dist(found.centre_mm, truth.centre_mm) <= found.centre_bound_mm


def test_what_contradicts_the_rig_file_is_refused() -> None:
    rng = np.random.default_rng(7)
    truth = replace(drawn_truth(rng), play_rad=math.radians(0.09))
    touches = touched(truth, rng)
    narrow = RIG.model_copy(update={"stage": STAGED.model_copy(update={"backlash_deg": 0.05})})
    with pytest.raises(InputError, match=r"play would be 0\.0\d+ ± 0\.00\d° .* says 0\.05° at most") as play:
        calibrated(touches, narrow)
    x, y = truth.centre_mm.tolist()
    away = STAGED.model_copy(update={"centre_mm": (x + 1.5, y)})
    with pytest.raises(InputError, match=r"axis would be 1\.5\d mm from centre_mm, .* within 1,") as centre:
        calibrated(touches, RIG.model_copy(update={"stage": away}))
    assert "\n" not in str(play.value) + str(centre.value)


def test_touches_that_turn_the_other_way_are_refused() -> None:
    rng = np.random.default_rng(8)
    swapped = [replace(item, stage_way=-item.stage_way) for item in touched(drawn_truth(rng), rng)]
    with pytest.raises(InputError, match="further than its servo, from either side"):
        calibrated(swapped)


def test_an_axis_needs_several_angles() -> None:
    rng = np.random.default_rng(9)
    with pytest.raises(
        InputError, match=r"was met 12 times at 2 stage angles, over 30\.\d°: the axis needs 3"
    ):
        calibrated(touched(drawn_truth(rng), rng, (-15.0, 15.0)))


def test_a_play_needs_stops_from_both_sides() -> None:
    rng = np.random.default_rng(11)
    unknown = [replace(item, stage_way=0) for item in touched(drawn_truth(rng), rng)]
    with pytest.raises(InputError, match=r"play, up to 0\.1° either way .* too large beside the 60\.\d°"):
        fitted(unknown)


def test_derivatives_are_those_of_the_residuals() -> None:
    """By the step of the fit itself: from a start that is a millimetre off it comes to the same place."""
    rng = np.random.default_rng(10)
    touches, known = touched(drawn_truth(rng), rng), known_fingers()
    given_ = stage_touches(touches, STAGED, known.models, FRESH.fingers, DISC)
    near, far = [3.0, -2.0, *place_disc(RIG, DISC), 0.0], [4.5, -3.0, -30.0, 30.0, 0.002]
    starts = [np.array(near), np.array(far)]
    one, other = (fit_stage(known, given_, DISC, start).values for start in starts)
    assert one == pytest.approx(other, abs=1e-7)


def test_the_disc_is_put_where_fingers_see_it_inside_the_workspace() -> None:
    for centre in ((3.0, -2.0), (0.0, 0.0), (40.0, 10.0), (-60.0, 0.0)):
        rig = RIG.model_copy(update={"stage": STAGED.model_copy(update={"centre_mm": centre})})
        x, y = place_disc(rig, DISC)
        assert math.dist((x, y), centre) == pytest.approx(50.0)
        for angle in np.radians([-30.0, 0.0, 30.0]).tolist():
            rel = complex(x, y) - complex(*centre)
            seen = complex(*centre) + rel * complex(math.cos(angle), -math.sin(angle))
            assert abs(seen) <= RIG.workspace.radius_mm - DISC.radius_mm - 5.0
    assert ReferencePlacement(DISC, (x, y)).reference is DISC
