"""DXF files: drawings as outlines of flat parts, in mm.

The file's own unit counts; one that it lacks has to be said. What counts as an outline: lines, arcs, circles,
ellipses, polylines and splines of the model space and its blocks, on layers that are on, thawed and plotted,
drawn in a continuous line. Dashed and chain lines stand for hidden edges and centre lines (ISO 128) and are
left out, like text, dimensions, hatches and points; what is left out is counted. Anything else that could be
an outline (a region, a solid, a mesh) is refused.

Some kinds of entities have coordinates of their own: those of their extrusion direction, which mirrored ones
have turned to (0, 0, -1). All come out in the drawing's plane, seen from above. Source: DXF reference, Object
Coordinate Systems,
https://help.autodesk.com/view/OARX/2024/ENU/?guid=GUID-D99F1509-E4E4-47A3-8691-92EA07DC88F5
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.file_io import CAD_BYTES, MOST_DRAWN_PIECES, MOST_NESTING, check_file
from palpate.base.geometry import Floats
from palpate.base.optional_imports import import_extra, input_errors
from palpate.cad.curves import Arc, DrawnCurve, bezier, bulge_curve, control_hull, spline, transform_curve
from palpate.cad.drawing_outlines import JOIN_MM, Sheet, Stroke, close_loops, nest_loops
from palpate.cad.parts import GIVE_NO_UNITS, UNIT_MM, DrawingFile

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document
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

_OUTLINE_KINDS = frozenset({"LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE"})
"""Kinds that outlines are made of."""

# fmt: off
_ANNOTATION_KINDS = frozenset({
    "TEXT", "MTEXT", "ATTRIB", "ATTDEF", "RTEXT", "ARCTEXT", "DIMENSION", "ARC_DIMENSION",
    "LARGE_RADIAL_DIMENSION", "LEADER", "MULTILEADER", "MLEADER", "TOLERANCE", "ACAD_TABLE", "HATCH",
    "MPOLYGON", "SOLID", "WIPEOUT", "IMAGE", "PDFUNDERLAY", "DWFUNDERLAY", "DGNUNDERLAY", "OLEFRAME",
    "OLE2FRAME", "POINT", "SHAPE", "RAY", "XLINE", "VIEWPORT",
})
# fmt: on
"""Kinds that label, fill or help; they are no outline."""


class NotFlatError(Exception):
    """Reason why an entity is no outline; the message goes on from the entity's name."""


class NoLengthError(Exception):
    """Reason to leave an entity out: it is a point."""


@dataclass(frozen=True, eq=False)
class BlockTransform:
    """A point p (3,) of the model space or a block is at p @ matrix (3, 3) + shift_mm (3,) in the drawing."""

    matrix: Floats
    shift_mm: Floats

    def of(self, insert: "Insert") -> "BlockTransform":
        """Make the style of what is in a block that is inserted here."""
        # ezdxf's own placing of blocks in blocks is wrong where the outer one is stretched in one direction.
        rows = np.array(tuple(insert.matrix44())).reshape(4, 4)
        return BlockTransform(rows[:3, :3] @ self.matrix, rows[3, :3] @ self.matrix + self.shift_mm)

    def __call__(self, points: Sequence["Vec3"]) -> Floats:
        """Points (n, 3) in the drawing, mm."""
        return np.array([tuple(point) for point in points]).reshape(-1, 3) @ self.matrix + self.shift_mm


def _entity_curves(entity: "DXFGraphic", placing: BlockTransform) -> tuple[tuple[DrawnCurve, ...], float]:
    """The curves of an entity of a kind in `DRAWN`, in mm, and the height that it lies at.

    Raises NotFlatError, and NoLengthError.
    """
    found, heights = _MAKERS[entity.dxftype()](entity, placing)
    if np.ptp(heights) > JOIN_MM:
        raise NotFlatError(f"is not flat: it goes from z = {heights.min():.6g} mm to {heights.max():.6g} mm")
    return found, float(heights.mean())


CurvesAndHeights = tuple[tuple[DrawnCurve, ...], Floats]
"""Curves, and the heights of some of their points."""


def _in_plane(
    entity: "Circle | LWPolyline | Polyline",
    elevation: float,
    made: Sequence[DrawnCurve],
    placing: BlockTransform,
) -> CurvesAndHeights:
    """Curves in an entity's own plane, as they are seen from above."""
    ocs = entity.ocs()
    frame = placing(
        [ocs.to_wcs(corner) for corner in ((0, 0, elevation), (1, 0, elevation), (0, 1, elevation))]
    )
    shift, axes = frame[0], (frame[1:] - frame[0]).T
    heights = np.concatenate([control_hull(curve) for curve in made]) @ axes[2] + shift[2]
    return tuple(transform_curve(curve, axes[:2], shift[:2]) for curve in made), heights


