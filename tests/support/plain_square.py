"""A square that lies straight in the table's middle, and contacts with it written down by hand."""

import numpy as np
from shapely_bench import Placed, flat

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.recognizer import Contact, Finger

FINGER = Finger(5.0, 10.0)
SQUARE_RING = np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])
SQUARE = flat("square", SQUARE_RING)
STRAIGHT = Placed(SQUARE, 0.0, 0.0, 0.0)


def touching(name: str, start: tuple[float, float], end: tuple[float, float], bound: float = 0.3) -> Contact:
    """A contact without a normal."""
    return Contact(name, FINGER, True, start, end, bound)


def three_sides(bound: float = 0.3) -> list[Contact]:
    """What fingers a, b and c feel of its left, its right and its lower side."""
    return [
        touching("a", (-100.0, 3.0), (-25.0, 3.0), bound),
        touching("b", (100.0, -4.0), (25.0, -4.0), bound),
        touching("c", (2.0, -100.0), (2.0, -25.0), bound),
    ]


def sections(name: str, *polygons: Polygon, z_hi: float = 20.0) -> ObjectModel:
    """An object with one section of several polygons."""
    return ObjectModel(name, (State("flat", (Section((0.0, z_hi), polygons),)),))
