"""Outline entities of a DXF file: a walk through its model space and blocks.

What counts: lines, arcs, circles, ellipses, polylines and splines on layers that are on, thawed and plotted,
drawn in a continuous line. Dashed and chain lines stand for hidden edges and centre lines (ISO 128) and are
left out, like text, dimensions, hatches and points; what is left out is counted. Anything else that could be
an outline (a region, a solid, a mesh) is refused.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palpate.base.errors import InputError
from palpate.base.files.limits import DRAWN_PIECES, NESTING
from palpate.cad.dxf_entities import DRAWN, NOT_DRAWN, BlockTransform, NotFlatError, curves
from palpate.cad.loop_assembly import Stroke

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document
    from ezdxf.entities.dxfgfx import DXFGraphic
    from ezdxf.entities.insert import Insert

__all__ = ["Walk"]


@dataclass(frozen=True, eq=False)
class _Style:
    """What an entity of a block takes over from the block's insertion."""

    layer: str
    linetype: str
    placing: BlockTransform


class Walk:
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
        style = _Style("0", "CONTINUOUS", BlockTransform(self._unit_mm * np.eye(3), np.zeros(3)))
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
        """In words, what is no outline, or not on one of the `layers`, if some are named."""
        named = {name.casefold() for name in layers}
        others = {
            f"on layer '{layer}'": len(strokes)
            for layer, strokes in self.found.items()
            if named and layer.casefold() not in named
        }
        found = [f"{count} {what}" for what, count in (self.left_out + Counter(others)).most_common()]
        return (*found, *([f"what is in paper space ({self.on_paper})"] if self.on_paper else []))

    def _collect(self, entity: "DXFGraphic", outer: _Style, blocks: tuple[str, ...]) -> None:
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
            self._insert(entity, _Style(layer, linetype, outer.placing), blocks)  # type: ignore[arg-type]
        elif not self._visible(layer):
            self.left_out[f"entities on the hidden layer '{layer}'"] += 1
        elif kind in NOT_DRAWN:
            self.left_out[kind] += 1
        elif self._dashed(linetype):
            self.left_out[f"{kind} in linetype {linetype}"] += 1
        else:
            self._keep(entity, layer, outer.placing)

    def _keep(self, entity: "DXFGraphic", layer: str, placing: BlockTransform) -> None:
        label, kind = f"layer '{layer}'", entity.dxftype()
        if kind not in DRAWN:
            raise InputError(
                f"{self._path}: {label}: holds a {kind}, which is no outline of a flat part; "
                "hide its layer or draw it with lines, arcs and splines"
            )
        try:
            made, height = curves(entity, placing)
        except NotFlatError as problem:
            raise InputError(f"{self._path}: {label}: a {kind} {problem}") from None
        self.found.setdefault(layer, []).append((Stroke(label, made), height))

    def _insert(self, insert: "Insert", style: _Style, blocks: tuple[str, ...]) -> None:
        name = insert.dxf.name
        if self._has_layer(style.layer) and self._document.layers.get(style.layer).is_frozen():
            self.left_out[f"blocks on the frozen layer '{style.layer}'"] += 1
            return
        block = insert.block()
        if block is None:
            raise InputError(f"{self._path}: inserts a block '{name}' that is not in the file")
        if name in blocks:
            raise InputError(f"{self._path}: the block '{name}' contains itself")
        if len(blocks) >= NESTING:
            raise InputError(f"{self._path}: blocks are nested in more than {NESTING} others; explode them")
        for one in insert.multi_insert() if insert.mcount > 1 else (insert,):
            self._count()
            inside = replace(style, placing=style.placing.of(one))
            for entity in block:
                self._collect(entity, inside, (*blocks, name))

    def _count(self) -> None:
        self._pieces += 1
        if self._pieces > DRAWN_PIECES:
            raise InputError(
                f"{self._path}: holds more than {DRAWN_PIECES} entities, those of inserted blocks counted "
                "each time; keep the outlines only"
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
