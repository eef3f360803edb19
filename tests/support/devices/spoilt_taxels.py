"""Taxels of an emulated array whose counts its electronics or firmware spoil before they are sent."""

import random
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from palpate.base.geometry import Counts, Floats
from palpate.drivers.emulators.taxels import Taxels

Spoil = Callable[[Counts, float], Counts]
"""What is sent of counts (rows, cols) that were sampled at a time (s)."""


class SpoiltTaxels:
    """An array's own taxels, spoilt; all else is theirs."""

    def __init__(self, taxels: Taxels, spoil: Spoil) -> None:
        self._taxels, self._spoil = taxels, spoil

    def __getattr__(self, name: str) -> Any:
        return getattr(self._taxels, name)

    def counts(self, force_n: Floats, now: float = 0.0) -> Counts:
        counts = self._taxels.counts(force_n, now)
        if now == 0.0:  # it tests itself
            return counts
        spoilt = np.clip(np.rint(self._spoil(counts, now)), 0, self._taxels.description.max_count)
        return spoilt.astype("<u2")


def spoil(array: Any, how: Spoil) -> None:
    """Spoil what an emulated array sends from now on."""
    array.taxels = cast("Taxels", SpoiltTaxels(array.taxels, how))


def hold(rate_hz: float, until_s: float = np.inf) -> Spoil:
    """The firmware samples at this rate only, and not at all any more after a time."""
    kept: dict[int, Counts] = {}

    def spoiled(counts: Counts, now: float) -> Counts:
        number = int(min(now, until_s) * rate_hz)
        if number not in kept:
            kept.clear()
            kept[number] = counts
        return kept[number]

    return spoiled


def drift(counts_per_s: float) -> Spoil:
    """All zeros move alike."""
    return lambda counts, now: counts + counts_per_s * now


def interference(size: float, seed: int = 1) -> Spoil:
    """Bursts of 8 to 40 ms that move all taxels, about twice a second."""
    rng, burst = random.Random(seed), [0.0, 0.0]

    def spoiled(counts: Counts, now: float) -> Counts:
        if now > burst[1]:
            burst[0] = now + rng.expovariate(2)
            burst[1] = burst[0] + rng.uniform(0.008, 0.04)
        return counts + size * (burst[0] < now < burst[1])

    return spoiled


def drop_rows(share: float, seed: int = 1) -> Spoil:
    """A row reads 0 in a share of the frames."""
    rng = random.Random(seed)

    def spoiled(counts: Counts, _: float) -> Counts:
        counts = counts.copy()
        if rng.random() < share:
            counts[rng.randrange(len(counts))] = 0
        return counts

    return spoiled


def loose(share: float, seed: int = 1) -> Spoil:
    """A taxel reads its largest count in a share of the frames."""
    rng = random.Random(seed)

    def spoiled(counts: Counts, _: float) -> Counts:
        counts = counts.copy()
        if rng.random() < share:
            counts[2, 3] = 4095
        return counts

    return spoiled


def low_pass(time_constant_s: float) -> Spoil:
    """The firmware sends an exponential mean."""
    state: list[tuple[float, Floats]] = []

    def spoiled(counts: Counts, now: float) -> Counts:
        before, mean = state.pop() if state else (now, counts.astype(float))
        share = 1 - float(np.exp(-(now - before) / time_constant_s))
        state.append((now, mean + share * (counts - mean)))
        return state[0][1]

    return spoiled


def gain(factor: float, from_s: float) -> Spoil:
    """The supply of the bridges sags at a time."""
    return lambda counts, now: counts * (factor if now > from_s else 1.0)
