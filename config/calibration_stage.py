"""Calibration of the turning stage: where its axis is, and its play.

Units are the suffixes of the names: mm, degrees; the covariance is in mm². The frame is the hand frame.
"""

from typing import Self

from pydantic import Field, model_validator

from palpate.config.calibration_numbers import Measured, MeasuredLength, Precise, UpLength, check_covariance
from palpate.config.fields import Count, FileModel, Items

__all__ = ["StageCalibration"]


class StageCalibration(FileModel):
    """What was found of the turning stage."""

    centre_mm: tuple[Measured, Measured] = Field(description="[x, y] of the ring's axis in the hand frame.")
    centre_sigma_mm: tuple[UpLength, UpLength] = Field(description="Standard deviations of centre_mm.")
    covariance: Items[Items[Precise]] = Field(description="2 x 2, of centre_mm (mm²).")
    centre_bound_mm: UpLength = Field(description="Bound: the axis is within this distance of centre_mm.")
    backlash_deg: MeasuredLength = Field(description="Play, either way.")
    backlash_sigma_deg: UpLength = Field(description="Standard deviation of backlash_deg.")
    stops: Count = Field(description="Times that the stage stopped for touches.")
    touches: Count = Field(description="Touches that were fitted.")
    degrees_of_freedom: Count = Field(description="Fitted touches less what they determine.")
    chi_square: MeasuredLength = Field(
        description="Sum of squares of residuals over expected deviations, what they share allowed for."
    )
    outliers: Count = Field(description="Touches that were left out.")
    rms_mm: MeasuredLength = Field(description="Root mean square of fitted touches' residuals.")

    @model_validator(mode="after")
    def _covaries(self) -> Self:
        check_covariance(self.covariance, 2, "covariance")
        return self
