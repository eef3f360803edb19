"""Compiled sweep: calls of the kernel for stops of approaches, the same as `sweep` has by whole arrays."""

import math
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.rays import Approach
from palpate.recognizer.region import Cells

__all__ = ["cells_left_free", "path_rows", "stops"]


def stops(
    kernel: ModuleType,
    outlines: Sequence[EdgeSet],
    cells: Cells,
    anchor_mm: Floats,
    approaches: Sequence[Approach],
    skipped: Bools | None,
) -> tuple[Floats, Floats]:
    """Earliest and latest stop (k, m) of approaches on their outlines; infinite where `skipped` (k, m)."""
    found = kernel.sweep(*_arguments(outlines, cells, anchor_mm, approaches, skipped))
    earliest, latest = (np.frombuffer(data).reshape(len(cells), len(approaches)) for data in found)
    return earliest, latest


def cells_left_free(
    kernel: ModuleType,
    outlines: Sequence[EdgeSet],
    cells: Cells,
    anchor_mm: Floats,
    paths: Sequence[Approach],
    skipped: Bools | None,
) -> Bools:
    """Cells (k,) in which no path has to stop before its end."""
    found = kernel.free_paths(*_arguments(outlines, cells, anchor_mm, paths, skipped))
    return np.frombuffer(found, dtype=bool)


def path_rows(paths: Sequence[Approach], anchor_mm: Floats) -> Floats:
    """Approaches (m, 6) as the kernel takes them: start from the anchor, heading, bound, travel; mm."""
    x, y = anchor_mm.tolist()
    rows = [
        (
            path.start_mm[0] - x,
            path.start_mm[1] - y,
            math.cos(path.direction_rad),
            math.sin(path.direction_rad),
            path.position_bound_mm,
            path.travel_mm,
        )
        for path in paths
    ]
    return np.array(rows, dtype=np.float64)


def _arguments(
    outlines: Sequence[EdgeSet],
    cells: Cells,
    anchor_mm: Floats,
    paths: Sequence[Approach],
    skipped: Bools | None,
) -> tuple[object, ...]:
    return (
        tuple(item.prepared for item in outlines),
        path_rows(paths, anchor_mm),
        np.ascontiguousarray(cells.state),
        np.ascontiguousarray(cells.lo),
        np.ascontiguousarray(cells.hi),
        np.ascontiguousarray(cells.polygon),
        len(cells),
        cells.polygon.shape[1],
        None if skipped is None else np.ascontiguousarray(skipped),
    )
