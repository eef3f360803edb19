"""The emulated skin: dipoles all over it, fields that magnetometers below it read, in all three axes.

Each cell of skin that the bench presses carries a dipole that stands on it; it is pushed in by its force over
the skin's stiffness, and the field of every magnetometer changes by the derivative of its field along that
way. Chips sit turned at random, with gains of their own, in a field at rest; skin creeps; zeros drift with
temperature. It is written from the makers' readers and this physics, not from the driver.
"""

from dataclasses import dataclass

import numpy as np

from palpate.plugins import Description, Floats
from palpate_reskin.codec import Fields, encode_fields

__all__ = ["MagneticSkin", "SkinTruth"]

_STEP_MM = 0.01


@dataclass(frozen=True)
class SkinTruth:
    """Truth of one skin. Noise: standard deviation of an axis; creep: a share that comes with a delay."""

    depth_mm: float = 3.5
    microtesla_per_n: float = 120.0
    gain_spread: float = 0.1
    noise_ut: float = 0.6
    drift_ut_per_s: float = 0.2
    creep_share: float = 0.08
    creep_s: float = 0.4


class MagneticSkin:
    """Frames of one skin. `cells`: of the bench; `places_mm` (n, 3): the chips' places under the skin."""

    def __init__(self, cells: Description, places_mm: Floats, truth: SkinTruth, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._truth, self._rng = truth, rng
        count = len(places_mm)
        response = _responses(cells, places_mm, truth.depth_mm)
        gain = 1 + truth.gain_spread * rng.uniform(-1, 1, count)
        turned = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]
        self._response = gain[:, None, None] * (turned @ response)
        self._rest_ut = rng.uniform(-900, 900, (count, 3))
        self._drift = rng.uniform(-1, 1, (count, 3)) * truth.drift_ut_per_s / np.sqrt(3)
        self._crept = np.zeros(cells.rows * cells.cols)
        self._last_s = 0.0

    def fields(self, now: float, force_n: Floats) -> Fields:
        """Temperature and field (n, 4) at `now` (s), float32 as sent, for forces on the cells (N)."""
        truth, force = self._truth, force_n.ravel()
        step_s, self._last_s = max(now - self._last_s, 0.0), now
        self._crept += (force - self._crept) * -np.expm1(-step_s / truth.creep_s)
        pressed = (1 - truth.creep_share) * force + truth.creep_share * self._crept
        change = truth.microtesla_per_n * (self._response @ pressed)
        # Zeros swing to and fro within a minute, no faster than is stated.
        drift = self._drift * (10.0 * np.sin(now / 10.0))
        field = self._rest_ut + drift + change + truth.noise_ut * self._rng.standard_normal(change.shape)
        warm = np.full((len(field), 1), 24.0 + 0.5 * np.sin(now / 50.0))
        return np.hstack([warm, field]).astype(np.float32)

    def frame(self, now: float, force_n: Floats) -> bytes:
        """The same as a board sends it."""
        return encode_fields(self.fields(now, force_n))


def _responses(cells: Description, places_mm: Floats, depth_mm: float) -> Floats:
    """Change of each chip's field by each cell, (n, 3, cells): a cell straight above makes 1."""
    at = cells.positions_mm().reshape(-1, 3)
    inward = -cells.normals().reshape(-1, 3)
    away = places_mm[:, None] - at[None]
    change = (_dipole(away - _STEP_MM * inward, inward) - _dipole(away, inward)) / _STEP_MM
    return np.swapaxes(change, 1, 2) * (depth_mm**4 / 6)


def _dipole(away_mm: Floats, moment: Floats) -> Floats:
    """Field of a unit dipole at places `away_mm` (n, m, 3) from it, but for a constant."""
    distance = np.linalg.norm(away_mm, axis=2, keepdims=True)
    unit = away_mm / distance
    result: Floats = (3 * unit * (unit * moment).sum(axis=2, keepdims=True) - moment) / distance**3
    return result
