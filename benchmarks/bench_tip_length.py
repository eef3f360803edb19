"""Tips of some length beside parts whose walls are not upright: a judge from elsewhere, and whole runs.

`python benchmarks/bench_tip_length.py fcl --cases 400` compares where the recogniser's grown outlines stop a
tip with where FCL, a collision library (pip install python-fcl), says that an upright cylinder meets the
meshes of drawn stacks of prisms and frusta. `python benchmarks/bench_tip_length.py runs --runs 40` identifies
such stacks on the emulated bench, whose tips are 12 mm long: with `length_mm` in the rig file, and without.
Ends with status 1 if a tip stops elsewhere, or if an answer with `length_mm` is false.
"""

import argparse
import math
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.geometry import Floats, ObjectModel
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile
from palpate.recognizer import Catalogue, Finger
from palpate.rig.bench import connect, set_up
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.identify import identify
from support.benches.rigs import small_rig
from support.oracles.upright_tips import REACH_MM, Stack, drawn_stack, model_of

_FACET_MM = 1e-3
_TOUCHING_MM = 1e-5  # FCL's distances between meshes and cylinders are iterated
_PATHS = 6
_LENGTH_MM = 12.0
_KINDS = 3


class FclJudge:
    """An upright cylinder beside a stack's meshes, in FCL."""

    def __init__(self, stack: Stack, finger: Finger) -> None:
        import fcl  # noqa: PLC0415  # only this half of the benchmark needs it

        self._fcl, self._height = fcl, finger.height_mm
        self._parts = []
        for block in stack.blocks:
            mesh, model = block.mesh(), fcl.BVHModel()
            model.beginModel(len(mesh.vertices), len(mesh.faces))
            model.addSubModel(mesh.vertices, mesh.faces)
            model.endModel()
            self._parts.append(fcl.CollisionObject(model, fcl.Transform()))
        self._tip = fcl.CollisionObject(fcl.Cylinder(finger.tip_radius_mm, 2 * finger.half_length_mm))

    def gap_mm(self, centre: Floats) -> float:
        """Distance of the tip from the nearest mesh; 0 or less where it touches."""
        self._tip.setTransform(self._fcl.Transform(np.eye(3), np.array([*centre, self._height])))
        request = self._fcl.DistanceRequest(enable_signed_distance=False)
        return min(
            self._fcl.distance(part, self._tip, request, self._fcl.DistanceResult()) for part in self._parts
        )

    def first_touch(self, start: Floats, heading: Floats) -> float:
        """Travel at which the tip is no further than FCL can tell; infinite if it passes by."""
        travel = 0.0
        while travel < REACH_MM:
            gap = self.gap_mm(start + travel * heading)
            if gap <= _TOUCHING_MM:
                return travel
            travel += gap
        return math.inf


@dataclass(frozen=True)
class Compared:
    """How far a stop is from the grown outline, or its path inside of it: `off_mm`; so many cases touch."""

    off_mm: float
    within_mm: float
    touched: int


def compared(seed: int, number: int) -> Compared:
    """One drawn stack, some paths: FCL's stops and the recogniser's outline."""
    rng = np.random.default_rng([seed, number])
    stack = drawn_stack(rng, leaning=bool(number % 2))
    height = float(rng.uniform(2.0, stack.top_mm))
    finger = Finger(float(rng.choice([1.0, 4.0, 6.0, 9.0])), height, float(rng.uniform(0.5, height)))
    model = model_of(stack)
    catalogue = Catalogue([model], facet_error_mm=_FACET_MM)
    edges, origin = catalogue.outlines(finger), catalogue.origins_mm[0]
    grown = shapely.MultiLineString(list(np.stack([edges.start + origin, edges.end + origin], axis=1)))
    judge = FclJudge(stack, finger)
    off, touched = 0.0, 0
    # The outline is that of the section's vertices, off by δ, grown by r − δ: true ones are up to 2δ outside.
    within = 2 * model.tolerance_mm + _FACET_MM + 2 * _TOUCHING_MM
    for _ in range(_PATHS):
        angle = float(rng.uniform(-math.pi, math.pi))
        heading = np.array([math.cos(angle), math.sin(angle)])
        start = rng.uniform(-20, 20, 2) - 110.0 * heading
        travel = judge.first_touch(start, heading)
        end = start + min(travel, 220.0) * heading
        if math.isfinite(travel):
            touched += 1
            off = max(off, float(grown.distance(shapely.Point(end))) - within)
        for point in shapely.get_coordinates(shapely.LineString([start, end]).intersection(grown)):
            off = max(off, judge.gap_mm(point) - 2 * _TOUCHING_MM)
    return Compared(off, within, touched)


