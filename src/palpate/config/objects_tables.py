"""Text of an objects file, format `palpate/objects@1`: tables, outlines, edits, and the writer.

Between JSON and `objects_file`, which checks what the values mean. Outlines are points, points with arcs
between them, or a circle. Edits go from text to text, so that everything else in the file stays as it is.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from palpate.base.errors import InputError, nearest
from palpate.base.file_access import relative_path
from palpate.base.geometry import Circle, Curve, Floats
from palpate.base.geometry.object_model import Faceted, arcs_polygon, circle_facets, circle_polygon
from palpate.config.fields import (
    Bounded,
    Coordinate,
    FileModel,
    Fraction,
    Items,
    Length,
    Name,
    Point,
    Positive,
    Text,
)
from palpate.config.problems import TAG

_STRAY_SHARE, _MIN_STRAY_MM, _MAX_STRAY_MM = (
    0.1,
    0.002,
    0.02,
)  # of the tolerance that facets may stray, and its limits


class CircleSize(FileModel):
    """Centre and radius of a circle, mm."""

    centre: Point
    radius: Annotated[Positive, Field(le=1e6)]


class CircleText(FileModel):
    """A circle as it stands in the file."""

    circle: CircleSize


_Bulge = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100, le=100)]
_BulgedPoint = tuple[Coordinate, Coordinate, _Bulge]
_PLAIN, _BULGED, _POINTS, _ARCS, _CIRCLE = (
    TAG + name for name in ("point", "bulged", "points", "arcs", "circle")
)


def _is_bulged(point: object) -> bool:
    return isinstance(point, list | tuple) and len(point) == 3


def _kind_of_point(point: object) -> str:
    return _BULGED if _is_bulged(point) else _PLAIN


def _kind_of_outline(outline: object) -> str:
    if isinstance(outline, dict | CircleText):
        return _CIRCLE
    return _ARCS if isinstance(outline, Sequence) and any(map(_is_bulged, outline)) else _POINTS


def _any_of(schema: dict[str, Any]) -> None:
    """JSON Schema for a list of points fits one with arcs as well: not exactly one of them has to fit."""
    schema["anyOf"] = schema.pop("oneOf")


_AnyPoint = Annotated[
    Annotated[Point, Tag(_PLAIN)] | Annotated[_BulgedPoint, Tag(_BULGED)], Discriminator(_kind_of_point)
]

Outline = Annotated[
    Annotated[Items[Point], Tag(_POINTS)]
    | Annotated[Items[_AnyPoint], Tag(_ARCS)]
    | Annotated[CircleText, Tag(_CIRCLE)],
    Discriminator(_kind_of_outline),
    Field(
        description="Corner points [x, y], mm, either way round, not closed; [x, y, bulge] where an arc runs "
        "to the next point (bulge: the tangent of a quarter of its angle, positive if it turns left); or a "
        'circle, {"circle": {"centre": [x, y], "radius": r}}.',
        json_schema_extra=_any_of,
    ),
]


def curve_of(outline: Outline) -> Curve | None:
    """The circle or the arcs of an outline; None for one of straight edges."""
    if isinstance(outline, CircleText):
        return Circle(outline.circle.centre, outline.circle.radius)
    if not any(map(_is_bulged, outline)):
        return None
    return _array([(*point[:2], point[2] if len(point) == 3 else 0.0) for point in outline], 3)


def outline_edges(outline: Outline) -> int:
    """Number of edges of an outline; a circle is one."""
    return 1 if isinstance(outline, CircleText) else len(outline)


def stray_for_mm(tolerance_mm: float) -> float:
    """Distance that facets may stray from curves of an object with some tolerance."""
    return float(np.clip(_STRAY_SHARE * tolerance_mm, _MIN_STRAY_MM, _MAX_STRAY_MM))


def facets_for(outlines: Iterable[Outline], stray_mm: float) -> int:
    """Number of facets that the largest of a state's circles needs: all have as many. 0: no circle."""
    circles = [curve for curve in map(curve_of, outlines) if isinstance(curve, Circle)]
    return max((circle_facets(circle.radius_mm, stray_mm) for circle in circles), default=0)


def flat_curve(outline: Outline, stray_mm: float, facets: int) -> Faceted:
    """The polygon that stands for an outline; circles get so many `facets`."""
    curve = curve_of(outline)
    if curve is None:
        assert not isinstance(outline, CircleText), "has a curve"
        return _array(outline, 2), 0.0, 0.0
    flat = circle_polygon(curve, facets) if isinstance(curve, Circle) else arcs_polygon(curve, stray_mm)
    flat[0].setflags(write=False)
    return flat


def outline_text(ring: Floats, curve: Curve | None) -> object:
    """Text in the file for a ring (n, 2), or for the curve that it stands for."""
    if curve is None:
        return [(x, y) for x, y in np.asarray(ring).tolist()]
    if isinstance(curve, Circle):
        return {"circle": {"centre": curve.centre_mm, "radius": curve.radius_mm}}
    return [(x, y, bulge) if bulge else (x, y) for x, y, bulge in curve.tolist()]


def _array(points: Sequence[Sequence[float]], columns: int) -> Floats:
    array = np.array(points, dtype=np.float64).reshape(-1, columns)
    array.setflags(write=False)
    return array


NormalBound = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=3.2)]
"""rad"""


Cosine = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1, le=1)]
"""Of a direction and an axis."""


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
    down: tuple[Cosine, Cosine, Cosine] | None = Field(
        default=None,
        description="Direction of the CAD file that points down; for lists. Written by the import.",
    )


