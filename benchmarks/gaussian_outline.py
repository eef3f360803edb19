"""Outline by a Gaussian process, as others learn shapes by touch: `gaussian_outline`.

A surface is where a function that is 0 at touches, 1 outside and -1 inside passes through 0 (Williams and
Fitzgibbon, Gaussian process implicit surfaces, 2007). Radial basis functions and white noise; scikit-learn
chooses their length and size by likelihood. Its mean is an outline without bounds.
"""

import contourpy
import numpy as np
import shapely
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from palpate.base.geometry import Floats

_BESIDE_MM, _GRID_MM, _MARGIN_MM = 4.0, 1.0, 15.0


def gaussian_outline(touched_mm: Floats, normals: Floats) -> shapely.Polygon | None:
    """Largest piece of what a Gaussian process takes to be the part; None if there is none.

    By touches (n, 2) and their outward normals (n, 2).
    """
    outside, inside = touched_mm + _BESIDE_MM * normals, touched_mm - _BESIDE_MM * normals
    places = np.concatenate([touched_mm, outside, inside, touched_mm.mean(axis=0, keepdims=True)])
    count = len(touched_mm)
    values = np.concatenate([np.zeros(count), np.ones(count), -np.ones(count), [-1.0]])
    kernel = ConstantKernel(1.0, (0.1, 100.0)) * RBF(20.0, (3.0, 100.0)) + WhiteKernel(0.01, (1e-5, 1.0))
    process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0).fit(places, values)
    lowest, highest = touched_mm.min(axis=0) - _MARGIN_MM, touched_mm.max(axis=0) + _MARGIN_MM
    x, y = (np.arange(lo, hi, _GRID_MM) for lo, hi in zip(lowest, highest, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    mean = process.predict(grid.reshape(-1, 2)).reshape(grid.shape[:2])
    lines = contourpy.contour_generator(x, y, mean).lines(0.0)
    found = [shapely.Polygon(line).buffer(0) for line in lines if len(line) > 3]
    pieces = [item for shape in found for item in shapely.get_parts(shape)]
    return max(pieces, key=lambda item: item.area, default=None)
