"""Explanation of touches that disagree with a calibration: what one change of one joint makes them agree.

Tried are, for every joint: it stands elsewhere than its servo says (a horn that slipped), it has more play
than was measured, its encoder is off by more than is known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.consistency_checks import DriftTest, compare_touches
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
)
from palpate.calibration.finger_model import FingerModel, waves_of
from palpate.config.rig_fingers import ENCODER_DEG

_FREE_SIGMA = 10.0  # of what may have changed: mm, rad
_AS_GOOD = 6.6  # of chi square: 1 % of right explanations are further behind the best one


@dataclass(frozen=True)
class JointChange:
    """A change of one joint that explains touches: "zero" or "play" by `amount` (mm, deg), or "encoder"."""

    finger: str
    joint: str
    what: str
    amount: float
    unit: str
    chi_square: float

    @property
    def words(self) -> str:
        """What would explain them, for people."""
        owner = f"{self.finger}'s {self.joint}"
        if self.what == "encoder":
            return f"an encoder error of {owner} above the known one, by {ENCODER_DEG:g}° at most"
        amount = f"{abs(self.amount):.2g}{' mm' if self.unit == 'mm' else self.unit}"
        if self.what == "play":
            return f"{amount} more play, either way, of {owner}"
        return f"{owner} standing {amount} from where its servo says"

    @property
    def remedy(self) -> str:
        """What to look at."""
        if self.what == "encoder":
            return f"set bounds.encoder_deg of {self.finger} to {ENCODER_DEG:g} or more"
        what = "take up the play of its gear" if self.what == "play" else "tighten its horn's screw"
        return f"{what} ({self.finger}'s {self.joint})"


@dataclass(frozen=True, eq=False)
class CheckedTouches:
    """Touches (n,) of a disc by a calibrated rig, with their covariance (n, n) and their fit."""

    models: Sequence[FingerModel]
    placings: Sequence[ReferencePlacement]
    touches: TouchArrays
    covariance: Floats
    fit: FingerFit

    def explain(self) -> list[JointChange]:
        """Changes that each alone explain the touches, the likeliest first.

        Of zeros, plays and encoders only the first that explain them: an encoder may do what a horn does.
        """
        zeros, plays, encoders = list[JointChange](), list[JointChange](), list[JointChange]()
        for k, model in enumerate(self.models):
            for number, (joint, zero, play) in enumerate(model.joints):
                zeros += self._shift(k, joint, "zero", zero)
                if play != zero:
                    plays += [item for item in self._shift(k, joint, "play", play) if item.amount > 0]
                test = self._with_encoder(k, number)
                if test is not None and not test.drifted:
                    encoders.append(JointChange(model.name, joint, "encoder", 0.0, "", test.chi_square))
        first = zeros or plays or encoders
        best = min((item.chi_square for item in first), default=0.0)
        near = (item for item in first if item.chi_square <= best + _AS_GOOD)
        return sorted(near, key=lambda item: item.chi_square)

    def _shift(self, index: int, joint: str, what: str, column: int) -> list[JointChange]:
        """The change of one value of a finger, if it explains the touches."""
        models, model = list(self.models), self.models[index]
        freed = model.covariance.copy()
        freed[column, column] = _FREE_SIGMA**2
        models[index] = replace(model, covariance=freed)
        fit = fit_fingers(models, self.placings, self.touches, (self.fit.values, self.fit.poses))
        slopes = self._slopes(fit)
        row = slopes[:, index * fit.values.shape[1] + column]
        if not row.any():
            return []  # touches that come from one side only say nothing of a play
        pose = slopes[:, fit.values.size :][:, :2]
        test = compare_touches(fit.residual_mm, np.column_stack([pose, row]), self.covariance)
        if test is None or test.drifted:
            return []
        unit, scale = ("mm", 1.0) if joint == "slide" else ("°", math.degrees(1.0))
        amount = scale * float(fit.values[index, column] - model.prior[column])
        return [JointChange(model.name, joint, what, amount, unit, test.chi_square)]

    def _with_encoder(self, index: int, joint: int) -> DriftTest | None:
        """How touches agree if one encoder may be off by what a maker allows."""
        slopes, columns = self._slopes(self.fit), self.fit.values.shape[1]
        own = slopes[:, index * columns : (index + 1) * columns][:, self.models[index].encoders]
        own = own[:, waves_of(joint)]
        more = own @ own.T * math.radians(ENCODER_DEG) ** 2 / 6
        pose = slopes[:, self.fit.values.size :][:, :2]
        return compare_touches(self.fit.residual_mm, pose, self.covariance + more)

    def _slopes(self, fit: FingerFit) -> Floats:
        return predict_residuals(self.models, self.placings, self.touches, fit.values, fit.poses)[3]
