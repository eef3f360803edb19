"""Tip lengths that a rig file leaves out although parts need them: walls that are not upright beside a tip.

A tip of which no length is known is taken to be as thin as a disc. Beside a step or a wall that leans it
meets more than that: then contacts are not what they are taken for, and answers may be false.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.errors import counted
from palpate.base.geometry import Floats, ObjectModel, State
from palpate.config import RigFile
from palpate.rig.catalogue.section_stack import region_within

__all__ = ["Overhang", "overhang_lines", "overhangs_of"]

_BESIDE_MM = 5.0  # above a tip's middle and below it: few are shorter than 10 mm
_LITTLE_MM = 0.05  # beside the outlines' tolerances; silhouettes are given to hundredths
_SAMPLED_MM = 2.0
_SHOWN = 5


@dataclass(frozen=True)
class Overhang:
    """A state that stands out by `out_mm` beside a tip at `height_mm`, from what is at just that height.

    Infinite, if nothing is at that height.
    """

    object_name: str
    state_name: str
    height_mm: float
    out_mm: float


def overhangs_of(rig: RigFile, models: Sequence[ObjectModel]) -> tuple[Overhang, ...]:
    """For each state the worst, at fingers whose tips' length is not known; none if walls are upright."""
    heights = sorted(
        {
            finger.height_mm
            for finger in rig.fingers
            if finger.tip.length_mm is None and not finger.tip.is_ball
        }
    )
    found = []
    for model in models:
        for state in model.states:
            off = 2 * (model.tolerance_mm + state.curves_off_mm) + _LITTLE_MM
            out = [(_out_mm(state, height), height) for height in heights]
            most, height = max(out, default=(0.0, 0.0))
            if most > off:
                found.append(Overhang(model.name, state.name, height, most))
    return tuple(found)


def overhang_lines(rig: RigFile, models: Sequence[ObjectModel]) -> list[str]:
    """One line if there are any, else none."""
    found = overhangs_of(rig, models)
    if not found:
        return []
    shown = "; ".join(_words(item) for item in found[:_SHOWN])
    more = len(found) - _SHOWN
    rest = f" and {counted(more, 'more state', 'more states')}" if more > 0 else ""
    return [
        f"{shown}{rest}: walls are not upright beside the tips; if tips are longer than discs, state their "
        "length_mm under [fingers.tip], or answers may be false"
    ]


def _words(item: Overhang) -> str:
    beside = f"within {_BESIDE_MM:g} mm of {item.height_mm:g} mm"
    if item.out_mm == np.inf:
        return f"{item.object_name}, {item.state_name} (stands only {beside})"
    return f"{item.object_name}, {item.state_name} (up to {item.out_mm:.2g} mm wider {beside})"


def _out_mm(state: State, height_mm: float) -> float:
    """How far sections beside a tip reach out of the one at its middle."""
    beside = max(height_mm - _BESIDE_MM, 0.0), height_mm + _BESIDE_MM
    at = state.sections_at(height_mm)
    # What ends just there is not beside the tip.
    others = [
        item
        for item in state.sections_within(beside)
        if item not in at and item.z_mm[1] > beside[0] and item.z_mm[0] < beside[1]
    ]
    if not at:
        return np.inf if others and state.known_at(height_mm) else 0.0
    out = _side_out_mm(state, height_mm, beside)
    if not others:
        return out
    region = region_within(state, (height_mm, height_mm))
    shapely.prepare(region)
    rings = [shapely.LinearRing(polygon.outer) for item in others for polygon in item.polygons]
    points = shapely.points(shapely.get_coordinates(shapely.segmentize(rings, _SAMPLED_MM)))
    return max(out, float(shapely.distance(points, region).max()))


def _side_out_mm(state: State, height_mm: float, beside_mm: tuple[float, float]) -> float:
    """The same as far as the silhouette shows it, for parts that are known near some heights only."""
    own, along = (_ends_mm(state, span) for span in ((height_mm, height_mm), beside_mm))
    if own is None or along is None:
        return 0.0
    return max(own[0] - along[0], along[1] - own[1])


def _ends_mm(state: State, span_mm: tuple[float, float]) -> tuple[float, float] | None:
    """From where to where the silhouette reaches across, somewhere in a span of heights."""
    across = np.concatenate([*_crossings(state, span_mm), np.empty(0)])
    return (float(across.min()), float(across.max())) if len(across) else None


def _crossings(state: State, span_mm: tuple[float, float]) -> Iterator[Floats]:
    """Places across at which a silhouette's lines pass the ends of a span, or have a corner between."""
    low, high = span_mm
    for ring in state.side_mm:
        begin, end = ring, np.roll(ring, -1, axis=0)
        yield ring[(ring[:, 1] >= low) & (ring[:, 1] <= high), 0]
        for z in {low, high}:
            passes = (begin[:, 1] - z) * (end[:, 1] - z) < 0
            share = (z - begin[passes, 1]) / (end[passes, 1] - begin[passes, 1])
            yield begin[passes, 0] + share * (end[passes, 0] - begin[passes, 0])
