"""Chi-square tests of touches: is a reference as described and at rest, and is a calibration still valid?

Inconsistent data are refused, not fitted: errors name the reference and say what to do.

*Drift.* The touched object is the identified one of a session, or a disc placed for this purpose (`palpate
check --touch`); its pose has been fitted. The calibration states by how much touches may differ; a larger
difference is either chance, at a stated rate, or a change of the rig.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    predict_residuals,
)
from palpate.calibration.finger_model import RADIUS, FingerModel
from palpate.calibration.frame_alignment import align_to_nominal, nominal_poses, poses_of
from palpate.calibration.measurements import TouchMeasurement
from palpate.config import CalibrationFile, FingerConfig
from palpate.config.calibration_finger import FingerCalibration
from palpate.drivers.kinematics import TICK_RAD

_MAX_OUTLIER_SHARE = 0.1  # of a placing's touches
_MAX_REDUCED_CHI_SQUARE = 2.0  # chi square over its degrees of freedom
_SIZE_SIGMAS = 4.5  # standard deviations of a reference's size


def check_still(
    first: Sequence[TouchMeasurement],
    again: Sequence[TouchMeasurement],
    models: Sequence[FingerModel],
    placing: ReferencePlacement,
) -> None:
    """Compare touches with the same ones made later; InputError if the reference has moved between them."""
    model = {item.name: item for item in models}
    later = {item.finger: item for item in again}
    for item in first:
        other = later.get(item.finger)
        if other is None:
            raise InputError(
                f"{_name_of(placing)}: finger {item.finger} touched it at first and missed it later; "
                "see if it has moved: if so, keep it from sliding (tape, a weight), else tighten the "
                "finger's screws; then begin this placing again"
            )
        off, limit = model[item.finger].repeat_mm(
            np.array(item.servos_rad), np.array(other.servos_rad), item.facing_rad
        )
        if off > limit:
            raise InputError(
                f"{_name_of(placing)}: finger {item.finger} met it {off:.2f} mm from where it had met it "
                f"before, and {limit:.2f} mm can be explained; see if it has moved: if so, keep it from "
                "sliding (tape, a weight), else tighten the finger's screws; then begin this placing again"
            )


@dataclass(frozen=True, eq=False)
class FittedTouches:
    """Touches of references that fingers were placed by: what was told of both, touches, and their fit."""

    specs: Sequence[FingerConfig]
    models: Sequence[FingerModel]
    placings: Sequence[ReferencePlacement]
    touches: TouchArrays
    fit: FingerFit


def check_fit(given: FittedTouches) -> None:
    """Refuse a fit whose touches do not agree with the references, or that leaves what the rig file allows.

    InputError names the reference or the finger.
    """
    placings, touches, fit = given.placings, given.touches, given.fit
    for number, placing in enumerate(placings):
        mine = touches.placing == number
        out = int((fit.outlier & mine).sum())
        if out > max(1, _MAX_OUTLIER_SHARE * int(mine.sum())):
            raise InputError(
                f"{_name_of(placing)}: {out} of {int(mine.sum())} touches do not agree with its shape at any "
                "place: it has moved between touches, or is not what was given; measure it, fix it, and "
                "begin again"
            )
    _check_sizes(given)
    _check_bounds(given)
    ratio = fit.chi_square / fit.freedom
    if ratio > _MAX_REDUCED_CHI_SQUARE:
        share = (fit.residual_mm / touches.sigma_mm) ** 2
        worst = max(range(len(placings)), key=lambda k: float(share[touches.placing == k].mean()))
        raise InputError(
            f"touches differ from the references by {math.sqrt(ratio):.1f} times what they should, most on "
            f"{_name_of(placings[worst])}: is its shape as given, and did it stand still?"
        )


def estimate_growth(given: FittedTouches, which: Bools) -> tuple[float, float]:
    """Excess radius of the references of some placings (n,), as touches show it, and its deviation; mm.

    The value of one more unknown, by linear least squares round the fit.
    """
    touches, fit = given.touches, given.fit
    rows = predict_residuals(given.models, given.placings, touches, fit.values, fit.poses)[3]
    used = touches.used & ~fit.outlier
    weight = 1 / touches.sigma_mm[used] ** 2
    slope = rows[used]
    grown = -which[touches.placing[used]].astype(float)
    explained = slope @ (fit.covariance @ (slope.T @ (weight * grown)))
    own = float((weight * grown * (grown - explained)).sum())
    if own <= 1e-9:
        return 0.0, math.inf
    # At the best fit the residuals are weighed so that no unknown could explain more of them.
    found = -float((weight * grown * fit.residual_mm[used]).sum()) / own
    return found, 1 / math.sqrt(own)


def _check_sizes(given: FittedTouches) -> None:
    placings = given.placings
    names = list(dict.fromkeys(placing.reference.name for placing in placings))
    if len(names) < 2:
        return
    for name in names[1:]:
        which = np.array([placing.reference.name == name for placing in placings])
        tolerance = sum(
            next(p.reference.tolerance_mm for p in placings if p.reference.name == each)
            for each in (names[0], name)
        )
        found, sigma = estimate_growth(given, which)
        if abs(found) > _SIZE_SIGMAS * sigma + tolerance:
            raise InputError(
                f"the {name} seems {abs(found):.3f} ± {sigma:.3f} mm too {_size_word(found)} all round "
                f"beside the {names[0]}: one of them has another size than given; measure both"
            )


def _check_bounds(given: FittedTouches) -> None:
    """Refuse values that the rig file rules out: they would come from references of a wrong size."""
    specs, models, fit = given.specs, given.models, given.fit
    sigma = np.sqrt(np.diag(fit.covariance))
    nominal, found = nominal_poses(specs), poses_of(fit.values)
    frame = align_to_nominal(nominal, found)
    for k, (spec, model) in enumerate(zip(specs, models, strict=True)):
        radius, bound = float(fit.values[k, RADIUS]), spec.tip.radius_bound_mm
        if abs(radius - spec.tip.radius_mm) > bound + 4 * float(sigma[k * fit.values.shape[1] + RADIUS]):
            raise InputError(
                f"finger {model.name}: its tip would have a radius of {radius:.2f} mm, and the rig file says "
                f"{spec.tip.radius_mm:g} ± {bound:g}: measure the tip; if the rig file is right, measure the "
                "references"
            )
        place = frame.place(found[k])
        away, bound = math.dist(place.base_mm, spec.base_mm), spec.bounds.base_mm
        if away > 2 * bound + 0.3:
            raise InputError(
                f"finger {model.name}: its base would be {away:.2f} mm from base_mm, and the rig file says "
                f"within {bound:g}: measure base_mm; if it is right, measure the references"
            )
        turned = abs(math.remainder(place.heading_rad - nominal[k].heading_rad, 2 * math.pi))
        bound = spec.bounds.heading_deg
        if turned > 2 * math.radians(bound) + 0.005:
            raise InputError(
                f"finger {model.name}: its heading would be {math.degrees(turned):.2f}° from heading_deg, "
                f"and the rig file says within {bound:g}°: measure heading_deg; if it is right, measure "
                "the references"
            )


def _size_word(growth: float) -> str:
    return "large" if growth > 0 else "small"


def _name_of(placing: ReferencePlacement) -> str:
    x, y = placing.about_mm
    return f"{placing.reference.name} near ({x:.0f}, {y:.0f}) mm"


FALSE_ALARM_RATE = 0.001
"""Share of looks at a rig that has not changed in which it is said to have changed, if errors are normal."""

_RANK_TOLERANCE = 1e-9
_MIN_SCATTER_MM = 1e-4  # nothing agrees better


@dataclass(frozen=True)
class ContactUncertainty:
    """Standard uncertainties of a finger's contacts, mm.

    `scatter_mm`: each touch by itself, along the surface's normal. `fit_mm`: all touches alike, in an unknown
    direction. `along_mm` and `across_mm`: each touch by itself, along and across the
    direction of travel. `sigmas`: bounds
    of what is as good as normally distributed are so many deviations.
    """

    scatter_mm: float
    fit_mm: float
    along_mm: float
    across_mm: float
    sigmas: float


@dataclass(frozen=True, eq=False)
class SurfaceContacts:
    """Contacts of n touches with a surface: finger (n,), its outward normal and the travel (n, 2), in W.

    `dent_mm` (n,): by how much the tip's dent may be other than it is taken to be. `tolerance_mm`: how far
    the surface may be from what is said of it. `shared_mm` (n, m): standard deviations along the normal that
    some contacts have in common, a column for each cause; None without.
    """

    finger: Ints
    normal: Floats
    travel: Floats
    dent_mm: Floats
    tolerance_mm: float
    shared_mm: Floats | None = None


@dataclass(frozen=True, eq=False)
class DriftTest:
    """Distances of n touches from a known shape at its best pose, with their bounds; mm.

    `residual_mm` (n,): what is left of each, outward positive. `rms_mm` is their root mean square and
    `expected_rms_mm` what the calibration lets expect. `drifted`: `chi_square` with `freedom` degrees is
    larger than chance makes it, but for a share `FALSE_ALARMS`.
    """

    residual_mm: Floats
    rms_mm: float
    expected_rms_mm: float
    chi_square: float
    freedom: int

    @property
    def drifted(self) -> bool:
        """True if the touches differ by more than the calibration explains."""
        return self.chi_square > float(chdtri(self.freedom, FALSE_ALARM_RATE))


def contact_uncertainties(calibration: CalibrationFile, *, at_rest: bool) -> list[ContactUncertainty] | None:
    """Standard uncertainties of every finger by a calibration; None if it does not bound the contacts of all.

    `at_rest`: touches were measured with slides at rest, anywhere in an encoder step; else on the move, as
    those of the calibration itself.
    """
    residuals = calibration.residuals
    if residuals is None or residuals.degrees_of_freedom == 0:
        return None
    scatter = residuals.rms_mm * math.sqrt(residuals.touches / residuals.degrees_of_freedom)
    found = [
        _finger_uncertainty(item, scatter, calibration.coverage, at_rest=at_rest)
        for item in calibration.fingers
    ]
    known = [item for item in found if item is not None]
    return known if len(known) == len(found) else None


def _finger_uncertainty(
    finger: FingerCalibration, scatter_mm: float, coverage: float, *, at_rest: bool
) -> ContactUncertainty | None:
    # The way back from bounds to deviations that `bound_contacts` went. Overshoot is left out: that of slow
    # touches is in what they differ by. Slides rest at the same end of a step time and again, so half a step
    # is not divided by anything. Play may be taken up anywhere.
    if finger.bounds is None or finger.place is None:
        return None
    parts = finger.bounds.parts_mm
    play_mm = parts.play / math.sqrt(3)
    mm_per_turn = finger.place.push_mm_per_turn
    if mm_per_turn is None:
        # Either joint moves the tip in any direction.
        along_mm = across_mm = math.hypot(play_mm, parts.quantisation) if at_rest else play_mm
    else:
        step_mm = abs(mm_per_turn) * TICK_RAD / (4 * math.pi)
        aim_mm = math.sqrt(max(parts.quantisation**2 - step_mm**2, 0.0))
        along_mm = step_mm if at_rest else 0.0
        across_mm = math.hypot(play_mm, aim_mm) if at_rest else play_mm
    return ContactUncertainty(
        scatter_mm=max(scatter_mm, _MIN_SCATTER_MM),
        fit_mm=parts.fit / math.sqrt(float(chdtri(2, 1 - coverage))),
        along_mm=along_mm,
        across_mm=across_mm,
        sigmas=float(ndtri((1 + coverage) / 2)),
    )


def touch_covariance(surface: SurfaceContacts, uncertainties: Sequence[ContactUncertainty]) -> Floats:
    """Covariance (n, n) of touches' distances from the surface, mm²; `uncertainties`: of every finger."""
    scatter, fit, along, across, sigmas = np.array(
        [(item.scatter_mm, item.fit_mm, item.along_mm, item.across_mm, item.sigmas) for item in uncertainties]
    )[surface.finger].T
    cosine = (surface.normal * surface.travel).sum(axis=1)
    same = surface.finger[:, None] == surface.finger
    shared = np.where(same, surface.normal @ surface.normal.T, 0.0) * np.outer(fit, fit)
    own = scatter**2 + (surface.dent_mm / sigmas) ** 2 + surface.tolerance_mm**2 / 3
    own += (cosine * along) ** 2 + (1 - cosine**2) * across**2
    result: Floats = shared + np.diag(own)
    if surface.shared_mm is not None:
        result = result + surface.shared_mm @ surface.shared_mm.T
    return result


def compare_touches(residual_mm: Floats, slopes: Floats, covariance: Floats) -> DriftTest | None:
    """Compare residuals (n,) mm, near the best pose, with their covariance (n, n); None if too few.

    `slopes` (n, k): derivatives of the residuals by the pose's k unknowns; what the pose can explain does not
    count (generalised least squares). Too few: not more touches than they determine unknowns.
    """
    root = np.linalg.cholesky(covariance)
    white, whitened = np.linalg.solve(root, residual_mm), np.linalg.solve(root, slopes)
    own, sizes, _ = np.linalg.svd(whitened, full_matrices=False)
    explained = own[:, sizes > _RANK_TOLERANCE * max(float(sizes.max(initial=0.0)), 1e-300)]
    freedom = len(residual_mm) - explained.shape[1]
    if freedom < 1:
        return None
    rest = np.eye(len(residual_mm)) - explained @ explained.T
    left = root @ (rest @ white)
    expected = float(np.trace(root @ rest @ root.T))
    return DriftTest(
        residual_mm=left,
        rms_mm=float(np.sqrt((left**2).mean())),
        expected_rms_mm=math.sqrt(expected / len(left)),
        chi_square=float(white @ rest @ white),
        freedom=freedom,
    )
