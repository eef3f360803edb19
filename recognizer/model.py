"""Object models: what the catalogue knows of each object. The recogniser's other input.

A state is one stable way in which an object rests on the support plane; it is a stack of cross sections
parallel to that plane (memo §1.2 and §3.1). Stable states are treated as separate objects.
"""

from dataclasses import dataclass

from palpate.recognizer.arrays import Floats

__all__ = ["ObjectModel", "Polygon", "Section", "State"]


@dataclass(frozen=True, eq=False)
class Polygon:
    """A simple polygon in the object's own frame, mm. `outer` has shape (n, 2), open, in either direction.

    Edge k runs from vertex k to vertex k + 1. Holes are rings of the same kind.
    """

    outer: Floats
    holes: tuple[Floats, ...] = ()


@dataclass(frozen=True, eq=False)
class Section:
    """The object's cross section between two heights over the support plane (mm, both included)."""

    z_lo_mm: float
    z_hi_mm: float
    polygons: tuple[Polygon, ...]


@dataclass(frozen=True, eq=False)
class State:
    """A stable state: its name and its cross sections from the bottom up."""

    name: str
    sections: tuple[Section, ...]


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A known object. Its true outline is nowhere further than `tolerance_mm` from the modelled one."""

    name: str
    states: tuple[State, ...]
    tolerance_mm: float = 0.0
