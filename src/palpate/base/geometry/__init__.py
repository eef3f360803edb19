"""Geometry that several packages share: array types, plane geometry and the values of object models.

`object_model`, the array types and the values of `curves` are exported here. `plane` has rotations, angles
and point-in-polygon tests, `segments` distances and intersections of straight segments. Nothing here reads
files or knows devices.
"""

from palpate.base.geometry.object_model import Circle, Curve, ObjectModel, Polygon, Section, State
from palpate.base.geometry.plane import Bools, Complexes, Counts, Floats, Ints, Singles

__all__ = [
    "Bools",
    "Circle",
    "Complexes",
    "Counts",
    "Curve",
    "Floats",
    "Ints",
    "ObjectModel",
    "Polygon",
    "Section",
    "Singles",
    "State",
]
