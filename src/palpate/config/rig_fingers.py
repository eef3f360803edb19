"""Finger tables of a rig file: tactile array, bounds, and keys common to all types of finger.

The values keep the file's units: mm, degrees, N.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, ClassVar, Literal, Self, cast, get_args

from pydantic import (
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    SerializeAsAny,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from palpate.base.extensions import TACTILE_ARRAYS, broken_plugin_error, registered_names
from palpate.base.tips import Ability, Refusals
from palpate.config.calibration_finger import ContactBounds, PlaceInHandFrame, TactileCalibration
from palpate.config.emulation import MechanicsConfig
from palpate.config.fields import (
    Count,
    FileModel,
    Items,
    Length,
    Name,
    Point,
    Positive,
    Text,
    check_gains,
    plugin,
)
from palpate.config.problems import problem
from palpate.config.rig_servos import Angle, ServoConfig, Share
from palpate.config.rig_tips import TipConfig, check_keys

PALPATE_PROTOCOL = "palpate"
"""Protocol of arrays that describe themselves, docs/tactile-protocol.md; built in."""

CONTACT_LINES_PROTOCOL = "contact-lines"
"""Protocol of contact sources that send lines of text, docs/contact-lines.md: built in, too."""

CURRENT_PROTOCOL = "present-current"
"""In place of an array's protocol: the finger has none, and senses by its servos' Present Current."""

SHIPPED_PROTOCOLS = ("weiss-wts", "weiss-dsa", "reskin", "fsr-matrix", "flexitac", "paxini")
"""Protocols of the plug-ins in `plugins/`; the rig file's JSON Schema shows the keys of those installed."""

BOUND_SIGMAS = 3.3
"""Standard deviations that 99.9 % of a normal distribution lie within (3.29)."""

ENCODER_DEG = 1.5
"""Largest error of encoders in X series servos. ams: AS5045 1.4° with its magnet 0.25 mm off centre, 0.9°
with it centred; AS5601 1° with it centred. Robotis does not say how well magnets are centred."""

_COVERAGE_DEG = 270.0


class TaxelsConfig(FileModel):
    """Calibration of an array's taxels, row by row from the tip's lower end up."""

    gain: Items[Items[Positive]] = Field(description="Relative gain of every taxel, 1 where unknown.")
    gain_bound: Items[Items[Share]] = Field(
        description="Bound: each gain is off by at most this share of it."
    )
    unusable: Items[tuple[Count, Count]] = Field(
        default=[], description="[row, column] of dead and hot taxels."
    )
    noise_counts: Positive = Field(description="Standard deviation of a taxel's noise.")
    crosstalk: Annotated[Length, Field(le=0.25)] = Field(
        description="Share of a taxel's force that each neighbour shows."
    )
    crosstalk_bound: Length = Field(description="Bound: crosstalk is off by at most this.")
    force_drift_n_per_s: Length | None = Field(
        default=None,
        description="Bound: what usable taxels of any three neighbouring columns show together, untouched, "
        "moves no faster; else as if all moved as fast as drift_counts_per_s and alike.",
    )

    @model_validator(mode="after")
    def _is_a_matrix(self) -> Self:
        rows, cols = check_gains(self.gain, self.gain_bound)
        for row, col in self.unusable:
            if row >= rows or col >= cols:
                raise problem(f"names taxel [{row}, {col}] of {rows} x {cols}", "unusable")
        return self


