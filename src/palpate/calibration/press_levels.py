"""Data reduction of presses: the way in of each as a few levels whose samples are averaged.

A level is a stretch of the travel. Averages over it take out noise, encoder steps and most of the steps of
Present Current, and the fit has a dozen numbers of each column in place of hundreds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.calibration.measurements import LEG_FREE, LEG_IN, PressMeasurement

LEVELS = 16

_MOTION_WINDOW_SAMPLES = 5  # samples within which a finger that moves must have got on by an encoder step
_MIN_SAMPLES = 8  # samples of a leg
_CONTACT_SIGMAS = 8.0  # sum over the array that is a contact for sure


@dataclass(frozen=True, eq=False)
class PressAtBearing:
    """A press, and what is known of where it went.

    `bearing_rad` ± `bearing_sigma_rad`: direction from the tip's axis to the contact, counter-clockwise
    from the direction of travel, when the tip just touches. `curvature_per_mm`: 1 / radius of
    the disc that was pressed, 0 for a flat face.
    """

    press: PressMeasurement
    bearing_rad: float
    bearing_sigma_rad: float
    curvature_per_mm: float

    def approach_mm(self) -> Floats:
        """Travel (n,) as it brings the tip nearer to the face; what it goes aside counts, too."""
        aside = math.tan(self.bearing_rad) * self.press.aside_mm
        result: Floats = self.press.travel_mm + aside
        return result


@dataclass(frozen=True, eq=False)
class PressLevels:
    """All presses of a finger, m levels in all.

    `press` (m,): whose level it is. `travel_mm` ± `spread_mm` (m,): mean and standard deviation of the
    travel since `start_mm` (presses,), about where the tip touched. `push_n` (m,), `facing_rad` (m,) and
    `counts` (m, rows, cols): means over `samples` (m,) samples. `free_n` (presses,): push of the free leg,
    in motion.
    """

    press: Ints
    travel_mm: Floats
    spread_mm: Floats
    push_n: Floats
    facing_rad: Floats
    counts: Floats
    samples: Ints
    start_mm: Floats
    free_n: Floats


def average_levels(presses: Sequence[PressAtBearing], live: Bools, full: Floats, noise: float) -> PressLevels:
    """Cut each press's way in into `LEVELS` levels of equal travel.

    `live` and `full` (rows, cols): taxels that are looked at, and counts at which they are saturated: samples
    with such a one are left out. Raises InputError for a press with too few samples in motion or in contact.
    """
    parts = [_levels(pressed, live, full, noise) for pressed in presses]
    return PressLevels(
        press=np.repeat(np.arange(len(parts)), [len(part.travel_mm) for part in parts]),
        travel_mm=np.concatenate([part.travel_mm for part in parts]),
        spread_mm=np.concatenate([part.spread_mm for part in parts]),
        push_n=np.concatenate([part.push_n for part in parts]),
        facing_rad=np.concatenate([part.facing_rad for part in parts]),
        counts=np.concatenate([part.counts for part in parts]),
        samples=np.concatenate([part.samples for part in parts]),
        start_mm=np.concatenate([part.start_mm for part in parts]),
        free_n=np.concatenate([part.free_n for part in parts]),
    )


def informative_presses(
    presses: Sequence[PressAtBearing], live: Bools, full: Floats, noise: float
) -> list[PressAtBearing]:
    """Presses with enough samples in motion and in contact, or all if these are fewer than half.

    A reference whose place is known by a few touches is met a little elsewhere than predicted now and then.
    """
    found = [item for item in presses if _has_enough(*_parts(item.press, live, full, noise))]
    return found if 2 * len(found) >= len(presses) else list(presses)


def _parts(press: PressMeasurement, live: Bools, full: Floats, noise: float) -> tuple[Bools, Bools]:
    """Samples (n,) of a finger that moves: those of its free way, and those that count as pressing."""
    total = press.counts[:, live].sum(axis=1)
    in_contact = total > _CONTACT_SIGMAS * noise * np.sqrt(live.sum())
    within = ~((press.counts >= full) & live).any(axis=(1, 2))
    return _moving(press, LEG_FREE), _moving(press, LEG_IN) & in_contact & within


def _has_enough(free: Bools, chosen: Bools) -> bool:
    return bool(free.sum() >= _MIN_SAMPLES and chosen.sum() >= _MIN_SAMPLES)


def _levels(pressed: PressAtBearing, live: Bools, full: Floats, noise: float) -> PressLevels:
    press, place = pressed.press, pressed.approach_mm()
    free, chosen = _parts(press, live, full, noise)
    if not _has_enough(free, chosen):
        raise InputError(
            f"finger {press.finger}, placing {press.placing}: a press has too few samples of a finger "
            f"that moves ({free.sum()} free, {chosen.sum()} in contact; {_MIN_SAMPLES} are needed); begin it "
            "further away, press harder or more slowly"
        )
    place, counts = place[chosen], press.counts[chosen]
    start = float(place.min())
    share = (place - start) / max(float(np.ptp(place)), 1e-9)
    wanted = min(LEVELS, len(place) // 2)
    _, level, samples = np.unique(
        np.minimum((share * wanted).astype(int), wanted - 1), return_inverse=True, return_counts=True
    )
    order = np.argsort(level, kind="stable")
    begins = np.concatenate([[0], np.cumsum(samples)[:-1]])
    means = [
        np.add.reduceat(a[order], begins) / samples.reshape(-1, *[1] * (a.ndim - 1))
        for a in (
            place - start,
            (place - start) ** 2,
            press.push_n[chosen],
            press.facing_rad[chosen],
            counts,
        )
    ]
    return PressLevels(
        press=np.zeros(len(samples), dtype=np.int64),
        travel_mm=means[0],
        spread_mm=np.sqrt(np.maximum(means[1] - means[0] ** 2, 0.0)),
        push_n=means[2],
        facing_rad=means[3],
        counts=means[4],
        samples=samples.astype(np.int64),
        start_mm=np.array([start]),
        free_n=np.array([float(press.push_n[free].mean())]),
    )


def _moving(press: PressMeasurement, leg: int) -> Bools:
    """Samples (n,) of a leg in which the finger moves on, by the steps round each of them."""
    there = np.flatnonzero(press.leg == leg)
    result = np.zeros(len(press.leg), dtype=bool)
    if len(there) < _MIN_SAMPLES:
        return result
    window = min(_MOTION_WINDOW_SAMPLES, len(there) // 4)
    place = press.travel_mm[there]
    padded = np.pad(place, window, mode="reflect", reflect_type="odd")
    moved = padded[2 * window :] - padded[: -2 * window]
    result[there[moved > press.step_mm / 2]] = True
    return result
