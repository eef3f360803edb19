"""Estimators of servos and drives: backlash, friction, homing against hard stops, stop latency.

Backlash and friction are derived from slow presses, in and back: on the way back the tip stands still until
the drive has taken up the backlash, so that the same force occurs at two servo angles. Homing compares
stalls against hard stops with their known distances. A finger that meets something runs on until the contact
is detected, the stop is sent and it stands: that is its latency, and part of it is the wait between two
readings of the array.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.calibration.measurements import LEG_FREE, LEG_IN, LEG_OUT, PressMeasurement, StopMeasurement
from palpate.config import Overshoot, SlideFingerConfig
from palpate.config.calibration_finger import StopsCalibration
from palpate.drivers.kinematics import TICK_RAD

_FORCE_SLICES = 8  # of the force, each of which weighs the same
_MIN_SLICES = 4  # that both legs must have met
_MIN_FORCE_SHARE, _MAX_FORCE_SHARE = (
    0.15,
    0.9,
)  # of the largest force: near it, servo and skin are turning back
_NOISE_SIGMAS = 4.0  # standard deviations that keep the turning point's samples out
_CURVE_DEGREE = 3  # of the curve from force to place


@dataclass(frozen=True)
class Backlash:
    """Half backlash of a slide (half of what lies between its flanks), ± a standard deviation; mm."""

    half_mm: float
    sigma_mm: float


def estimate_backlash(press: PressMeasurement, force: Floats, lag_samples: float = 0.0) -> Backlash:
    """Half backlash by one press; `force` (n,): any measure of the load that grows with it.

    `lag_samples`: by how many samples the force is older than the angle beside it, 0.5 where it is the mean
    of all frames since the sample before. It would count as backlash, by speed × time.

    Place is fitted as one curve of the force for both legs, plus the half backlash going in, less it going
    back. Every slice of the force weighs the same in each leg, so that neither an uneven pace nor noise of
    the force, which flattens the curve, moves one leg against the other. Encoder steps average out. What else
    is lost between servo and tip, a drive that winds up under its friction, cannot be distinguished and is
    counted: it is lost motion all the same. A skin that pushes back less than it was pushed hides backlash
    instead, by half the difference of its dents at one force; the deviation, which is that of single slices,
    shows such a thing in part. Raises InputError if the two legs have too little in common.
    """
    number = np.arange(len(press.travel_mm))
    place = np.interp(number - lag_samples, number, press.travel_mm)
    chosen, leg, slice_of = _select_samples(press, force)
    place, load = place[chosen], force[chosen]
    weight = (
        1
        / np.bincount(leg * _FORCE_SLICES + slice_of, minlength=2 * _FORCE_SLICES)[
            leg * _FORCE_SLICES + slice_of
        ]
    )
    side = np.where(leg == 0, 1.0, -1.0)
    curve = np.polynomial.chebyshev.chebvander(_to_unit_interval(load), _CURVE_DEGREE)
    columns = np.column_stack([side, curve])
    root = np.sqrt(weight)
    found = np.linalg.lstsq(columns * root[:, None], place * root, rcond=None)[0]
    off = (place - columns @ found) * side * weight
    by_slice = np.bincount(slice_of, off, minlength=_FORCE_SLICES)[np.unique(slice_of)] / 2
    steps = len(np.unique(np.round(press.travel_mm[chosen] / press.step_mm)))
    step_mm = press.step_mm / math.sqrt(12 * steps)
    scatter = math.sqrt(float((by_slice**2).sum()) / (len(by_slice) - 1))
    return Backlash(max(0.0, float(found[0])), math.hypot(scatter, step_mm))


def combine_backlash(plays: Sequence[Backlash]) -> Backlash:
    """Backlash of a slide from several presses: their median, and how far one more may be off it.

    The deviation is that of the presses among one another, because backlash differs from place to place, and
    what a single one is uncertain by. ValueError for none.
    """
    if not plays:
        raise ValueError("backlash is combined from at least one press")
    half = np.array([play.half_mm for play in plays])
    middle = float(np.median(half))
    spread = 1.4826 * float(np.median(np.abs(half - middle)))
    own = float(np.median([play.sigma_mm for play in plays]))
    return Backlash(middle, math.hypot(spread, own / math.sqrt(len(plays))))


def _select_samples(press: PressMeasurement, force: Floats) -> tuple[Bools, Ints, Ints]:
    """Samples (n,) that count; of those the leg (0 in, 1 out) and the slice of force."""
    noise = float(np.std(force[press.leg == LEG_FREE])) if (press.leg == LEG_FREE).sum() > 1 else 0.0
    legs = [force[press.leg == leg] for leg in (LEG_IN, LEG_OUT)]
    if min(len(leg) for leg in legs) < _FORCE_SLICES:
        raise _too_little(press)
    largest = min(float(np.quantile(leg, 0.98)) for leg in legs)
    hi = min(_MAX_FORCE_SHARE * largest, largest - _NOISE_SIGMAS * noise)
    lo = max(_MIN_FORCE_SHARE * largest, _NOISE_SIGMAS * noise)
    if not lo < hi:
        raise _too_little(press)
    slice_of = np.floor((force - lo) / (hi - lo) * _FORCE_SLICES).astype(np.int64)
    both = np.intersect1d(slice_of[press.leg == LEG_IN], slice_of[press.leg == LEG_OUT])
    both = both[(both >= 0) & (both < _FORCE_SLICES)]
    if len(both) < _MIN_SLICES:
        raise _too_little(press)
    chosen: Bools = np.isin(press.leg, [LEG_IN, LEG_OUT]) & np.isin(slice_of, both)
    return chosen, (press.leg[chosen] == LEG_OUT).astype(np.int64), slice_of[chosen]


def _to_unit_interval(values: Floats) -> Floats:
    """Values moved to -1 … 1."""
    middle = (values.min() + values.max()) / 2
    result: Floats = (values - middle) / max(float(np.ptp(values)) / 2, 1e-12)
    return result


def _too_little(press: PressMeasurement) -> InputError:
    return InputError(
        f"finger {press.finger}, placing {press.placing}: going in and going back, its press measured "
        "too few of the same forces to show the slide's backlash; press harder or more slowly"
    )


_MOTION_WINDOW_SAMPLES = 5  # samples over which a slide must have moved on by an encoder step
_MIN_MOVING_SAMPLES = 8  # moving samples
_SIGNIFICANT_SIGMAS = 3.0  # standard errors from which on a current has a direction


@dataclass(frozen=True)
class Friction:
    """Force along the way of a finger that moves on freely, N: the median of samples.

    `direction`: +1 if currents push the tip on, as they must; -1 if they pull, so that the finger was
    pushed or its direction is not what the rig file says; 0 if currents cannot be told from none.
    """

    push_n: float
    direction: int


def estimate_friction(presses: Sequence[PressMeasurement]) -> Friction:
    """Friction from the free legs of a finger's presses, by samples in which it moves on.

    Median, and the deviation that a normal distribution with their quartiles would have: stiction at
    the start, and places where a carriage catches, are rare. Raises InputError if too few samples move.
    """
    moving = [press.push_n[_moves_on(press)] for press in presses]
    push = np.concatenate(moving) if moving else np.empty(0)
    if len(push) < _MIN_MOVING_SAMPLES:
        name = presses[0].finger if presses else "?"
        raise InputError(
            f"finger {name}: before it touched, it moved in {len(push)} samples only; {_MIN_MOVING_SAMPLES} "
            "are needed to tell its friction; begin presses further away from the reference"
        )
    middle = float(np.median(push))
    lower, upper = np.quantile(push, [0.25, 0.75])
    sigma = float(upper - lower) / 1.349
    significant = abs(middle) > _SIGNIFICANT_SIGMAS * sigma / np.sqrt(len(push))
    return Friction(middle, int(np.sign(middle)) if significant else 0)


def _moves_on(press: PressMeasurement) -> Bools:
    """Samples (n,) of the free leg before and after which the finger moves on."""
    free = np.flatnonzero(press.leg == LEG_FREE)
    result = np.zeros(len(press.leg), dtype=bool)
    if len(free) < 2 * _MOTION_WINDOW_SAMPLES:
        return result
    place = press.travel_mm[free]
    before = place[_MOTION_WINDOW_SAMPLES:-_MOTION_WINDOW_SAMPLES] - place[: -2 * _MOTION_WINDOW_SAMPLES]
    after = place[2 * _MOTION_WINDOW_SAMPLES :] - place[_MOTION_WINDOW_SAMPLES:-_MOTION_WINDOW_SAMPLES]
    steady = (before > press.step_mm / 2) & (after > press.step_mm / 2)
    result[free[_MOTION_WINDOW_SAMPLES:-_MOTION_WINDOW_SAMPLES][steady]] = True
    return result


_TRAVEL_SIGMAS = 5.0  # standard deviations


@dataclass(frozen=True, eq=False)
class StopStalls:
    """Servo angles (rad) at which a slide stalled against its back stop (n,) and its front stop (m,).

    `stops_mm`: distances from the base to the tip's centre at either stop.
    """

    stops_mm: tuple[float, float]
    back_rad: Floats
    front_rad: Floats

    def means_rad(self) -> Floats:
        """Mean at the back and at the front stop."""
        return np.array([self.back_rad.mean(), self.front_rad.mean()])

    def mean_sigmas_rad(self) -> Floats:
        """Standard deviations of the means (2,).

        An encoder that reads the same at every stall is off by the same part of a step: repeating does not
        make the uncertainty smaller than that.
        """
        off = np.concatenate([self.back_rad - self.back_rad.mean(), self.front_rad - self.front_rad.mean()])
        single = math.sqrt(float((off**2).sum()) / max(len(off) - 2, 1))
        counts = np.array([len(self.back_rad), len(self.front_rad)])
        result: Floats = np.hypot(single / np.sqrt(counts), TICK_RAD / math.sqrt(12))
        return result


@dataclass(frozen=True)
class Homing:
    """Travel and zero with standard deviations: distance = zero_mm + mm_per_rad · servo angle.

    The distance is that of the middle of the play: a tip that is pushed back, as in a touch, is nearer to
    the base by the half.
    """

    mm_per_rad: float
    mm_per_rad_sigma: float
    zero_mm: float
    zero_sigma_mm: float


def fit_homing(spec: SlideFingerConfig, stalls: StopStalls, backlash: Backlash) -> Homing:
    """Travel and zero of a slide from its stalls.

    The drive that presses the carriage against the back stop has gone past it by the half backlash, towards
    the base; at the front stop as much outwards. What else yields under the stall, a belt or a rail, acts
    alike: stall at little current, or count it to the backlash. Raises InputError if a stop was not tried, or
    if travel or direction is not what the rig file says.
    """
    servo = f"finger {spec.name}, slide (ID {spec.slide.dxl_id})"
    if not (len(stalls.back_rad) and len(stalls.front_rad)):
        raise InputError(
            f"{servo} was stalled {len(stalls.back_rad)} times at its back and {len(stalls.front_rad)} times "
            "at its front stop; homing needs both; repeat it"
        )
    if float(np.diff(stalls.means_rad())[0]) * spec.slide.mm_per_rad <= 0:
        raise InputError(
            f"{servo} met its front stop where the back one should be: it turns the other way than "
            "the rig file says; change the sign of slide.mm_per_turn, or the servo's Drive Mode"
        )
    (zero, scale), covariance = line_through_stops(stalls, backlash, (-1.0, 1.0))
    zero_sigma, scale_sigma = np.sqrt(np.diag(covariance)).tolist()
    described, spread = spec.slide.mm_per_rad, spec.slide.mm_per_turn_spread
    turned = abs(float(np.diff(stalls.means_rad())[0]))
    spread += 2 * math.radians(spec.bounds.encoder_deg) / turned  # off one way here, the other way there
    if abs(scale / described - 1) > spread + _TRAVEL_SIGMAS * scale_sigma / abs(described):
        raise InputError(
            f"{servo} moves {2 * math.pi * scale:.3f} mm per turn between its stops; the rig file says "
            f"{spec.slide.mm_per_turn:.3f} mm ± {100 * spread:.2g} %, with bounds.encoder_deg; check "
            "slide.stops_mm and slide.mm_per_turn, and that nothing held the slide before its stops"
        )
    return Homing(float(scale), scale_sigma, float(zero), zero_sigma)


def line_through_stops(
    stalls: StopStalls, backlash: Backlash, halves: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Zero (mm) and travel (mm/rad) of a slide, (2,), and their covariance (2, 2).

    `halves`: how many half backlashes the drive is beyond the back and the front stop, outwards positive,
    when it stalls: -1 and 1 as seen from the middle of the play, -2 and 0 from its flank in a touch.
    """
    halves_of = np.array(halves)
    inverse = np.linalg.inv(np.column_stack([np.ones(2), stalls.means_rad()]))
    line = inverse @ (np.array(stalls.stops_mm) + halves_of * backlash.half_mm)
    # Angles err each by itself, both ends by the same backlash.
    errors = np.diag((line[1] * stalls.mean_sigmas_rad()) ** 2)
    errors += backlash.sigma_mm**2 * np.outer(halves_of, halves_of)
    return line, inverse @ errors @ inverse.T


