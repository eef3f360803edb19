"""A rig's description, format `palpate/rig@1`: TOML in, one checked `RigFile` out.

Says which servos and arrays hang on which ports, where the fingers stand, how well all that is known, and
how carefully to move. The values keep the file's units, which are the suffixes of their names: mm, degrees,
N, Hz; `rig` turns them into mm, rad, s, N where it builds the bench. `docs/rig-file.md` explains every key.
"""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from palpate.config.fields import FileModel, Length, Name, Number, Point, Positive, Text, in_order
from palpate.config.loading import Source, load_toml
from palpate.config.outlines import outline_problem
from palpate.config.problems import problem
from palpate.config.rig_checks import check_emulation, check_identities, check_obstacles, check_places

__all__ = [
    "BUS_BAUDRATES",
    "AimServo",
    "Array",
    "Bounds",
    "Bus",
    "Closing",
    "Emulation",
    "Finger",
    "Obstacle",
    "RigFile",
    "Search",
    "SlideServo",
    "Tip",
    "Workspace",
    "load_rig",
]

BUS_BAUDRATES = (9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000)
"""Rates that all supported servos know (e-Manual, Baud Rate (8))."""

_TURNS = 256
"""Turns either way in Extended Position Control Mode (e-Manual, Operating Mode (11))."""

ServoModel = Literal["XL330-M288", "XC330-M288", "XM430-W350"]
DxlId = Annotated[int, Field(strict=True, ge=0, le=252)]
Angle = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-360, le=360)]
Share = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, lt=1)]


def _not_zero(value: float) -> float:
    if value == 0:
        raise problem("is 0; it must not be")
    return value


Ratio = Annotated[
    float, Field(strict=True, allow_inf_nan=False, ge=-1000, le=1000), AfterValidator(_not_zero)
]
AngleRange = Annotated[tuple[Angle, Angle], AfterValidator(in_order)]
LengthRange = Annotated[tuple[Length, Length], AfterValidator(in_order)]


class Bus(FileModel):
    """The bus that all servos share."""

    port: Text = Field(description="Device path, socket://host:port, or mock://name for an emulated bus.")
    baudrate_bps: Annotated[int, Field(strict=True)] = Field(
        description="Baud rate set in every servo.", json_schema_extra={"enum": list(BUS_BAUDRATES)}
    )

    @model_validator(mode="after")
    def _baudrate_is_known(self) -> Self:
        if self.baudrate_bps not in BUS_BAUDRATES:
            allowed = ", ".join(str(rate) for rate in BUS_BAUDRATES)
            raise problem(f"is {self.baudrate_bps}; allowed: {allowed}", "baudrate_bps")
        return self


class Workspace(FileModel):
    """Where parts may lie."""

    radius_mm: Positive = Field(
        description="Parts lie inside this circle round W's origin; fingers wait outside."
    )


class Closing(FileModel):
    """How fingers close on a part."""

    approach_speed_mm_s: Annotated[Positive, Field(le=1000)] = Field(description="Speed through free space.")
    touch_speed_mm_s: Annotated[Positive, Field(le=100)] = Field(
        description="Speed when a contact is measured."
    )
    back_off_mm: Positive = Field(description="Way back from a first contact before touching again slowly.")
    contact_force_n: Positive = Field(description="Force that counts as a contact.")
    max_force_n: Annotated[Positive, Field(le=200)] = Field(description="No finger may ever press harder.")
    clearance_mm: Length = Field(description="Least gap between two fingers, or a finger and an obstacle.")
    sample_rate_hz: Annotated[Positive, Field(ge=1, le=10000)] = Field(
        description="Frames per second of an array."
    )

    @model_validator(mode="after")
    def _grows_in_order(self) -> Self:
        if self.touch_speed_mm_s > self.approach_speed_mm_s:
            raise problem(
                f"is {self.touch_speed_mm_s:g}, above approach_speed_mm_s ({self.approach_speed_mm_s:g})",
                "touch_speed_mm_s",
            )
        if self.contact_force_n >= self.max_force_n:
            raise problem(
                f"is {self.contact_force_n:g}, not below max_force_n ({self.max_force_n:g})",
                "contact_force_n",
            )
        return self


class Search(FileModel):
    """When to stop asking."""

    max_grips: Annotated[int, Field(strict=True, ge=1, le=1000)] = Field(
        description="Grips before giving up."
    )
    goal_position_mm: Positive = Field(description="Position bounds narrower than this (±) are fine enough.")
    goal_orientation_deg: Annotated[Positive, Field(le=180)] = Field(
        description="Orientation bounds narrower than this (±) are fine enough."
    )


class AimServo(FileModel):
    """The servo that turns the slide about the finger's base: servo angle = zero_deg + gear_ratio · aim."""

    dxl_id: DxlId = Field(description="ID on the bus.")
    model: ServoModel = Field(description="Model as printed on the servo.")
    gear_ratio: Ratio = Field(
        description="Servo turns per turn of the slide; negative if they turn opposite ways."
    )
    range_deg: AngleRange = Field(description="[lo, hi] of the aim, counter-clockwise from heading_deg.")
    backlash_deg: Length = Field(
        description="Bound: the aim is off by at most this through play, either way."
    )
    zero_deg: Number = Field(description="Servo angle at aim 0, from its Goal Position 0.")

    @model_validator(mode="after")
    def _within_the_servo(self) -> Self:
        turns = [(self.zero_deg + self.gear_ratio * aim) / 360 for aim in self.range_deg]
        _check_turns(turns, "range_deg")
        return self