def _line(entity: "Line", placing: BlockTransform) -> CurvesAndHeights:
    ends = placing([entity.dxf.start, entity.dxf.end])
    return (bezier(ends[:, :2]),), ends[:, 2]


def _circle(entity: "Circle | DxfArc", placing: BlockTransform) -> CurvesAndHeights:
    dxf = entity.dxf
    start, sweep = 0.0, 2 * math.pi
    if entity.dxftype() == "ARC":
        start = math.radians(dxf.start_angle)
        sweep = _sweep(start, math.radians(dxf.end_angle))
    arc = Arc(np.array([dxf.center.x, dxf.center.y]), dxf.radius * np.eye(2), start, sweep)
    return _in_plane(entity, dxf.center.z, [arc], placing)


def _ellipse(entity: "Ellipse", placing: BlockTransform) -> CurvesAndHeights:
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


def _light_polyline(entity: "LWPolyline", placing: BlockTransform) -> CurvesAndHeights:
    corners = np.array(entity.get_points("xyb"), dtype=np.float64).reshape(-1, 3)
    made = _edges(corners[:, :2], corners[:, 2], entity.closed)
    return _in_plane(entity, entity.dxf.elevation, made, placing)


def _polyline(entity: "Polyline", placing: BlockTransform) -> CurvesAndHeights:
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


def _edges(corners: Floats, bulges: Floats, closed: bool) -> list[DrawnCurve]:
    """Between corners (n, 2), each with the bulge behind it."""
    if len(corners) < 2:
        raise NoLengthError
    last = len(corners) if closed else len(corners) - 1
    return [bulge_curve(corners[k], corners[(k + 1) % len(corners)], float(bulges[k])) for k in range(last)]


def _spline(entity: "Spline", placing: BlockTransform) -> CurvesAndHeights:
    points = placing(entity.control_points)
    if not len(points):
        raise NotFlatError("has fit points but no control points; save it with control points")
    degree, knots = entity.dxf.degree, np.array(entity.knots, dtype=np.float64)
    weights = np.array(entity.weights, dtype=np.float64) if len(entity.weights) else np.ones(len(points))
    if np.all(weights == -1.0):  # so some programs say that there are none
        weights = np.ones(len(points))
    if len(weights) != len(points) or not np.all(weights > 0):
        raise NotFlatError("has weights that are not positive or not one for each control point")
    if len(knots) != len(points) + degree + 1 or np.any(np.diff(knots) < 0) or not 1 <= degree < len(points):
        raise NotFlatError(
            f"has {len(knots)} knots for {len(points)} control points of degree {degree}; needed are "
            f"{len(points) + degree + 1}, in order"
        )
    found = spline(degree, points[:, :2], weights, knots)
    if not found:
        raise NoLengthError
    return found, points[:, 2]


_MAKERS: dict[str, Callable[[Any, BlockTransform], CurvesAndHeights]] = {
    "LINE": _line,
    "ARC": _circle,
    "CIRCLE": _circle,
    "ELLIPSE": _ellipse,
    "LWPOLYLINE": _light_polyline,
    "POLYLINE": _polyline,
    "SPLINE": _spline,
}


@dataclass(frozen=True, eq=False)
class _InheritedStyle:
    """Style that an entity of a block takes over from the block's insertion."""

    layer: str
    linetype: str
    placing: BlockTransform