_MIN_STOPS = 3  # stops that are faster than a touch
_FASTER = 1.5  # times as fast as a touch, to count
_SETTLE_MARGIN = 1.5  # times the longest of a few


def fit_stops(
    stops: Sequence[StopMeasurement], step_mm: float, touch_speed_mm_s: float, coverage: float
) -> StopsCalibration:
    """Fit one latency to the stops of a finger, and bound how far and how long it goes on.

    `touch_speed_mm_s`: that of the touches at `contact_mm`; `step_mm`: by what an encoder step moves the tip.

    A slow touch runs on as well, and dents what it touches, so a stop is further than it by (speed − touch
    speed) × latency. Stops weigh as the wait for the next look and the encoder's steps let them. The bound
    covers one more stop with probability `coverage`: Student's, one-sided, with a deviation of no less than
    that wait has, and no less than the mean plus half the wait. Overshoots go by growing speed, mm beyond
    where the slowest touch stands, and hold for the speeds that were tried: faster, braking adds to them.
    Raises InputError for too few stops.
    """
    used = [stop for stop in stops if stop.speed_mm_s > _FASTER * touch_speed_mm_s]
    if len(used) < _MIN_STOPS:
        name = stops[0].finger if stops else "?"
        raise InputError(
            f"finger {name}: {len(used)} stops were faster than {_FASTER:g} times a touch; {_MIN_STOPS} are "
            "needed to tell its latency; stop it more often at closing.approach_speed_mm_s"
        )
    speed = np.array([stop.speed_mm_s for stop in used])
    wait = np.array([stop.samples_s for stop in used])
    further = np.array([stop.stood_mm - stop.contact_mm for stop in used])
    known = _deviations_s(speed, touch_speed_mm_s, wait, step_mm)
    each = further / (speed - touch_speed_mm_s)
    latency = max(0.0, float(np.average(each, weights=known**-2.0)))
    bound = _bound_s(each, latency, known, float(wait.max()), coverage)
    return StopsCalibration(
        latency_s=latency,
        latency_bound_s=bound,
        settle_s=_settle_s(stops, step_mm),
        overshoots=_overshoots_by_speed(speed, further + touch_speed_mm_s * latency, bound, step_mm),
    )


