"""Parts of a catalogue with one feature moved, added or missing: how probably touches agree all the same.

The outline is a hypothesis's but for a stretch that is displaced along its normals. Where the stretch lies
and how deep it is are equally probable for some values of both. A touch on it is off by its depth, and every
touch by what the rigid motion is off that the touches before were fitted with, those on the stretch among
them. That motion is Gaussian, and its uncertainty is the same wherever the stretch lies (the trend of
`outline_deviations`): one Cholesky factor serves all stretches.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from palpate.base.geometry import Floats
from palpate.recognizer.outline_deviations import OutlinePlaces, OutlineTouches, motion_covariance

_STRETCHES = 48  # places along a ring, evenly spaced
_LEAST_WEIGHT = 1e-300


@dataclass(frozen=True, eq=False)
class Features:
    """m kinds of altered parts: `share` (m,) of the ring that is displaced, by `depth_mm` (d,) out or in."""

    share: Floats
    depth_mm: Floats


def feature_agreement(touches: OutlineTouches, features: Features) -> Floats:
    """Probability (m, h, t) that parts altered in each way agree with a touch, given that they did before."""
    off = _displacements_mm(touches.places, features)
    hypotheses, count = touches.places.along.shape
    factor = np.linalg.cholesky(_covariance(touches))
    # Innovations: what each touch is off by, beyond what the fit of the motion to those before explains.
    rows = np.zeros((hypotheses, 2 * count, off.shape[0] * off.shape[3]))
    rows[:, 0::2] = off.transpose(1, 2, 0, 3).reshape(hypotheses, count, -1)
    new = np.linalg.solve(factor, rows)[:, 0::2]
    spread = np.diagonal(factor, axis1=1, axis2=2)[:, 0::2]
    across = np.sqrt(np.maximum(spread**2 - touches.known_mm**2, 0.0) + touches.noise_mm**2)[..., None]
    mean = new * spread[..., None]
    agrees = ndtr((touches.outward_mm[..., None] - mean) / across)
    agrees -= ndtr((-touches.inward_mm[..., None] - mean) / across)
    is_known = np.isinf(touches.outward_mm) & np.isinf(touches.inward_mm)
    likelihood = np.where(is_known[..., None], np.exp(-np.minimum(new**2 / 2, 600.0)), agrees)
    before = np.cumprod(np.concatenate([np.ones_like(agrees[:, :1]), likelihood[:, :-1]], axis=1), axis=1)
    shape = (hypotheses, count, off.shape[0], off.shape[3])
    before, agrees = before.reshape(shape), agrees.reshape(shape)
    result: Floats = (before * agrees).sum(axis=3) / np.maximum(before.sum(axis=3), _LEAST_WEIGHT)
    return result.transpose(2, 0, 1)


def _displacements_mm(places: OutlinePlaces, features: Features) -> Floats:
    """Displacement (m, h, t, s) of every touched place, for all stretches of each kind."""
    at = places.along / places.perimeter
    middle = np.arange(_STRETCHES) / _STRETCHES
    away = np.abs((at[..., None] - middle + 0.5) % 1.0 - 0.5)
    inside = away[None] <= features.share[:, None, None, None] / 2
    depths = np.concatenate([features.depth_mm, -features.depth_mm])
    result: Floats = (inside[..., None] * depths).reshape(*inside.shape[:3], -1)
    return result


def _covariance(touches: OutlineTouches) -> Floats:
    """Covariance (h, 2t, 2t) of deviations and turns of the normal that a rigid motion causes, and noise."""
    result = motion_covariance(touches.places)
    known = np.stack([touches.known_mm, touches.known_rad], axis=2).reshape(len(touches.known_mm), -1)
    index = np.arange(result.shape[1])
    result[:, index, index] += known**2
    return result
