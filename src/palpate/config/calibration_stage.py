"""Calibration of the turning stage: where its axis is, and its play.

Units are the suffixes of the names: mm, degrees; the covariance is in mm². The frame is the hand frame.
"""

from typing import Annotated

from pydantic import Field

from palpate.config.calibration_fit import FitQuality
from palpate.config.calibration_numbers import Matrix, Measured, MeasuredLength, UpLength, covariance_of
from palpate.config.fields import Count

__all__ = ["StageCalibration"]


class StageCalibration(FitQuality):
    """What was found of the turning stage, and how well touches at its angles agree with that."""

    centre_mm: tuple[Measured, Measured] = Field(description="[x, y] of the ring's axis in the hand frame.")
    centre_sigma_mm: tuple[UpLength, UpLength] = Field(description="Standard deviations of centre_mm.")
    covariance: Annotated[Matrix, covariance_of(2)] = Field(description="2 x 2, of centre_mm (mm²).")
    centre_bound_mm: UpLength = Field(description="Bound: the axis is within this distance of centre_mm.")
    backlash_deg: MeasuredLength = Field(description="Play, either way.")
    backlash_sigma_deg: UpLength = Field(description="Standard deviation of backlash_deg.")
    stops: Count = Field(description="Times that the stage stopped for touches.")