def judge_by_fcl(seed: int, cases: int) -> int:
    """Print what FCL says; 1 if a tip stops elsewhere."""
    found = [compared(seed, number) for number in range(cases)]
    wrong = [number for number, item in enumerate(found) if item.off_mm > 1e-6]
    touched = sum(item.touched for item in found)
    print(f"{cases} stacks, {cases * _PATHS} paths, {touched} of them touch")
    print(f"stacks that stop a tip elsewhere than the grown outline says: {wrong or 'none'}")
    return 1 if wrong else 0


def stacks(seed: int, number: int) -> list[ObjectModel]:
    """A few stepped parts whose feet or flanges end or begin within the tips' lengths."""
    rng = np.random.default_rng([seed, number, 5])
    found = []
    while len(found) < _KINDS:
        stack = drawn_stack(rng, leaning=bool(number % 2))
        if stack.top_mm > 10.0 and any(4.5 < z < 15.5 for block in stack.blocks for z in block.z_mm):
            found.append(model_of(stack, f"stack-{len(found)}", step_mm=0.5))
    return found


def rig_of(length_mm: float | None) -> RigFile:
    """The small emulated rig; its tips are 12 mm long, whatever its file says."""
    data = small_rig().model_dump(exclude_unset=True)
    data["emulation"]["tip_length_mm"] = _LENGTH_MM
    for finger in data["fingers"]:
        finger["tip"]["length_mm"] = length_mm
    return RigFile.model_validate(data)


def run(seed: int, number: int, length_mm: float | None) -> str:
    """What one run answers, and whether that is true."""
    rig, models = rig_of(length_mm), stacks(seed, number)
    rng = np.random.default_rng([seed, number, 6])
    model = models[int(rng.integers(len(models)))]
    x, y, theta = *rng.uniform(-6, 6, 2).tolist(), float(rng.uniform(-math.pi, math.pi))
    placement = Placement(model, model.states[0], x, y, theta)
    bench = set_up(rig, [placement], seed + number)
    with connect(bench) as hand:
        hand.prepare()
        result = identify(hand, Catalogue(models))
    left = result.recognition.hypotheses if result.recognition else ()
    answer = compare_answer(placement, left)
    names = IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE
    if result.outcome in names:
        return "right" if answer.inside_bounds else "false"
    if result.outcome is IdentificationVerdict.UNKNOWN:
        return "called unknown"
    return "not resolved, truth kept" if answer.inside_bounds else "not resolved, truth lost"


def identify_stacks(seed: int, runs: int) -> int:
    """Print what runs with and without `length_mm` answer; 1 if one with it is false."""
    wrong = 0
    for words, length in (("with length_mm = 12", _LENGTH_MM), ("without length_mm", None)):
        begin = time.perf_counter()
        found = Counter(run(seed, number, length) for number in range(runs))
        if length is not None:
            wrong = found["false"] + found["called unknown"] + found["not resolved, truth lost"]
        print(f"{words}, {runs} runs in {time.perf_counter() - begin:.0f} s: ", end="", flush=True)
        print(", ".join(f"{count} {word}" for word, count in found.most_common()))
    return 1 if wrong else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("fcl", "runs"))
    parser.add_argument("--cases", type=int, default=400)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.what == "fcl":
        return judge_by_fcl(options.seed, options.cases)
    return identify_stacks(options.seed, options.runs)


if __name__ == "__main__":
    sys.exit(main())
