"""Strangers: how often is what is not in the catalogue given a name, and is the stated probability right?

    python benchmarks/bench_strangers.py --size 10 --size 60 --size 129 --runs 150 --out strangers.jsonl

Catalogues are sets of the shared outlines. What lies still on the table is, by turns, an outline of other
sets (at 129, which are all: a shipped or a drawn one), one of the catalogue scaled by 3 to 15 %, a mirrored
one, one with a feature moved by 2 to 5 mm, added or missing, and every eighth time a part of the catalogue
itself, for the price in touches. Touches are simulated by shapely, with errors within their bounds. A run
depends on its seed only. With `--out FILE` every run is kept as a line of JSON, and a campaign that was
stopped goes on where it was. The tables say how often strangers were named, and how often they were said to
move, those apart that differ by 2 mm or more over a fifth of the outline from every part; and, over all
touches of strangers, what was stated against how many agreed.
"""

import argparse
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.geometry import Floats, ObjectModel
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile, load_rig
from palpate.recognizer import Catalogue, Contact, Recognition, StrangerEvidence, predict, stranger_terms
from palpate.recognizer.evidence import StrangerTerms
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.events import Event, MoveEvent, Observers, RecognitionEvent, TouchEvent
from palpate.rig.identification.grip_evidence import normal_halves_rad, paths_of
from palpate.rig.identification.identify import search
from palpate.rig.identification.outcome import Identification
from palpate.rig.reach.approaches import Reach, reach_of
from support.campaign.objects import random_model
from support.commands.repository import SHARED_OUTLINES
from support.oracles.outlines import difference
from support.oracles.plans import SimulatedTouches
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, outlines, place_within

FIRM_RIG = Path(__file__).parent.parent / "examples" / "firm-rig.toml"
ALL = 129  # shared outlines
CATALOGUES = 6  # different ones of each size, but for all of them
LYING = ("other", "moved", "scaled", "true", "mirrored", "added", "moved", "missing")
ALTERED = ("mirrored", "moved", "added", "missing")
SAME = 0.02  # share of the outline: what differs over less is no stranger (a mirrored part may look the same)
LARGE_MM, SHARE = 2.0, 0.2
_MAX_DRAWS = 200  # of an alteration
NAMED = (IdentificationVerdict.IDENTIFIED.value, IdentificationVerdict.INDISTINGUISHABLE.value)


@dataclass(frozen=True)
class Row:
    """What came of one run. `touches`: of every touch, the probabilities that are stated of strangers that
    differ by 2 mm over a fifth and of those that differ by less, and whether it agreed.
    """

    size: int
    seed: int
    kind: str
    name: str
    difference: float
    outcome: str
    answer: str
    stated: float | None
    touches: list[tuple[float, float, bool]]
    beyond: int
    seconds: float

    @property
    def is_named(self) -> bool:
        return self.outcome in NAMED


@cache
def rig_and_reach() -> tuple[RigFile, Reach]:
    rig = load_rig(FIRM_RIG)
    return rig, reach_of(rig)


@cache
def catalogue_of(size: int, which: int) -> tuple[Catalogue, tuple[ObjectModel, ...], tuple[ObjectModel, ...]]:
    """A catalogue of whole sets, the last one cut off; and the outlines of sets that are not in it."""
    every = outlines(SHARED_OUTLINES)
    by_set: dict[str, list[ObjectModel]] = defaultdict(list)
    for item in every:
        by_set[item.name.split("-")[0]].append(item)
    names = sorted(by_set)
    np.random.default_rng([size, which, 3]).shuffle(names)
    own: list[ObjectModel] = []
    others: list[ObjectModel] = []
    for name in names:
        if len(own) < size:
            own += by_set[name][: size - len(own)]
        else:
            others += by_set[name]
    return Catalogue(own), tuple(own), tuple(others)


def stranger(
    own: Sequence[ObjectModel], others: Sequence[ObjectModel], kind: str, rng: np.random.Generator
) -> ObjectModel:
    """What lies on the table."""
    part = own[int(rng.integers(len(own)))]
    ring = ring_of(part)
    if kind == "true":
        return part
    if kind == "scaled":
        factor = 1.0 + float(rng.choice([-1, 1])) * float(rng.uniform(0.03, 0.15))
        return flat(f"{part.name} x {factor:.3f}", ring * factor)
    if kind in ALTERED:
        changed = ring[::-1] * [-1.0, 1.0] if kind == "mirrored" else altered(ring, kind, rng)
        return flat(f"{part.name} {kind}", changed)
    return others[int(rng.integers(len(others)))] if others else any_part(rng)


