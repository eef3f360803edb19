"""Bodies for MuJoCo of parts on an emulated table: their masses, and convex prisms of which they are made.

Needs the extra `physics`.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.drivers.emulators import FrictionSupport
from palpate.drivers.emulators.mujoco_parts import MassDistribution, MujocoBody, MujocoParts, Prism
from palpate.rig.emulated.hidden_truth import centre_of_mass
from palpate.rig.emulated.scene import Placement, shape_of

_CONVEX_MM = 1e-3  # depth up to which a notch is filled
_LEAST_PIECE_MM2 = 1e-3


def mujoco_parts(supports: Sequence[FrictionSupport], placements: Sequence[Placement]) -> MujocoParts:
    """The parts in MuJoCo, on their supports."""
    return MujocoParts(
        [
            MujocoBody(support, _mass_of(lies), list(_prisms(lies)) if len(placements) > 1 else [])
            for support, lies in zip(supports, placements, strict=True)
        ]
    )


def _mass_of(placement: Placement) -> MassDistribution:
    centre, height = centre_of_mass(placement)
    low, high = np.array(shapely.bounds(shape_of(placement, placement.state.sections[0]))).reshape(2, 2)
    x, y = (high - low).tolist()
    extent = (x, y, placement.state.top_mm)
    return MassDistribution((float(centre[0]), float(centre[1])), height, extent)


def _prisms(placement: Placement) -> Iterator[Prism]:
    for section in placement.state.sections:
        for corners in convex_pieces(shape_of(placement, section)):
            yield Prism(corners, section.z_mm)


def convex_pieces(shape: shapely.Geometry) -> list[Floats]:
    """Corners (n, 2) of convex polygons that make up a region: triangles, joined while they stay convex."""
    pieces = list(shapely.get_parts(shapely.constrained_delaunay_triangles(shape)))
    while len(joined := _join_neighbours(pieces)) < len(pieces):
        pieces = joined
    return [
        shapely.get_coordinates(shapely.convex_hull(piece))[:-1]
        for piece in pieces
        if piece.area > _LEAST_PIECE_MM2
    ]


def _join_neighbours(pieces: Sequence[shapely.Geometry]) -> list[shapely.Geometry]:
    """The pieces, each joined with those of its neighbours with which it is convex."""
    tree, left, found = shapely.STRtree(pieces), set(range(len(pieces))), []
    while left:
        number = min(left)
        whole, near = pieces[number], tree.query(pieces[number], "intersects").tolist()
        left.remove(number)
        for other in sorted(left.intersection(near)):
            both = shapely.union(whole, pieces[other])
            if both.geom_type == "Polygon" and _is_convex(both):
                whole = both
                left.remove(other)
        found.append(whole)
    return found


def _is_convex(shape: shapely.Geometry) -> bool:
    notches = shapely.difference(shapely.convex_hull(shape), shape)
    return bool(shapely.buffer(notches, -_CONVEX_MM / 2).is_empty)