class DxfWalk:
    """Goes through a file and keeps what is visible and drawn, in mm.

    `found`: by layer, strokes with the heights that they lie at; `left_out`: kinds of what is no outline;
    `on_paper`: what is drawn in paper space, in words.
    """

    def __init__(self, path: Path, document: "Document", unit_mm: float) -> None:
        """`unit_mm`: what a unit of the file is in mm."""
        self.found: dict[str, list[tuple[Stroke, float]]] = {}
        self.left_out: Counter[str] = Counter()
        self.on_paper = ""
        self._path, self._document, self._unit_mm = path, document, unit_mm
        self._pieces = 0

    def all(self) -> None:
        """Go through the model space. Raises InputError for what cannot be an outline of a flat part."""
        style = _InheritedStyle("0", "CONTINUOUS", BlockTransform(self._unit_mm * np.eye(3), np.zeros(3)))
        for entity in self._document.modelspace():
            self._collect(entity, style, ())
        # A viewport shows the model space; what else there is belongs to the sheet of paper.
        papers = {
            layout.name: sum(entity.dxftype() != "VIEWPORT" for entity in layout)
            for layout in self._document.layouts
            if not layout.is_modelspace
        }
        self.on_paper = ", ".join(f"{count} in '{name}'" for name, count in papers.items() if count)

    def rest(self, layers: Sequence[str] = ()) -> tuple[str, ...]:
        """Describe what is no outline, or not on one of the `layers`, if some are named."""
        named = {name.casefold() for name in layers}
        others = {
            f"on layer '{layer}'": len(strokes)
            for layer, strokes in self.found.items()
            if named and layer.casefold() not in named
        }
        found = [f"{count} {what}" for what, count in (self.left_out + Counter(others)).most_common()]
        return (*found, *([f"what is in paper space ({self.on_paper})"] if self.on_paper else []))

    def _collect(self, entity: "DXFGraphic", outer: _InheritedStyle, blocks: tuple[str, ...]) -> None:
        kind = entity.dxftype()
        self._count()
        # A block's layer 0 and BYBLOCK are those of its insertion (DXF reference, BLOCKS section).
        layer = outer.layer if blocks and entity.dxf.layer == "0" else entity.dxf.layer
        linetype = entity.dxf.linetype.upper()
        if linetype == "BYLAYER":
            linetype = self._of_layer(layer)
        elif linetype == "BYBLOCK":
            linetype = outer.linetype
        if entity.dxf.invisible:
            self.left_out["invisible entities"] += 1
        elif kind == "INSERT":
            self._insert(entity, _InheritedStyle(layer, linetype, outer.placing), blocks)  # type: ignore[arg-type]
        elif not self._visible(layer):
            self.left_out[f"entities on the hidden layer '{layer}'"] += 1
        elif kind in _ANNOTATION_KINDS:
            self.left_out[kind] += 1
        elif self._dashed(linetype):
            self.left_out[f"{kind} in linetype {linetype}"] += 1
        else:
            self._keep(entity, layer, outer.placing)

    def _keep(self, entity: "DXFGraphic", layer: str, placing: BlockTransform) -> None:
        label, kind = f"layer '{layer}'", entity.dxftype()
        if kind not in _OUTLINE_KINDS:
            raise InputError(
                f"{self._path}: {label}: holds a {kind}, which is no outline of a flat part; "
                "hide its layer or draw it with lines, arcs and splines"
            )
        try:
            made, height = _entity_curves(entity, placing)
        except NotFlatError as problem:
            raise InputError(f"{self._path}: {label}: a {kind} {problem}") from None
        except NoLengthError:
            self.left_out[f"{kind} without length"] += 1
            return
        self.found.setdefault(layer, []).append((Stroke(label, made), height))

    def _insert(self, insert: "Insert", style: _InheritedStyle, blocks: tuple[str, ...]) -> None:
        name = insert.dxf.name
        if self._has_layer(style.layer) and self._document.layers.get(style.layer).is_frozen():
            self.left_out[f"blocks on the frozen layer '{style.layer}'"] += 1
            return
        block = insert.block()
        if block is None:
            raise InputError(f"{self._path}: inserts a block '{name}' that is not in the file")
        if name in blocks:
            raise InputError(f"{self._path}: the block '{name}' contains itself")
        if len(blocks) >= MOST_NESTING:
            raise InputError(
                f"{self._path}: blocks are nested in more than {MOST_NESTING} others; explode them"
            )
        for one in insert.multi_insert() if insert.mcount > 1 else (insert,):
            self._count()
            inside = replace(style, placing=style.placing.of(one))
            for entity in block:
                self._collect(entity, inside, (*blocks, name))

    def _count(self) -> None:
        self._pieces += 1
        if self._pieces > MOST_DRAWN_PIECES:
            raise InputError(
                f"{self._path}: holds more than {MOST_DRAWN_PIECES} entities, those of inserted blocks "
                "counted each time; keep the outlines only"
            )

    def _has_layer(self, name: str) -> bool:
        return bool(self._document.layers.has_entry(name))

    def _of_layer(self, name: str) -> str:
        """The linetype of a layer; a layer that the file does not describe has continuous lines."""
        layers = self._document.layers
        return str(layers.get(name).dxf.linetype).upper() if self._has_layer(name) else "CONTINUOUS"

    def _visible(self, name: str) -> bool:
        if not self._has_layer(name):
            return True
        layer = self._document.layers.get(name)
        return not (layer.is_off() or layer.is_frozen()) and bool(layer.dxf.get("plot", 1))

    def _dashed(self, linetype: str) -> bool:
        """Has it a pattern? A name that the file does not define is drawn as a continuous line."""
        table = self._document.linetypes
        return bool(table.has_entry(linetype) and len(table.get(linetype).simplified_line_pattern()) > 1)


