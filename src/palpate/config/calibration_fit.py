"""Quality of a fit to touches, as parts of a calibration file give it."""

from pydantic import Field

from palpate.config.calibration_numbers import MeasuredLength
from palpate.config.fields import Count, FileModel

__all__ = ["FitQuality"]


class FitQuality(FileModel):
    """How well what was fitted agrees with its touches."""

    rms_mm: MeasuredLength = Field(description="Root mean square of fitted touches' residuals.")
    touches: Count = Field(description="Touches that were fitted.")
    degrees_of_freedom: Count = Field(description="Fitted touches less what they determine.")
    chi_square: MeasuredLength = Field(
        description="Sum of squares of residuals over expected deviations, what touches share allowed for."
    )
    outliers: Count = Field(description="Touches that were left out.")
