"""Emulated hardware and parts: tables of `[emulation]` in a rig file, and scenes, `palpate/scene@1`.

Adapters, imperfect mechanics, a part that may move when it is pushed, and the scene on the table. Only
emulators use any of it. The seed draws values from ranges [lo, hi].
"""

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from palpate.config.fields import FileModel, Flag, Items, Length, Name, Number, Positive, Text, in_order
from palpate.config.loading import Source, load_json
from palpate.config.problems import TAG, problem

MAX_SCENE_PARTS = 8

Span = Annotated[tuple[Length, Length], AfterValidator(in_order)]
"""[lo, hi], from which the seed draws."""


class AdapterConfig(FileModel):
    """Delays and failures of USB adapters. Ranges are drawn by the seed."""

    latency_ms: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1, le=255)] = Field(
        default=1.0,
        description="Latency timer: what does not fill a packet of 62 bytes waits so long at most.",
    )
    echoes: Flag = Field(default=False, description="Whether it returns whatever is sent.")
    stall_ms: Span | None = Field(
        default=None, description="[lo, hi]: a hub passes nothing for so long, now and then."
    )
    stall_every_s: Positive = Field(default=2.0, description="Time between such stalls, on average.")
    gone_after_s: Span | None = Field(
        default=None,
        description="[lo, hi]: so long after the start it is unplugged, of arrays' one; absent: never.",
    )
    gone_for_s: Positive = Field(default=2.0, description="And comes back so much later.")
    comes_back_as: Literal["same", "other"] = Field(
        default="same", description="Under the name that it had, or another one."
    )
    grabbed_s: Length = Field(
        default=0.0,
        description="For so long after it is first opened, another program writes and reads, too.",
    )


_Signed = Annotated[tuple[Number, Number], AfterValidator(in_order)]
_Loss = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.9)]


class MechanicsConfig(FileModel):
    """Ranges [lo, hi] from which the seed draws; absent: as in the model of the servo and the rig file."""

    friction: Span | None = Field(
        default=None, description="Friction in motion, times that of the servo's model; each servo's own."
    )
    rest_friction: Span | None = Field(
        default=None, description="Friction at rest, times that in motion; at least 1 is taken."
    )
    cogging: Span | None = Field(
        default=None, description="Torque that comes and goes along a turn, times the model's friction."
    )
    torque_loss: Annotated[tuple[_Loss, _Loss], AfterValidator(in_order)] | None = Field(
        default=None, description="Share by which warm motors have less torque for a current."
    )
    supply_ohm: Span | None = Field(
        default=None, description="Resistance of supply and cables that all servos share."
    )
    cable_n: _Signed | None = Field(
        default=None, description="A cable pulls each slide outwards with so many N, inwards if negative."
    )
    slide_deflection_mm_per_n: Annotated[tuple[Length, Length], AfterValidator(in_order)] | None = Field(
        default=None, description="Slides give way along their travel, by so much for each N on the tip."
    )
    slip_mm: _Signed | None = Field(
        default=None, description="The screw of one slide's horn slips once: the tip is off by so much then."
    )
    slip_after_s: Span = Field(default=(5.0, 20.0), description="When it slips, from the start.")


Mass = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=100)]
"""kg"""

Friction = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=2)]
"""Coefficient of Coulomb friction."""

_FrictionOrNone = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=2)]

Range = tuple[float, float]
"""[lo, hi], from which the seed draws."""


def _number_or_range(value: object) -> str:
    return TAG + ("range" if isinstance(value, list | tuple) else "number")


_MassOrRange = Annotated[
    Annotated[Mass, Tag(TAG + "number")]
    | Annotated[tuple[Mass, Mass], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_number_or_range),
]
_FrictionOrRange = Annotated[
    Annotated[Friction, Tag(TAG + "number")]
    | Annotated[tuple[Friction, Friction], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_number_or_range),
]
_TipFrictionOrRange = Annotated[
    Annotated[_FrictionOrNone, Tag(TAG + "number")]
    | Annotated[tuple[_FrictionOrNone, _FrictionOrNone], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_number_or_range),
]


_PartCount = Annotated[int, Field(strict=True, ge=1, le=MAX_SCENE_PARTS)]

PartCountOrRange = Annotated[
    Annotated[_PartCount, Tag(TAG + "number")]
    | Annotated[tuple[_PartCount, _PartCount], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_number_or_range),
]
"""Number of parts on the table, or [lo, hi] from which the seed draws."""


def _check_feet(count: int) -> int:
    if count in (1, 2):
        raise problem(f"is {count}; a part stands on 3 feet at least, or on its whole base (0)")
    return count


