"""Fit of the turning stage: a disc whose touches at several stage angles are worked out by closed forms.

The ring's frame sees the disc turn back about the axis; where tips then meet it, `touched_references` says.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quick_rig import STAGE
from scipy.stats import chi2
from touched_references import FRESH, PRIOR_SIGMA, SPECS, laid, met, models, servos_rad

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.reference import ReferenceDisc
from palpate.calibration.stage_fit import CENTRE, PLAY, KnownFingers, StageFit, fit_stage, stage_touches
from palpate.calibration.stage_step import calibrate_stage, place_disc
from palpate.config import RigFile, StageConfig
from palpate.config.calibration_file import StageCalibration
from palpate.drivers.kinematics import TICK_RAD

DISC = ReferenceDisc("disc", 25.0)
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
@settings(max_examples=15, deadline=None)
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
