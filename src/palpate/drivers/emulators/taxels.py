"""Taxels of an emulated array: forces in, counts out, independent of the protocol.

The sensor's faults are its own: gain and offset per taxel, drift, crosstalk to the four neighbours, noise,
saturation, quantisation, dead and hot taxels.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Counts, Floats
from palpate.drivers.tactile.description import Description

_NOISE_BLOCK_SAMPLES = 64  # samples for which noise is drawn at once


class Taxels:
    """Taxels of one array, with their hidden truth drawn from `seed`; same seed and forces: same counts.

    `gain_spread` is the half-width of the uniform gain error of each taxel, `crosstalk` the share of a
    taxel's force that each of its four neighbours takes from it (the total is kept), `noise_counts` the
    standard deviation of the noise. Zeros wander up and down, each in its own time, and never faster than
    `drift_counts_per_s`. What is sent is an exponential mean that shows 99 % of a step after `lag_s`. `dead`
    and `hot` are (row, column) pairs stuck at 0 and at full.
    """

    def __init__(  # noqa: PLR0913  # one for each thing that is wrong with a sensor, all optional
        self,
        description: Description,
        *,
        seed: int,
        noise_counts: float = 2.0,
        gain_spread: float = 0.0,
        offset_counts: float = 0.0,
        crosstalk: float = 0.0,
        drift_counts_per_s: float = 0.0,
        lag_s: float = 0.0,
        dead: Sequence[tuple[int, int]] = (),
        hot: Sequence[tuple[int, int]] = (),
    ) -> None:
        self.description = description
        shape = (description.rows, description.cols)
        self._rng = np.random.default_rng(seed)
        gain = 1.0 + gain_spread * self._rng.uniform(-1.0, 1.0, shape)
        self._gain_counts = gain * description.counts_per_n
        self._offset = np.full(shape, float(offset_counts))
        self._noise = _Noise(self._rng, shape, noise_counts)
        self._spread_rows = _crosstalk_matrix(description.rows, crosstalk)
        self._spread_cols = _crosstalk_matrix(description.cols, crosstalk)
        self._wander = None if drift_counts_per_s == 0 else self._wandering(drift_counts_per_s)
        self._filter_s = lag_s / math.log(100)
        self._filtered: tuple[float, Floats] | None = None
        self._dead = tuple(dead)
        self._hot = tuple(hot)
        self._none_n: Floats | None = None
        self._rest: Counts | None = None
        self._rest_of: Floats | None = None

    @property
    def gain(self) -> Floats:
        """True relative gain of every taxel, shape (rows, cols): the truth that calibration looks for."""
        return self._gain_counts / self.description.counts_per_n

    @property
    def dead(self) -> tuple[tuple[int, int], ...]:
        """Taxels (row, column) that are stuck at 0."""
        return self._dead

    def counts(self, force_n: Floats, now: float | Floats = 0.0) -> Counts:
        """Counts at `now` (s) for forces (N per taxel), both of shape (rows, cols).

        For n instants `now` has shape (n,), forces and counts (n, rows, cols).

        Raises ValueError on another shape.
        """
        d = self.description
        if force_n.shape[-2:] != (d.rows, d.cols):
            raise ValueError(f"forces of shape {force_n.shape} for an array of {d.rows} x {d.cols}")
        plain = self._wander is None and self._filter_s == 0
        if force_n.ndim == 2 and plain and self._is_none(force_n):  # as nearly always
            return self._idle_counts()
        counts = self._force_counts(force_n)
        if self._wander is not None:
            size, speed, phase = self._wander
            counts += size * np.sin(speed * np.asarray(now)[..., None, None] + phase)
        counts += self._noise.take(len(counts)) if counts.ndim == 3 else self._noise.take_one()
        if self._filter_s and counts.ndim == 2 and isinstance(now, float):
            counts = self._filter(counts, now)
        return self._read(counts)

    def _filter(self, counts: Floats, now: float) -> Floats:
        """Exponential mean of one sample and those before; where time goes back it begins anew."""
        before_s, mean = self._filtered or (now, counts)
        if now > before_s:
            mean = mean + (counts - mean) * -math.expm1((before_s - now) / self._filter_s)
        else:
            mean = counts
        self._filtered = now, mean
        return mean.copy()

    def _is_none(self, force_n: Floats) -> bool:
        """True if nothing presses; an array that cannot change is looked through once."""
        if force_n is self._none_n:
            return True
        if force_n.any():
            return False
        if not force_n.flags.writeable:
            self._none_n = force_n
        return True

    def _idle_counts(self) -> Counts:
        """The next counts without a force, worked out for as many samples at once as there is noise for."""
        self._noise.go_on()
        if self._rest is None or self._rest_of is not self._noise.block:
            self._rest_of = self._noise.block
            self._rest = self._read(self._offset + self._noise.block)
            self._rest.flags.writeable = False
        result: Counts = self._rest[self._noise.index - 1]
        return result

    def _read(self, counts: Floats) -> Counts:
        """Digitise counts (…, rows, cols), which it overwrites."""
        d = self.description
        np.rint(counts, out=counts)
        np.maximum(counts, 0, out=counts)
        np.minimum(counts, d.max_count, out=counts)
        for row, col in self._dead:
            counts[..., row, col] = 0
        for row, col in self._hot:
            counts[..., row, col] = d.max_count
        return counts.astype("<u2")

    def _force_counts(self, force_n: Floats) -> Floats:
        """Counts of forces without drift and noise."""
        if not force_n.any():
            return np.broadcast_to(self._offset, force_n.shape).copy()
        counts: Floats = self._spread_rows @ force_n
        counts += force_n @ self._spread_cols
        counts += force_n
        counts *= self._gain_counts
        counts += self._offset
        return counts

    def _wandering(self, rate: float) -> tuple[Floats, Floats, Floats]:
        """Size (counts), angular speed (1/s) and phase of each zero's wandering; a round takes 1 to 5 min."""
        shape = self._gain_counts.shape
        speed = 2 * math.pi / self._rng.uniform(60.0, 300.0, shape)
        return rate / speed, speed, self._rng.uniform(0.0, 2 * math.pi, shape)


