"""Several parts on one table: `python benchmarks/bench_several_parts.py --grips N | --scenes N`.

`--grips N`: are truths lost? Two or three outlines, apart or touching, are met by grips of three fingers that
nobody plans. Contacts are worked out by shapely alone on the union of the parts, each as far off as its
bounds allow. After every grip the true division must be among those that are left, and every true
configuration within the bounds of its part. A table is left after nine grips.

`--scenes N`: identifications on the emulated bench, half of the tables with parts that touch. `--rig`:
another rig file, such as one whose parts slide; by default parts are held. `--strangers K`: as many of them
are in no catalogue, all of a table where it has no more. `--outlines`: the catalogue is 129 outlines of
others. `--simulated`: straight paths against outlines instead of emulated devices; a table then takes
seconds. A line for each table, then the sum of all; what a table took to compute is this process's time, most
of it that of the emulated bench.
"""

import argparse
import contextlib
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import palpate
from palpate.config import ObjectsFile, load_objects, load_rig, shipped_objects
from palpate.recognizer import Catalogue
from palpate.rig.emulated.scene import Placement
from palpate.rig.emulated.table import draw_placements, scene_of
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.divisions import Division, GripDivider, PartSearch, TakenGrip
from palpate.rig.identification.events import Observers
from palpate.rig.identification.identify import begin_search, run_search
from palpate.rig.identification.part_count import PartCount
from palpate.rig.identification.several_parts import SeveralSearch
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from palpate.rig.study.simulated_touches import SimulatedTouches
from support.benches.rigs import firm_rig
from support.commands.repository import SHARED_OUTLINES
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    holding_truth,
    outlines,
    place,
    stop,
    touch,
    unit,
)

WORKSPACE_MM, RING_MM, GRIPS_EACH = 125.0, 140.0, 9
BOUND_MM, HALF_RAD = 0.3, math.radians(10)
APART_MM, TOUCHING_MM = 12.0, 0.3
GAPS = {"touching": (0.0, 0.5), "apart": (12.0, math.inf)}


# ----------------------------------------------------------------------------------------------------
# Truths, by shapely.


def table(models: list, count: int, rng: np.random.Generator, *, touching: bool) -> list[Placed]:
    """Parts side by side in the workspace."""
    while True:
        drawn = [place(models[int(rng.integers(len(models)))], rng, WORKSPACE_MM) for _ in range(count)]
        if touching:
            drawn[1] = _moved_up(drawn[1], drawn[0].shape, rng)
        shapes = [item.shape for item in drawn]
        gaps = [shapely.distance(*pair) for pair in combinations(shapes, 2)]
        least = 0.0 if touching else APART_MM
        inside = all(shapely.hausdorff_distance(item, shapely.Point(0, 0)) < WORKSPACE_MM for item in shapes)
        if inside and min(gaps) > least and (not touching or min(gaps) < TOUCHING_MM):
            return drawn


def _moved_up(part: Placed, other: shapely.Geometry, rng: np.random.Generator) -> Placed:
    """The part as near to another as it comes from some side without overlapping it."""
    way = unit(rng.uniform(0, 2 * math.pi))
    lo, hi = 0.0, 2 * WORKSPACE_MM
    centre = shapely.get_coordinates(shapely.union(part.shape, other).centroid)[0]
    for _ in range(40):
        middle = (lo + hi) / 2
        moved = replace(part, x=centre[0] + middle * way[0], y=centre[1] + middle * way[1])
        lo, hi = (middle, hi) if shapely.distance(moved.shape, other) == 0 else (lo, middle)
    return replace(part, x=centre[0] + hi * way[0], y=centre[1] + hi * way[1])


@dataclass
class TruthCount:
    """What became of grips."""

    grips: int = 0
    tables: int = 0
    lost: int = 0
    outside: int = 0
    divisions: int = 0


def keep_truths(models: list, seed: int, wanted: int) -> TruthCount:
    """Divide touches of tables until so many grips were made."""
    rig, count = load_rig(firm_rig()), TruthCount()
    single = begin_search(rig, reach_of(rig), Catalogue(models))
    while count.grips < wanted:
        rng = np.random.default_rng([seed, count.tables])
        parts = table(models, 2 + count.tables % 2, rng, touching=count.tables % 4 >= 2)
        _grips_on(parts, PartSearch(single, frozenset()), rng, count)
        count.tables += 1
    return count


