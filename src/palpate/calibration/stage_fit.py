"""Fit of the turning stage: its axis and backlash, from touches of a stationary disc.

The fingers are those of a calibration, with their covariance.

In the frame of the ring that carries the fingers the disc turns back about the axis: at a stage angle φ its
centre is at c + R(−φ) (d − c). The fit uses generalised least squares: errors of the fingers' positions, of
an angle or of the disc are common to many touches, and are treated as correlated errors (Schmidt's consider
covariance).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotate
from palpate.calibration.experiment_design import touch_arrays
from palpate.calibration.finger_fit import ReferencePlacement, TouchArrays, predict_residuals, touch_loads
from palpate.calibration.finger_model import FingerModel
from palpate.calibration.measurements import ReferenceDisc, TouchMeasurement
from palpate.calibration.rig_models import KnownFingers
from palpate.config import FingerConfig, StageConfig
from palpate.drivers.kinematics import TICK_RAD

CENTRE, DISC, PLAY = slice(0, 2), slice(2, 4), 4
"""Unknowns: the axis (mm), the disc's place with the stage at 0 (mm), the play either way (rad)."""

_UNKNOWNS = 5
_MAX_ITERATIONS = 12
_STEP_TOLERANCE = 1e-9
_OUTLIER_SIGMAS = 4.5  # standard deviations
_MAX_OUTLIER_SHARE = 0.1  # of all touches
_MAX_REDUCED_CHI_SQUARE = 2.0  # chi square over its degrees of freedom
_MIN_VARIANCE_SHARE = 0.04  # of the expected squares: some 0.002 mm
_CHANCE_PER_TEST = 1e-5  # of one of some ten tests for another cause
_SAME_ANGLE_RAD = math.radians(0.5)  # angles that are nearer are one: the stage's error there is the same
_MIN_ANGLES = 3
_MIN_TURN_DEG = 2.0
_BISECTIONS = 20


@dataclass(frozen=True, eq=False)
class StageTouches:
    """n touches at v stops of the stage: `touches.placing` is the number of the stop.

    `angle_rad` (v,): by the servo. `way` (v,): from which side the stage came, +1 from below, 0 if unknown.
    `angle_covariance` (v, v): of what angles are off by, besides the play where that is on a known side.
    `shared_mm` (n, m): deviations that several touches have in common.
    """

    touches: TouchArrays
    angle_rad: Floats
    way: Floats
    angle_covariance: Floats
    shared_mm: Floats


@dataclass(frozen=True, eq=False)
class StageFit:
    """Unknowns (5,) with their covariance; `residual_mm` (n,); `outlier` (n,): touches that were left out.

    `chi_square` of those that were fitted, with `freedom` degrees, by what is expected of touches beforehand.
    """

    values: Floats
    covariance: Floats
    residual_mm: Floats
    outlier: Bools
    chi_square: float
    freedom: int


def stage_touches(
    touched: Sequence[TouchMeasurement],
    stage: StageConfig,
    models: Sequence[FingerModel],
    specs: Sequence[FingerConfig],
    disc: ReferenceDisc,
) -> StageTouches:
    """Touches as arrays; each stop is a placing of the disc, as its fingers see it.

    Raises InputError if they are of too few angles.
    """
    numbers, stop = np.unique([item.placing for item in touched], return_inverse=True)
    placings = [ReferencePlacement(disc, (0.0, 0.0))] * len(numbers)
    own = [replace(item, placing=int(k)) for item, k in zip(touched, stop, strict=True)]
    reading = np.array([item.stage_rad for item in touched])
    count = np.bincount(stop, minlength=len(numbers))
    angle = np.bincount(stop, reading, minlength=len(numbers)) / np.maximum(count, 1)
    way = np.array([next(item.stage_way for item in own if item.placing == k) for k in range(len(numbers))])
    group = _group_angles(angle)
    _check_angles(angle, way, group, len(own), stage, disc)
    step = TICK_RAD / abs(stage.gear_ratio) / math.sqrt(12)
    unsure = np.where(way == 0, math.radians(stage.backlash_deg) / math.sqrt(3), 0.0)
    error = math.radians(stage.bound_deg) / math.sqrt(3)
    covariance = np.diag(step**2 + unsure**2) + error**2 * (group[:, None] == group)
    give = touch_loads(own, specs).give_sigma_mm
    touches = touch_arrays(own, models, placings, specs)
    shared = [np.where(touches.finger == k, give, 0.0) for k in range(len(models))]
    shared.append(np.full(len(own), disc.tolerance_mm / math.sqrt(3)))
    return StageTouches(touches, angle, way.astype(np.float64), covariance, np.column_stack(shared))


