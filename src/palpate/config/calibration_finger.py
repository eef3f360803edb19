"""Calibration of one finger: its array, its actuators, its geometry, its bounds.

Units are the suffixes of the names: mm, degrees, N, A, s; covariances in mm and rad. Frames are those of the
rig file.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from palpate.config.fields import (
    Count,
    FileModel,
    Flag,
    Gain,
    Items,
    Matrix,
    Measured,
    MeasuredLength,
    MeasuredPositive,
    Name,
    ShareUp,
    TravelPerTurn,
    UpLength,
    UpPositive,
    check_gains,
    covariance_of,
)
from palpate.config.problems import TAG, problem


class UnusableTaxel(FileModel):
    """A taxel that is left out, and why."""

    row: Count = Field(description="Row, from the tip's lower end up, from 0.")
    col: Count = Field(description="Column, from 0.")
    what: Literal["dead", "hot", "unresponsive"] = Field(
        description='"dead": stuck at rest; "hot": stuck at the top; "unresponsive": does not follow presses.'
    )


class TactileCalibration(FileModel):
    """Calibration of a finger's array and of the skin under it."""

    gain: Items[Items[Gain]] = Field(
        description="Relative gain of every taxel, row by row from the tip's lower end up; 1 where unknown."
    )
    gain_bound: Items[Items[ShareUp]] = Field(
        description="Bound: each gain is off by at most this share of it."
    )
    unusable: Items[UnusableTaxel] = Field(default=[], description="Taxels that are left out.")
    noise_counts: UpPositive = Field(description="Standard deviation of a taxel's noise.")
    offset_counts: MeasuredLength = Field(description="Mean of what taxels read at rest.")
    drift_counts_per_s: UpLength = Field(description="Bound: no taxel's zero moves faster.")
    force_drift_n_per_s: UpLength | None = Field(
        default=None,
        description="Bound: what usable taxels of any three neighbouring columns show together, untouched, "
        "moves no faster; left out if not known.",
    )
    crosstalk: Annotated[MeasuredLength, Field(le=0.25)] = Field(
        description="Share of a taxel's force that each neighbour shows."
    )
    crosstalk_bound: UpLength = Field(description="Bound: crosstalk is off by at most this.")
    stiffness_n_per_mm: MeasuredPositive = Field(description="Force per mm of dent.")
    stiffness_bound: ShareUp = Field(description="Bound: the stiffness is off by at most this share.")
    least_contact_force_n: UpPositive = Field(description="Least force that stands out of the noise.")
    saturates_n: MeasuredPositive | None = Field(
        default=None, description="Least force at which a taxel was full; left out if none was."
    )
    phase_deg: Measured = Field(
        description="Where the array's middle looks, from the slide's or the arm's last link's direction, as "
        "presses alone show it."
    )
    phase_sigma_deg: UpLength = Field(description="Standard deviation of phase_deg.")
    presses: Count = Field(description="Presses that went into this.")
    residual_share: UpLength = Field(
        description="Root mean square of what the fit leaves of the presses' forces, as a share of them."
    )

    @model_validator(mode="after")
    def _is_one_array(self) -> Self:
        rows, cols = check_gains(self.gain, self.gain_bound)
        seen: set[tuple[int, int]] = set()
        for index, taxel in enumerate(self.unusable):
            if taxel.row >= rows or taxel.col >= cols:
                raise problem(f"names taxel [{taxel.row}, {taxel.col}] of {rows} x {cols}", "unusable", index)
            if (taxel.row, taxel.col) in seen:
                raise problem(f"names taxel [{taxel.row}, {taxel.col}] again", "unusable", index)
            seen.add((taxel.row, taxel.col))
        return self


class Overshoot(FileModel):
    """Distance that a slide went on after a contact, at one speed."""

    speed_mm_s: MeasuredPositive = Field(description="Speed at the contact.")
    largest_mm: MeasuredLength = Field(description="The farthest that was seen.")
    bound_mm: UpLength = Field(description="Bound: no stop from this speed goes farther.")


class StopsCalibration(FileModel):
    """Time and distance in which a finger comes to stand at a contact."""

    latency_s: MeasuredLength = Field(description="Mean time from a contact to standing still.")
    latency_bound_s: UpLength = Field(description="Bound: no stop takes longer.")
    settle_s: UpLength = Field(
        description="Bound: in a touch, from the stop that is sent to standing still, at most this."
    )
    overshoots: Items[Overshoot] = Field(default=[], description="What was seen at each speed.")