def _grips_on(parts: list[Placed], nothing: PartSearch, rng: np.random.Generator, count: TruthCount) -> None:
    shapes = [item.shape for item in parts]
    every = shapely.union_all(shapes)
    owned: list[set[tuple[int, int]]] = [set() for _ in parts]
    divisions, untouched, asked = [Division(())], nothing, PartCount(len(parts))
    for number in range(1, GRIPS_EACH + 1):
        touches, first = [], rng.uniform(0, 2 * math.pi)
        for k in range(3):
            at = first + 2 * math.pi * k / 3
            aimed = rng.uniform(-90, 90, 2)
            start = RING_MM * unit(at)
            direction = math.atan2(*(aimed - start)[::-1])
            met = touch(
                every,
                rng,
                radius=5.0,
                bound=BOUND_MM,
                half_range=HALF_RAD,
                direction=direction,
                start=start,
                reach=2 * RING_MM,
                at_bound=True,
                name=f"f{k + 1}",
            )
            if met.touched:
                travels = [stop(shape, start, direction, 5.0, 2 * RING_MM) for shape in shapes]
                owned[int(np.argmin(travels))].add((number, k))
            touches.append(Touch(k, met, None, (math.nan, math.nan)))
        divisions, untouched = GripDivider(TakenGrip((), touches, untouched.search.bounds)).divide(
            divisions, untouched, asked
        )
        count.grips += 1
        count.divisions = max(count.divisions, len(divisions))
        wanted = {frozenset(item) for item in owned if item}
        true = [item for item in divisions if {part.touched for part in item.parts} == wanted]
        if not true:
            count.lost += 1
            print("lost", parts, number, flush=True)
            return
        for part in true[0].parts:
            (placed,) = [item for item, own in zip(parts, owned, strict=True) if own == part.touched]
            if part.recognition is not None and holding_truth(part.recognition, placed) is None:
                count.outside += 1
                print("outside", placed, number, flush=True)


# ----------------------------------------------------------------------------------------------------
# Identifications on the emulated bench.


def scenes(args: argparse.Namespace) -> None:
    """Identify tables and print what came of it."""
    catalogue = load_objects(SHARED_OUTLINES if args.outlines else shipped_objects())
    strangers = load_objects(shipped_objects() if args.outlines else SHARED_OUTLINES)
    rig = Path(args.rig or firm_rig())
    found: Counter[str] = Counter()
    touches, seconds, computed, parts_in_all = [], [], [], 0
    for number in range(args.first, args.first + args.scenes):
        rng = np.random.default_rng([number, 51])
        count, gap = 2 + number % 2, "touching" if number // 2 % 2 else "apart"
        known = max(count - args.strangers, 0)
        picked = [catalogue.objects[int(rng.integers(len(catalogue.objects)))] for _ in range(known)]
        picked += [strangers.objects[int(rng.integers(len(strangers.objects)))] for _ in range(count - known)]
        lying = _drawn(replace(catalogue, objects=tuple(picked)), rng, GAPS[gap])
        begin = time.process_time()
        out = (_simulate if args.simulated else _identify)(rig, catalogue, lying, number)
        computed.append(time.process_time() - begin)
        verdicts = list(out.parts) or [out.verdict]
        found.update(verdicts)
        found["missing"] += count - len(out.parts)
        parts_in_all += count
        touches.append(out.touches / count)
        seconds.append(out.rig_s / count)
        names = ", ".join(item.model.name for item in lying)
        print(
            f"{number} {gap} ({names}): {out.verdict}: {', '.join(verdicts)}; {out.touches} touches"
            f"{_rig_time(out.rig_s)}; computed in {computed[-1]:.0f} s",
            flush=True,
        )
    print(
        f"\n{parts_in_all} parts on {args.scenes} tables: "
        + ", ".join(f"{key} {value}" for key, value in sorted(found.items()) if value)
    )
    print(
        f"for each part {np.mean(touches):.1f} touches{_rig_time(float(np.mean(seconds)))} in the mean; "
        f"a table was computed in {np.mean(computed):.0f} s"
    )


