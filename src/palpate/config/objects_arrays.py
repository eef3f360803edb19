"""Checked object models as arrays, and back: what was read of a large file once need not be checked again."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Circle, Curve, Floats, ObjectModel, Polygon, Section, State

__all__ = ["arrays_of_objects", "objects_of_arrays"]


def arrays_of_objects(objects: tuple[ObjectModel, ...], notices: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Object models and what there was to say of their file."""
    rings = list(_rings(objects))
    text = json.dumps([list(notices), [_object(item) for item in objects]])
    points = np.concatenate([np.empty((0, 2)), *rings])
    points.setflags(write=False)
    return {
        "text": np.frombuffer(text.encode(), np.uint8),
        "sizes": np.array([len(ring) for ring in rings], np.int64),
        "points": points,
    }


def objects_of_arrays(arrays: Mapping[str, NDArray[Any]]) -> tuple[tuple[ObjectModel, ...], tuple[str, ...]]:
    """Object models and notices. Raises ValueError for arrays that hold none."""
    try:
        text, sizes, points = arrays["text"], arrays["sizes"], arrays["points"]
        if sizes.dtype != np.int64 or sizes.ndim != 1 or bool(np.any(sizes < 0)):
            raise ValueError("no sizes of rings")
        if points.dtype != np.float64 or points.shape != (int(sizes.sum()), 2):
            raise ValueError("no points of rings")
        notices, items = json.loads(text.tobytes())
        # Views of one array, which is mapped from its file.
        rings = iter([points[end - size : end] for size, end in zip(sizes, np.cumsum(sizes), strict=True)])
        objects = tuple(_read_object(item, rings) for item in items)
        if next(rings, None) is not None:
            raise ValueError("more rings than objects have")
        return objects, tuple(notices)
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise ValueError("no objects") from error


def _rings(objects: tuple[ObjectModel, ...]) -> Iterator[Floats]:
    for item in objects:
        for state in item.states:
            for section in state.sections:
                yield from section.rings
            yield from state.side_mm


def _object(item: ObjectModel) -> list[object]:
    states = [_state(state) for state in item.states]
    return [item.name, states, item.tolerance_mm, item.holds_n, item.support_mm, item.normal_bound_rad]


def _state(state: State) -> list[object]:
    sections = [[section.z_mm, [_polygon(item) for item in section.polygons]] for section in state.sections]
    return [
        state.name,
        sections,
        state.probability,
        state.tipping_angle_rad,
        state.height_mm,
        state.heights_mm,
        state.normal_bound_rad,
        state.curves_off_mm,
        state.curves_turn_rad,
        len(state.side_mm),
    ]


def _polygon(polygon: Polygon) -> list[object]:
    return [len(polygon.holes), [_curve(curve) for curve in polygon.curves]]


def _curve(curve: Curve | None) -> object:
    if isinstance(curve, Circle):
        return {"circle": [*curve.centre_mm, curve.radius_mm]}
    return None if curve is None else curve.tolist()


def _read_object(item: list[Any], rings: Iterator[Floats]) -> ObjectModel:
    name, states, *numbers = item
    return ObjectModel(name, tuple(_read_state(state, rings) for state in states), *numbers)


def _read_state(item: list[Any], rings: Iterator[Floats]) -> State:
    name, sections, probability, tipping, height, heights, bound, off, turn, sides = item
    found = tuple(
        Section(tuple(z), tuple(_read_polygon(polygon, rings) for polygon in polygons))
        for z, polygons in sections
    )
    known = None if heights is None else tuple((low, high) for low, high in heights)
    side = tuple(next(rings) for _ in range(sides))
    return State(name, found, probability, tipping, height, known, bound, off, turn, side)


def _read_polygon(item: list[Any], rings: Iterator[Floats]) -> Polygon:
    holes, curves = item
    outer = next(rings)
    return Polygon(outer, tuple(next(rings) for _ in range(holes)), tuple(map(_read_curve, curves)))


def _read_curve(item: Any) -> Curve | None:
    if item is None:
        return None
    if isinstance(item, dict):
        x, y, radius = item["circle"]
        return Circle((x, y), radius)
    curve = np.array(item, np.float64).reshape(-1, 3)
    curve.setflags(write=False)
    return curve
