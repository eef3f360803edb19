"""Scenes, format `palpate/scene@1`: what lies on an emulated rig's table, and how. Only emulators see it."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from palpate.config.emulated_part import Friction, Mass
from palpate.config.fields import FileModel, Name, Number, Text
from palpate.config.loading import Source, load_json

__all__ = ["Scene", "SceneFile", "ScenePart", "load_scene"]


class ConfigurationText(FileModel):
    """Where the object frame lies in the support-plane frame W."""

    x: Number = Field(description="mm")
    y: Number = Field(description="mm")
    theta: Number = Field(description="rad, counter-clockwise")


class ScenePart(FileModel):
    """What is known of the part where `[emulation.part]` of the rig file would have it drawn."""

    mass_kg: Mass | None = Field(default=None, description="kg")
    friction: Friction | None = Field(default=None, description="Friction between part and table.")


class SceneFile(FileModel):
    """The file as it stands; source of the exported JSON Schema."""

    format: Literal["palpate/scene@1"]
    object: Name = Field(description="Name of the object on the table.")
    state: Name | None = Field(
        default=None, description="Stable state; may be left out if there is one only."
    )
    configuration: ConfigurationText
    objects: Text | None = Field(
        default=None, description="File the object comes from, beside this one; else the run's catalogue."
    )
    part: ScenePart = Field(
        default=ScenePart(), description="Mass and friction, before those of the rig file's [emulation.part]."
    )


@dataclass(frozen=True, slots=True)
class Scene:
    """One object on the table: `state` None means its only one, `objects` None the run's catalogue.

    `mass_kg` and `friction` (part on table): None as the rig file has them.
    """

    object: str
    state: str | None
    x_mm: float
    y_mm: float
    theta_rad: float
    objects: Path | None
    mass_kg: float | None = None
    friction: float | None = None


def load_scene(source: Source) -> Scene:
    """Read and check the scene in `source`; its `objects` path is taken from the scene file's folder.

    Raises:
        InputError: unreadable, wrong keys or values; one line.

    """
    text = load_json(source, SceneFile, {})
    folder = Path(source).parent if isinstance(source, str | os.PathLike) else Path()
    return Scene(
        object=text.object,
        state=text.state,
        x_mm=text.configuration.x,
        y_mm=text.configuration.y,
        theta_rad=text.configuration.theta,
        objects=None if text.objects is None else folder / text.objects,
        mass_kg=text.part.mass_kg,
        friction=text.part.friction,
    )