def _rig_time(seconds: float) -> str:
    return "" if math.isnan(seconds) else f", {seconds:.0f} s"


def _drawn(
    picked: ObjectsFile, rng: np.random.Generator, gap_mm: tuple[float, float]
) -> tuple[Placement, ...]:
    """Each of the objects once, side by side."""
    names = Counter(item.name for item in picked.objects)
    while True:
        with contextlib.suppress(palpate.InputError):  # no room was found for what was drawn
            count = len(picked.objects)
            lying = draw_placements(picked, count, WORKSPACE_MM, rng, WORKSPACE_MM, gap_mm)
            if Counter(item.model.name for item in lying) == names:
                return lying


@dataclass(frozen=True)
class Outcome:
    """Verdict on a table, those on its parts against the truth, touches, and time (s) of the rig."""

    verdict: str
    parts: tuple[str, ...]
    touches: int
    rig_s: float


def _identify(rig: Path, catalogue: ObjectsFile, lying: Sequence[Placement], seed: int) -> Outcome:
    described = scene_of(lying)
    files = {True: shipped_objects(), False: SHARED_OUTLINES}
    of_shipped = {item.name for item in load_objects(shipped_objects()).objects}
    parts = [
        item.model_copy(update={"objects": str(files[item.object in of_shipped])}) for item in described.parts
    ]
    scene = described.model_copy(update={"parts": parts})
    with palpate.open_rig(rig, seed=seed) as opened:
        answer = opened.identify(catalogue, scene=scene, parts=len(lying), notice=lambda _: None)
    out = json.loads(answer.to_json())
    verdicts = [
        _judge(item["verdict"], item["agreed"], item["truth"]["named"], item["truth"]["inside_bounds"])
        for item in out["parts"]
    ]
    return Outcome(out["verdict"], tuple(verdicts), out["touches"], out["rig_seconds"])


def _simulate(rig: Path, catalogue: ObjectsFile, lying: Sequence[Placement], seed: int) -> Outcome:
    file = load_rig(rig)
    single = begin_search(file, reach_of(file), Catalogue(catalogue.objects))
    search = SeveralSearch(single, PartCount(len(lying)))
    touches = SimulatedTouches(lying, resolution_of(file), np.random.default_rng([seed, 8]))
    result = run_search(search, touches, Observers())
    assert result.table is not None
    verdicts, left = [], list(lying)
    for part, agreed in zip(result.table.parts, result.table.agreed, strict=True):
        hypotheses = part.recognition.hypotheses if part.recognition else ()
        names = {item.state.object_name for item in hypotheses}
        named = [item for item in left if item.model.name in names]
        holding = [item for item in named if holding_truth(part.recognition, _placed(item))]
        verdicts.append(_judge(part.outcome.value, agreed, bool(named), bool(holding)))
        for item in holding[:1]:
            left.remove(item)
    return Outcome(result.outcome.value, tuple(verdicts), result.touches, math.nan)


def _placed(lies: Placement) -> Placed:
    return Placed(lies.model, lies.x_mm, lies.y_mm, lies.theta_rad)


def _judge(verdict: str, agreed: bool, named: bool, inside_bounds: bool) -> str:
    """Verdict on a part against the truth."""
    if verdict not in ("identified", "indistinguishable") or not agreed:
        return "open"
    if not named:
        return "WRONG"
    return verdict if inside_bounds else "OUTSIDE"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grips", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rig", default=None)
    parser.add_argument("--outlines", action="store_true")
    parser.add_argument("--strangers", type=int, default=0)
    parser.add_argument("--simulated", action="store_true")
    args = parser.parse_args()
    if args.grips:
        models = outlines(SHARED_OUTLINES)[::3] if args.outlines else outlines(SHIPPED_OBJECTS)
        print(keep_truths(models, args.first, args.grips))
    if args.scenes:
        scenes(args)


if __name__ == "__main__":
    main()