def _settle_s(stops: Sequence[StopMeasurement], step_mm: float) -> float:
    """Longest time from a stop that was sent to standing still, from the slowest speed, with some room.

    It is for touches, which are slower still; from higher speeds a slide takes longer to brake.
    """
    slowest = min((stop.speed_mm_s for stop in stops), default=0.0)
    stops = [stop for stop in stops if stop.speed_mm_s == slowest]
    ran_on = [(abs(stop.stood_mm - stop.felt_mm) + step_mm) / stop.speed_mm_s for stop in stops]
    return _SETTLE_MARGIN * max(ran_on, default=0.0)


def _deviations_s(speed: Floats, touch_speed: float, wait: Floats, step_mm: float) -> Floats:
    """Standard deviations (n,) of single latencies: waits of both touches, steps of both angles."""
    waits = (speed**2 + touch_speed**2) * wait**2 / 12
    result: Floats = np.sqrt(waits + step_mm**2 / 6) / (speed - touch_speed)
    return result


def _bound_s(each: Floats, latency: float, known: Floats, wait: float, coverage: float) -> float:
    """Prediction bound on the latency of one more stop.

    What the readings' steps add to the scatter makes the mean uncertain, but is no part of a stop.
    """
    n = len(each)
    worse = max(1.0, math.sqrt(float((((each - latency) / known) ** 2).sum()) / (n - 1)))
    own, of_mean = wait / math.sqrt(12), 1 / math.sqrt(float((known**-2.0).sum()))
    reach = float(stdtrit(n - 1, coverage)) * worse * math.hypot(own, of_mean)
    return latency + max(reach, wait / 2)


def _overshoots_by_speed(speed: Floats, beyond: Floats, bound_s: float, step_mm: float) -> list[Overshoot]:
    """One for each speed; the bound has room for an encoder step and is never below what was measured."""
    rows = []
    for each in np.unique(speed):
        largest = float(beyond[speed == each].max())
        bound = max(float(each) * bound_s + step_mm, largest)
        rows.append(Overshoot(speed_mm_s=float(each), largest_mm=max(largest, 0.0), bound_mm=bound))
    return rows
