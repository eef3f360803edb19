"""Rotational symmetry of a section and of a state, as the recogniser has it."""

from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats, Polygon, Section, State
from palpate.recognizer.catalogue import SYMMETRY_TOLERANCE_MM
from palpate.recognizer.symmetry import centroid, rotational_symmetry
from palpate.rig.catalogue.section_stack import StateSections

__all__ = ["SectionSymmetry", "symmetry_of_region", "symmetry_of_state"]


@dataclass(frozen=True, eq=False)
class SectionSymmetry:
    """It looks the same after each nth of a turn, n = `order`, about its centre of area (2,), mm."""

    order: int
    centre_mm: Floats


def symmetry_of_region(region: shapely.Geometry) -> SectionSymmetry:
    """SectionSymmetry of one section."""
    return _symmetry([(0.0, 1.0, region)])


def symmetry_of_state(state: StateSections) -> SectionSymmetry:
    """SectionSymmetry of all sections of a state together."""
    return _symmetry([(*level.z_mm, level.region) for level in state.levels])


def _symmetry(parts: list[tuple[float, float, shapely.Geometry]]) -> SectionSymmetry:
    state = State("", tuple(Section((low, high), _polygons(region)) for low, high, region in parts))
    centre = centroid(state)
    return SectionSymmetry(rotational_symmetry(state, centre, SYMMETRY_TOLERANCE_MM).order, centre)


def _polygons(region: shapely.Geometry) -> tuple[Polygon, ...]:
    return tuple(
        Polygon(_open(part.exterior), tuple(_open(hole) for hole in part.interiors))
        for part in shapely.get_parts(region)
    )


def _open(ring: shapely.LinearRing) -> Floats:
    points: Floats = np.array(ring.coords)[:-1]
    return points
