"""Compiled kernel: C code for the innermost loops, where it could be built; numpy does the same without it.

`KERNEL` is None where there was no C compiler, or where the environment variable `PALPATE_KERNEL` is `off`.
See docs/adr/0038-a-compiled-kernel.md. Its calls are here where they take bare arrays: polygons of cells, and
the boxes around them. Those that take edges and contacts are in `compiled_search`, those that judge cells and
configurations in `compiled_judgement`.
"""

import os
from importlib import import_module
from types import ModuleType

import numpy as np

from palpate.base.geometry import Floats, Ints


def _kernel() -> ModuleType | None:
    if os.environ.get("PALPATE_KERNEL") == "off":
        return None
    try:
        return import_module("palpate.recognizer._kernel")
    except ImportError:
        return None


KERNEL = _kernel()
"""The compiled module, or None."""


def polygon_shapes(kernel: ModuleType, polygon: Floats) -> tuple[Floats, Floats, Floats]:
    """Of polygons (k, v, 2): middles of bounding boxes (k, 2), largest distances from there, areas (k,)."""
    count, vertices = polygon.shape[:2]
    centre, radius, area = kernel.shapes(np.ascontiguousarray(polygon), count, vertices)
    return np.frombuffer(centre).reshape(count, 2), np.frombuffer(radius), np.frombuffer(area)


def furthest_along_axes(
    kernel: ModuleType, polygon: Floats, origin_mm: Floats, lo: Floats, hi: Floats
) -> Floats:
    """How far (k, 4) polygons (k, v, 2) get along ±x, ±y if turned by [lo, hi] (k,) about origins (k, 2)."""
    count, vertices = polygon.shape[:2]
    arrays = [np.ascontiguousarray(item) for item in (origin_mm, lo, hi)]
    found = kernel.furthest(np.ascontiguousarray(polygon), count, vertices, *arrays)
    return np.frombuffer(found).reshape(count, 4)


def clip_polygons(kernel: ModuleType, polygon: Floats, g: Floats, limit: Floats) -> tuple[Floats, Ints]:
    """Parts of convex polygons (k, v, 2) where g·s ≤ limit, a half-plane each; and which have one."""
    count, vertices = polygon.shape[:2]
    arrays = [np.ascontiguousarray(item) for item in (polygon, g, limit)]
    most, rows, points = kernel.clip_polygons(arrays[0], count, vertices, *arrays[1:])
    return np.frombuffer(points).reshape(-1, most, 2), np.frombuffer(rows, np.int64)


def group_boxes(
    kernel: ModuleType, boxes: tuple[Ints | Floats, ...], order: Ints, asked: tuple[Ints, Ints, Ints]
) -> Ints:
    """Component (k,) of each box: `asked` (n,) is which boxes are compared with [begin, end) of `order` (m,).

    `boxes`: state, middle, half width and turn, each (k,), and two corners (k, 2).
    """
    arrays = [np.ascontiguousarray(item) for item in boxes]
    rows = [np.ascontiguousarray(item, dtype=np.int64) for item in asked]
    found = kernel.groups(
        *arrays, len(arrays[0]), np.ascontiguousarray(order), len(order), *rows, len(rows[0])
    )
    return np.frombuffer(found, np.int64)
