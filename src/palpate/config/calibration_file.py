"""Calibration of a rig, `palpate/calibration@1`, and its references, `palpate/references@1`.

Both are TOML. `palpate calibrate` writes the calibration beside the rig file; `calibration_overlay` lays it
over the rig, and every other command takes the rig from there. `docs/calibration-file.md` explains every
key.
"""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from palpate.config.calibration_finger import FingerCalibration
from palpate.config.fields import (
    Count,
    FileModel,
    Flag,
    Hash,
    Items,
    Length,
    Matrix,
    Measured,
    MeasuredLength,
    Name,
    Point,
    Positive,
    Text,
    UpLength,
    UtcTime,
    covariance_of,
)
from palpate.config.loading import Source, load_toml
from palpate.config.problems import problem


class FitQuality(FileModel):
    """Agreement of what was fitted with its touches."""

    rms_mm: MeasuredLength = Field(description="Root mean square of fitted touches' residuals.")
    touches: Count = Field(description="Touches that were fitted.")
    degrees_of_freedom: Count = Field(description="Fitted touches less what they determine.")
    chi_square: MeasuredLength = Field(
        description="Sum of squares of residuals over expected deviations, what touches share allowed for."
    )
    outliers: Count = Field(description="Touches that were left out.")


class StageCalibration(FitQuality):
    """Calibration of the turning stage, and how well touches at its angles agree with it."""

    centre_mm: tuple[Measured, Measured] = Field(description="[x, y] of the ring's axis in the hand frame.")
    centre_sigma_mm: tuple[UpLength, UpLength] = Field(description="Standard deviations of centre_mm.")
    covariance: Annotated[Matrix, covariance_of(2)] = Field(description="2 x 2, of centre_mm (mm²).")
    centre_bound_mm: UpLength = Field(description="Bound: the axis is within this distance of centre_mm.")
    backlash_deg: MeasuredLength = Field(description="Play, either way.")
    backlash_sigma_deg: UpLength = Field(description="Standard deviation of backlash_deg.")
    stops: Count = Field(description="Times that the stage stopped for touches.")


class CalibrationReference(FileModel):
    """A thing of known shape that was touched."""

    name: Name = Field(description="What it is called.")
    sha256: Hash = Field(description="Of the description of its shape.")


class CalibrationDevice(FileModel):
    """A device that took part: another one in its place has not been calibrated."""

    port: Text = Field(description="The rig file's port.")
    kind: Literal["servo", "array"] = Field(description='"servo" or "array".')
    id: Text = Field(description="A servo's ID on the bus, an array's unique id in hexadecimal.")
    model: Text = Field(description="Model of the servo; what the array speaks and its size.")
    firmware: Text = Field(description="Version of its firmware.")


class TouchResidual(FileModel):
    """A touch, where the fit says that it was."""

    finger: Name = Field(description="Which finger touched.")
    placing: Count = Field(description="Number of the reference's placing, from 0.")
    x_mm: Measured = Field(description="Tip centre in W.")
    y_mm: Measured = Field(description="Likewise.")
    normal_deg: Measured = Field(description="Direction of the reference's outward normal there, from +x.")
    residual_mm: Measured = Field(description="Distance from where it should be, along the normal, outward.")
    held_out: Flag = Field(description="It was not fitted, only predicted.")
    outlier: Flag = Field(description="It was left out because it does not agree with the others.")


class Residuals(FitQuality):
    """Agreement of all fingers' places with the touches."""

    largest_mm: MeasuredLength = Field(description="Largest residual of fitted touches, without its sign.")
    held_out: Count = Field(description="Touches that were only predicted.")
    held_out_rms_mm: MeasuredLength = Field(description="Root mean square of their residuals; 0 for none.")
    held_out_largest_mm: MeasuredLength = Field(description="The largest of them; 0 for none.")
    touches_seen: Items[TouchResidual] = Field(default=[], description="Every touch.")


class CalibrationFile(FileModel):
    """Calibration of a rig, `palpate/calibration@1`."""

    format: Literal["palpate/calibration@1"] = "palpate/calibration@1"
    rig: Name = Field(description="Name of the rig.")
    rig_sha256: Hash = Field(description="Of the rig file as it was.")
    geometry_sha256: Hash = Field(
        description="Of what calibration depends on in the rig file; if that changes, calibrate again."
    )
    made: UtcTime = Field(description="When it was made, in UTC.")
    palpate: Text = Field(description="Version that made it.")
    emulated: Flag = Field(description="The devices were emulated.")
    coverage: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, lt=1)] = Field(
        description="Share of contacts that the bounds are to hold for."
    )
    references: Items[CalibrationReference] = Field(default=[], description="What was touched.")
    devices: Items[CalibrationDevice] = Field(description="Every device that took part.")
    fingers: Items[FingerCalibration] = Field(
        min_length=1, description="The rig's fingers, in the rig file's order."
    )
    stage: StageCalibration | None = Field(
        default=None, description="The turning stage; left out if there is none, or if it was not measured."
    )
    residuals: Residuals | None = Field(
        default=None, description="How well the fingers' places agree with the touches."
    )

    @model_validator(mode="after")
    def _names_are_known_once(self) -> Self:
        names = [finger.name for finger in self.fingers]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise problem(f"fingers[{names.index(name)}] has this name already", "fingers", index, "name")
        seen = () if self.residuals is None else self.residuals.touches_seen
        for index, touch in enumerate(seen):
            if touch.finger not in names:
                raise problem(
                    f'is "{touch.finger}"; fingers: {", ".join(names)}',
                    *("residuals", "touches_seen", index, "finger"),
                )
        return self


def calibration_path(rig: Path) -> Path:
    """Path of a rig file's calibration, beside it: `bench.toml` → `bench.calibration.toml`."""
    return rig.with_name(f"{rig.stem}.calibration.toml")


def load_calibration(source: Source) -> CalibrationFile:
    """Read and check a calibration file; whether it belongs to a rig is for `check_calibration` to say.

    Raises:
        InputError: unreadable, wrong keys or values; one line.

    """
    return load_toml(source, CalibrationFile, {})


class DiscConfig(FileModel):
    """A round reference."""

    diameter_mm: Positive = Field(description="Diameter.")
    height_mm: Positive = Field(description="Height of its top above the support plane.")
    tolerance_mm: Length = Field(default=0.0, description="Its rim is off by at most this.")


class PlateConfig(FileModel):
    """A convex reference with straight faces, such as a square plate."""

    outline_mm: Items[Point] = Field(min_length=3, description="Corners [x, y] in order round it.")
    height_mm: Positive = Field(description="Height of its top above the support plane.")
    tolerance_mm: Length = Field(default=0.0, description="Its faces are off by at most this.")


class ReferencesFile(FileModel):
    """The things that fingers touch to be calibrated, `palpate/references@1`."""

    format: Literal["palpate/references@1"]
    disc: DiscConfig = Field(description="A disc.")
    plate: PlateConfig = Field(description="A plate.")


def references_sha256(file: ReferencesFile) -> str:
    """SHA-256 of the shapes, by which a calibration knows what it was made with."""
    return hashlib.sha256(json.dumps(file.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()


def load_references(source: Source) -> ReferencesFile:
    """Read and check a references file. Raises InputError, one line."""
    return load_toml(source, ReferencesFile, {})
