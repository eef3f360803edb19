"""Chi-square test for drift: do touches of a thing of known shape agree with the calibration?

The thing is an identified object in a session, or a disc that was put there to be touched (`palpate check
--touch`); its pose has been fitted. The calibration states by how much touches may differ; that they differ
by more is either chance, at a stated rate, or the rig has changed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from palpate.base.geometry import Floats, Ints
from palpate.config import CalibrationFile
from palpate.config.calibration_finger import FingerCalibration
from palpate.drivers.kinematics import TICK_RAD

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