_INSUNITS = {
    1: ("inch", 25.4),
    2: ("ft", 304.8),
    4: ("mm", 1.0),
    5: ("cm", 10.0),
    6: ("m", 1000.0),
    8: ("microinch", 25.4e-6),
    9: ("mil", 0.0254),
    10: ("yd", 914.4),
    13: ("µm", 1e-3),
    14: ("dm", 100.0),
}
"""Units of $INSUNITS that a part can be drawn in, in mm. Source: DXF reference, HEADER section."""


def read_dxf(path: Path, units: str | None, curve_mm: float, layers: Sequence[str] = ()) -> DrawingFile:
    """The parts that a drawing shows, each with its holes, from the largest on; curves within `curve_mm`.

    `units`: "mm", "inch" or "m" for a file that has none. `layers`: the ones with outlines; none named: all
    that are visible. Raises InputError for a file that is no DXF, has no or other units, or whose lines are
    no closed outlines, with coordinates in the file's own unit.
    """
    document = _open_document(path)
    with input_errors(path, "DXF"):
        unit, unit_mm = _unit_of(document, units, path)
    walk = DxfWalk(path, document, unit_mm)
    with input_errors(path, "DXF"):
        walk.all()
    strokes = _choose_layers(walk, layers, path)
    low, high = min(strokes, key=itemgetter(1)), max(strokes, key=itemgetter(1))
    if high[1] - low[1] > JOIN_MM:
        raise InputError(
            f"{path}: the drawing is not flat: {low[0].label} lies at z = {low[1] / unit_mm:.6g} {unit}, "
            f"{high[0].label} at {high[1] / unit_mm:.6g} {unit}"
        )
    sheet = Sheet(str(path), unit, (1 / unit_mm, 1 / unit_mm))
    loops = close_loops([stroke for stroke, _ in strokes], curve_mm, sheet)
    return DrawingFile(nest_loops(loops, path.stem, unit, sheet), walk.rest(layers))


def _open_document(path: Path) -> "Document":
    ezdxf = import_extra("ezdxf", "cad", "reading DXF files")
    check_file(path, CAD_BYTES, "keep the outlines only")
    with input_errors(path, "DXF"):
        document: Document = ezdxf.readfile(path)
    return document


def _unit_of(document: "Document", units: str | None, path: Path) -> tuple[str, float]:
    """The unit of the file's numbers and what it is in mm: its own, or the one that is asked for."""
    code = int(document.header.get("$INSUNITS", 0))
    if code == 0:
        if units is None:
            raise InputError(f"{path}: has no units ($INSUNITS is 0): give its units: mm, inch or m")
        return units, UNIT_MM[units]
    if code not in _INSUNITS:
        raise InputError(f"{path}: has $INSUNITS {code}, a unit in which no part is drawn; save it in mm")
    unit, unit_mm = _INSUNITS[code]
    if units not in {None, unit}:
        raise InputError(f"{path}: is in {unit} ($INSUNITS is {code}), not in {units}: {GIVE_NO_UNITS}")
    return unit, unit_mm


def _choose_layers(walk: DxfWalk, layers: Sequence[str], path: Path) -> list[tuple[Stroke, float]]:
    """Select what is drawn on the layers that are asked for, or on all."""
    found, left_out = walk.found, walk.rest()
    rest = f"; left out: {', '.join(left_out)}" if left_out else ""
    if not found and walk.on_paper and not walk.left_out:
        raise InputError(
            f"{path}: its model space is empty: what it shows is drawn in paper space ({walk.on_paper}); "
            "draw the part in model space"
        )
    if not found:
        raise InputError(f"{path}: holds no outlines; draw them on a visible layer in continuous lines{rest}")
    names = {name.casefold(): name for name in found}
    for name in layers:
        if name.casefold() not in names:
            there = ", ".join(f"'{name}'" for name in sorted(found))
            raise InputError(f"{path}: has no outlines on a visible layer '{name}', only on {there}{rest}")
    wanted = dict.fromkeys(names[name.casefold()] for name in layers) if layers else found
    return [stroke for name in wanted for stroke in found[name]]
