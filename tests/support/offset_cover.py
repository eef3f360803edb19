"""Whether the edges that contacts are paired with cover the true boundary of a grown section: a judge.

The boundary of a section grown by r is where a disc of radius r rests: its centre is r from the section,
along a normal of an edge or between the normals at a convex vertex. Places are drawn along every edge and
about every vertex; those that are really r away, by shapely, have to be covered: within the slack of an edge,
with their normal within its span.
"""

import numpy as np
import shapely

from palpate.base.geometry import Section
from palpate.recognizer.edges import EdgeSet

__all__ = ["places_of_rest", "uncovered"]

_ROUNDING_MM = 1e-12


def places_of_rest(
    section: Section, radius_mm: float, each: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 2) of discs that rest on a section, and directions (n,) rad of the outward normal there.

    `each`: as many are drawn for each edge and for each vertex.
    """
    solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in section.polygons])
    points, normals = [], []
    for part in shapely.get_parts(solid):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            start = np.asarray(ring.coords)[:-1]
            leg = np.roll(start, -1, axis=0) - start
            start = start[np.hypot(*leg.T) > 1e-6]
            leg = np.roll(start, -1, axis=0) - start
            angle = np.arctan2(leg[:, 1], leg[:, 0]) - np.pi / 2
            turn = (angle - np.roll(angle, 1) + np.pi) % (2 * np.pi) - np.pi
            share = _shares(len(start), each, rng)
            points.append((start[:, None] + share[..., None] * leg[:, None]).reshape(-1, 2))
            normals.append(np.repeat(angle, each))
            convex = (turn > 0) & (radius_mm > 0)  # a point rests with the normal of either edge
            share = _shares(int(convex.sum()), each, rng)
            points.append(np.repeat(start[convex], each, axis=0))
            normals.append((angle[convex, None] - turn[convex, None] * share).ravel())
    point, normal = np.vstack(points), np.concatenate(normals)
    centre = point + radius_mm * np.column_stack([np.cos(normal), np.sin(normal)])
    rests = shapely.distance(solid, shapely.points(centre)) >= radius_mm - _ROUNDING_MM
    return centre[rests], normal[rests]


def _shares(count: int, each: int, rng: np.random.Generator) -> np.ndarray:
    """Shares (count, each) of ways, some of them very near to an end."""
    even = rng.uniform(size=(count, each))
    ends = 10.0 ** rng.uniform(-9, -2, (count, each))
    side = rng.integers(0, 4, (count, each))
    return np.select([side == 0, side == 1], [ends, 1 - ends], even)


def uncovered(edges: EdgeSet, state: int, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Which places (n,), seen from the state's centroid, no edge covers."""
    rows = slice(int(edges.first[state]), int(edges.first[state + 1]))
    reach = float(np.max(edges.slack_mm[rows])) + 1e-6
    lines = shapely.linestrings(np.stack([edges.start[rows], edges.end[rows]], axis=1))
    place, edge = shapely.STRtree(lines).query(shapely.points(centre), predicate="dwithin", distance=reach)
    rel = centre[place] - edges.start[rows][edge]
    along = np.sum(rel * edges.direction[rows][edge], axis=1)
    out = np.sum(rel * edges.normal[rows][edge], axis=1)
    off = np.abs((normal[place] - edges.normal_rad[rows][edge] + np.pi) % (2 * np.pi) - np.pi)
    slack = edges.slack_along[rows][edge]
    fits = (
        (along >= -slack) & (along <= edges.length[rows][edge] + slack) & (out <= edges.slack_out[rows][edge])
    )
    fits &= (out >= -edges.slack_in[rows][edge]) & (off <= edges.span[rows][edge])
    covered = np.zeros(len(centre), dtype=bool)
    covered[place[fits]] = True
    return ~covered