class SlideTravel(FileModel):
    """Travel of a slide as it was measured."""

    direction_confirmed: Flag = Field(description="It was seen to move the way the rig file says.")
    mm_per_turn: TravelPerTurn = Field(description="Travel per servo turn; as described if not homed.")
    mm_per_turn_sigma: UpLength = Field(description="Standard deviation of mm_per_turn.")
    zero_mm: Measured = Field(
        description="Distance at Goal Position 0, in the middle of the play; as described if not homed."
    )
    zero_sigma_mm: UpLength = Field(description="Standard deviation of zero_mm.")
    homed: Flag = Field(description="It met its hard stops, so that mm_per_turn and zero_mm were measured.")
    backlash_mm: MeasuredLength = Field(description="Play, either way; the skin's lost motion is in it.")
    backlash_sigma_mm: UpLength = Field(description="Standard deviation of backlash_mm.")
    touch_zero_mm: Measured = Field(
        description="Distance at Goal Position 2048 in a touch, which has taken up the play."
    )
    touch_covariance: Annotated[Matrix, covariance_of(2)] = Field(
        description="2 x 2, of touch_zero_mm and of mm_per_turn's error as a share."
    )
    friction_a: MeasuredLength = Field(description="Current that it needs to move through free space.")


class SlideCalibration(StopsCalibration, SlideTravel):
    """Calibration of a slide: its travel, and how its tip comes to stand."""


class RotaryCalibration(FileModel):
    """Calibration of a servo that turns a finger: an aim, or a joint of an arm."""

    direction_confirmed: Flag = Field(description="It was seen to turn the way the rig file says.")
    backlash_deg: MeasuredLength = Field(description="Play, either way.")
    backlash_sigma_deg: UpLength = Field(description="Standard deviation of backlash_deg.")
    friction_a: MeasuredLength = Field(description="Current that it needs to turn freely.")


class ActuatorsCalibration(FileModel):
    """Calibration of the servos of an aim and slide finger and what they drive."""

    slide: SlideCalibration = Field(description="The slide.")
    aim: RotaryCalibration = Field(description="The aim.")


class ArmActuatorsCalibration(FileModel):
    """Calibration of the servos of an arm."""

    shoulder: RotaryCalibration = Field(description="The shoulder.")
    elbow: RotaryCalibration = Field(description="The elbow.")
    stops: StopsCalibration = Field(description="How its tip comes to stand.")


Harmonics = tuple[Measured, Measured, Measured, Measured]


class PlaceInHandFrame(FileModel):
    """Place of a finger of any type in the hand frame W."""

    base_mm: tuple[Measured, Measured] = Field(description="[x, y] of the aim's or shoulder's axis.")
    base_sigma_mm: tuple[UpLength, UpLength] = Field(description="Standard deviations of base_mm.")
    heading_deg: Measured = Field(
        description="Direction of the slide at aim 0, or of the first link at shoulder angle 0, "
        "counter-clockwise from +x."
    )
    heading_sigma_deg: UpLength = Field(description="Standard deviation of heading_deg.")
    tip_radius_mm: MeasuredPositive = Field(description="Radius of the tip.")
    tip_radius_sigma_mm: UpLength = Field(description="Standard deviation of tip_radius_mm.")
    array_heading_deg: Measured = Field(
        description="Where the array's middle looks, from the slide's or the arm's last link's direction."
    )
    array_heading_sigma_deg: UpLength = Field(description="Standard deviation of array_heading_deg.")
    encoder_harmonics_deg: tuple[Harmonics, Harmonics] | None = Field(
        default=None,
        description="What corrects the encoders of both servos in this fit, the one next to the base first: "
        "a cos + b sin + c cos + d sin of what they read, from Goal Position 2048, and of twice that; left "
        "out by calibrations that did not measure it.",
    )
    encoder_bound_deg: UpLength = Field(
        default=0.0, description="Bound: then they are off by at most this, anywhere in their turn."
    )

    @property
    def push_mm_per_turn(self) -> float | None:
        """Travel per turn of the servo that alone moves the tip on its path; None if both do."""
        return None


