"""Forward model of presses (expected column forces and servo currents) and the fit of its unknowns.

The skin is an elastic foundation (Johnson, Contact Mechanics, ch. 4.3) that yields along the radius:
pressure in a direction grows with how far the reference reaches into the undeformed circle there. Travel
past first contact gives the dent, the dent and the bearing give the columns' shares, stiffness gives forces,
gains give counts. Presses at different bearings move one patch over the columns, and each patch grows with
its dent: both tell where the array's middle looks without knowing gains, so that a slope of gains is not
taken for it. Currents tell newtons.

An oblique press also slides along the face. Friction shears the skin, carries the patch back towards the
way, and pushes against it; what carries the tip gives way sideways, which takes some of the dent away. An
arm gives way in any direction, by how much depends on its posture: a share of the dent that each press has
for itself, and one that all have in common, which looks like a softer skin. How much all that is remains
open as far as the rig file leaves it open (`tip.max_friction`, `bounds.deflection_mm_per_n`).

Errors of one level are not independent: where the travel is off, all columns and the current are off
together. What travels scatter by is estimated from the residuals, and each level is decorrelated by it
(generalised least squares). A press as a whole may be off, too, by a share of its travel.
"""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.finger_model import encoder_rate_sigma
from palpate.calibration.idle_statistics import LEVELS, PressAtBearing, PressLevels
from palpate.calibration.rig_models import nominal_model
from palpate.config import FingerConfig
from palpate.drivers.tactile import Description

_COLUMN_NODES, _PATCH_NODES = 4, 12  # nodes of Gauss's rule: pressure is smooth where there is any


@dataclass(frozen=True, eq=False)
class PressureDistribution:
    """Force of n contacts by columns.

    `share` (n, cols) of all force that the skin bears; less than 1 in sum if some of it is beside the
    array. `lean` (n,): what the tip as a whole is pushed with, as a part of the sum of what its skin
    bears; the skin's forces point to the axis, so that they partly cancel.
    """

    share: Floats
    lean: Floats


def distribute_pressure(
    columns_rad: Floats,
    pitch_rad: float,
    towards_rad: Floats,
    dent: Floats,
    curvature: Floats,
) -> PressureDistribution:
    """Distribute contacts over columns at `columns_rad` (cols,), each `pitch_rad` wide.

    `towards_rad` (n,): direction from the axis to the contact, as the columns'. In tip radii: `dent`
    (n,) is the deepest dent, in 0 … 1 (both excluded); `curvature` (n,) is tip radius over the
    reference's, 0 for a flat face.
    """
    half = _half_width(dent, curvature)
    whole = _quadrature(-half, half, dent, curvature, _PATCH_NODES)
    middle = wrap_angle(columns_rad - towards_rad[:, None])
    low = np.clip(middle - pitch_rad / 2, -half[:, None], half[:, None])
    high = np.clip(middle + pitch_rad / 2, -half[:, None], half[:, None])
    by_column = _quadrature(low, high, dent[:, None], curvature[:, None], _COLUMN_NODES)[0]
    return PressureDistribution(by_column / whole[0][:, None], whole[1] / whole[0])


def dent_and_bearing(
    travel_mm: Floats, bearing_rad: Floats, radius_mm: float, curvature_per_mm: Floats
) -> tuple[Floats, Floats]:
    """Deepest dent (mm) and bearing (rad) after a travel past first contact, all (n,).

    `bearing_rad`: direction to the contact from the direction of travel, when the tip just touches.
    Against a disc the tip slides round it on the way: a triangle of the two centres. Dents before
    contact are negative.
    """
    per_mm = curvature_per_mm / (1 + curvature_per_mm * radius_mm)  # 1 / distance of the centres
    ahead, aside = travel_mm * np.cos(bearing_rad), travel_mm * np.sin(bearing_rad)
    nearer = np.sqrt((1 - per_mm * ahead) ** 2 + (per_mm * aside) ** 2)
    dent: Floats = (2 * ahead - per_mm * travel_mm**2) / (1 + nearer)
    turned: Floats = bearing_rad + np.arctan2(per_mm * aside, 1 - per_mm * ahead)
    return dent, turned


