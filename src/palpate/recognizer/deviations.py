"""Deviations of a stranger's outline from a hypothesis's: a Gaussian process along it, known from touches.

The outline is displaced along its normals by a process over arc length with covariance σ² exp(−r² / 2ℓ²), r
being the chord of the circle on which the ring is rolled up, and scaled. A rigid motion of the stranger is
not known, either: kriging with a trend. Normals are the process's derivative (C. E. Rasmussen and
C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press, 2006, §2.7 and §9.4).
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.special import erf, ndtr

from palpate.base.geometry import Floats
from palpate.recognizer.outline_places import OutlinePlaces

__all__ = ["Deviations", "Touchable", "agreement"]

_SHIFT_MM, _TURN_RAD = 100.0, 1.5  # standard deviations of the rigid motion: any
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Deviations:
    """m kinds of strangers, all (m,): standard deviation `sigma_mm` of what varies along the outline, its
    correlation length `length_mm`, and standard deviation `scale` of the size, relative.
    """

    sigma_mm: Floats
    length_mm: Floats
    scale: Floats


@dataclass(frozen=True, eq=False)
class Touchable:
    """Touches at places of h outlines, and what agrees there, for t touches, all (h, t).

    Deviations from −`inward_mm` to `outward_mm` agree, with normals within `normal_rad` of the predicted one.
    `noise_mm` and `noise_rad`: standard deviations of the measurement; `known_mm` and `known_rad`: of what is
    known of the deviation and of the normal once the touch has agreed.
    """

    places: OutlinePlaces
    inward_mm: Floats
    outward_mm: Floats
    normal_rad: Floats
    noise_mm: Floats
    noise_rad: Floats
    known_mm: Floats
    known_rad: Floats

    def followed_by(self, other: "Touchable") -> "Touchable":
        """These touches, and then those of another on the same outlines."""
        numbers = [
            np.concatenate([getattr(self, item.name), getattr(other, item.name)], axis=1)
            for item in fields(self)[1:]
        ]
        return Touchable(OutlinePlaces.joined([self.places, other.places]), *numbers)

    def column(self, index: int) -> "Touchable":
        """One of the touches."""
        return self.mapped(lambda item: item[:, index : index + 1])

    def mapped(self, change: Callable[[Any], Any]) -> "Touchable":
        """The same change of all arrays: other rows, other columns."""
        numbers = [change(getattr(self, item.name)) for item in fields(self)[1:]]
        return Touchable(self.places.mapped(change), *numbers)


def agreement(touches: Touchable, deviations: Deviations) -> Floats:
    """Probability (m, h, t) that strangers of each kind agree with a touch, given that they did before."""
    deviation, normal = _conditional(touches, deviations)
    across, turned = np.hypot(deviation, touches.noise_mm), np.hypot(normal, touches.noise_rad)
    stops = ndtr(touches.outward_mm / across) - ndtr(-touches.inward_mm / across)
    result: Floats = stops * erf(touches.normal_rad / (np.sqrt(2.0) * turned))
    return result


def _conditional(touches: Touchable, deviations: Deviations) -> tuple[Floats, Floats]:
    """Standard deviations (m, h, t) of every deviation and turn of the normal, given all the touches before.

    Cholesky's factor has them on its diagonal, deviation and normal of one touch after those of the other.
    """
    covariance = _covariance(touches.places, deviations)
    known = np.stack([touches.known_mm, touches.known_rad], axis=2).reshape(len(touches.known_mm), -1)
    index = np.arange(covariance.shape[2])
    covariance[:, :, index, index] += known**2
    diagonal = np.linalg.cholesky(covariance)[:, :, index, index]
    spread = np.sqrt(np.maximum(diagonal**2 - known**2, _LEAST_VARIANCE))
    return spread[:, :, 0::2], spread[:, :, 1::2]


def _covariance(places: OutlinePlaces, deviations: Deviations) -> Floats:
    """Prior covariance (m, h, 2t, 2t) of deviations and turns of the normal, one touch after the other."""
    hypotheses, count = places.along.shape
    smooth = _smooth(places, deviations)
    support = np.sum(places.normal * places.foot, axis=2)
    sized = (deviations.scale**2)[:, None, None, None] * (support[:, :, None] * support[:, None])
    smooth[..., 0, :, 0] += sized
    x, y = np.moveaxis(places.foot, 2, 0)
    u, v = np.moveaxis(places.normal, 2, 0)
    trend = np.zeros((hypotheses, count, 2, 3))
    trend[..., 0, :] = -np.stack([u * _SHIFT_MM, v * _SHIFT_MM, (x * v - y * u) * _TURN_RAD], axis=2)
    trend[..., 1, 2] = -_TURN_RAD
    flat = trend.reshape(hypotheses, 2 * count, 3)
    result: Floats = smooth.reshape(len(deviations.scale), hypotheses, 2 * count, 2 * count)
    result += flat @ flat.swapaxes(1, 2)
    return result


def _smooth(places: OutlinePlaces, deviations: Deviations) -> Floats:
    """What varies along the outline: covariance (m, h, t, 2, t, 2) of it and of the turns of the normal."""
    same = places.ring[:, :, None] == places.ring[:, None]
    turn = 2 * np.pi / places.perimeter[:, :, None]
    u = turn * (places.along[:, :, None] - places.along[:, None])
    sin, cos, chord = np.sin(u) / turn, np.cos(u), 2 * np.sin(u / 2) / turn
    sigma, length = (item[:, None, None, None] for item in (deviations.sigma_mm, deviations.length_mm))
    value = np.where(same, sigma**2 * np.exp(-((chord / length) ** 2) / 2), 0.0)
    slope = -value * sin / length**2
    # The normal turns by −d′ where the displacement d grows.
    result = np.empty((*value.shape[:3], 2, value.shape[3], 2))
    result[..., 0, :, 0] = value
    result[..., 0, :, 1] = slope
    result[..., 1, :, 0] = slope.swapaxes(2, 3)
    result[..., 1, :, 1] = value * (cos - (sin / length) ** 2) / length**2
    return result
