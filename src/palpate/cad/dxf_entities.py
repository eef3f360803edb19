"""DXF entities as strokes in the plane of the drawing.

Some kinds have coordinates of their own: those of their extrusion direction, which mirrored entities have
turned to (0, 0, -1). All come out in the drawing's plane, seen from above. Source: DXF reference, Object
Coordinate Systems,
https://help.autodesk.com/view/OARX/2024/ENU/?guid=GUID-D99F1509-E4E4-47A3-8691-92EA07DC88F5
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.base.geometry import Floats
from palpate.cad.curves import Arc, Curve, bulge, hull, line, mapped, spline
from palpate.cad.loop_assembly import JOIN_MM

if TYPE_CHECKING:
    from ezdxf.entities.arc import Arc as DxfArc
    from ezdxf.entities.circle import Circle
    from ezdxf.entities.dxfgfx import DXFGraphic
    from ezdxf.entities.ellipse import Ellipse
    from ezdxf.entities.insert import Insert
    from ezdxf.entities.line import Line
    from ezdxf.entities.lwpolyline import LWPolyline
    from ezdxf.entities.polyline import Polyline
    from ezdxf.entities.spline import Spline
    from ezdxf.math import Vec3

__all__ = ["DRAWN", "NOT_DRAWN", "BlockTransform", "NotFlatError", "curves"]

DRAWN = frozenset({"LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE"})
"""Kinds that outlines are made of."""

# fmt: off
NOT_DRAWN = frozenset({
    "TEXT", "MTEXT", "ATTRIB", "ATTDEF", "RTEXT", "ARCTEXT", "DIMENSION", "ARC_DIMENSION",
    "LARGE_RADIAL_DIMENSION", "LEADER", "MULTILEADER", "MLEADER", "TOLERANCE", "ACAD_TABLE", "HATCH",
    "MPOLYGON", "SOLID", "WIPEOUT", "IMAGE", "PDFUNDERLAY", "DWFUNDERLAY", "DGNUNDERLAY", "OLEFRAME",
    "OLE2FRAME", "POINT", "SHAPE", "RAY", "XLINE", "VIEWPORT",
})
# fmt: on
"""Kinds that label, fill or help; they are no outline."""


class NotFlatError(Exception):
    """What keeps an entity from being an outline; its message goes on from the entity's name."""


@dataclass(frozen=True, eq=False)
class BlockTransform:
    """A point p (3,) of the model space or a block is at p @ matrix (3, 3) + shift_mm (3,) in the drawing."""

    matrix: Floats
    shift_mm: Floats

    def of(self, insert: "Insert") -> "BlockTransform":
        """For what is in a block that is inserted here."""
        # ezdxf's own placing of blocks in blocks is wrong where the outer one is stretched in one direction.
        rows = np.array(tuple(insert.matrix44())).reshape(4, 4)
        return BlockTransform(rows[:3, :3] @ self.matrix, rows[3, :3] @ self.matrix + self.shift_mm)

    def __call__(self, points: Sequence["Vec3"]) -> Floats:
        """Points (n, 3) in the drawing, mm."""
        return np.array([tuple(point) for point in points]).reshape(-1, 3) @ self.matrix + self.shift_mm


def curves(entity: "DXFGraphic", placing: BlockTransform) -> tuple[tuple[Curve, ...], float]:
    """The curves of an entity of a kind in `DRAWN`, in mm, and the height that it lies at.

    Raises NotFlatError.
    """
    found, heights = _MAKERS[entity.dxftype()](entity, placing)
    if np.ptp(heights) > JOIN_MM:
        raise NotFlatError(f"is not flat: it goes from z = {heights.min():.6g} mm to {heights.max():.6g} mm")
    return found, float(heights.mean())


Made = tuple[tuple[Curve, ...], Floats]
"""Curves, and the heights of some of their points."""


def _in_plane(
    entity: "Circle | LWPolyline | Polyline", elevation: float, made: Sequence[Curve], placing: BlockTransform
) -> Made:
    """Curves in an entity's own plane, as they are seen from above."""
    ocs = entity.ocs()
    frame = placing(
        [ocs.to_wcs(corner) for corner in ((0, 0, elevation), (1, 0, elevation), (0, 1, elevation))]
    )
    shift, axes = frame[0], (frame[1:] - frame[0]).T
    heights = np.concatenate([hull(curve) for curve in made]) @ axes[2] + shift[2]
    return tuple(mapped(curve, axes[:2], shift[:2]) for curve in made), heights


