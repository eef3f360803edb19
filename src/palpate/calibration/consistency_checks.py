"""Consistency checks of touches: whether a reference is as described, and whether it stands still.

What is inconsistent is refused, not fitted: errors name the reference and what to do.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    predict_residuals,
)
from palpate.calibration.finger_model import RADIUS, FingerModel
from palpate.calibration.frame_alignment import align_to_nominal, nominal_poses, poses_of
from palpate.calibration.measurements import TouchMeasurement
from palpate.config import FingerConfig

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
                f"{_name_of(placing)}: finger {item.finger} touched it at first and missed it later: it has "
                "moved; put it back, keep it from sliding, and begin this placing again"
            )
        off, limit = model[item.finger].repeat_mm(
            np.array(item.servos_rad), np.array(other.servos_rad), item.facing_rad
        )
        if off > limit:
            raise InputError(
                f"{_name_of(placing)}: finger {item.finger} met it {off:.2f} mm from where it had met it "
                f"before, and {limit:.2f} mm can be explained: it has moved between touches; keep it from "
                "sliding (tape, a weight), and begin this placing again"
            )


def check_fit(
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touches: TouchArrays,
    fit: FingerFit,
) -> None:
    """Refuse a fit whose touches do not agree with the references, or that leaves what the rig file allows.

    InputError names the reference or the finger.
    """
    for number, placing in enumerate(placings):
        mine = touches.placing == number
        out = int((fit.outlier & mine).sum())
        if out > max(1, _MAX_OUTLIER_SHARE * int(mine.sum())):
            raise InputError(
                f"{_name_of(placing)}: {out} of {int(mine.sum())} touches do not agree with its shape at any "
                "place: it has moved between touches, or is not what was given; measure it, fix it, and "
                "begin again"
            )
    _check_sizes(models, placings, touches, fit)
    _check_bounds(specs, models, fit)
    ratio = fit.chi_square / fit.freedom
    if ratio > _MAX_REDUCED_CHI_SQUARE:
        share = (fit.residual_mm / touches.sigma_mm) ** 2
        worst = max(range(len(placings)), key=lambda k: float(share[touches.placing == k].mean()))
        raise InputError(
            f"touches differ from the references by {math.sqrt(ratio):.1f} times what they should, most on "
            f"{_name_of(placings[worst])}: is its shape as given, and did it stand still?"
        )


def estimate_growth(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touches: TouchArrays,
    fit: FingerFit,
    which: Bools,
) -> tuple[float, float]:
    """Excess radius of the references of some placings (n,), as touches show it, and its deviation; mm.

    The value of one more unknown, by linear least squares round the fit.
    """
    rows = predict_residuals(models, placings, touches, fit.values, fit.poses)[3]
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


def _check_sizes(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touches: TouchArrays,
    fit: FingerFit,
) -> None:
    names = list(dict.fromkeys(placing.reference.name for placing in placings))
    if len(names) < 2:
        return
    for name in names[1:]:
        which = np.array([placing.reference.name == name for placing in placings])
        tolerance = sum(
            next(p.reference.tolerance_mm for p in placings if p.reference.name == each)
            for each in (names[0], name)
        )
        found, sigma = estimate_growth(models, placings, touches, fit, which)
        if abs(found) > _SIZE_SIGMAS * sigma + tolerance:
            raise InputError(
                f"the {name} seems {abs(found):.3f} ± {sigma:.3f} mm too {_size_word(found)} all round "
                f"beside the {names[0]}: one of them has another size than given; measure both"
            )


def _check_bounds(specs: Sequence[FingerConfig], models: Sequence[FingerModel], fit: FingerFit) -> None:
    """Refuse values that the rig file rules out: they would come from references of a wrong size."""
    sigma = np.sqrt(np.diag(fit.covariance))
    nominal, found = nominal_poses(specs), poses_of(fit.values)
    frame = align_to_nominal(nominal, found)
    for k, (spec, model) in enumerate(zip(specs, models, strict=True)):
        radius, bound = float(fit.values[k, RADIUS]), spec.tip.radius_bound_mm
        if abs(radius - spec.tip.radius_mm) > bound + 4 * float(sigma[k * fit.values.shape[1] + RADIUS]):
            raise InputError(
                f"finger {model.name}: its tip would have a radius of {radius:.2f} mm, and the rig file says "
                f"{spec.tip.radius_mm:g} ± {bound:g}: measure references, tip, or widen tip.radius_bound_mm"
            )
        place = frame.place(found[k])
        away, bound = math.dist(place.base_mm, spec.base_mm), spec.bounds.base_mm
        if away > 2 * bound + 0.3:
            raise InputError(
                f"finger {model.name}: its base would be {away:.2f} mm from base_mm, and the rig file says "
                f"within {bound:g}: check the references, correct base_mm or widen bounds.base_mm"
            )
        turned = abs(math.remainder(place.heading_rad - nominal[k].heading_rad, 2 * math.pi))
        bound = spec.bounds.heading_deg
        if turned > 2 * math.radians(bound) + 0.005:
            raise InputError(
                f"finger {model.name}: its heading would be {math.degrees(turned):.2f}° from heading_deg, "
                f"and the rig file says within {bound:g}°: check the references, correct heading_deg or "
                "widen bounds.heading_deg"
            )


def _size_word(growth: float) -> str:
    return "large" if growth > 0 else "small"


def _name_of(placing: ReferencePlacement) -> str:
    x, y = placing.about_mm
    return f"{placing.reference.name} near ({x:.0f}, {y:.0f}) mm"