def _half_width(dent: Floats, curvature: Floats) -> Floats:
    """Angle from a patch's middle to its end, rad: where the reference crosses the undeformed circle."""
    left = 1 - dent
    cosine = (curvature * (1 + left**2) + 2 * left) / (2 * (curvature * left + 1))
    result: Floats = np.arccos(np.clip(cosine, -1.0, 1.0))
    return result


def _dent(angle: Floats, dent: Floats, curvature: Floats) -> Floats:
    """Dent in tip radii at `angle` from a patch's middle."""
    left = 1 - dent
    centre = curvature * left + 1  # distance to the disc's centre in its radii
    root = np.sqrt(np.maximum(1 - (centre * np.sin(angle)) ** 2, 0.0))
    result: Floats = 1 - (curvature * left**2 + 2 * left) / (centre * np.cos(angle) + root)
    return result


def _quadrature(
    low: Floats, high: Floats, dent: Floats, curvature: Floats, nodes: int
) -> tuple[Floats, Floats]:
    """Integrals over angles `low` … `high` of the dent, and of its part along the patch's middle."""
    place, weight = np.polynomial.legendre.leggauss(nodes)
    half = (high - low)[..., None] / 2
    angle = (high + low)[..., None] / 2 + half * place
    depth = _dent(angle, dent[..., None], curvature[..., None]) * weight * half
    return depth.sum(axis=-1), (depth * np.cos(angle)).sum(axis=-1)


HEADING_BOUND_DEG = 5.0
"""Bound of an array's heading where the rig file gives none."""

_MODEL_SHARE = 0.005 * math.sqrt(LEVELS)  # of the strongest column; the levels of a press share their errors
_MIN_LEVEL_SHARE = 0.2  # of a press's strongest level: levels below count as that one
_DIFFERENCE_STEP = 1e-5  # of differences in place of derivatives
_MIN_DENT_RADII, _MAX_DENT_RADII = 1e-6, 0.9  # tip radii
_SCALE_SIGMA = 0.1  # of dents against the tip's radius: the radius, and what gives way besides the skin
_CROSSTALK_SIGMA = 0.1
_STRETCH_SIGMA = 0.005  # of a press's travel: joints and links that are not as described, the skin's evenness
_MIN_LIT_SHARE = 0.1  # of the strongest column of a press: what a weaker one is off by says little
_FRICTION_SIGMA = 0.05  # of the friction: it is not quite the same all along the slide
_SHEAR_STIFFNESS_SHARE = 0.7  # of the skin's stiffness along a surface to that across it, as of rubber
_CERTAIN_SIGMA = 1e-5  # deviation of what the rig file rules out
_SHARED_UNKNOWNS = 6  # unknowns of the finger as a whole, of which these are the places
_PHASE, _STIFFNESS, _SCALE, _CROSSTALK, _FRICTION, _SOFTNESS = range(_SHARED_UNKNOWNS)
_NUMERIC = (_PHASE, _SCALE, _CROSSTALK, _FRICTION, _SOFTNESS)  # whose derivatives are differences


@dataclass(frozen=True, eq=False)
class PressFit:
    """Fit to n presses with m levels; sigmas are standard deviations, some of logarithms.

    `gain` (cols,) ± `gain_log_sigma`. `friction`: of tip on reference; `softness`: how far the tip gives way
    (a slide's sideways, an arm's all round), over how far the same force dents it. `touch_mm` (n,): travel at
    first contact, from each press's first level; `bearing_rad` (n,) there. `counts` (m, cols): what columns
    should read. `off` (m, cols): what they read more, as a share of the strongest column; 0 where a column is
    not looked at.
    `misfit` (n,): root mean square of what each press is off by in the columns that it lights, in deviations.
    """

    gain: Floats
    gain_log_sigma: Floats
    phase_rad: float
    phase_sigma_rad: float
    stiffness_n_per_mm: float
    stiffness_log_sigma: float
    crosstalk: float
    crosstalk_sigma: float
    friction: float
    friction_sigma: float
    softness: float
    softness_sigma: float
    touch_mm: Floats
    bearing_rad: Floats
    counts: Floats
    off: Floats
    misfit: Floats