def any_part(rng: np.random.Generator) -> ObjectModel:
    """A shipped part, or a drawn one."""
    shipped = outlines(SHIPPED_OBJECTS)
    pick = int(rng.integers(4 * len(shipped)))
    if pick < len(shipped):
        return shipped[pick]
    while True:
        drawn = random_model(str(rng.choice(["star", "oval", "near-regular"])), rng, 5.0)
        if len(ring_of(drawn)) <= 60:
            return drawn


def altered(ring: Floats, kind: str, rng: np.random.Generator) -> Floats:
    """A ring with a feature moved by 2 to 5 mm, added (a tab or a notch), or missing (cut off or filled)."""
    count = len(ring)
    for _ in range(_MAX_DRAWS):
        at, size = int(rng.integers(count)), int(rng.integers(1, 4))
        rolled, depth = np.roll(ring, -at, axis=0), float(rng.uniform(2, 5))
        if kind == "missing":
            changed = rolled[min(size, max(count - 3, 0)) :]
        elif kind == "moved":
            angle = rng.uniform(0, 2 * math.pi)
            changed = rolled.copy()
            changed[:size] += depth * np.array([math.cos(angle), math.sin(angle)])
        else:
            changed = np.vstack([rolled[:1], _tab(rolled[0], rolled[1], depth, rng), rolled[1:]])
        shape = shapely.Polygon(changed)
        if (
            len(changed) > 2
            and shape.is_valid
            and shape.buffer(-4.0).area > 0
            and shapely.hausdorff_distance(shape.boundary, shapely.LinearRing(ring)) >= LARGE_MM
        ):
            return np.asarray(changed)
        kind = "moved" if kind == "missing" and count < 5 else kind
    raise RuntimeError(f"no {kind} feature fits this outline")


def _tab(one: Floats, other: Floats, depth: float, rng: np.random.Generator) -> Floats:
    """Corners (4, 2) of a tab or a notch between two vertices."""
    along = other - one
    length = float(np.hypot(*along))
    half = float(rng.uniform(0.1, 0.4)) * min(length, 30.0)
    middle = float(rng.uniform(half, length - half))
    aside = np.array([along[1], -along[0]]) / length * depth * float(rng.choice([-1, 1]))
    ends = one + along / length * np.array([[middle - half], [middle + half]])
    return np.vstack([ends[0], ends[0] + aside, ends[1] + aside, ends[1]])


def ring_of(model: ObjectModel) -> Floats:
    return np.asarray(model.states[0].sections[0].polygons[0].outer)


def least_difference(model: ObjectModel, own: Sequence[ObjectModel]) -> float:
    """Least share of the boundary that is further than LARGE_MM from any of the catalogue's parts."""
    ring, size = ring_of(model), extent(ring_of(model))
    best = 1.0
    for item in own:
        other = ring_of(item)
        # A part whose extents differ by more than twice the distance is further off over more than a fifth.
        if np.abs(extent(other) - size).max() > 8.0:
            continue
        best = min(best, difference(ring, other, LARGE_MM))
    return best


def extent(ring: Floats) -> Floats:
    """Length and width along the principal axes of the ring's hull: an invariant of rigid motions."""
    angle = np.arange(0.0, math.pi, math.pi / 60)
    span = ring @ np.stack([np.cos(angle), np.sin(angle)])
    width = span.max(axis=0) - span.min(axis=0)
    return np.array([width.min(), width.max()])


@dataclass
class Watch:
    """Notes for every touch after the first recognition what is stated, and whether it agreed."""

    before: Recognition | None = None
    strangers: StrangerEvidence = field(default_factory=StrangerEvidence.none)
    rows: list[tuple[float, float, bool]] = field(default_factory=list)
    terms: list[tuple[StrangerTerms, bool]] = field(default_factory=list)

    def __call__(self, event: Event) -> None:
        match event:
            case MoveEvent():
                self.before, self.strangers = None, StrangerEvidence.none()
            case TouchEvent() if self.before is not None and self.before.hypotheses:
                self._compare(self.before, [touch.contact for touch in event.touches])
            case RecognitionEvent():
                self.before = event.recognition

    def _compare(self, before: Recognition, contacts: Sequence[Contact]) -> None:
        paths = paths_of(contacts)
        predictions = predict(before.catalogue, before.hypotheses, before.anchor_mm, paths)
        halves = normal_halves_rad(contacts, resolution_of(rig_and_reach()[0]).normal_half_rad)
        terms = stranger_terms(before, paths, halves, predictions)
        for k, passing in enumerate(terms.with_any()):
            agrees = bool(before.extend(contacts[: k + 1]).hypotheses)
            stated = self.strangers.different_kinds @ passing, self.strangers.altered_kinds @ passing
            self.rows.append((*map(float, stated), agrees))
            self.terms.append((StrangerTerms(terms.passing[[k]], terms.distinct[[k]], terms.count), agrees))
            self.strangers = self.strangers.after(passing[None])
            if not agrees:
                break