class _Noise:
    """Noise sample by sample, drawn for many at once: the same numbers as if each were drawn for itself."""

    def __init__(self, rng: np.random.Generator, shape: tuple[int, int], counts: float) -> None:
        """`counts`: standard deviation."""
        self._rng, self._shape, self._counts = rng, shape, counts
        self.block: Floats = np.zeros((0, *shape))
        self.index = 0

    def take_one(self) -> Floats:
        """Noise of the next sample, (rows, cols)."""
        self.go_on()
        result: Floats = self.block[self.index - 1]
        return result

    def go_on(self) -> None:
        """Go on to the next sample, whose noise is `block[index - 1]` then."""
        if self.index == len(self.block):
            self.block = self._counts * self._rng.standard_normal((_NOISE_BLOCK_SAMPLES, *self._shape))
            self.index = 0
        self.index += 1

    def take(self, samples: int) -> Floats:
        """Noise of the next samples, (samples, rows, cols)."""
        ahead = self.block[self.index : self.index + samples]
        self.index += len(ahead)
        more = self._counts * self._rng.standard_normal((samples - len(ahead), *self._shape))
        return np.concatenate((ahead, more))


def _crosstalk_matrix(count: int, share: float) -> Floats:
    """Return the change that neighbours in a line of `count` work on each other, shape (count, count)."""
    matrix = np.zeros((count, count))
    for i in range(count - 1):
        matrix[i, i + 1] = matrix[i + 1, i] = share
        matrix[i, i] -= share
        matrix[i + 1, i + 1] -= share
    return matrix
