"""Room that a part certainly takes up: what all configurations that are left have in common."""

import math

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry.outlines import region_of
from palpate.recognizer import Hypothesis, Recognition

_CHORDS = 16


def occupied_room(recognition: Recognition | None, span_mm: tuple[float, float]) -> shapely.Geometry:
    """Region in W, between two heights (mm), that the part fills wherever it is; empty if none is known."""
    if recognition is None or not recognition.hypotheses:
        return shapely.Polygon()
    rooms = [core_of(item, span_mm) for item in recognition.hypotheses]
    return shapely.intersection_all(rooms)


def core_of(hypothesis: Hypothesis, span_mm: tuple[float, float]) -> shapely.Geometry:
    """Region in W that is inside of the part in every configuration of a hypothesis.

    Its section, at the hypothesis's configuration, less how far any of its points may be from there.
    """
    state, at, bounds = hypothesis.state, hypothesis.configuration, hypothesis.search_bounds
    region = shapely.union_all([region_of(item.polygons) for item in state.state.sections_within(span_mm)])
    if region.is_empty:
        return region
    corners = shapely.get_coordinates(region)
    reach = float(np.hypot(*(corners - state.origin_mm).T).max())
    x, y = (max(abs(lo - here), abs(hi - here)) for (lo, hi), here in ((bounds.x_mm, at.x_mm), (bounds.y_mm, at.y_mm)))
    turn = max(abs(bounds.theta_rad[0] - at.theta_rad), abs(bounds.theta_rad[1] - at.theta_rad))
    # Positions are those of the file's origin, about which it is turned.
    lever = float(np.hypot(*corners.T).max())
    off = math.hypot(x, y) + min(turn, math.pi) * lever + state.tolerance_mm + state.rounding_mm
    placed = affinity.translate(
        affinity.rotate(region, at.theta_rad, origin=(0, 0), use_radians=True), at.x_mm, at.y_mm
    )
    return placed.buffer(-off / math.cos(math.pi / (4 * _CHORDS)), _CHORDS)