class SlideServo(FileModel):
    """The servo that moves the tip: distance from base = zero_mm + mm_per_turn · servo turns."""

    dxl_id: DxlId = Field(description="ID on the bus.")
    model: ServoModel = Field(description="Model as printed on the servo.")
    mm_per_turn: Ratio = Field(
        description="Travel per servo turn; negative if growing angles retract the tip."
    )
    range_mm: LengthRange = Field(description="[lo, hi] of the distance from base to tip centre.")
    backlash_mm: Length = Field(
        description="Bound: the distance is off by at most this through play, either way."
    )
    zero_mm: Number = Field(description="Distance at Goal Position 0.")

    @model_validator(mode="after")
    def _within_the_servo(self) -> Self:
        turns = [(distance - self.zero_mm) / self.mm_per_turn for distance in self.range_mm]
        _check_turns(turns, "range_mm")
        # After power-up a servo knows its angle within one turn, so the finger must start in that one.
        if not 0 <= turns[0] < 1:
            raise problem(
                f"is {self.zero_mm:g}: retracted, at {self.range_mm[0]:g} mm, the servo would stand at turn "
                f"{turns[0]:.2f}; it must be in 0 … 1, because a servo starts within one turn",
                "zero_mm",
            )
        return self


class Tip(FileModel):
    """The cylindrical fingertip."""

    radius_mm: Annotated[Positive, Field(le=100)] = Field(description="Radius of the cylinder.")
    stiffness_n_per_mm: Positive = Field(description="Force per mm of dent.")
    stiffness_spread: Share = Field(description="Bound: the stiffness is off by at most this share.")


class Array(FileModel):
    """The tactile array round the tip."""

    port: Text = Field(description="Device path, socket://host:port, or mock://name for an emulated array.")
    baudrate_bps: Annotated[int, Field(strict=True, ge=9600, le=12_000_000)] = Field(description="Baud rate.")
    protocol: Literal["palpate"] = Field(
        description='What the array speaks; "palpate" is docs/tactile-protocol.md.'
    )
    gain_spread: Share = Field(description="Bound: each taxel's gain is off by at most this share.")
    heading_deg: Angle = Field(
        default=0.0,
        description="Where the array's middle looks, counter-clockwise from the direction of travel.",
    )


class Bounds(FileModel):
    """How well the finger's place is known."""

    base_mm: Length = Field(description="Bound: the base is within this distance of base_mm.")
    heading_deg: Annotated[Length, Field(le=45)] = Field(
        description="Bound: the heading is off by at most this."
    )


class Finger(FileModel):
    """One finger: an aim servo turns a slide about a fixed base, a slide servo moves the tip along it."""

    name: Name
    base_mm: Point = Field(description="[x, y] of the aim axis in the support-plane frame W.")
    heading_deg: Angle = Field(description="Direction of the slide at aim 0, counter-clockwise from +x of W.")
    height_mm: Positive = Field(description="Height of the middle of the tip above the support plane.")
    aim: AimServo
    slide: SlideServo
    tip: Tip
    array: Array
    bounds: Bounds


class Obstacle(FileModel):
    """A part of the rig that stands in the fingers' plane: a post, a camera."""

    name: Name = Field(description="How messages call it.")
    outline_mm: list[Point] = Field(
        min_length=3, description="Corners [x, y] in the support-plane frame W, in order round it."
    )

    @model_validator(mode="after")
    def _is_simple(self) -> Self:
        found = outline_problem(np.array(self.outline_mm, dtype=np.float64))
        if found is not None:
            point, what = found
            raise problem(what, "outline_mm", *(() if point is None else (point,)))
        return self


class Emulation(FileModel):
    """How far the emulated devices stray from this description. What they draw stays hidden from the host."""

    noise_counts: Length = Field(default=0.0, description="Standard deviation of a taxel's noise.")
    offset_counts: Length = Field(default=0.0, description="Every taxel at rest reads this.")
    gain_spread: Share = Field(default=0.0, description="Taxel gains differ by up to this share.")
    crosstalk: Annotated[Length, Field(le=0.25)] = Field(
        default=0.0, description="Share of a taxel's pressure that each neighbour shows."
    )
    backlash_mm: Length = Field(default=0.0, description="Play of the slides, either way.")
    aim_backlash_deg: Length = Field(default=0.0, description="Play of the aims, either way.")
    base_error_mm: Length = Field(
        default=0.0, description="Bases are up to this far from where they should be."
    )
    heading_error_deg: Length = Field(default=0.0, description="Headings are off by up to this.")
    stiffness_spread: Share = Field(default=0.0, description="Tips are harder or softer by up to this share.")
    placement_radius_mm: Positive = Field(
        description="Parts are put with the origin of their object frame inside this circle."
    )


class RigFile(FileModel):
    """A bench rig of tactile fingers, `palpate/rig@1`."""

    format: Literal["palpate/rig@1"]
    name: Name
    bus: Bus
    workspace: Workspace
    closing: Closing
    search: Search
    fingers: list[Finger] = Field(min_length=1, description="The fingers, in the order they are reported.")
    obstacles: list[Obstacle] = Field(default=[], description="What stands in the fingers' plane.")
    emulation: Emulation | None = Field(default=None, description="Only for rigs with mock:// ports.")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        check_identities(self)
        check_places(self)
        check_obstacles(self)
        check_emulation(self)
        return self

    @property
    def emulated(self) -> bool:
        """Whether the devices are emulated rather than real."""
        return self.emulation is not None


def load_rig(source: Source) -> RigFile:
    """Read and check the rig described in `source`.

    Raises:
        InputError: unreadable, wrong keys or values, or parts of the rig that do not go together; one line.

    """
    return load_toml(source, RigFile, {})


def _check_turns(turns: list[float], key: str) -> None:
    if max(abs(turn) for turn in turns) > _TURNS:
        raise problem(
            f"needs servo turns {min(turns):.0f} to {max(turns):.0f}; a servo reaches {_TURNS} either way",
            key,
        )
