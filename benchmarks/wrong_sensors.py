"""Arrays that lie: what one does with counts before it sends them, drawn at random.

Nothing here imports what finds them.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators import Taxels

File = dict[str, Any]
"""A rig file as TOML has it."""


class Sensor:
    """What an array does with counts before it sends them. State belongs to one array."""

    def counts(self, counts: Floats, now: float) -> Floats:  # noqa: ARG002  # some need it
        """Return other counts for these, shape (rows, cols), at `now` (s)."""
        return counts


class Hung(Sensor):
    """From an instant on the same frame for ever."""

    def __init__(self, from_s: float) -> None:
        self._from_s, self._frame = from_s, None

    def counts(self, counts: Floats, now: float) -> Floats:
        if now >= self._from_s and self._frame is None:
            self._frame = counts
        return counts if self._frame is None else self._frame


class Spare(Sensor):
    """A healthy array that is not on the finger: it sends noise and feels nothing."""

    def __init__(self, seed: int) -> None:
        self._rng, self._frame = np.random.default_rng(seed), None

    def counts(self, counts: Floats, now: float) -> Floats:  # noqa: ARG002
        if self._frame is None:
            self._frame = counts
        return np.rint(self._frame + self._rng.normal(0.0, 1.0, counts.shape))


class Repeats(Sensor):
    """Fresh samples so often only; in between the last one again."""

    def __init__(self, hz: float) -> None:
        self._hz, self._number, self._frame = hz, -1, None

    def counts(self, counts: Floats, now: float) -> Floats:
        if (number := int(now * self._hz)) != self._number:
            self._number, self._frame = number, counts
        return self._frame


class Lags(Sensor):
    """A low-pass filter in its firmware."""

    def __init__(self, lag_s: float) -> None:
        self._lag_s, self._mean, self._at = lag_s, None, 0.0

    def counts(self, counts: Floats, now: float) -> Floats:
        if self._mean is None:
            self._mean = counts.astype(float)
        share = 1 - math.exp(-(now - self._at) / self._lag_s)
        self._at = now
        self._mean += share * (counts - self._mean)
        return np.rint(self._mean)


class Drifts(Sensor):
    """Counts go up by so many a second."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s

    def counts(self, counts: Floats, now: float) -> Floats:
        return counts + int(self._per_s * now)


class Bursts(Sensor):
    """Interference common to all taxels, 8 to 40 ms long, twice a second."""

    def __init__(self, size: int, seed: int) -> None:
        self._rng, self._size, self._begin, self._end = np.random.default_rng(seed), size, 0.0, 0.0

    def counts(self, counts: Floats, now: float) -> Floats:
        if now > self._end:
            self._begin = now + self._rng.exponential(0.5)
            self._end = self._begin + self._rng.uniform(0.008, 0.04)
        return counts + self._size if self._begin < now < self._end else counts


class Mirrored(Sensor):
    """Columns, or columns and rows, run the other way: the array is mounted wrongly."""

    def __init__(self, upside: bool) -> None:
        self._upside = upside

    def counts(self, counts: Floats, now: float) -> Floats:  # noqa: ARG002  # others need it
        return counts[::-1, ::-1] if self._upside else counts[:, ::-1]


def _one(rig: File, rng: np.random.Generator, make: Callable[[], Sensor]) -> dict[str, Callable[[], Sensor]]:
    return {str(rng.choice([finger["name"] for finger in rig["fingers"]])): make}


def _all(rig: File, make: Callable[[], Sensor]) -> dict[str, Callable[[], Sensor]]:
    return {finger["name"]: make for finger in rig["fingers"]}


def _hung(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    at = 0.0 if rng.random() < 0.5 else float(rng.uniform(3, 16))
    return f"from {at:.1f} s", _one(rig, rng, lambda: Hung(at))


def _spare(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    seed = int(rng.integers(2**31))
    return "feels nothing", _one(rig, rng, lambda: Spare(seed))


def _repeats(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    hz = float(rng.uniform(10, 60))
    return f"{hz:.0f} Hz", _all(rig, lambda: Repeats(hz))


def _lags(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    lag = float(rng.uniform(0.05, 0.15))
    return f"{lag * 1e3:.0f} ms", _all(rig, lambda: Lags(lag))


def _drifts(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    rate = float(rng.choice([-1, 1]) * rng.uniform(3, 20))
    return f"{rate:.1f} counts/s", _all(rig, lambda: Drifts(rate))


def _bursts(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    size, seed = int(rng.uniform(20, 150)), int(rng.integers(2**31))
    return f"{size} counts", _all(rig, lambda: Bursts(size, seed))


def _mirrored(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    return "columns", _one(rig, rng, lambda: Mirrored(False))


def _upside(rig: File, rng: np.random.Generator) -> tuple[str, dict[str, Callable[[], Sensor]]]:
    return "columns and rows", _one(rig, rng, lambda: Mirrored(True))


SENSORS: Mapping[str, Callable[[File, np.random.Generator], tuple[str, dict[str, Callable[[], Sensor]]]]] = {
    "array hung": _hung,
    "spare array": _spare,
    "samples repeated": _repeats,
    "array lags": _lags,
    "array drifts": _drifts,
    "interference": _bursts,
    "array mirrored": _mirrored,
    "array upside down": _upside,
}


class SpoiltTaxels(Taxels):
    """Taxels of an array that lies, made for the fingers in turn."""

    names: tuple[str, ...] = ()
    sensors: Mapping[str, Callable[[], Sensor]] = {}
    made = 0

    def __init__(self, *args: Any, **values: Any) -> None:
        super().__init__(*args, **values)
        name = self.names[SpoiltTaxels.made % len(self.names)]
        SpoiltTaxels.made += 1
        make = self.sensors.get(name)
        self._sensor = None if make is None else make()

    def counts(self, force_n: Floats, now: Any = 0.0) -> Any:
        true = super().counts(force_n, now)
        if self._sensor is None or (isinstance(now, float) and now == 0.0):  # its self-test has no instants
            return true
        most = 2**self.description.bit_depth - 1
        if true.ndim == 2:
            found = self._sensor.counts(true.astype(float), float(now))
            return np.clip(found, 0, most).astype(true.dtype)
        found = [self._sensor.counts(one.astype(float), float(at)) for one, at in zip(true, now, strict=True)]
        return np.clip(np.stack(found), 0, most).astype(true.dtype)