class ArrayConfig(FileModel):
    """The tactile array round the tip."""

    # Protocols other than "palpate" come by plug-in, each with a model of its own: a subclass of this one
    # with the keys that only its arrays need. Validating a table gives the model that `protocol` names.

    has_device: ClassVar[bool] = True
    """True if there is an array, on a port of its own."""
    reports_contacts: ClassVar[bool] = False
    """True if the device reports contacts and no taxels."""
    cannot: ClassVar[Refusals] = {}
    """Abilities that a finger with it has not, and why; a reason goes on from "finger f1: "."""
    idle_noise_counts: ClassVar[float] = 2.0
    """Standard deviation of a taxel that was not calibrated; 0: at rest it may always read the same."""
    port: Text = Field(description="Device path, socket://host:port, or mock://name for an emulated array.")
    baudrate_bps: Annotated[int, Field(strict=True, ge=9600, le=12_000_000)] = Field(description="Baud rate.")
    protocol: Text = Field(
        description='What the array speaks: "palpate" is docs/tactile-protocol.md, "contact-lines" '
        'docs/contact-lines.md; "weiss-wts", '
        '"weiss-dsa", "reskin", "fsr-matrix", "flexitac" and "paxini" come by plug-ins in plugins/; others '
        "add more."
    )
    gain_spread: Share = Field(description="Bound: each taxel's gain is off by at most this share.")
    drift_counts_per_s: Length = Field(
        default=0.0, description="Bound: no taxel's zero moves faster; 0 takes zeros as they were when tared."
    )
    lag_s: Annotated[Length, Field(le=1)] = Field(
        default=0.0,
        description="Bound: a reading shows what presses, to 1 %, after so long: what a filter of its "
        "firmware takes; 0: at once.",
    )
    heading_deg: Angle = Field(
        default=0.0,
        description="Where the array's middle looks, from the slide's or the arm's last link's direction.",
    )
    heading_bound_deg: Annotated[Length, Field(le=45)] = Field(
        default=0.0, description="Bound: heading_deg is off by at most this."
    )
    taxels: TaxelsConfig | None = Field(
        default=None, description="Gains and faults of single taxels; calibration finds them."
    )
    coverage_deg: Annotated[Positive, Field(le=360)] = Field(
        default=_COVERAGE_DEG, description="How much of the tip's circumference has taxels."
    )
    pitch_mm: Positive | None = Field(
        default=None,
        description="Bound: columns of a pad's flat array are no further apart; they reach from one edge of "
        "its face to the other.",
    )

    first_texel: Literal["lower-left", "lower-right", "upper-left", "upper-right"] | None = Field(
        default=None,
        description="Corner of the matrix where the device begins to count, seen from outside with the tip "
        "pointing up; lower-left if left out. palpate check --press finds it.",
    )

    @classmethod
    def variant(cls, data: object) -> type[FileModel]:
        """The model of the protocol that `data` names. Raises a pydantic error if no plug-in adds it."""
        name = data.get("protocol") if isinstance(data, dict) else None
        if name in _BUILT_IN:
            return _BUILT_IN[name]
        return ArrayConfig if not isinstance(name, str) or name == PALPATE_PROTOCOL else _model_of(name)

    @model_validator(mode="wrap")
    @classmethod
    def _by_protocol(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        model = cls.variant(data)
        return handler(data) if model is cls else cast("Self", model.model_validate(data))

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema with the keys of shipped plug-ins that are installed; those of others vary."""
        schema = handler.resolve_ref_schema(handler(core))
        if cls is ArrayConfig:
            models = _BUILT_IN | _installed_models()
            for model in models.values():
                schema["properties"] = model.model_json_schema()["properties"] | schema["properties"]
            schema["properties"]["protocol"]["examples"] = [PALPATE_PROTOCOL, *models]
            schema["additionalProperties"] = True
        return schema


class MountedArrayConfig(ArrayConfig):
    """Keys of arrays that know their cells only: how strong they are and how they sit on the tip."""

    counts_per_n: Positive = Field(
        description="What 1 N on a taxel adds to its count; for arrays that do not tell (weiss-…)."
    )
    shape: Literal["cylinder", "flat"] | None = Field(
        default=None,
        description="Whether the matrix is bent round the tip, as it is if left out, or flat (weiss-…).",
    )
    first_row: Literal["across", "upright"] | None = Field(
        default=None,
        description="Whether the device's rows run round the tip, as they do if left out, or along its axis "
        "(weiss-…).",
    )


class FreeRunningArrayConfig(ArrayConfig):
    """Keys of sensors that run freely: they send by themselves, at a rate that nobody sets."""

    rate_hz: Annotated[Positive, Field(le=1000)] = Field(
        description="Frames a second that the sensor sends by itself."
    )
    delay_s: Annotated[Positive, Field(le=0.2)] = Field(
        default=0.04,
        description="Bound: from the first reading of a frame to the frame's arrival at this computer, with "
        "adapter and hub.",
    )


class WrappedArrayConfig(FreeRunningArrayConfig):
    """Keys of sensors that run freely, wrapped round an upright tip, whose cells need not be linear.

    They cannot be asked anything. Normals are taken from the places of cells that are pressed.
    """

    columns: Annotated[Count, Field(ge=2, le=255)] = Field(description="Columns of cells round the tip.")
    column_step_deg: Annotated[Positive, Field(le=90)] = Field(
        description="Angle about the tip's axis from one column to the next."
    )
    row_heights_mm: Items[Length] = Field(
        min_length=1,
        description="Heights of the rows of cells over the tip's lower end, ascending; of a single row "
        "normals are hardly known.",
    )


class ContactSourceConfig(FreeRunningArrayConfig):
    """Keys of contact sources: devices that report contacts by themselves, at a rate that nobody sets."""

    reports_contacts: ClassVar[bool] = True
    cannot: ClassVar[Refusals] = {
        "calibrate": "its contact source reports contacts and no taxels; measure the finger by hand",
        "calibrate taxels": "its contact source has no taxels",
        "check what parts hold": "its contact source may not know which way the part presses",
        "simulate": "contact sources have bounds of their own, which nobody knows beforehand",
    }
    idle_noise_counts: ClassVar[float] = 0.0
    gain_spread: Share = Field(
        default=0.0,
        description="Bound: forces that planning expects are off by at most this share; of contacts the "
        "source's own bounds count.",
    )
    angle_bound_deg: Annotated[Length, Field(le=180)] = Field(
        default=0.0,
        description="Bound: no angle that the source reports is trusted to be nearer than this (contact "
        "sources).",
    )
    force_bound_n: Length = Field(
        default=0.0,
        description="Bound: no force that the source reports is trusted to be nearer than this (contact "
        "sources).",
    )

    @model_validator(mode="after")
    def _has_no_taxels(self) -> Self:
        for key in ("taxels", "first_texel", "pitch_mm", "drift_counts_per_s"):
            if getattr(self, key):
                raise problem("is there, and a contact source has no taxels; leave it out", key)
        return self


class ContactLinesConfig(ContactSourceConfig):
    """Keys of contact sources that send lines of text."""

    protocol: Literal["contact-lines"] = Field(description="Lines of JSON, docs/contact-lines.md.")
    source: Name | None = Field(
        default=None,
        description='What its lines say as "finger", where several share a connection (contact-lines).',
    )
    checksum: bool = Field(
        default=False, description="True: lines without a checksum are left out (contact-lines)."
    )


class CurrentSensingConfig(ArrayConfig):
    """What a finger without an array senses with: its servos' Present Current, beyond their friction."""

    has_device: ClassVar[bool] = False
    cannot: ClassVar[Refusals] = {
        ability: f"it has no array and senses by Present Current: it cannot {ability}"
        for ability in get_args(Ability)
        if ability not in ("identify", "plan", "turn on the way")
    }
    protocol: Literal["present-current"] = Field(description="The finger has no array.")
    port: Literal["none"] = Field(default="none", description="It has none.")
    baudrate_bps: Literal[0] = Field(default=0, description="It has none.")
    gain_spread: Share = Field(
        description="Bound: the force for a current is off by at most this share, by the motor's torque and "
        "by what gears and guides lose of it under load."
    )
    friction_n: tuple[Length, Length] = Field(
        description="Bound: [lo, hi] of the force at the tip that the slide's current shows in free space on "
        "its way, one step of Present Current included; at rest hi at most (present-current)."
    )
    aim_friction_nmm: Length = Field(
        description="Bound: the torque on the slide, N mm, that the aim's current shows in free space, "
        "turning steadily or at rest, one step of Present Current included (present-current)."
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.friction_n[0] > self.friction_n[1]:
            raise problem("has its lower bound above its upper one", "friction_n")
        return self

    def hidden_n(self, lever_mm: float) -> float:
        """Force (N) that friction may hide, with the tip so far from the aim's axis."""
        low, high = self.friction_n
        return (1 + self.gain_spread) * math.hypot(high - low, 2 * self.aim_friction_nmm / lever_mm)


_BUILT_IN: dict[str, type[ArrayConfig]] = {
    CURRENT_PROTOCOL: CurrentSensingConfig,
    CONTACT_LINES_PROTOCOL: ContactLinesConfig,
}
"""Models of what is built in beside the array that describes itself."""


def _model_of(protocol: str) -> type[ArrayConfig]:
    """The model that a plug-in gives for the array's table."""
    model = getattr(
        plugin(TACTILE_ARRAYS, protocol, [PALPATE_PROTOCOL, *_BUILT_IN], "protocol"), "config", None
    )
    if not (isinstance(model, type) and issubclass(model, ArrayConfig)):
        reason = "its config is no subclass of ArrayConfig"
        raise problem(str(broken_plugin_error(TACTILE_ARRAYS, protocol, reason)), "protocol")
    return model


def _installed_models() -> dict[str, type[ArrayConfig]]:
    """Models of the shipped protocols that are installed and can be imported.

    One that cannot be is said where a rig file names it.
    """
    models = {}
    for name in SHIPPED_PROTOCOLS:
        if name in registered_names(TACTILE_ARRAYS):
            with suppress(PydanticCustomError):
                models[name] = _model_of(name)
    return models


class BoundsConfig(FileModel):
    """Bounds on the finger's place."""

    base_mm: Length = Field(description="Bound: the base is within this distance of base_mm.")
    heading_deg: Annotated[Length, Field(le=45)] = Field(
        description="Bound: the heading is off by at most this."
    )
    position_mm: Positive | None = Field(
        default=None,
        description="Bound on the tip centre's place anywhere in the workspace, as calibration finds it; "
        "takes the place of what base_mm, heading_deg, backlash and radius_bound_mm add up to.",
    )
    direction_deg: Annotated[Positive, Field(le=45)] | None = Field(
        default=None,
        description="Bound on the direction that carries the array, as calibration finds it; likewise.",
    )
    encoder_deg: Annotated[Length, Field(le=10)] = Field(
        default=ENCODER_DEG,
        description="Bound: encoders of both servos are off by at most this, as an angle of the servo; "
        "position_mm and direction_deg are without it.",
    )
    deflection_mm_per_n: Annotated[Length, Field(le=1)] = Field(
        default=0.0,
        description="Bound: a force on the tip bends what carries it, and moves its centre, by at most this "
        "per N.",
    )
    deflection_deg_per_n: Annotated[Length, Field(le=10)] = Field(
        default=0.0, description="Bound: and turns the array by at most this per N."
    )


class FingerConfig(FileModel, ABC):
    """Finger: what tables of every type have. A type is a subclass with a key `type`, a `Literal`."""

    drawn_within: ClassVar[Sequence[tuple[str, str]]] = ()
    """Keys of [emulation] and the bounds of its mechanism, by their places in its table."""
    calibrated_by: ClassVar[tuple[type, ...]] = ()
    """Tables of a calibration that are of this type."""
    no_calibration: ClassVar[str] = "is of a type that palpate does not calibrate yet"
    """Reason why a calibration's table is not of this type."""

    name: Name = Field(description="How reports and messages call it.")
    base_mm: Point = Field(description="[x, y] of the aim's or shoulder's axis in the support-plane frame W.")
    heading_deg: Angle = Field(
        description="Direction of the slide at aim 0, or of the first link at shoulder angle 0, "
        "counter-clockwise from +x of W."
    )
    height_mm: Positive = Field(description="Height of the middle of the tip above the support plane.")
    tip: TipConfig
    array: SerializeAsAny[ArrayConfig]
    bounds: BoundsConfig

    @model_validator(mode="after")
    def _stands_clear(self) -> Self:
        tip = self.tip.kind
        check_keys(tip, self.array, "array")
        check_keys(tip, self.bounds, "bounds")
        pitch_mm, width_mm = self.array.pitch_mm, self.tip.width_mm
        if pitch_mm is not None and width_mm is not None and pitch_mm > width_mm:
            raise problem(f"is {pitch_mm:g}; it is at most tip.width_mm ({width_mm:g})", "array", "pitch_mm")
        if self.tip.half_height_mm > self.height_mm:
            raise problem(
                f"is {getattr(self.tip, tip.half_height_key):g}, too much at height_mm "
                f"({self.height_mm:g}): the {tip.noun} would reach below the support plane",
                *("tip", tip.half_height_key),
            )
        return self

    @property
    def span_mm(self) -> tuple[float, float]:
        """Heights (from, to) of the tip's lower and upper end."""
        return self.height_mm - self.tip.half_height_mm, self.height_mm + self.tip.half_height_mm

    @property
    @abstractmethod
    def servos(self) -> Mapping[str, ServoConfig]:
        """Both servos by their keys, the one next to the base first."""

    @property
    @abstractmethod
    def lever_mm(self) -> float:
        """Largest distance of the tip from the joint that its deflection turns it about."""

    @property
    def stops_mm(self) -> tuple[float, float] | None:
        """Hard stops that it can be homed against; None without any."""
        return None

    @abstractmethod
    def start_tip_mm(self, radius_mm: float) -> tuple[float, float]:
        """Tip centre where the finger must start; `radius_mm`: of the circle that holds the workspace."""

    @abstractmethod
    def check_place(self, radius_mm: float, *at: str | int) -> None:
        """Refuse a finger that cannot wait outside that circle or never reaches into it; `at`: its table."""

    def give_mm_per_n(self, _mechanics: MechanicsConfig | None) -> float:
        """Emulated give of its mechanism, along the way of the tip."""
        return 0.0

    def with_actuators(self, _found: Any) -> Self:
        """The finger with calibrated servos."""
        return self

    def with_place(self, _found: Any) -> Self:
        """The finger where it was found to stand."""
        return self

    def with_tactile(self, found: TactileCalibration) -> Self:
        """The finger with a calibrated array and skin."""
        taxels = TaxelsConfig(
            gain=found.gain,
            gain_bound=found.gain_bound,
            unusable=[(taxel.row, taxel.col) for taxel in found.unusable],
            noise_counts=found.noise_counts,
            crosstalk=found.crosstalk,
            crosstalk_bound=found.crosstalk_bound,
            force_drift_n_per_s=found.force_drift_n_per_s,
        )
        array = {"taxels": taxels, "drift_counts_per_s": found.drift_counts_per_s}
        tip = {"stiffness_n_per_mm": found.stiffness_n_per_mm, "stiffness_spread": found.stiffness_bound}
        return self.replace_in_tables(array=array, tip=tip)

    def with_bounds(self, found: ContactBounds) -> Self:
        """The finger with contact bounds, which contain those of radius and heading."""
        return self.replace_in_tables(
            bounds={"position_mm": found.position_mm, "direction_deg": found.direction_deg},
            tip={"radius_bound_mm": 0.0},
            array={"heading_bound_deg": 0.0},
        )

    def place_in_hand_frame(self, found: PlaceInHandFrame, **tables: Mapping[str, object]) -> Self:
        """The finger at a place, with its tip's radius, its array's heading and other values in `tables`."""
        placed = self.model_copy(update={"base_mm": found.base_mm, "heading_deg": found.heading_deg})
        changes = {key: dict(values) for key, values in tables.items()}
        if found.encoder_harmonics_deg is not None:
            changes["bounds"] = {"encoder_deg": found.encoder_bound_deg}
            for key, own in zip(self.servos, found.encoder_harmonics_deg, strict=True):
                changes[key] = changes.get(key, {}) | {"encoder_harmonics_deg": own}
        return placed.replace_in_tables(
            **changes,
            tip={
                "radius_mm": found.tip_radius_mm,
                "radius_bound_mm": BOUND_SIGMAS * found.tip_radius_sigma_mm,
            },
            array={
                "heading_deg": found.array_heading_deg,
                "heading_bound_deg": BOUND_SIGMAS * found.array_heading_sigma_deg,
            },
        )

    def replace_in_tables(self, **tables: Mapping[str, object]) -> Self:
        """The finger with other values in some of its tables."""
        new = {key: getattr(self, key).model_copy(update=values) for key, values in tables.items()}
        return self.model_copy(update=new)
