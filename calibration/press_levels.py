"""Data reduction of presses: the way in of each as a few levels whose samples are averaged.

A level is a stretch of the slide's travel. Averages over it take out noise, encoder steps and most of
the steps of Present Current, and the fit has a dozen numbers of each column in place of hundreds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.measurements import FREE, IN, PressMeasurement
from palpate.drivers.finger import TICK_RAD
from palpate.errors import InputError
from palpate.geometry import Bools, Floats, Ints

__all__ = ["LEVELS", "PressAtBearing", "PressLevels", "average_levels", "informative_presses"]

LEVELS = 16

_WINDOW = 5  # samples within which a slide that moves must have got on by an encoder step
_FEWEST = 8  # samples of a leg
_FELT_SIGMAS = 8.0  # sum over the array that is a contact for sure


@dataclass(frozen=True, eq=False)
class PressAtBearing:
    """A press, and what is known of where it went.

    `bearing_rad` ± `bearing_sigma_rad`: direction from the tip's axis to the contact, counter-clockwise
    from the slide's direction of travel, when the tip just touches. `curvature_per_mm`: 1 / radius of
    the disc that was pressed, 0 for a flat face. `newton_per_a`: force along the travel that a current
    gives.
    """

    press: PressMeasurement
    bearing_rad: float
    bearing_sigma_rad: float
    curvature_per_mm: float
    newton_per_a: float


@dataclass(frozen=True, eq=False)
class PressLevels:
    """All presses of a finger, m levels in all.

    `press` (m,): whose level it is. `travel_mm` ± `spread_mm` (m,): mean and standard deviation of the
    travel since `start_mm` (presses,), about where the tip touched. `current_a` (m,) and `counts` (m,
    rows, cols): means over `samples` (m,) samples. `free_a` (presses,): current of the free leg, in
    motion.
    """

    press: Ints
    travel_mm: Floats
    spread_mm: Floats
    current_a: Floats
    counts: Floats
    samples: Ints
    start_mm: Floats
    free_a: Floats


def average_levels(
    presses: Sequence[PressAtBearing], live: Bools, full: Floats, noise: float, mm_per_rad: float
) -> PressLevels:
    """Cut each press's way in into `LEVELS` levels of equal travel.

    `live` and `full` (rows, cols): taxels that are looked at, and counts at which they are saturated: samples
    with such a one are left out. Raises InputError for a press with too few samples in motion or in contact.
    """
    parts = [_levels(pressed.press, live, full, noise, mm_per_rad) for pressed in presses]
    return PressLevels(
        press=np.repeat(np.arange(len(parts)), [len(part.travel_mm) for part in parts]),
        travel_mm=np.concatenate([part.travel_mm for part in parts]),
        spread_mm=np.concatenate([part.spread_mm for part in parts]),
        current_a=np.concatenate([part.current_a for part in parts]),
        counts=np.concatenate([part.counts for part in parts]),
        samples=np.concatenate([part.samples for part in parts]),
        start_mm=np.concatenate([part.start_mm for part in parts]),
        free_a=np.concatenate([part.free_a for part in parts]),
    )


def informative_presses(
    presses: Sequence[PressAtBearing], live: Bools, full: Floats, noise: float, mm_per_rad: float
) -> list[PressAtBearing]:
    """Presses with enough samples in motion and in contact, or all if these are fewer than half.

    A reference whose place is known by a few touches is met a little elsewhere than predicted now and then.
    """
    found = [item for item in presses if _enough(*_parts(item.press, live, full, noise, mm_per_rad))]
    return found if 2 * len(found) >= len(presses) else list(presses)


def _parts(
    press: PressMeasurement, live: Bools, full: Floats, noise: float, mm_per_rad: float
) -> tuple[Bools, Bools]:
    """Samples (n,) of a slide that moves: those of its free way, and those that count as pressing."""
    total = press.counts[:, live].sum(axis=1)
    in_contact = total > _FELT_SIGMAS * noise * np.sqrt(live.sum())
    within = ~((press.counts >= full) & live).any(axis=(1, 2))
    return _moving(press, FREE, mm_per_rad), _moving(press, IN, mm_per_rad) & in_contact & within


def _enough(free: Bools, chosen: Bools) -> bool:
    return bool(free.sum() >= _FEWEST and chosen.sum() >= _FEWEST)


def _levels(
    press: PressMeasurement, live: Bools, full: Floats, noise: float, mm_per_rad: float
) -> PressLevels:
    place = mm_per_rad * press.slide_rad
    free, chosen = _parts(press, live, full, noise, mm_per_rad)
    if not _enough(free, chosen):
        raise InputError(
            f"finger {press.finger}, placing {press.placing}: a press has too few samples of a slide that "
            f"moves ({free.sum()} free, {chosen.sum()} in contact; {_FEWEST} are needed); begin it "
            "further away, press harder or more slowly"
        )
    place, current, counts = place[chosen], press.current_a[chosen], press.counts[chosen]
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
        for a in (place - start, (place - start) ** 2, current, counts)
    ]
    return PressLevels(
        press=np.zeros(len(samples), dtype=np.int64),
        travel_mm=means[0],
        spread_mm=np.sqrt(np.maximum(means[1] - means[0] ** 2, 0.0)),
        current_a=means[2],
        counts=means[3],
        samples=samples.astype(np.int64),
        start_mm=np.array([start]),
        free_a=np.array([float(press.current_a[free].mean())]),
    )


def _moving(press: PressMeasurement, leg: int, mm_per_rad: float) -> Bools:
    """Samples (n,) of a leg in which the slide moves outwards, by the steps round each of them."""
    there = np.flatnonzero(press.leg == leg)
    result = np.zeros(len(press.leg), dtype=bool)
    if len(there) < _FEWEST:
        return result
    window = min(_WINDOW, len(there) // 4)
    place = press.slide_rad[there] * np.sign(mm_per_rad)
    padded = np.pad(place, window, mode="reflect", reflect_type="odd")
    moved = padded[2 * window :] - padded[: -2 * window]
    result[there[moved > TICK_RAD / 2]] = True
    return result