def _line(entity: "Line", placing: BlockTransform) -> Made:
    ends = placing([entity.dxf.start, entity.dxf.end])
    return (line(ends[:, :2]),), ends[:, 2]


def _circle(entity: "Circle | DxfArc", placing: BlockTransform) -> Made:
    dxf = entity.dxf
    start, sweep = 0.0, 2 * math.pi
    if entity.dxftype() == "ARC":
        start = math.radians(dxf.start_angle)
        sweep = _sweep(start, math.radians(dxf.end_angle))
    arc = Arc(np.array([dxf.center.x, dxf.center.y]), dxf.radius * np.eye(2), start, sweep)
    return _in_plane(entity, dxf.center.z, [arc], placing)


def _ellipse(entity: "Ellipse", placing: BlockTransform) -> Made:
    dxf = entity.dxf
    points = placing([dxf.center, dxf.center + dxf.major_axis, dxf.center + entity.minor_axis])
    axes = (points[1:] - points[0])[:, :2]
    return (Arc(points[0, :2], axes, dxf.start_param, _sweep(dxf.start_param, dxf.end_param)),), points[:, 2]


def _sweep(start_rad: float, end_rad: float) -> float:
    """Counter-clockwise from start to end; all round where they are the same."""
    sweep = math.fmod(end_rad - start_rad, 2 * math.pi)
    if sweep < 0:
        sweep += 2 * math.pi
    whole = sweep < 1e-9 or sweep > 2 * math.pi - 1e-9
    return 2 * math.pi if whole else sweep


def _light_polyline(entity: "LWPolyline", placing: BlockTransform) -> Made:
    corners = np.array(entity.get_points("xyb"), dtype=np.float64).reshape(-1, 3)
    made = _edges(corners[:, :2], corners[:, 2], entity.closed)
    return _in_plane(entity, entity.dxf.elevation, made, placing)


def _polyline(entity: "Polyline", placing: BlockTransform) -> Made:
    if not (entity.is_2d_polyline or entity.is_3d_polyline):
        raise NotFlatError("is a mesh")
    if entity.dxf.flags & (entity.CURVE_FIT_VERTICES_ADDED | entity.SPLINE_FIT_VERTICES_ADDED):
        raise NotFlatError(
            "is fitted by a curve that the file does not hold; make it lines, arcs or a spline"
        )
    corners = [vertex.dxf.location for vertex in entity.vertices]
    if entity.is_3d_polyline:
        points = placing(corners)
        return tuple(_edges(points[:, :2], np.zeros(len(points)), entity.is_closed)), points[:, 2]
    bulges = np.array([vertex.dxf.get("bulge", 0.0) for vertex in entity.vertices])
    flat = np.array([(corner.x, corner.y) for corner in corners]).reshape(-1, 2)
    return _in_plane(entity, entity.dxf.elevation.z, _edges(flat, bulges, entity.is_closed), placing)


def _edges(corners: Floats, bulges: Floats, closed: bool) -> list[Curve]:
    """Between corners (n, 2), each with the bulge behind it."""
    if len(corners) < 2:
        raise NotFlatError(f"has too few vertices ({len(corners)})")
    last = len(corners) if closed else len(corners) - 1
    return [bulge(corners[k], corners[(k + 1) % len(corners)], float(bulges[k])) for k in range(last)]


def _spline(entity: "Spline", placing: BlockTransform) -> Made:
    points = placing(entity.control_points)
    if not len(points):
        raise NotFlatError("has fit points but no control points; save it with control points")
    degree, knots = entity.dxf.degree, np.array(entity.knots, dtype=np.float64)
    weights = np.array(entity.weights, dtype=np.float64) if len(entity.weights) else np.ones(len(points))
    if len(weights) != len(points) or not np.all(weights > 0):
        raise NotFlatError("has weights that are not positive or not one for each control point")
    if len(knots) != len(points) + degree + 1 or np.any(np.diff(knots) < 0) or not 1 <= degree < len(points):
        raise NotFlatError(
            f"has {len(knots)} knots for {len(points)} control points of degree {degree}; needed are "
            f"{len(points) + degree + 1}, in order"
        )
    found = spline(degree, points[:, :2], weights, knots)
    if not found:
        raise NotFlatError("has no length: all its knots are the same")
    return found, points[:, 2]


_MAKERS: dict[str, Callable[[Any, BlockTransform], Made]] = {
    "LINE": _line,
    "ARC": _circle,
    "CIRCLE": _circle,
    "ELLIPSE": _ellipse,
    "LWPOLYLINE": _light_polyline,
    "POLYLINE": _polyline,
    "SPLINE": _spline,
}
