"""Pressure distribution of a cylindrical tip on a reference, over the array's columns.

The skin is an elastic foundation (Johnson, Contact Mechanics, ch. 4.3) that yields along the radius:
pressure in a direction grows with how far the reference reaches into the undeformed circle there.
References are flat faces and discs. Whole arrays, n contacts at a time.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle

__all__ = ["PressureDistribution", "dent_and_bearing", "distribute_pressure"]

_IN_COLUMN, _IN_WHOLE = 4, 12  # nodes of Gauss's rule: pressure is smooth where there is any


@dataclass(frozen=True, eq=False)
class PressureDistribution:
    """Force of n contacts by columns.

    `share` (n, cols) of all force that the skin bears; less than 1 in sum if some of it is beside the
    array. `lean` (n,): what the tip as a whole is pushed with, as a part of the sum of what its skin
    bears; the skin's forces point to the axis, so that they partly cancel.
    """

    share: Floats
    lean: Floats


def distribute_pressure(
    columns_rad: Floats,
    pitch_rad: float,
    towards_rad: Floats,
    dent: Floats,
    curvature: Floats,
) -> PressureDistribution:
    """How contacts spread over columns at `columns_rad` (cols,), each `pitch_rad` wide.

    `towards_rad` (n,): direction from the axis to the contact, as the columns'. In tip radii: `dent`
    (n,) is the deepest dent, in 0 … 1 (both excluded); `curvature` (n,) is tip radius over the
    reference's, 0 for a flat face.
    """
    half = _half_width(dent, curvature)
    whole = _quadrature(-half, half, dent, curvature, _IN_WHOLE)
    middle = wrap_angle(columns_rad - towards_rad[:, None])
    low = np.clip(middle - pitch_rad / 2, -half[:, None], half[:, None])
    high = np.clip(middle + pitch_rad / 2, -half[:, None], half[:, None])
    by_column = _quadrature(low, high, dent[:, None], curvature[:, None], _IN_COLUMN)[0]
    return PressureDistribution(by_column / whole[0][:, None], whole[1] / whole[0])


def dent_and_bearing(
    travel_mm: Floats, bearing_rad: Floats, radius_mm: float, curvature_per_mm: Floats
) -> tuple[Floats, Floats]:
    """Deepest dent (mm) and bearing (rad) after a travel past first contact, all (n,).

    `bearing_rad`: direction to the contact from the direction of travel, when the tip just touches.
    Against a disc the tip slides round it on the way: a triangle of the two centres. Dents before
    contact are negative.
    """
    per_mm = curvature_per_mm / (1 + curvature_per_mm * radius_mm)  # 1 / distance of the centres
    ahead, aside = travel_mm * np.cos(bearing_rad), travel_mm * np.sin(bearing_rad)
    nearer = np.sqrt((1 - per_mm * ahead) ** 2 + (per_mm * aside) ** 2)
    dent: Floats = (2 * ahead - per_mm * travel_mm**2) / (1 + nearer)
    turned: Floats = bearing_rad + np.arctan2(per_mm * aside, 1 - per_mm * ahead)
    return dent, turned


def _half_width(dent: Floats, curvature: Floats) -> Floats:
    """Angle from a patch's middle to its end, rad: where the reference crosses the undeformed circle."""
    left = 1 - dent
    cosine = (curvature * (1 + left**2) + 2 * left) / (2 * (curvature * left + 1))
    result: Floats = np.arccos(np.clip(cosine, -1.0, 1.0))
    return result


def _dent(angle: Floats, dent: Floats, curvature: Floats) -> Floats:
    """Dent in tip radii at `angle` from a patch's middle."""
    left = 1 - dent
    centre = curvature * left + 1  # distance to the disc's centre in its radii
    root = np.sqrt(np.maximum(1 - (centre * np.sin(angle)) ** 2, 0.0))
    result: Floats = 1 - (curvature * left**2 + 2 * left) / (centre * np.cos(angle) + root)
    return result


def _quadrature(
    low: Floats, high: Floats, dent: Floats, curvature: Floats, nodes: int
) -> tuple[Floats, Floats]:
    """Integrals over angles `low` … `high` of the dent, and of its part along the patch's middle."""
    place, weight = np.polynomial.legendre.leggauss(nodes)
    half = (high - low)[..., None] / 2
    angle = (high + low)[..., None] / 2 + half * place
    depth = _dent(angle, dent[..., None], curvature[..., None]) * weight * half
    return depth.sum(axis=-1), (depth * np.cos(angle)).sum(axis=-1)
