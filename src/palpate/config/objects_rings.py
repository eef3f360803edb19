"""Outlines as they stand in an objects file: points, points with arcs between them, or a circle."""

from collections.abc import Iterable, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from palpate.base.geometry import Circle, Curve, Floats
from palpate.base.geometry.curves import FlatCurve, arcs_polygon, circle_facets, circle_polygon
from palpate.config.fields import Coordinate, FileModel, Items, Point, Positive
from palpate.config.model_places import TAG

__all__ = [
    "CircleText",
    "Outline",
    "curve_of",
    "facets_for",
    "flat_curve",
    "outline_edges",
    "outline_text",
    "stray_for_mm",
]

_SHARE, _LEAST_MM, _MOST_MM = 0.1, 0.002, 0.02  # of the tolerance that facets may stray, and its limits


class CircleSize(FileModel):
    """Where a circle is, mm."""

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
    """How many edges an outline has; a circle is one."""
    return 1 if isinstance(outline, CircleText) else len(outline)


def stray_for_mm(tolerance_mm: float) -> float:
    """How far facets may stray from curves of an object with some tolerance."""
    return float(np.clip(_SHARE * tolerance_mm, _LEAST_MM, _MOST_MM))


def facets_for(outlines: Iterable[Outline], stray_mm: float) -> int:
    """How many facets the largest circle among outlines needs; all of a state have as many. 0: no circle."""
    circles = [curve for curve in map(curve_of, outlines) if isinstance(curve, Circle)]
    return max((circle_facets(circle.radius_mm, stray_mm) for circle in circles), default=0)


def flat_curve(outline: Outline, stray_mm: float, facets: int) -> FlatCurve:
    """The polygon that stands for an outline; circles get so many `facets`."""
    curve = curve_of(outline)
    if curve is None:
        assert not isinstance(outline, CircleText), "has a curve"
        return FlatCurve(_array(outline, 2), 0.0, 0.0)
    flat = circle_polygon(curve, facets) if isinstance(curve, Circle) else arcs_polygon(curve, stray_mm)
    flat.ring.setflags(write=False)
    return flat


def outline_text(ring: Floats, curve: Curve | None) -> object:
    """What stands in the file for a ring (n, 2), or for the curve that it stands for."""
    if curve is None:
        return [(x, y) for x, y in ring.tolist()]
    if isinstance(curve, Circle):
        return {"circle": {"centre": curve.centre_mm, "radius": curve.radius_mm}}
    return [(x, y, bulge) if bulge else (x, y) for x, y, bulge in curve.tolist()]


def _array(points: Sequence[Sequence[float]], columns: int) -> Floats:
    array = np.array(points, dtype=np.float64).reshape(-1, columns)
    array.setflags(write=False)
    return array
