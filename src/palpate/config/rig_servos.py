"""Servo tables of a rig file: aim, slide, an arm's joints, the turning stage.

A servo knows its angle within one turn when it starts, and counts 256 turns either way; ranges, zeros and
stops that do not fit that are refused here, at the key to be changed. Units are the file's: mm, degrees.
"""

import math
import re
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

from pydantic import AfterValidator, Field, model_validator

from palpate.base.extensions import SERVO_MODELS, registered_names
from palpate.config.fields import FileModel, Length, Number, Point, Text, in_order, plugin
from palpate.config.problems import problem

_MAX_TURN = 256
"""Turns either way in Extended Position Control Mode (e-Manual, Operating Mode (11))."""

_STOP_MARGIN_MM = 0.5


def _not_zero(value: float) -> float:
    if value == 0:
        raise problem("is 0; it must not be")
    return value


BUILT_IN_MODELS = (
    *("XL330-M077", "XL330-M288", "XC330-M181", "XC330-M288", "XC330-T181", "XC330-T288", "XM335-T323"),
    *("XM430-W210", "XM430-W350", "XH430-W210", "XH430-W350", "XH430-V210", "XH430-V350"),
    *("XD430-T210", "XD430-T350", "XW430-T200", "XW430-T333"),
    *("XM540-W150", "XM540-W270", "XH540-W150", "XH540-W270", "XH540-V150", "XH540-V270"),
    *("XD540-T150", "XD540-T270", "XW540-T140", "XW540-T260"),
)
"""Servo models of rig files that need no plug-in: those of the X series that report Present Current."""

_WITHOUT_CURRENT = re.compile(r"(2?X[LC]430|XL-?320|[ADER]X-|MX-(12|28))")
"""How names of the vendor's models without Present Current begin (e-Manual, their control tables)."""


def without_current(name: str) -> str | None:
    """Why a model of the vendor's cannot be used, if it does not report its current; None for any other."""
    if name in BUILT_IN_MODELS or name in registered_names(SERVO_MODELS) or not _WITHOUT_CURRENT.match(name):
        return None
    return (
        f'is "{name}", which does not report its current, so that what it presses with can be neither '
        "limited nor known; models that do are in docs/rig-file.md#servo-models, XC330-M288 and "
        "XM430-W350 among them"
    )


def _known_model(name: str) -> str:
    if name in BUILT_IN_MODELS:
        return name
    if (why := without_current(name)) is not None:
        raise problem(why)
    plugin(SERVO_MODELS, name, BUILT_IN_MODELS)
    return name


ServoModel = Annotated[Text, Field(examples=list(BUILT_IN_MODELS)), AfterValidator(_known_model)]
DxlId = Annotated[int, Field(strict=True, ge=0, le=252)]
Angle = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-360, le=360)]
Share = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, lt=1)]
Ratio = Annotated[
    float, Field(strict=True, allow_inf_nan=False, ge=-1000, le=1000), AfterValidator(_not_zero)
]
AngleRange = Annotated[tuple[Angle, Angle], AfterValidator(in_order)]
LengthRange = Annotated[tuple[Length, Length], AfterValidator(in_order)]


EncoderHarmonics = Annotated[
    tuple[Number, Number, Number, Number],
    Field(
        description="Error of its encoder, as calibration finds it: its angle is what it reads, from Goal "
        "Position 2048, and a cos + b sin of that + c cos + d sin of twice that: [a, b, c, d].",
    ),
]

NO_HARMONICS = (0.0, 0.0, 0.0, 0.0)


class ServoConfig(FileModel):
    """A servo on the bus."""

    ratio_key: ClassVar[str] = "gear_ratio"
    """Key whose sign says which way its joint goes."""

    dxl_id: DxlId = Field(description="ID on the bus.")
    model: ServoModel = Field(description="Model as printed on the servo.")
    homing_offset: Annotated[int, Field(strict=True, ge=-1024, le=1024)] = Field(
        default=0, description="Homing Offset in the servo's EEPROM when its zero was measured, in steps."
    )

    @property
    def _offset_turns(self) -> float:
        """Turns that the servo counts ahead of its encoder, which knows its angle within one turn."""
        return self.homing_offset / 4096

    @property
    def ratio(self) -> float:
        """Value of `ratio_key`."""
        return float(getattr(self, self.ratio_key))