def fit_presses(
    presses: Sequence[PressAtBearing],
    levels: PressLevels,
    column_counts: Floats,
    rows_used: Ints,
    noise_counts: float,
    description: Description,
    spec: FingerConfig,
) -> PressFit:
    """Least squares over all levels; `column_counts` (m, cols): mean over the rows that are used.

    `rows_used` (cols,): how many rows that are, 0 for a column that is not looked at. Sigmas are those of the
    levels' stated errors, or as much larger as the residuals are.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    model = _Model(presses, levels, column_counts, rows_used, noise_counts, description, spec)
    x = least_squares(model.residuals, model.start(), model.jacobian, method="lm").x
    model = model.decorrelated(x)
    x = least_squares(model.residuals, x, model.jacobian, method="lm").x
    square = _gram_matrix(model.jacobian(x))
    squares, lit = model.misfits(x)
    sigma = np.sqrt(max(1.0, model.misfit(x)) * np.diag(np.linalg.inv(square)))
    gains, touch, bearing, _, _ = model.parts(x)
    counts = model.counts(x)
    return PressFit(
        gain=np.exp(gains),
        gain_log_sigma=sigma[_SHARED_UNKNOWNS : _SHARED_UNKNOWNS + len(gains)],
        phase_rad=float(x[_PHASE]),
        phase_sigma_rad=float(sigma[_PHASE]),
        stiffness_n_per_mm=math.exp(x[_STIFFNESS]),
        stiffness_log_sigma=float(sigma[_STIFFNESS]),
        crosstalk=float(x[_CROSSTALK]),
        crosstalk_sigma=float(sigma[_CROSSTALK]),
        friction=float(x[_FRICTION]),
        friction_sigma=float(sigma[_FRICTION]),
        softness=float(x[_SOFTNESS]),
        softness_sigma=float(sigma[_SOFTNESS]),
        touch_mm=touch,
        bearing_rad=bearing,
        counts=counts,
        off=np.where(rows_used > 0, (column_counts - counts) / model.strongest, 0.0),
        misfit=np.sqrt(squares.sum(axis=1) / np.maximum(lit.sum(axis=1), 1)),
    )


def _gram_matrix(slopes: Floats) -> Floats:
    """The transposed times itself, without BLAS: its threads cost more than they save here."""
    result: Floats = np.einsum("ki,kj->ij", slopes, slopes)
    return result


class _Model:
    """The unknowns are those of the finger, logarithms of the columns' gains, and four of each press.

    Of a press: travel (mm) and bearing (rad) at first contact, friction (N), and the share by which its dents
    are deeper than its travel says. `strongest` (m, 1): counts of the column with most, or a part of the
    press's most where that is more.
    """

    def __init__(
        self,
        presses: Sequence[PressAtBearing],
        levels: PressLevels,
        column_counts: Floats,
        rows_used: Ints,
        noise_counts: float,
        description: Description,
        spec: FingerConfig,
    ) -> None:
        self._levels, self._read, self._rows_used = levels, column_counts, rows_used
        self._columns_rad, self._radius_mm = np.asarray(description.columns), spec.tip.radius_mm
        self._phase_rad = math.radians(spec.array.heading_deg)
        self._phase_sigma = math.radians(spec.array.heading_bound_deg or HEADING_BOUND_DEG) / math.sqrt(3)
        # Softness: how far the tip gives way, sideways or all round, over how far the same force dents it.
        self._friction = spec.tip.max_friction / 2
        self._softness = spec.bounds.deflection_mm_per_n * spec.tip.stiffness_n_per_mm / 2
        self._gives_all_round = nominal_model(spec).gives_all_round
        own = self._softness / math.sqrt(3) if self._gives_all_round else 0.0
        self._stretch_sigma = math.hypot(_STRETCH_SIGMA, own, encoder_rate_sigma(spec))
        self._load_sigma = np.maximum(
            np.array([self._friction, self._softness]) / math.sqrt(3), _CERTAIN_SIGMA
        )
        self._gain_sigma = spec.array.gain_spread / math.sqrt(3)
        self._bearing = np.array([p.bearing_rad for p in presses])
        self._bearing_sigma = np.array([p.bearing_sigma_rad for p in presses])
        self._curvature = np.array([p.curvature_per_mm for p in presses])[levels.press]
        cols = description.cols
        self._cols, self._presses = cols, len(presses)
        self._exchange = np.eye(cols, k=1) + np.eye(cols, k=-1)
        self._exchange -= np.diag(self._exchange.sum(axis=0))
        self._counts_per_n = description.counts_per_n / description.rows
        strongest = column_counts.max(axis=1)
        most = np.zeros(self._presses)
        np.maximum.at(most, levels.press, strongest)
        # Shallow dents are known to a part of an encoder step only.
        self.strongest = np.maximum(strongest, _MIN_LEVEL_SHARE * most[levels.press])[:, None]
        noise = noise_counts**2 / (levels.samples[:, None] * np.maximum(rows_used, 1))
        # One over the standard deviation of counts, (m, cols); 0 where a column is not looked at.
        sigma = np.sqrt(noise + (_MODEL_SHARE * self.strongest) ** 2)
        self._weight = np.where(rows_used > 0, 1 / sigma, 0.0)
        step = np.array([p.press.push_step_n for p in presses]) / math.sqrt(12)
        self._push_sigma = step[levels.press]
        loaded = np.array([p.press.friction_sigma_n for p in presses])
        self._friction_sigma = np.sqrt(step**2 + (_FRICTION_SIGMA * levels.free_n) ** 2 + loaded**2)
        self._travel_off: Floats = np.zeros((len(levels.press), cols + 1))

    def start(self) -> Floats:
        """Values to begin with: contact and stiffness from straight lines, nominal ones otherwise."""
        total = self._read.sum(axis=1) / self._counts_per_n
        slopes, touch = np.zeros(self._presses), np.zeros(self._presses)
        for press in range(self._presses):
            its = self._levels.press == press
            slope, offset = np.polyfit(self._levels.travel_mm[its], total[its], 1)
            slopes[press] = max(slope, 1e-3)
            touch[press] = np.clip(-offset / slopes[press], -0.5, 0.0)
        firm = float(np.median(slopes / np.cos(self._bearing)))
        shared = [self._phase_rad, math.log(firm), 0.0, 0.0, self._friction, self._softness]
        return np.concatenate(
            [
                shared,
                np.zeros(self._cols),
                touch,
                self._bearing,
                self._levels.free_n,
                np.zeros(self._presses),
            ]
        )

    def parts(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Logarithms of gains, travels and bearings at first contact, frictions, stretches."""
        gains, rest = x[_SHARED_UNKNOWNS : _SHARED_UNKNOWNS + self._cols], x[_SHARED_UNKNOWNS + self._cols :]
        touch, bearing, friction, stretch = rest.reshape(4, self._presses)
        return gains, touch, bearing, friction, stretch

    def counts(self, x: Floats) -> Floats:
        """Expected readings of columns, (m, cols)."""
        gains, touch, bearing, _, stretch = self.parts(x)
        load, _ = self._forces(x[:_SHARED_UNKNOWNS], touch, bearing, stretch)
        result: Floats = load * np.exp(gains) * self._counts_per_n
        return result

    def decorrelated(self, x: Floats) -> "_Model":
        """The same with levels that are off together by what their travels scatter by near `x`.

        What the travel of each is off by is told by what it is off by all in all; its variance goes with one
        over the samples. A press has two levels' worth of unknowns along its travel.
        """
        m, cols = len(self._levels.press), self._cols
        slopes = self.jacobian(x)[: m * (cols + 1)]
        at_touch = _SHARED_UNKNOWNS + cols + self._levels.press
        along = np.column_stack(
            [
                slopes[: m * cols].reshape(m, cols, -1)[np.arange(m), :, at_touch],
                slopes[m * cols :][np.arange(m), at_touch],
            ]
        )
        off = self._by_level(self.residuals(x))
        sure = np.einsum("mk,mk->m", along, along)
        off_mm = np.einsum("mk,mk->m", along, off) / np.maximum(sure, 1e-12)
        freedom = m / max(m - 2 * self._presses, 1)
        variance = freedom * float((sure * self._levels.samples * off_mm**2).sum() / sure.sum())
        result = copy(self)
        result._travel_off = along * np.sqrt(variance / self._levels.samples)[:, None]
        return result

    def misfits(self, x: Floats) -> tuple[Floats, Bools]:
        """Squares (n, cols) of what presses are off by at `x`, 0 in columns that they do not light; lit ones.

        Errors of a column in the levels of one press are taken to be the same: they are summed up.
        """
        press, shape = self._levels.press, (self._presses, self._cols)
        summed, most = np.zeros(shape), np.zeros(shape)
        np.add.at(summed, press, self._by_level(self.residuals(x))[:, :-1])
        np.maximum.at(most, press, np.where(self._rows_used > 0, self.counts(x), 0.0))
        lit = most > _MIN_LIT_SHARE * most.max(axis=1, keepdims=True)
        levels = np.bincount(press, minlength=self._presses)[:, None]
        return np.where(lit, summed**2 / levels, 0.0), lit

    def misfit(self, x: Floats) -> float:
        """Mean square of what lit columns of presses are off by at `x`, or pushes, whichever is larger."""
        squares, lit = self.misfits(x)
        # Each press has its place and its bearing, each column its gain.
        unknowns = 2 * self._presses + int(lit.any(axis=0).sum()) + 2
        freedom = max(int(lit.sum()) - unknowns, int(lit.sum()) // 4, 1)
        pushes = self._by_level(self.residuals(x))[:, -1]
        return max(float(squares.sum()) / freedom, float((pushes**2).mean()))

    def _by_level(self, residuals: Floats) -> Floats:
        """Residuals (m, cols + 1) of counts and pushes."""
        m, cols = len(self._levels.press), self._cols
        counts, pushes = residuals[: m * cols].reshape(m, cols), residuals[m * cols : m * (cols + 1)]
        return np.column_stack([counts, pushes])

    def _apart(self, counts: Floats, pushes: Floats) -> tuple[Floats, Floats]:
        """Values (m, cols, …) and (m, …) less what their levels have in common: inverse square roots.

        The covariance of a level is 1 + h hᵀ, of which h is `_travel_off`.
        """
        off = self._travel_off
        square = np.einsum("mk,mk->m", off, off)
        part = (1 - 1 / np.sqrt(1 + square)) / np.maximum(square, 1e-300)
        common = np.einsum("mc,mc...->m...", off[:, :-1], counts) + (off[:, -1] * pushes.T).T
        common = (part * common.T).T
        counts = counts - np.einsum("mc,m...->mc...", off[:, :-1], common)
        return counts, pushes - (off[:, -1] * common.T).T

    def residuals(self, x: Floats) -> Floats:
        """Residuals in standard deviations: counts (m · cols), pushes (m), what is likely."""
        gains, touch, bearing, friction, stretch = self.parts(x)
        load, push = self._forces(x[:_SHARED_UNKNOWNS], touch, bearing, stretch)
        counts = (load * np.exp(gains) * self._counts_per_n - self._read) * self._weight
        off_n = friction[self._levels.press] + push - self._levels.push_n
        counts, pushes = self._apart(counts, off_n / self._push_sigma)
        likely = [
            [(x[_PHASE] - self._phase_rad) / self._phase_sigma],
            [x[_SCALE] / _SCALE_SIGMA, x[_CROSSTALK] / _CROSSTALK_SIGMA],
            (x[[_FRICTION, _SOFTNESS]] - [self._friction, self._softness]) / self._load_sigma,
            gains / self._gain_sigma,
            (bearing - self._bearing) / self._bearing_sigma,
            (friction - self._levels.free_n) / self._friction_sigma,
            stretch / self._stretch_sigma,
        ]
        return np.concatenate([counts.ravel(), pushes, *likely])

    def jacobian(self, x: Floats) -> Floats:
        """Derivatives of `residuals`. A press's unknowns move its own levels: all presses at once."""
        m, cols, n = len(self._levels.press), self._cols, self._presses
        result = np.zeros((m * (cols + 1) + len(_NUMERIC) + cols + 3 * n, len(x)))
        gains, touch, bearing, _, stretch = self.parts(x)
        shared = x[:_SHARED_UNKNOWNS]
        load, push = self._forces(shared, touch, bearing, stretch)
        to_counts = np.exp(gains) * self._counts_per_n * self._weight
        to_push = 1 / self._push_sigma

        def scaled(load: Floats, push: Floats) -> tuple[Floats, Floats]:
            return load * to_counts, push * to_push

        def moved(shared: Floats, touch: Floats, bearing: Floats, stretch: Floats) -> tuple[Floats, Floats]:
            there = self._forces(shared, touch, bearing, stretch)
            return scaled((there[0] - load) / _DIFFERENCE_STEP, (there[1] - push) / _DIFFERENCE_STEP)

        counts, current = scaled(load, push)
        read = result[: m * cols].reshape(m, cols, -1)
        pushed = result[m * cols : m * (cols + 1)]
        read[..., _STIFFNESS], pushed[:, _STIFFNESS] = counts, current
        for place in _NUMERIC:
            step = np.zeros(_SHARED_UNKNOWNS)
            step[place] = _DIFFERENCE_STEP
            read[..., place], pushed[:, place] = moved(shared + step, touch, bearing, stretch)
        every = np.arange(cols)
        read[:, every, _SHARED_UNKNOWNS + every] = counts
        level, press = np.arange(m), self._levels.press
        at_touch = _SHARED_UNKNOWNS + cols + press
        for k, there in (
            (0, (touch + _DIFFERENCE_STEP, bearing, stretch)),
            (1, (touch, bearing + _DIFFERENCE_STEP, stretch)),
            (3, (touch, bearing, stretch + _DIFFERENCE_STEP)),
        ):
            read[level, :, at_touch + k * n], pushed[level, at_touch + k * n] = moved(shared, *there)
        pushed[level, at_touch + 2 * n] = to_push
        read[:], pushed[:] = self._apart(read, pushed)
        likely = result[m * (cols + 1) :]
        places = np.concatenate([_NUMERIC, _SHARED_UNKNOWNS + every, np.arange(-3 * n, 0)])
        likely[np.arange(len(places)), places] = np.concatenate(
            [
                [1 / self._phase_sigma, 1 / _SCALE_SIGMA, 1 / _CROSSTALK_SIGMA],
                1 / self._load_sigma,
                np.full(cols, 1 / self._gain_sigma),
                1 / self._bearing_sigma,
                1 / self._friction_sigma,
                np.full(n, 1 / self._stretch_sigma),
            ]
        )
        return result

    def _forces(
        self, shared: Floats, touch: Floats, bearing: Floats, stretch: Floats
    ) -> tuple[Floats, Floats]:
        """Force on columns (m, cols) and along the travel (m,), N: means over each level.

        Two places stand for all of a level's: they have its mean and its spread.
        """
        press, spread = self._levels.press, self._levels.spread_mm
        travel, longer = self._levels.travel_mm - touch[press], 1 + stretch[press]
        lower = self._forces_at(longer * (travel - spread), shared, bearing)
        upper = self._forces_at(longer * (travel + spread), shared, bearing)
        return (lower[0] + upper[0]) / 2, (lower[1] + upper[1]) / 2

    def _forces_at(self, travel_mm: Floats, shared: Floats, bearing: Floats) -> tuple[Floats, Floats]:
        """The same for travels past first contact (m,)."""
        press, radius = self._levels.press, self._radius_mm
        free, turned = dent_and_bearing(travel_mm, bearing[press], radius, self._curvature)
        sine, cosine = np.abs(np.sin(turned)), np.cos(turned)
        # Skin sticks as far as the tip has gone along the face, and slips at friction times what presses.
        slid = np.abs(np.tan((turned + bearing[press]) / 2))
        along = np.minimum(_SHEAR_STIFFNESS_SHARE * slid, shared[_FRICTION])
        aside = 1.0 if self._gives_all_round else sine * (sine - along * cosine)
        dent = free / (1 + shared[_SOFTNESS] * aside)
        felt = turned - np.sign(turned) * along * dent / (_SHEAR_STIFFNESS_SHARE * radius)
        depth = np.clip(dent * math.exp(shared[_SCALE]) / radius, _MIN_DENT_RADII, _MAX_DENT_RADII)
        pressed = distribute_pressure(
            self._columns_rad,
            float(self._columns_rad[1] - self._columns_rad[0]),
            felt - self._levels.facing_rad - shared[_PHASE],
            depth,
            self._curvature * radius,
        )
        force = math.exp(shared[_STIFFNESS]) * np.maximum(dent, 0.0)
        share = pressed.share + shared[_CROSSTALK] * (pressed.share @ self._exchange)
        return force[:, None] * share, force * pressed.lean * (cosine + along * sine)