class EmulatedPartConfig(FileModel):
    """Mechanics of the emulated part. A number, or [lo, hi] from which the seed draws."""

    engine: Literal["still", "quasi-static", "mujoco"] = Field(
        description="still: nothing moves it; quasi-static: it slides without inertia; mujoco: a rigid body "
        "in MuJoCo, which needs palpate[physics]."
    )
    mass_kg: _MassOrRange = Field(default=0.15, description="Mass; drawn log-uniformly from a range.")
    friction: _FrictionOrRange = Field(default=0.3, description="Friction between part and table.")
    tip_friction: _TipFrictionOrRange = Field(
        default=0.0, description="Friction between tips and whatever they touch."
    )
    feet: Annotated[int, Field(strict=True, ge=0, le=100), AfterValidator(_check_feet)] = Field(
        default=0,
        description="0: it stands on its whole base; 3 or more: on so many points, drawn by the seed and "
        "unequally loaded.",
    )


def _angle_in_rad(value: float) -> float:
    if abs(value) > 2 * math.pi:
        raise problem(f"is {value:g}; it is in rad, from −2π to 2π, where 90° are 1.5708")
    return value


class ConfigurationText(FileModel):
    """Place of the object frame in the support-plane frame W."""

    x: Number = Field(description="mm")
    y: Number = Field(description="mm")
    theta: Annotated[Number, AfterValidator(_angle_in_rad)] = Field(
        description="rad, counter-clockwise, from −2π to 2π"
    )


class PartProperties(FileModel):
    """Properties of the part that `[emulation.part]` of the rig file would have drawn."""

    mass_kg: Mass | None = Field(default=None, description="kg")
    friction: Friction | None = Field(default=None, description="Friction between part and table.")


_StateName = Annotated[Name | None, Field(description="Stable state; may be left out if there is one only.")]
_ObjectsPath = Annotated[
    Text | None, Field(description="File the object comes from, beside this one; else the run's catalogue.")
]
_Properties = Annotated[
    PartProperties, Field(description="Mass and friction, before those of the rig file's [emulation.part].")
]


class ScenePart(FileModel):
    """One of several objects on the table."""

    object: Name = Field(description="Name of the object.")
    configuration: ConfigurationText
    state: _StateName = None
    objects: _ObjectsPath = None
    part: _Properties = PartProperties()


class Scene(FileModel):
    """One object on the table, or several `parts`, `palpate/scene@1`.

    `load_scene` seeks files of `objects` beside the scene file.
    """

    format: Literal["palpate/scene@1"]
    object: Name | None = Field(default=None, description="Name of the object on the table.")
    configuration: ConfigurationText | None = None
    state: _StateName = None
    objects: _ObjectsPath = None
    part: _Properties = PartProperties()
    parts: Items[ScenePart] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_SCENE_PARTS,
        description="Several objects, in place of object and configuration above.",
    )

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        beside = [key for key in ScenePart.model_fields if key in self.model_fields_set]
        if self.parts is not None and beside:
            raise problem(f'is there beside "{beside[0]}"; give one object, or a list of parts', "parts")
        if self.parts is None:
            for key in ("object", "configuration"):
                if getattr(self, key) is None:
                    raise problem(f'the key "{key}" is missing; or give several objects as "parts"')
        return self

    @property
    def entries(self) -> tuple[ScenePart, ...]:
        """The objects, of either form."""
        if self.parts is not None:
            return tuple(self.parts)
        assert self.object is not None, "checked by _check_form"
        assert self.configuration is not None, "checked by _check_form"
        return (
            ScenePart(
                object=self.object,
                configuration=self.configuration,
                state=self.state,
                objects=self.objects,
                part=self.part,
            ),
        )

    def with_files(self, renamed: Callable[[str, int], str]) -> "Scene":
        """The scene with other files of objects: each by its name now and the number of its part, from 0."""

        def with_file(part: _PartT, number: int) -> _PartT:
            if part.objects is None:
                return part
            return part.model_copy(update={"objects": renamed(part.objects, number)})

        if self.parts is None:
            return with_file(self, 0)
        parts = [with_file(part, number) for number, part in enumerate(self.parts)]
        return self.model_copy(update={"parts": parts})


_PartT = TypeVar("_PartT", Scene, ScenePart)


def load_scene(source: Source) -> Scene:
    """Read and check the scene in `source`; its `objects` paths are taken from the scene file's folder.

    Raises:
        InputError: unreadable, wrong keys or values; one line.

    """
    scene = load_json(source, Scene, {})
    if not isinstance(source, str | os.PathLike):
        return scene
    folder = Path(source).parent
    return scene.with_files(lambda name, _: str(folder / name))