@dataclass(frozen=True, slots=True)
class RigServo:
    """Servo of a rig: the joint that it moves, of a finger, or of none for the stage."""

    finger: str | None
    joint: str
    dxl_id: int
    model: str

    @property
    def name(self) -> str:
        """Name in exports, such as "f1_slide"."""
        return self.joint if self.finger is None else f"{self.finger}_{self.joint}"

    @property
    def owner(self) -> str:
        """Name for people, such as "f1 slide"."""
        return self.joint if self.finger is None else f"{self.finger} {self.joint}"


class RotaryConfig(ServoConfig):
    """A servo that turns something: servo angle = zero_deg + gear_ratio · angle."""

    gear_ratio: Ratio = Field(
        description="Servo turns per turn of what it turns; negative if they turn opposite ways."
    )
    range_deg: AngleRange = Field(description="[lo, hi] of the angle, counter-clockwise.")
    backlash_deg: Length = Field(
        description="Bound: the angle is off by at most this through play, either way."
    )
    zero_deg: Number = Field(description="Servo angle at angle 0, from its Goal Position 0.")

    def _turns(self) -> list[float]:
        """Servo turns at both ends of the range, as its encoder counts."""
        counted = (self.zero_deg + self.gear_ratio * angle for angle in self.range_deg)
        return [angle / 360 - self._offset_turns for angle in counted]

    def _check_one_turn(self) -> None:
        """Refuse a range that leaves the one turn within which a servo knows its angle at power-up."""
        turns = self._turns()
        if min(turns) < 0 or max(turns) >= 1:
            raise problem(
                f"needs servo turns {min(turns):.2f} to {max(turns):.2f}; this servo must stay within 0 … 1, "
                "because it knows its angle within one turn when it starts",
                "range_deg",
            )


class AimConfig(RotaryConfig):
    """The servo that turns the slide about the finger's base; its angle, the aim, counts from heading_deg."""

    backlash_holds_n: Length | None = Field(
        default=None,
        description="Bound: up to this force across the slide at the tip, friction holds the aim within its "
        "play; a greater one may push it to its flank. Without it: no force does.",
    )
    encoder_harmonics_deg: EncoderHarmonics = NO_HARMONICS

    @model_validator(mode="after")
    def _within_the_servo(self) -> Self:
        _check_turns(self._turns(), "range_deg")
        return self


class JointConfig(RotaryConfig):
    """The servo of an arm's joint."""

    zero_bound_deg: Annotated[Length, Field(le=45)] = Field(
        default=0.0, description="Bound: zero_deg is off by at most this, as an angle of the joint."
    )
    backlash_holds_n: Length | None = Field(
        default=None,
        description="Bound: up to this force at the tip, across its way to the joint, friction holds it "
        "within its play; a greater one may push it to its flank. Without it: no force does.",
    )
    encoder_harmonics_deg: EncoderHarmonics = NO_HARMONICS

    @model_validator(mode="after")
    def _within_one_turn(self) -> Self:
        self._check_one_turn()
        return self


class StageConfig(RotaryConfig):
    """The servo that turns the ring with all fingers; at angle 0 they stand as they are described."""

    centre_mm: Point = Field(description="[x, y] of the ring's axis in the support-plane frame W.")
    bound_deg: Annotated[Length, Field(le=45)] = Field(
        description="Bound: the ring's angle is off by at most this, besides its play."
    )
    centre_bound_mm: Length = Field(
        default=0.0, description="Bound: the ring's axis is within this distance of centre_mm."
    )

    @model_validator(mode="after")
    def _starts_within_one_turn(self) -> Self:
        lo, hi = self.range_deg
        if not lo <= 0 <= hi:
            raise problem(f"is [{lo:g}, {hi:g}]; it must contain 0, where the stage starts", "range_deg")
        self._check_one_turn()
        return self