class PlaceCalibration(PlaceInHandFrame):
    """Place of an aim and slide finger, with what belongs to it in the same fit."""

    zero_mm: Measured = Field(
        description="Distance at Goal Position 0 that belongs to this fit, the play taken up as in a touch."
    )
    mm_per_turn: TravelPerTurn = Field(
        description="Travel per turn of the slide's servo that belongs to this fit."
    )
    covariance: Annotated[Matrix, covariance_of(5)] = Field(
        description="5 x 5, of base x, base y (mm), heading (rad), tip radius and zero (mm)."
    )

    @property
    def push_mm_per_turn(self) -> float:
        """Travel per turn of the slide."""
        return self.mm_per_turn


class ArmPlaceCalibration(PlaceInHandFrame):
    """Place of an arm, with what belongs to it in the same fit."""

    upper_mm: MeasuredPositive = Field(description="From the shoulder's axis to the elbow's.")
    upper_sigma_mm: UpLength = Field(description="Standard deviation of upper_mm.")
    fore_mm: MeasuredPositive = Field(description="From the elbow's axis to the tip's.")
    fore_sigma_mm: UpLength = Field(description="Standard deviation of fore_mm.")
    elbow_zero_deg: Measured = Field(
        description="By how much the elbow's angle is larger than the rig file's zero_deg makes it."
    )
    elbow_zero_sigma_deg: UpLength = Field(description="Standard deviation of elbow_zero_deg.")
    covariance: Annotated[Matrix, covariance_of(7)] = Field(
        description="7 x 7, of base x, base y (mm), heading (rad), tip radius, lengths of the upper and the "
        "second link (mm), and the elbow's zero (rad)."
    )


def _by_key(key: str) -> Discriminator:
    """Discriminate the types of fingers by a key: an arm's table has `key`."""

    def kind(value: Any) -> str:
        is_arm = key in value if isinstance(value, dict) else hasattr(value, key)
        return TAG + ("two-link" if is_arm else "slide")

    return Discriminator(kind)


Actuators = Annotated[
    Annotated[ActuatorsCalibration, Tag(TAG + "slide")]
    | Annotated[ArmActuatorsCalibration, Tag(TAG + "two-link")],
    _by_key("shoulder"),
]
"""What was found of a finger's servos, for a finger of either type."""

FingerPlace = Annotated[
    Annotated[PlaceCalibration, Tag(TAG + "slide")] | Annotated[ArmPlaceCalibration, Tag(TAG + "two-link")],
    _by_key("upper_mm"),
]
"""Where a finger of either type stands."""


class PositionParts(FileModel):
    """Parts of the bound on the tip centre's place, mm."""

    fit: UpLength = Field(description="Place, heading, radius and zero, as well as the fit knows them.")
    repeatability: UpLength = Field(description="What touches of the same place differ by.")
    quantisation: UpLength = Field(description="Steps of the servos' encoders.")
    play: UpLength = Field(description="What is left of play, on the side where touches have it.")
    overshoot: UpLength = Field(description="What is not known of how far the tip went on.")


class DirectionParts(FileModel):
    """Parts of the bound on the direction that carries the array, degrees."""

    fit: UpLength = Field(description="The finger's and the array's headings, as the fits know them.")
    repeatability: UpLength = Field(description="What touches of the same place differ by.")
    quantisation: UpLength = Field(description="Steps of the aim's or the joints' encoders.")
    play: UpLength = Field(description="Play of the aim, or of both joints.")


class ContactBounds(FileModel):
    """Bounds on a contact of this finger, at the file's coverage."""

    position_mm: UpPositive = Field(description="Bound on the tip centre's place anywhere in the workspace.")
    direction_deg: Annotated[UpPositive, Field(le=45)] = Field(
        description="Bound on the direction that carries the array."
    )
    parts_mm: PositionParts = Field(description="What position_mm is made of.")
    normal_parts_deg: DirectionParts = Field(description="What direction_deg is made of.")


class FingerCalibration(FileModel):
    """One finger; what was not calibrated is left out."""

    name: Name = Field(description="The rig file's name of the finger.")
    tactile: TactileCalibration | None = Field(default=None, description="Its array and skin.")
    actuators: Actuators | None = Field(default=None, description="Its servos.")
    place: FingerPlace | None = Field(default=None, description="Where it stands.")
    bounds: ContactBounds | None = Field(default=None, description="How far off its contacts may be.")