def simulated(
    catalogue: Catalogue, model: ObjectModel, rng: np.random.Generator, seed: int
) -> tuple[Identification, Watch]:
    """A search for what `model` is, and what was stated on the way."""
    rig, reach = rig_and_reach()
    watch = Watch()
    touches = SimulatedTouches(reach, place_within(model, rng), rng)
    return search(rig, reach, touches, catalogue, Observers(record=watch), seed=seed), watch


def run(job: tuple[int, int]) -> Row:
    """One run: size of the catalogue and seed, which decide everything."""
    size, seed = job
    rng = np.random.default_rng([size, seed])
    catalogue, own, others = catalogue_of(size, seed % CATALOGUES if size < ALL else 0)
    kind = LYING[seed % len(LYING)]
    model = stranger(own, others, kind, rng)
    begin = time.perf_counter()
    result, watch = simulated(catalogue, model, rng, seed)
    spent = time.perf_counter() - begin
    found = result.recognition.hypotheses if result.recognition else ()
    return Row(
        size,
        seed,
        kind,
        model.name,
        0.0 if kind == "true" else least_difference(model, own),
        result.outcome.value,
        found[0].state.object_name if len(found) else "",
        result.stranger_probability,
        watch.rows,
        result.touches - len(result.grips[0]),
        spent,
    )


def print_bins(title: str, touches: Sequence[tuple[float, bool]]) -> None:
    """Stated probabilities against frequencies, in ten bins."""
    stated = np.array([item[0] for item in touches])
    agreed = np.array([item[1] for item in touches], dtype=float)
    which = np.minimum((10 * stated).astype(np.int64), 9)
    print(f"\n{title}: {len(touches)} touches\n  stated     touches    mean  agreed  deviation")
    for k in range(10):
        some = which == k
        if some.any():
            mean = stated[some].mean()
            expected = math.sqrt(float((stated[some] * (1 - stated[some])).sum())) / some.sum()
            print(
                f"  {k / 10:.1f} … {(k + 1) / 10:.1f} {some.sum():>8} {mean:>8.3f}"
                f" {agreed[some].mean():>7.3f}  {(agreed[some].mean() - mean) / expected:>+6.1f} σ"
            )


def print_tables(rows: Sequence[Row]) -> None:
    """All of them."""
    strangers = [row for row in rows if row.kind != "true" and row.difference > SAME]
    print("parts   what lies there                      runs   named  moving   touches beyond the first grip")
    for size in sorted({row.size for row in rows}):
        for title, some in (
            ("stranger, 2 mm over a fifth", [row for row in strangers if row.difference >= SHARE]),
            ("stranger, less", [row for row in strangers if row.difference < SHARE]),
            *((f"  {kind}", [row for row in strangers if row.kind == kind]) for kind in sorted(set(LYING))),
            ("part of the catalogue", [row for row in rows if row.kind == "true"]),
        ):
            own = [row for row in some if row.size == size]
            if own:
                beyond = [row.beyond for row in own]
                print(
                    f"{size:>5}   {title:<34} {len(own):>6} {sum(row.is_named for row in own):>7}"
                    f" {sum(row.outcome == IdentificationVerdict.MOVING.value for row in own):>7}"
                    f"   mean {np.mean(beyond):.2f}, 90 % {np.percentile(beyond, 90):.0f}, most {max(beyond)}"
                )
    far = [(at[0], at[2]) for row in strangers if row.difference >= SHARE for at in row.touches]
    near = [(at[1], at[2]) for row in strangers if row.difference < SHARE for at in row.touches]
    print_bins("strangers that differ by 2 mm over a fifth", far)
    print_bins("those that differ by less", near)
    print("\nnamed, though they differ by 2 mm over a fifth:")
    for row in strangers:
        if row.is_named and row.difference >= SHARE:
            print(
                f"  {row.size} parts, seed {row.seed}: {row.name} as {row.answer}, {row.difference:.2f}, "
                f"stated {row.stated}"
            )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, action="append", help="parts of the catalogue")
    parser.add_argument("--runs", type=int, default=150, help="of each size")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--out", type=Path, help="file to keep runs in, and to go on from")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    rows = []
    if options.out is not None and options.out.is_file():
        rows = [Row(**json.loads(line)) for line in options.out.read_text(encoding="utf-8").splitlines()]
    done = {(row.size, row.seed) for row in rows}
    seeds = range(options.first, options.first + options.runs)
    jobs = [(size, seed) for size in options.size or [10] for seed in seeds if (size, seed) not in done]
    with ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(run, jobs, chunksize=4):
            rows.append(row)
            if options.out is not None:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(row)) + "\n")
    print_tables(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