class SlideConfig(ServoConfig):
    """The servo that moves the tip: distance from base = zero_mm + mm_per_turn · servo turns."""

    ratio_key = "mm_per_turn"

    mm_per_turn: Ratio = Field(
        description="Travel per servo turn; negative if growing angles retract the tip."
    )
    range_mm: LengthRange = Field(description="[lo, hi] of the distance from base to tip centre.")
    backlash_mm: Length = Field(
        description="Bound: the distance is off by at most this through play, either way."
    )
    zero_mm: Number = Field(description="Distance at Goal Position 0.")
    zero_bound_mm: Length = Field(default=0.0, description="Bound: zero_mm is off by at most this.")
    mm_per_turn_spread: Share = Field(
        default=0.0, description="Bound: mm_per_turn is off by at most this share."
    )
    friction_a: Annotated[Length, Field(le=1)] = Field(
        default=0.0,
        description="Bound: friction takes at least this current; max_force_n allows so much more for it.",
    )
    stops_mm: LengthRange | None = Field(
        default=None,
        description="[back, front]: distance from base to tip centre where the slide meets its hard stops; "
        "calibration homes against them.",
    )
    encoder_harmonics_deg: EncoderHarmonics = NO_HARMONICS

    @model_validator(mode="after")
    def _within_the_servo(self) -> Self:
        retracted, extended = self.range_mm
        turns = [self._turn(retracted), self._turn(extended)]
        _check_turns(turns, "range_mm")
        # After power-up a servo knows its angle within one turn, so the finger must start in that one.
        if not 0 <= turns[0] < 1:
            raise problem(
                f"is {self.zero_mm:g}: retracted, at {retracted:g} mm, with mm_per_turn = "
                f"{self.mm_per_turn:g}, the servo would stand at turn {turns[0]:.2f}; it must be in 0 … 1, "
                "because a servo starts within one turn",
                "zero_mm",
            )
        if self.stops_mm is not None:
            self._check_stops(*self.stops_mm)
        return self

    @property
    def mm_per_rad(self) -> float:
        """Travel per rad of the servo."""
        return self.mm_per_turn / (2 * math.pi)

    def off_mm(self, distance_mm: float) -> float:
        """Distance by which zero and travel per turn may put the tip off at some distance."""
        return self.zero_bound_mm + self.mm_per_turn_spread * abs(distance_mm - self.zero_mm)

    def _turn(self, distance_mm: float) -> float:
        return (distance_mm - self.zero_mm) / self.mm_per_turn - self._offset_turns

    def _check_stops(self, back_mm: float, front_mm: float) -> None:
        """Refuse soft limits that may lie on or beyond the stops, and a back stop outside the first turn."""
        lo, hi = self.range_mm
        needed = [_STOP_MARGIN_MM + self.off_mm(distance) for distance in (lo, hi)]
        if lo - back_mm < needed[0] or front_mm - hi < needed[1]:
            raise problem(
                f"is [{back_mm:g}, {front_mm:g}]; range_mm [{lo:g}, {hi:g}] needs stops at "
                f"{lo - needed[0]:.4g} or less and {hi + needed[1]:.4g} or more: {_STOP_MARGIN_MM:g} mm "
                "clear by all that zero_bound_mm and mm_per_turn_spread allow",
                "stops_mm",
            )
        back = self._turn(back_mm)
        _check_turns([back, self._turn(front_mm)], "stops_mm")
        # The finger may have been pushed back to its stop before switching on; turned on, it reads a whole
        # turn too much if that is before the servo's zero, and nothing would show it.
        off = self.off_mm(back_mm) / abs(self.mm_per_turn)
        if not off <= back < 1 - off:
            raise problem(
                f"is [{back_mm:g}, {front_mm:g}]: at the back stop the servo would stand at turn {back:.3f}, "
                f"± {off:.3f}; it must be in 0 … 1, because a servo starts within one turn",
                "stops_mm",
            )


def _check_turns(turns: list[float], key: str) -> None:
    """Refuse turns that a servo cannot count."""
    if max(abs(turn) for turn in turns) > _MAX_TURN:
        raise problem(
            f"needs servo turns {min(turns):.0f} to {max(turns):.0f}; a servo reaches {_MAX_TURN} either way",
            key,
        )