class SourceText(FileModel):
    """Origin of an imported object, so that it is made anew only when that has changed."""

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
    least_tip_radius: Positive | None = Field(
        default=None,
        description="The model is of what tips of at least this radius can feel, mm: narrower notches may "
        "not be in it. Written where a part was learned by touch.",
    )
    source: SourceText | None = Field(default=None, description="Written by the import.")
    size: tuple[Positive, Positive, Positive] | None = Field(
        default=None,
        description="Extents along the axes of its CAD file, mm; for lists. Written by the import.",
    )
    mass_g: Positive | None = Field(default=None, description="Mass, g; for lists. Written by the import.")
    tags: Items[Name] | None = Field(default=None, description="Words by which lists choose; as you like.")
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


_LINE_CHARS = 100  # to which points are filled; keys and brackets come on top


def objects_json(text: ObjectsFileText) -> str:
    """The text of the file: short things on one line, the points of an outline several to a line.

    Reading it gives the same values again, to the last digit.
    """
    return _layout(text.model_dump(mode="json", exclude_unset=True, exclude_none=True), 0) + "\n"


def _layout(value: Any, indent: int) -> str:
    """JSON of a value whose further lines begin in column `indent` + 1."""
    if isinstance(value, dict):
        before, after = "{", "}"
        parts = [f"{_json_of(key)}: {_layout(item, indent + 1)}" for key, item in value.items()]
    elif isinstance(value, list):
        before, after = "[", "]"
        parts = [_layout(item, indent + 1) for item in value]
    else:
        return _json_of(value)
    return before + f",\n{' ' * (indent + 1)}".join(_fill_lines(parts, _LINE_CHARS - indent)) + after


def _fill_lines(parts: list[str], width: int) -> list[str]:
    """Join as many parts to a line as fit; those of several lines begin one of their own."""
    lines = parts[:1]
    for part in parts[1:]:
        if len(lines[-1]) + len(part) + 2 <= width and "\n" not in lines[-1] + part:
            lines[-1] += f", {part}"
        else:
            lines.append(part)
    return lines


def _json_of(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


_MAX_NAMES = 12


def select_objects(text: ObjectsFileText, names: Sequence[str], file: str) -> ObjectsFileText:
    """Keep some objects only. Raises InputError for a name that no object has."""
    check_objects_there([item.name for item in text.objects], names, file)
    return text.model_copy(update={"objects": [item for item in text.objects if item.name in names]})


def select_tagged(text: ObjectsFileText, tags: Sequence[str], file: str) -> ObjectsFileText:
    """Keep the objects that have all of these tags. Raises InputError if none has."""
    left = [item for item in text.objects if set(tags) <= set(item.tags or ())]
    if not left:
        there = sorted({tag for item in text.objects for tag in item.tags or ()})
        some = f"{', '.join(there[:_MAX_NAMES])}{', …' if len(there) > _MAX_NAMES else ''}"
        raise InputError(f"{file}: no object is tagged {' and '.join(tags)}; its tags are {some or 'none'}")
    return text.model_copy(update={"objects": left})


def remove_objects(text: ObjectsFileText, names: Sequence[str], file: str) -> ObjectsFileText:
    """Leave out objects. Raises InputError for a name that no object has, and if no object would be left."""
    check_objects_there([item.name for item in text.objects], names, file)
    left = [item for item in text.objects if item.name not in names]
    if not left:
        raise InputError(f"{file} would hold no object any more; delete the file instead")
    return text.model_copy(update={"objects": left})


def rename_object(text: ObjectsFileText, old: str, new: str, file: str) -> ObjectsFileText:
    """Give an object another name. Raises InputError for a name that none has, or that another one has."""
    check_objects_there([item.name for item in text.objects], [old], file)
    if new != old and any(item.name == new for item in text.objects):
        raise InputError(f'{file}: another object is named "{new}" already')
    objects = [item.model_copy(update={"name": new}) if item.name == old else item for item in text.objects]
    return text.model_copy(update={"objects": objects})


def merge_objects(texts: Sequence[tuple[Path, ObjectsFileText]], target: Path) -> ObjectsFileText:
    """All objects of several files, for a file at `target`.

    CAD files that they came from are named as seen from there. The same object twice is taken once. Raises
    InputError if two files have different objects of one name.
    """
    objects: dict[str, ObjectText] = {}
    owner: dict[str, Path] = {}
    refused: list[RefusedText] = []
    for path, text in texts:
        for item in text.objects:
            moved = item
            if item.source is not None:
                moved = item.model_copy(update={"source": _relative_source(item.source, path, target)})
            there = objects.setdefault(item.name, moved)
            if there != moved:
                raise InputError(
                    f'{path} and {owner[item.name]} have different objects named "{item.name}"; rename one'
                )
            owner.setdefault(item.name, path)
        for entry in text.refused or []:
            seen = entry.model_copy(update={"source": _relative_source(entry.source, path, target)})
            refused += [] if seen in refused else [seen]
    made = texts[0][1].model_copy(update={"objects": list(objects.values())})
    return made.model_copy(update={"refused": refused}) if refused else made


def _relative_source(source: SourceText, path: Path, target: Path) -> SourceText:
    """A source as an objects file in another folder has it."""
    file = relative_path(path.parent / source.file, target.parent)
    return source.model_copy(update={"file": file})


def check_objects_there(there: Sequence[str], names: Iterable[str], file: str) -> None:
    """Raise InputError for the first of some names that no object in `file` has; `there`: those of all."""
    for name in names:
        if name in there:
            continue
        near = nearest(name, there)
        hint = f"it has {', '.join(there[:_MAX_NAMES])}{', …' if len(there) > _MAX_NAMES else ''}"
        hint = hint if near is None else f'did you mean "{near}"?'
        raise InputError(f'{file}: has no object "{name}"; {hint}')
