"""Fit what `recognizer/evidence.py` takes for granted: weights of the kinds, overlap, and free paths.

    python benchmarks/fit_strangers.py --runs 400

Strangers are drawn polygons that lie there instead of a catalogue's, which are drawn the same way, or are its
parts scaled, with their vertices displaced, or with a feature moved, added or missing. Those that differ by 2
mm over a fifth of the outline are explained by other kinds than those that differ by less. Of each touch that
a stranger got to is kept how probably each kind would have agreed with each hypothesis, and whether it did;
the constants are those of the greatest likelihood; they are judged on other outlines (bench_strangers.py).
Prints them, and ten bins of what they state.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import shapely
from bench_strangers import SAME, SHARE, least_difference, print_bins, ring_of, simulated, stranger
from scipy.optimize import minimize
from scipy.special import expit, log_softmax

from palpate.base.geometry import Floats, ObjectModel
from palpate.recognizer import Catalogue
from palpate.recognizer.evidence import KINDS, StrangerTerms
from support.oracles.shapely_touches import flat

SIZES = (100, 30, 12)
TURNS = ("other", "scaled", "moved", "altered", "other", "added", "moved", "missing")
_FLATTEN = 5e-5  # keeps weights of kinds that hardly occur from vanishing


def outline(rng: np.random.Generator) -> Floats:
    """A drawn polygon, 18 to 120 mm large: a hull, a star, an angle or a trapezium, or a triangle."""
    while True:
        ring = _some_ring(rng, float(rng.uniform(18, 60)))
        shape = shapely.Polygon(ring)
        if shape.is_valid and shape.area > 500 and shape.area / shape.length > 5:
            return ring - np.array(shape.centroid.coords[0])


def _some_ring(rng: np.random.Generator, size: float) -> Floats:
    kind = int(rng.integers(4))
    if kind == 1:
        angle = np.sort(rng.uniform(0, 2 * math.pi, int(rng.integers(5, 14))))
        radius = size * rng.uniform(0.45, 1, len(angle))
        return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if kind == 2:
        w, h = 2 * size, 2 * size * float(rng.uniform(0.4, 1))
        a, c = w * float(rng.uniform(0.2, 0.8)), h * float(rng.uniform(0.2, 0.8))
        angle = [(0, 0), (w, 0), (w, c), (a, c), (a, h), (0, h)]
        trapezium = [(0, 0), (w, 0), (w - a / 4, h), (a / 3, h)]
        return np.array(angle if rng.random() < 0.6 else trapezium)
    count, slim = (3, 1.0) if kind == 3 else (int(rng.integers(4, 10)), float(rng.uniform(0.4, 1)))
    points = rng.uniform(-1, 1, (count, 2)) * [size, size * slim]
    return shapely.get_coordinates(shapely.MultiPoint(points).convex_hull)[:-1]


@cache
def drawn(size: int, which: int) -> tuple[Catalogue, tuple[ObjectModel, ...], tuple[ObjectModel, ...]]:
    """A catalogue with its parts, and others."""
    rng = np.random.default_rng([size, which, 99])
    own = tuple(flat(f"part {k}", outline(rng)) for k in range(size))
    return Catalogue(own), own, tuple(flat(f"other {k}", outline(rng)) for k in range(200))


def some_stranger(
    own: Sequence[ObjectModel], others: Sequence[ObjectModel], kind: str, rng: np.random.Generator
) -> ObjectModel:
    """What lies there."""
    if kind != "altered":
        return stranger(own, others, kind, rng)
    part = own[int(rng.integers(len(own)))]
    while True:
        ring = ring_of(part)
        moved = ring + rng.normal(0, rng.uniform(0.5, 6), ring.shape)
        if shapely.Polygon(moved).is_valid:
            return flat(f"{part.name} altered", moved)


@dataclass(frozen=True)
class Touched:
    """Touches of one stranger since a first recognition, in order, and whether each agreed.

    `different`: it differs by 2 mm over a fifth of its outline.
    """

    different: bool
    terms: tuple[StrangerTerms, ...]
    agreed: tuple[bool, ...]

    def stated(self, constants: "Constants") -> Floats:
        """Probability of each to agree."""
        weight = constants.different if self.different else constants.altered
        found = []
        for item in self.terms:
            some = item.with_any(constants.clear, constants.overlap)[0]
            found.append(float(weight @ some / weight.sum()))
            weight = weight * np.maximum(some, 1e-9)
        return np.array(found)


@dataclass(frozen=True)
class Constants:
    """What is fitted: weights (m,) of both populations, probabilities (m,) of free paths, and overlap."""

    different: Floats
    altered: Floats
    clear: Floats
    overlap: float

    @classmethod
    def of(cls, x: Floats) -> "Constants":
        """Constants from what is varied."""
        clear = np.ones(KINDS)
        clear[0] = expit(x[-2])
        different, altered = (np.exp(log_softmax(part)) for part in (x[:KINDS], x[KINDS:-2]))
        return cls(different, altered, clear, float(expit(x[-1])))


def runs_of(size: int, seeds: range) -> list[Touched]:
    """Sequences of touches that ended with one that did not agree, or with an answer."""
    found = []
    for seed in seeds:
        rng = np.random.default_rng([size, seed])
        catalogue, own, others = drawn(size, seed % 6)
        model = some_stranger(own, others, TURNS[seed % len(TURNS)], rng)
        apart = least_difference(model, own)
        if apart <= SAME:
            continue
        _, watch = simulated(catalogue, model, rng, seed)
        begin = 0
        ends = [k + 1 for k, (_, agrees) in enumerate(watch.terms) if not agrees or k + 1 == len(watch.terms)]
        for end in ends:
            part = watch.terms[begin:end]
            terms, agreed = tuple(item for item, _ in part), tuple(agrees for _, agrees in part)
            found.append(Touched(apart >= SHARE, terms, agreed))
            begin = end
    return found


def loss(x: Floats, runs: Sequence[Touched]) -> float:
    """Mean negative log likelihood of what agreed."""
    constants = Constants.of(x)
    stated = np.clip(np.concatenate([item.stated(constants) for item in runs]), 1e-3, 1 - 1e-3)
    agreed = np.concatenate([item.agreed for item in runs])
    return float(-np.mean(np.where(agreed, np.log(stated), np.log1p(-stated)))) + _FLATTEN * float(
        np.sum(x[:-2] ** 2)
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=400, help="for each size of the catalogue")
    options = parser.parse_args()
    runs = [item for size in SIZES for item in runs_of(size, range(options.runs))]
    start = np.zeros(2 * KINDS + 2)
    found = minimize(partial(loss, runs=runs), start, method="L-BFGS-B", bounds=[(-9, 9)] * len(start))
    constants = Constants.of(found.x)
    print(
        f"{len(runs)} sequences of touches; weights of different ones {constants.different.round(4)}, of "
        f"altered ones {constants.altered.round(4)}, clear {constants.clear.round(3)}, "
        f"overlap {constants.overlap:.3f}"
    )
    for different in (True, False):
        some = [item for item in runs if item.different == different]
        stated = np.concatenate([item.stated(constants) for item in some])
        agreed = [agrees for item in some for agrees in item.agreed]
        print_bins(f"fitted to, different: {different}", list(zip(stated.tolist(), agreed, strict=True)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
