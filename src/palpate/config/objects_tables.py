"""The text of an objects file, format `palpate/objects@1`: its tables as they stand there, and the writer.

Between JSON and `objects_file`, which checks what the values mean.
"""

import json
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from palpate.config.fields import Bounded, FileModel, Fraction, Items, Length, Name, Point, Positive, Text
from palpate.config.objects_rings import Outline

__all__ = [
    "ObjectText",
    "ObjectsFileText",
    "PolygonText",
    "RefusedText",
    "SectionText",
    "SourceText",
    "StateText",
    "objects_json",
]

NormalBound = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=3.2)]
"""rad"""


class PolygonText(FileModel):
    """A polygon as it stands in the file."""

    outer: Outline
    holes: Items[Outline] = Field(default=[], description="Outlines of holes, inside `outer`.")


class SectionText(FileModel):
    """A cross section as it stands in the file."""

    z: Bounded = Field(description="[from, to], mm above the support plane.")
    polygons: Items[PolygonText] = Field(min_length=1)


class StateText(FileModel):
    """A stable state as it stands in the file."""

    name: Name
    probability: Fraction | None = Field(default=None, description="How often the object comes to rest so.")
    tipping_angle: Annotated[float, Field(strict=True, ge=0, le=np.pi)] | None = Field(
        default=None, description="Smallest tilt that tips the object over, rad."
    )
    height: Positive | None = Field(
        default=None, description="Height of the part in this state, mm; above it there is nothing."
    )
    heights: Items[Bounded] | None = Field(
        default=None,
        min_length=1,
        description="Heights [from, to] at which the sections are known, mm, ascending; without it, all are.",
    )
    normal_bound: NormalBound | None = Field(
        default=None, description="As that of the object, before which it goes."
    )
    sections: Items[SectionText] = Field(min_length=1)
    side: Items[Items[Point]] | None = Field(
        default=None,
        max_length=64,
        description="Rings of [across, z], mm, of the silhouette seen from the side, for pictures only. "
        "Written by the import.",
    )


class SourceText(FileModel):
    """What an object was made from, so that it is made anew only when that has changed."""

    file: Text = Field(description="Seen from the folder of the objects file.")
    sha256: Annotated[str, Field(strict=True, pattern=r"^[0-9a-f]{64}$")] = Field(description="Of the file.")
    request: Annotated[str, Field(strict=True, max_length=64)] = Field(
        description="Hash of the options that it was imported with."
    )


class ObjectText(FileModel):
    """An object as it stands in the file: `outline` and `height`, or `states`."""

    name: Name
    tolerance: Length = Field(
        default=0.0, description="The part's true outline is within this distance of the model's, mm."
    )
    normal_bound: NormalBound | None = Field(
        default=None,
        description="Normals of the part's true outline are within this angle of the model's normals within "
        "`tolerance` of the place, rad; without it they may be off by what `tolerance` does to an edge.",
    )
    source: SourceText | None = Field(default=None, description="Written by the import.")
    outline: Outline | None = Field(default=None, description="Short form: the only cross section.")
    height: Positive | None = Field(default=None, description="Short form: height of the part, mm.")
    states: Items[StateText] | None = Field(default=None, min_length=1)
    part_holds_n: Positive | None = Field(
        default=None,
        description="The part does not slide below this horizontal force at its middle, N; goes before the "
        "rig's.",
    )
    part_support_mm: Positive | None = Field(
        default=None,
        description="The support's mean distance from its geometric median is at least this; goes before the "
        "rig's.",
    )


class RefusedText(FileModel):
    """A file that the import has refused, so that it is read again only when it has changed."""

    source: SourceText
    why: Text
    is_loss: bool = Field(default=False, description="It can be read, but too much would be left out.")


class ObjectsFileText(FileModel):
    """The file as it stands; source of the exported JSON Schema."""

    format: Literal["palpate/objects@1"]
    units: Literal["mm"] = Field(description="mm is the only unit; convert other drawings on import.")
    objects: Items[ObjectText] = Field(min_length=1)
    refused: Items[RefusedText] | None = Field(default=None, description="Written by the import.")


_WIDTH = 100  # to which points are filled; keys and brackets come on top


def objects_json(text: ObjectsFileText) -> str:
    """The text of the file: short things on one line, the points of an outline several to a line.

    Reading it gives the same values again, to the last digit.
    """
    return _laid_out(text.model_dump(mode="json", exclude_unset=True, exclude_none=True), 0) + "\n"


def _laid_out(value: Any, indent: int) -> str:
    """JSON of a value whose further lines begin in column `indent` + 1."""
    if isinstance(value, dict):
        before, after = "{", "}"
        parts = [f"{_plain(key)}: {_laid_out(item, indent + 1)}" for key, item in value.items()]
    elif isinstance(value, list):
        before, after = "[", "]"
        parts = [_laid_out(item, indent + 1) for item in value]
    else:
        return _plain(value)
    return before + f",\n{' ' * (indent + 1)}".join(_filled(parts, _WIDTH - indent)) + after


def _filled(parts: list[str], width: int) -> list[str]:
    """As many parts to a line as fit; those of several lines begin one of their own."""
    lines = parts[:1]
    for part in parts[1:]:
        if len(lines[-1]) + len(part) + 2 <= width and "\n" not in lines[-1] + part:
            lines[-1] += f", {part}"
        else:
            lines.append(part)
    return lines


def _plain(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
