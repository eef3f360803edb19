"""Run record of a calibration under way, format `palpate/calibration-run@1`, by which it can be resumed.

JSON beside the rig file, replaced whole after every step and every placing. It belongs to one rig as
described, one set of references and one set of devices; for others it is begun anew.
"""

from typing import Literal

from pydantic import Field

from palpate.calibration.measurements import TouchMeasurement
from palpate.config.calibration_file import CalibrationDevice
from palpate.config.calibration_finger import Actuators, TactileCalibration
from palpate.config.fields import FileModel, Items

__all__ = ["RunRecord"]


class RunRecord(FileModel):
    """Results of a calibration so far; steps that are not done are left out."""

    format: Literal["palpate/calibration-run@1"] = "palpate/calibration-run@1"
    steps: Items[str] = Field(description="Steps that were asked for.")
    geometry_sha256: str = Field(description="Of the rig as described.")
    references_sha256: str = Field(description="Of the references.")
    places: Items[tuple[str, float, float]] = Field(description="What is put where: name, x, y (mm).")
    devices: Items[CalibrationDevice] = Field(description="Every device that takes part.")
    actuators: Items[Actuators] | None = Field(default=None, description="By finger.")
    tactile: Items[TactileCalibration] | None = Field(default=None, description="By finger.")
    touched: Items[Items[TouchMeasurement]] = Field(
        default=[], description="Touches of every placing that is done."
    )
    stage: Items[TouchMeasurement] | None = Field(
        default=None, description="Touches of the disc at several angles of the turning stage."
    )

    def is_for(self, other: "RunRecord") -> bool:
        """Whether this is about the same rig, references, devices and steps as another one."""
        return (
            self.steps == other.steps
            and self.geometry_sha256 == other.geometry_sha256
            and self.references_sha256 == other.references_sha256
            and self.places == other.places
            and self.devices == other.devices
        )
