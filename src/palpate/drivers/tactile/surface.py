"""The taxels of an array as cells on its surface. A description in, places, sizes and sides out."""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.drivers.tactile.messages import Description, Shape

__all__ = ["TaxelSurface", "surface_of"]


@dataclass(frozen=True, eq=False)
class TaxelSurface:
    """k = rows · cols cells in the tip frame, row by row.

    `place_mm` (k, 3) are their middles; within `half_mm` (3,) of it, by axis, a cell's load lies. `area_mm2`
    (k,). `azimuth_rad` (k,) is where their normals point, nan where they point up or down; neighbours differ
    by at most `turn_rad`. `sides` (4, k): cells on the first and last column, on the first and last row;
    `inner` (4, k): cells on the line next to each, none where there is no other line. `step_mm` (4, 2, 3):
    least and largest step outward from there to the side, by axis.
    """

    flat: bool
    place_mm: Floats
    half_mm: Floats
    area_mm2: Floats
    azimuth_rad: Floats
    turn_rad: float
    sides: Bools
    inner: Bools
    step_mm: Floats


def surface_of(description: Description) -> TaxelSurface:
    """The cells of a flat or free array."""
    d = description
    place = d.positions_mm()
    normal = d.normals()
    steps = [np.abs(np.diff(place, axis=axis)).reshape(-1, 3) for axis in (0, 1)]
    half = np.concatenate([*steps, np.zeros((1, 3))]).max(axis=0) / 2
    length = [np.linalg.norm(np.diff(place, axis=axis), axis=2) for axis in (0, 1)]
    size = [float(each.mean()) if each.size else 0.0 for each in length]
    side = [each if each else max(size) for each in size]
    level = np.hypot(normal[..., 0], normal[..., 1])
    azimuth = np.where(level > 0.2, np.arctan2(normal[..., 1], normal[..., 0]), np.nan)
    turns = np.concatenate([np.diff(azimuth, axis=axis).ravel() for axis in (0, 1)] + [np.zeros(1)])
    turns = np.abs(wrap_angle(turns))
    row, col = np.indices((d.rows, d.cols)).reshape(2, -1)
    return TaxelSurface(
        flat=d.shape is Shape.FLAT,
        place_mm=place.reshape(-1, 3),
        half_mm=half,
        area_mm2=np.full(d.taxels, side[0] * side[1]),
        azimuth_rad=azimuth.ravel(),
        turn_rad=float(np.nanmax(turns)),
        sides=np.stack([col == 0, col == d.cols - 1, row == 0, row == d.rows - 1]),
        inner=np.stack([col == 1, col == d.cols - 2, row == 1, row == d.rows - 2]),
        step_mm=np.stack(
            [
                _steps(place[:, :2, :], 1),
                _steps(place[:, :-3:-1, :], 1),
                _steps(place[:2], 0),
                _steps(place[:-3:-1], 0),
            ]
        ),
    )


def _steps(pair: Floats, axis: int) -> Floats:
    """Least and largest step (2, 3) outward, from the second line of cells to the first, both in `pair`."""
    steps = -np.diff(pair, axis=axis).reshape(-1, 3)
    return np.stack([steps.min(axis=0), steps.max(axis=0)]) if len(steps) else np.zeros((2, 3))
