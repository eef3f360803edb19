"""Finger tables of a rig file: tactile array, bounds, and the mechanism that carries the tip.

A finger is of one of two types: "slide", an aim that turns a slide, or "two-link", an arm with a shoulder
and an elbow. The values keep the file's units: mm, degrees, N.
"""

from contextlib import suppress
from typing import Annotated, Any, Literal, Self, cast

from pydantic import (
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    SerializeAsAny,
    Tag,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from palpate.base.extensions import TACTILE_ARRAYS, broken_plugin_error, registered_names
from palpate.config.fields import Count, FileModel, Items, Length, Name, Point, Positive, Text, plugin
from palpate.config.problems import TAG, problem
from palpate.config.rig_servos import AimConfig, Angle, JointConfig, Share, SlideConfig
from palpate.config.rig_tips import TipConfig, check_keys

PALPATE_PROTOCOL = "palpate"
"""Protocol of arrays that describe themselves, docs/tactile-protocol.md: the only one that is built in."""

SHIPPED_PROTOCOLS = ("weiss-wts", "weiss-dsa")
"""Protocols of the plug-ins in `plugins/`; the rig file's JSON Schema shows the keys of those installed."""

_COVERAGE_DEG = 270.0


def check_gains(gain: list[list[float]], gain_bound: list[list[float]]) -> tuple[int, int]:
    """Rows and columns of two matrices by taxel; refuses those that differ in shape."""
    rows, cols = len(gain), len(gain[0]) if gain else 0
    for key, matrix in (("gain", gain), ("gain_bound", gain_bound)):
        if 0 in (rows, cols) or len(matrix) != rows or any(len(row) != cols for row in matrix):
            raise problem("has rows of different lengths; both matrices have a value for each taxel", key)
    return rows, cols


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

    port: Text = Field(description="Device path, socket://host:port, or mock://name for an emulated array.")
    baudrate_bps: Annotated[int, Field(strict=True, ge=9600, le=12_000_000)] = Field(description="Baud rate.")
    protocol: Text = Field(
        description='What the array speaks: "palpate" is docs/tactile-protocol.md; "weiss-wts" and '
        '"weiss-dsa" are tactile sensors of Weiss Robotics; installed plug-ins add others.'
    )
    gain_spread: Share = Field(description="Bound: each taxel's gain is off by at most this share.")
    drift_counts_per_s: Length = Field(
        default=0.0, description="Bound: no taxel's zero moves faster; 0 takes zeros as they were when tared."
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

    @classmethod
    def variant(cls, data: object) -> type[FileModel]:
        """The model of the protocol that `data` names. Raises a pydantic error if no plug-in adds it."""
        name = data.get("protocol") if isinstance(data, dict) else None
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
            models = _installed_models()
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
    first_texel: Literal["lower-left", "lower-right", "upper-left", "upper-right"] | None = Field(
        default=None,
        description="Corner of the matrix where the device begins to count, seen from outside with the tip "
        "pointing up; lower-left if left out (weiss-…).",
    )
    first_row: Literal["across", "upright"] | None = Field(
        default=None,
        description="Whether the device's rows run round the tip, as they do if left out, or along its axis "
        "(weiss-…).",
    )


def _model_of(protocol: str) -> type[ArrayConfig]:
    """The model that a plug-in gives for the array's table."""
    model = getattr(plugin(TACTILE_ARRAYS, protocol, [PALPATE_PROTOCOL], "protocol"), "config", None)
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
    deflection_mm_per_n: Annotated[Length, Field(le=1)] = Field(
        default=0.0,
        description="Bound: a force on the tip bends what carries it, and moves its centre, by at most this "
        "per N.",
    )
    deflection_deg_per_n: Annotated[Length, Field(le=10)] = Field(
        default=0.0, description="Bound: and turns the array by at most this per N."
    )


class _MountedFinger(FileModel):
    """Tables that fingers of both types have."""

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


class SlideFingerConfig(_MountedFinger):
    """One finger: an aim servo turns a slide about a fixed base, a slide servo moves the tip along it."""

    type: Literal["slide"] = Field(default="slide", description='"slide": an aim and a slide.')
    aim: AimConfig
    slide: SlideConfig

    @property
    def servos(self) -> dict[str, AimConfig | SlideConfig]:
        """Both servos by their keys, the one next to the base first."""
        return {"aim": self.aim, "slide": self.slide}


class LinksConfig(FileModel):
    """The two links of an arm, which pass above the parts; the tip hangs down from the end of the second."""

    upper_mm: Positive = Field(description="From the shoulder's axis to the elbow's.")
    fore_mm: Positive = Field(description="From the elbow's axis to the tip's.")
    bound_mm: Length = Field(description="Bound: each length is off by at most this.")
    width_mm: Positive = Field(description="Width of the links, seen from above.")
    links_height_mm: Positive = Field(
        description="Underside of the links above the support plane; parts must be lower."
    )


class ArmFingerConfig(_MountedFinger):
    """One finger: an arm of two links, turned by a shoulder servo at the base and an elbow servo."""

    type: Literal["two-link"] = Field(description='"two-link": an arm with a shoulder and an elbow.')
    shoulder: JointConfig
    elbow: JointConfig
    links: LinksConfig

    @model_validator(mode="after")
    def _bends_one_way(self) -> Self:
        if (why := self.tip.kind.cannot.get("turn on the way")) is not None:
            raise problem(f'is "{self.tip.shape}"; {why}', "tip", "shape")
        lo, hi = self.elbow.range_deg
        if lo <= 0 <= hi or max(abs(lo), abs(hi)) > 180:
            raise problem(
                f"is [{lo:g}, {hi:g}]; the elbow bends one way, so that both are above 0 or both below, "
                "and by 180 at most",
                *("elbow", "range_deg"),
            )
        if self.height_mm >= self.links.links_height_mm:
            raise problem(
                f"is {self.links.links_height_mm:g}, not above the tip's height_mm ({self.height_mm:g})",
                *("links", "links_height_mm"),
            )
        if self.span_mm[1] > self.links.links_height_mm:
            raise problem(
                f"is {self.links.links_height_mm:g}, below the tip's upper end "
                f"({self.span_mm[1]:g}, by its {self.tip.kind.half_height_key})",
                *("links", "links_height_mm"),
            )
        return self

    @property
    def servos(self) -> dict[str, JointConfig]:
        """Both servos by their keys, the one next to the base first."""
        return {"shoulder": self.shoulder, "elbow": self.elbow}


def _kind(value: Any) -> str | None:
    kind = value.get("type", "slide") if isinstance(value, dict) else getattr(value, "type", "slide")
    return TAG + kind if isinstance(kind, str) else None


FingerConfig = Annotated[
    Annotated[SlideFingerConfig, Tag(TAG + "slide")] | Annotated[ArmFingerConfig, Tag(TAG + "two-link")],
    Discriminator(
        _kind,
        custom_error_type="finger_type",
        custom_error_message="type",
    ),
]
"""A finger of either type, by its key `type`."""
