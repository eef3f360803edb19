"""Solids as files, made without the code under test: prisms by shapely's triangulation, others by trimesh."""

from pathlib import Path

import numpy as np
import shapely
import trimesh

__all__ = ["ELL", "WEDGE", "mesh_file", "prism"]

ELL = shapely.Polygon([(0, 0), (60, 0), (60, 8), (8, 8), (8, 40), (0, 40)])
"""An angle profile: legs of 60 mm and 40 mm, 8 mm thick."""

WEDGE = shapely.Polygon([(0, 0), (50, 0), (0, 30)])
"""A right-angled triangle; a prism of it lies on five faces."""


def prism(outline: shapely.Polygon, height: float) -> trimesh.Trimesh:
    """The closed solid over an outline, with its holes, from z = 0 to `height`."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
    flat = np.array([np.asarray(shapely.orient_polygons(item).exterior.coords)[:3] for item in triangles])
    whole = shapely.orient_polygons(outline)
    rings = [np.asarray(ring.coords) for ring in (whole.exterior, *whole.interiors)]
    start, end = np.vstack([ring[:-1] for ring in rings]), np.vstack([ring[1:] for ring in rings])

    def at(points: np.ndarray, z: float) -> np.ndarray:
        return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)

    low, high = np.stack([at(start, 0), at(end, 0)]), np.stack([at(start, height), at(end, height)])
    walls = [
        np.stack([low[0], low[1], high[1]], axis=1),
        np.stack([low[0], high[1], high[0]], axis=1),
    ]
    facets = np.concatenate([at(flat[:, ::-1], 0), at(flat, height), *walls])
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(facets))
    mesh.merge_vertices()
    assert mesh.is_volume
    return mesh


def mesh_file(mesh: trimesh.Trimesh, path: Path) -> Path:
    """Write a mesh; the suffix says how."""
    mesh.export(path)
    return path
