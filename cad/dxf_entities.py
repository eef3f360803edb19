"""DXF entities as strokes. Between `dxf`, which walks through the file, and `chains`.

Some kinds have coordinates of their own: those of their extrusion direction, which mirrored entities have
turned to (0, 0, -1). All come out in the drawing's plane, seen from above. Source: DXF reference, Object
Coordinate Systems, https://help.autodesk.com/view/OARX/2024/ENU/?guid=GUID-D99F1509-E4E4-47A3-8691-92EA07DC88F5
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.cad.chains import JOIN_MM
from palpate.cad.curves import Arc, Curve, bulge, line, spline
from palpate.cad.values import Floats

if TYPE_CHECKING:
    from ezdxf.entities.arc import Arc as DxfArc
    from ezdxf.entities.circle import Circle
    from ezdxf.entities.dxfgfx import DXFGraphic
    from ezdxf.entities.ellipse import Ellipse
    from ezdxf.entities.line import Line
    from ezdxf.entities.lwpolyline import LWPolyline
    from ezdxf.entities.polyline import Polyline
    from ezdxf.entities.spline import Spline

__all__ = ["DRAWN", "NOT_DRAWN", "NotFlatError", "curves"]

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


def curves(entity: "DXFGraphic", unit_mm: float) -> tuple[tuple[Curve, ...], float]:
    """The curves of an entity of a kind in `DRAWN`, in mm, and the height that it lies at.

    `unit_mm`: what a unit of the file is in mm. Raises NotFlatError.
    """
    kind = entity.dxftype()
    found, heights = _MAKERS[kind](entity, unit_mm)
    if np.ptp(heights) > JOIN_MM:
        raise NotFlatError(
            f"is not flat: it goes from z = {heights.min() / unit_mm:.6g} to {heights.max() / unit_mm:.6g}"
        )
    return found, float(heights.mean())


Made = tuple[tuple[Curve, ...], Floats]


def _line(entity: "Line", unit_mm: float) -> Made:
    ends = np.array([tuple(entity.dxf.start), tuple(entity.dxf.end)]) * unit_mm
    return (line(ends[:, :2]),), ends[:, 2]


def _circle(entity: "Circle | DxfArc", unit_mm: float) -> Made:
    dxf = entity.dxf
    x, y, z = dxf.center
    corners = [(x, y, z), (x + dxf.radius, y, z), (x, y + dxf.radius, z)]
    points = np.array([tuple(entity.ocs().to_wcs(corner)) for corner in corners]) * unit_mm
    start, sweep = 0.0, 2 * math.pi
    if entity.dxftype() == "ARC":
        start = math.radians(dxf.start_angle)
        sweep = _sweep(start, math.radians(dxf.end_angle))
    return (Arc(points[0, :2], (points[1:] - points[0])[:, :2], start, sweep),), points[:, 2]


def _ellipse(entity: "Ellipse", unit_mm: float) -> Made:
    dxf = entity.dxf
    points = np.array([tuple(dxf.center), tuple(dxf.major_axis), tuple(entity.minor_axis)]) * unit_mm
    start, sweep = dxf.start_param, _sweep(dxf.start_param, dxf.end_param)
    return (Arc(points[0, :2], points[1:, :2], start, sweep),), points[0, 2] + np.array([0.0, *points[1:, 2]])


def _sweep(start_rad: float, end_rad: float) -> float:
    """Counter-clockwise from start to end; all round where they are the same."""
    sweep = math.fmod(end_rad - start_rad, 2 * math.pi)
    if sweep < 0:
        sweep += 2 * math.pi
    whole = sweep < 1e-9 or sweep > 2 * math.pi - 1e-9
    return 2 * math.pi if whole else sweep


def _light_polyline(entity: "LWPolyline", unit_mm: float) -> Made:
    corners = np.array(entity.get_points("xyb"), dtype=np.float64).reshape(-1, 3)
    bulges = corners[:, 2].copy()
    corners[:, 2] = entity.dxf.elevation
    return _edges(*_seen_from_above(entity, corners, bulges), entity.closed, unit_mm)


def _polyline(entity: "Polyline", unit_mm: float) -> Made:
    if not (entity.is_2d_polyline or entity.is_3d_polyline):
        raise NotFlatError("is a mesh")
    if entity.dxf.flags & (entity.CURVE_FIT_VERTICES_ADDED | entity.SPLINE_FIT_VERTICES_ADDED):
        raise NotFlatError(
            "is fitted by a curve that the file does not hold; make it lines, arcs or a spline"
        )
    corners = np.array([tuple(vertex.dxf.location) for vertex in entity.vertices]).reshape(-1, 3)
    if entity.is_3d_polyline:
        return _edges(corners, np.zeros(len(corners)), entity.is_closed, unit_mm)
    bulges = np.array([vertex.dxf.get("bulge", 0.0) for vertex in entity.vertices])
    corners[:, 2] = entity.dxf.elevation.z
    return _edges(*_seen_from_above(entity, corners, bulges), entity.is_closed, unit_mm)


def _seen_from_above(
    entity: "LWPolyline | Polyline", corners: Floats, bulges: Floats
) -> tuple[Floats, Floats]:
    """Corners (n, 3) and the bulges behind them (n,), from the entity's coordinates into the drawing's."""
    ocs = entity.ocs()
    points = np.array([tuple(ocs.to_wcs(corner)) for corner in corners]).reshape(-1, 3)
    return points, bulges * math.copysign(1.0, entity.dxf.extrusion.z)


def _edges(corners: Floats, bulges: Floats, closed: bool, unit_mm: float) -> Made:
    if len(corners) < 2:
        raise NotFlatError(f"has {len(corners)} vertices; it needs 2")
    points = corners * unit_mm
    flat = points[:, :2]
    last = len(flat) if closed else len(flat) - 1
    edges = tuple(bulge(flat[k], flat[(k + 1) % len(flat)], float(bulges[k])) for k in range(last))
    return edges, points[:, 2]


def _spline(entity: "Spline", unit_mm: float) -> Made:
    points = np.array([tuple(point) for point in entity.control_points]).reshape(-1, 3) * unit_mm
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


_MAKERS: dict[str, Callable[[Any, float], Made]] = {
    "LINE": _line,
    "ARC": _circle,
    "CIRCLE": _circle,
    "ELLIPSE": _ellipse,
    "LWPOLYLINE": _light_polyline,
    "POLYLINE": _polyline,
    "SPLINE": _spline,
}