def _check_angles(
    angle_rad: Floats, way: Ints, group: Ints, count: int, stage: StageConfig, disc: ReferenceDisc
) -> None:
    """InputError for stops (v,) or touches that cannot show an axis and a play."""
    met, turned_deg = len(np.unique(group)), math.degrees(float(np.ptp(angle_rad)))
    if met < _MIN_ANGLES or turned_deg < _MIN_TURN_DEG or count <= 2 * _UNKNOWNS:
        raise InputError(
            f"the {disc.name} was met {count} times at {met} stage angles, over {turned_deg:.1f}°: "
            f"the axis needs {_MIN_ANGLES} or more; widen stage.range_deg, or clear its way"
        )
    if not {1, -1} <= set(way.tolist()):
        raise InputError(
            f"the stage's play, up to {stage.backlash_deg:g}° either way by stage.backlash_deg, is too large "
            f"beside the {turned_deg:.1f}° that it turns: on which side it stops is not known; measure the "
            "play, or widen stage.range_deg"
        )


def fit_stage(known: KnownFingers, given: StageTouches, disc: ReferenceDisc, start: Floats) -> StageFit:
    """Unknowns that explain touches best; `start` (5,): to begin with.

    Touches that are more than 4.5 standard deviations off are left out. Expected errors are scaled to what
    the others scatter by. Raises InputError if touches do not agree, with the cause that explains them.
    """
    problem = _Problem(known, given, disc)
    x, used = _reject_outliers(problem, start)
    now = problem.at(x, used, 1.0)
    left_out = int((~used).sum())
    ratio = now.chi_square / now.freedom
    if ratio > _MAX_REDUCED_CHI_SQUARE or not _is_enough(given, used):
        every = np.ones(len(used), dtype=bool)
        _raise_likeliest_cause(problem, problem.at(problem.solved(x, every, 1.0), every, 1.0))
        raise InputError(
            f"touches of the {disc.name} at {len(given.angle_rad)} stops of the stage differ by "
            f"{math.sqrt(ratio):.1f} times what they should, {left_out} of {len(used)} do not agree at all: "
            "does the stage sit tight, and did nothing slide? begin this step again"
        )
    share = _variance_share(problem, now)
    x = problem.solved(x, used, share)
    scaled = problem.at(x, used, share)
    _raise_likeliest_cause(problem, scaled)
    residual = problem.derived(x)[0]
    return StageFit(x, scaled.covariance, residual, ~used, now.chi_square, now.freedom)


