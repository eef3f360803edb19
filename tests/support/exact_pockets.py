"""Exact angle pockets: of single points of edges, where the search takes those of whole edges."""

import math

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.angle_pockets import EdgePieces, Pockets, pockets_of
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.tables import expand_ranges


def exact_pockets(
    edges: EdgeSet, edge: Ints, point_mm: Floats, allowance_mm: float, travel_mm: float = math.inf
) -> Pockets:
    """Pocket of each point (m, 2), taken at the nearest point of its edge (m,); mm in the object's frame."""
    start, direction = edges.start[edge], edges.direction[edge]
    along = np.clip(np.sum((point_mm - start) * direction, axis=1), 0.0, edges.length[edge])
    foot = start + along[:, None] * direction
    pieces = []
    for state in range(len(edges.first) - 1):
        row = np.flatnonzero(edges.state[edge] == state)
        pieces.append(EdgePieces(row, edge[row], foot[row], foot[row]))
    return pockets_of(edges, pieces, allowance_mm, travel_mm, edge)


def hold(pockets: Pockets, row: Ints, direction_rad: Floats) -> Bools:
    """Whether each direction (m,) lies in the pocket of its row (m,)."""
    owner, arc = expand_ranges(pockets.first[row], np.diff(pockets.first)[row])
    past = (direction_rad[owner] - pockets.lo_rad[arc]) % (2 * np.pi)
    inside: Bools = np.zeros(len(row), dtype=bool)
    inside[owner[past <= pockets.hi_rad[arc] - pockets.lo_rad[arc]]] = True
    return inside


def widths_rad(pockets: Pockets) -> Floats:
    """Angle that the arcs of each row cover together, (n,)."""
    width = np.zeros(len(pockets))
    np.add.at(width, pockets.row, pockets.hi_rad - pockets.lo_rad)
    return width
