"""Geometry that several rooms share: array types, plane geometry and the object model's values.

`object_model` and the array types are exported here. `plane` has rotations, angles and point-in-polygon
tests, `segments` distances and intersections of straight segments. Nothing here reads files or knows devices.
"""

from palpate.geometry.arrays import Bools, Complexes, Counts, Floats, Ints, Singles
from palpate.geometry.object_model import ObjectModel, Polygon, Section, State

__all__ = [
    "Bools",
    "Complexes",
    "Counts",
    "Floats",
    "Ints",
    "ObjectModel",
    "Polygon",
    "Section",
    "Singles",
    "State",
]