@dataclass(frozen=True, eq=False)
class _Linear:
    """The problem round a solution, for the m touches of n that are `used` (n,).

    `rest` (m, m): the weight of what the unknowns cannot explain. `covariance` (5, 5) of the unknowns.
    `per_stop` (m, 2), `per_rad` (m,): derivatives of residuals by the disc's place at their stop, and by the
    ring's angle.
    """

    x: Floats
    used: Bools
    residual_mm: Floats
    rest: Floats
    covariance: Floats
    per_stop: Floats
    per_rad: Floats

    @property
    def chi_square(self) -> float:
        """Chi square of the residuals."""
        return float(self.residual_mm @ self.rest @ self.residual_mm)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the fit."""
        return len(self.residual_mm) - _UNKNOWNS

    def explained(self, columns: Floats) -> tuple[float, Floats]:
        """Fall of chi square with k more unknowns, and these; `columns` (m, k): their slopes."""
        normal = columns.T @ self.rest @ columns
        towards = columns.T @ self.rest @ self.residual_mm
        more: Floats = -np.linalg.lstsq(normal, towards, rcond=1e-9)[0].astype(np.float64)
        return float(-towards @ more), more


_Derived = tuple[Floats, Floats, Floats, Floats, Floats]


class _Problem:
    """Residuals of touches and their derivatives for the five unknowns."""

    def __init__(self, known: KnownFingers, given: StageTouches, disc: ReferenceDisc) -> None:
        self.given = given
        self._known, self._stop = known, given.touches.placing
        self._placings = [ReferencePlacement(disc, (0.0, 0.0))] * len(given.angle_rad)

    def derived(self, x: Floats) -> _Derived:
        """Residuals (n,) and their derivatives: by the unknowns (n, 5), by the fingers' values (n, f), by the
        disc's place at each stop (n, 2) and by the ring's angle there (n,).
        """
        turned = -(self.given.angle_rad - self.given.way * x[PLAY])
        arm = np.tile(x[DISC] - x[CENTRE], (len(turned), 1))
        there = rotate(arm, turned)
        poses = np.column_stack([x[CENTRE] + there, np.zeros(len(turned))])
        residual, _, _, rows = predict_residuals(
            self._known.models, self._placings, self.given.touches, self._known.values, poses
        )
        values = rows[:, : self._known.values.size]
        at = self._known.values.size + 3 * self._stop
        per_pose = np.column_stack([rows[np.arange(len(at)), at], rows[np.arange(len(at)), at + 1]])
        per_disc = rotate(per_pose, -turned[self._stop])  # a pose's shift is the disc's, turned back
        # A ring that is further round sees the disc further back.
        back = np.column_stack([there[:, 1], -there[:, 0]])[self._stop]
        per_rad = (per_pose * back).sum(axis=1)
        play = -self.given.way[self._stop] * per_rad
        slopes = np.column_stack([per_pose - per_disc, per_disc, play])
        return residual, slopes, values, per_disc, per_rad

    def covariance(self, values: Floats, per_rad: Floats, used: Bools, share: float) -> Floats:
        """Expected covariance (m, m) of used touches, that of each by itself times a share; mm²."""
        stop, given = self._stop[used], self.given
        angle = given.angle_covariance[np.ix_(stop, stop)] * np.outer(per_rad[used], per_rad[used])
        fingers = values[used] @ self._known.covariance @ values[used].T
        shared = given.shared_mm[used] @ given.shared_mm[used].T
        result: Floats = fingers + angle + shared + np.diag(share * given.touches.sigma_mm[used] ** 2)
        return result

    def at(self, x: Floats, used: Bools, share: float) -> _Linear:
        """The problem round a solution."""
        return self.linear(x, used, share, self.derived(x))

    def linear(self, x: Floats, used: Bools, share: float, derived: _Derived) -> _Linear:
        """The same, where derivatives are known."""
        residual, slopes, values, per_stop, per_rad = derived
        weight: Floats = np.linalg.inv(self.covariance(values, per_rad, used, share)).astype(np.float64)
        own = slopes[used]
        normal: Floats = np.asarray(np.linalg.inv(own.T @ weight @ own), dtype=np.float64)
        rest: Floats = weight - weight @ own @ normal @ own.T @ weight
        return _Linear(x, used, residual[used], rest, normal, per_stop[used], per_rad[used])

    def solved(self, x: Floats, used: Bools, share: float) -> Floats:
        """Unknowns that fit the used touches best, from `x` on (Gauss-Newton)."""
        for _ in range(_MAX_ITERATIONS):
            residual, slopes, values, _, per_rad = self.derived(x)
            root = np.linalg.cholesky(self.covariance(values, per_rad, used, share))
            step = np.linalg.lstsq(
                np.linalg.solve(root, slopes[used]), np.linalg.solve(root, residual[used]), rcond=None
            )[0]
            x = x - step
            if float(np.abs(step).max()) < _STEP_TOLERANCE:
                break
        return x


def _group_angles(angle_rad: Floats) -> Ints:
    """Numbers (v,) of angles, the same for those that are one."""
    order = np.argsort(angle_rad)
    far = np.diff(angle_rad[order]) > _SAME_ANGLE_RAD
    group = np.empty(len(angle_rad), dtype=np.int64)
    group[order] = np.concatenate([[0], np.cumsum(far)])
    return group


def _reject_outliers(problem: _Problem, start: Floats) -> tuple[Floats, Bools]:
    """Unknowns, and which touches agree with them: the worst is left out, again and again."""
    count = len(problem.given.touches.finger)
    used = np.ones(count, dtype=bool)
    x = problem.solved(start, used, 1.0)
    for _ in range(1 + int(_MAX_OUTLIER_SHARE * count) + 1):
        now = problem.at(x, used, 1.0)
        own = np.sqrt(np.maximum(np.diag(now.rest), 1e-300))
        off = np.abs(now.rest @ now.residual_mm) / own
        worst = int(off.argmax())
        if off[worst] <= _OUTLIER_SIGMAS or used.sum() <= 2 * _UNKNOWNS:
            break
        used = used.copy()
        used[np.flatnonzero(used)[worst]] = False
        x = problem.solved(x, used, 1.0)
    return x, used


def _is_enough(given: StageTouches, used: Bools) -> bool:
    """True if few touches were left out, and not half of any stop's: that would be a disc that moved."""
    stop = given.touches.placing
    left_out, made = np.bincount(stop[~used], minlength=len(given.angle_rad)), np.bincount(stop)
    few = int(left_out.sum()) <= max(1, _MAX_OUTLIER_SHARE * len(used))
    return few and not ((left_out > 1) & (2 * left_out >= made)).any()


def _variance_share(problem: _Problem, now: _Linear) -> float:
    """Share of the expected squares of single touches by which they agree as they should, within limits."""
    low, high = math.log(_MIN_VARIANCE_SHARE), math.log(_MAX_REDUCED_CHI_SQUARE)
    derived = problem.derived(now.x)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        at = problem.linear(now.x, now.used, math.exp(middle), derived)
        low, high = (middle, high) if at.chi_square > at.freedom else (low, middle)
    return math.exp(high)


def _raise_likeliest_cause(problem: _Problem, now: _Linear) -> None:
    """InputError with what explains touches much better than five unknowns do: a disc that moved, a gear."""
    stop = problem.given.touches.placing[now.used]
    causes = []
    for first in range(1, len(problem.given.angle_rad)):
        later = np.where((stop >= first)[:, None], now.per_stop, 0.0)
        fall, moved = now.explained(later)
        causes.append(
            (
                fall - float(chdtri(2, _CHANCE_PER_TEST)),
                f"the disc has moved by about {math.hypot(*moved):.2f} mm while the stage turned: keep it "
                "from sliding (tape, a weight), and begin this step again",
            )
        )
    turned = now.per_rad * problem.given.angle_rad[stop]
    fall, more = now.explained(turned[:, None])
    causes.append(
        (
            fall - float(chdtri(1, _CHANCE_PER_TEST)),
            f"the stage turns {1 + float(more[0]):.4f} times as far as its servo says: correct "
            "stage.gear_ratio, or see that nothing slips",
        )
    )
    beyond, words = max(causes)
    if beyond > 0:
        raise InputError(words)
