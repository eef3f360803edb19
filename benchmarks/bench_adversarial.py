"""Can a search for trouble lose the truth? Run with `python benchmarks/bench_adversarial.py`.

Hill climbing: outlines, approaches, errors and bounds are changed a little at a time, by anything from their
whole range down to rounding, and a change is kept if it brings the truth no further from what is excluded:
from the ends of its hypothesis's bounds, of the cells that hold it, and of their orientations. Touches are
simulated by shapely. A step whose truth is lost is printed with its index and ends the climb; the whole with
status 1.
"""

import argparse
import json
import math
import sys
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.errors import InputError
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, Recognition, recognise
from support.campaign.trials import holding_cell
from support.oracles.shapely_touches import Placed, first_contact, flat, holding_truth, true_normal, unit

_STEPS_OF_A_CLIMB = 500
_SLOW_S = 3.0
_RING_MM = 120.0
_FINGERS = 5  # of which the first few count


@dataclass(frozen=True)
class Scene:
    """All that decides a grip. Rows of `approach` (f, 2): from where (rad), and how far beside the middle,
    as a share; of `error` (f, 5): of the end and of the path's start, each a direction (rad) and a share of
    its bound, and the share of the normal's range that it is off. `vertices` (n, 2) mm; `off` (n,): whither
    (rad) each is displaced by the tolerance.
    """

    vertices: np.ndarray
    off: np.ndarray
    pose: np.ndarray
    approach: np.ndarray
    error: np.ndarray
    fingers: int
    radius_mm: float
    bound_mm: float
    further_mm: float
    half_rad: float
    tolerance_mm: float


def begun(rng: np.random.Generator) -> Scene:
    """Where a climb begins."""
    vertices = _outline(rng)
    return Scene(
        vertices=vertices,
        off=rng.uniform(0, 2 * math.pi, len(vertices)),
        pose=np.array([*rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi)]),
        approach=np.column_stack([rng.uniform(0, 2 * math.pi, _FINGERS), rng.uniform(-0.8, 0.8, _FINGERS)]),
        error=_errors(rng),
        fingers=int(rng.integers(2, _FINGERS + 1)),
        radius_mm=float(rng.choice([0.0, 1.0, 5.0, rng.uniform(0.2, 8.0)])),
        bound_mm=float(rng.choice([0.0, 1e-6, 0.01, 0.1, 0.3, 1.0])),
        further_mm=float(rng.choice([0.0, 0.0, 0.5, 3.0])),
        half_rad=math.radians(float(rng.choice([0.0, 1e-4, 1.0, 5.0, 10.0, 20.0]))),
        tolerance_mm=float(rng.choice([0.0, 0.0, 0.0, 0.05])),
    )


def _outline(rng: np.random.Generator) -> np.ndarray:
    """A star, a slab with notches, or a regular polygon."""
    kind = int(rng.integers(3))
    count = int(rng.integers(4, 12))
    if kind == 1:
        top = [
            (10.0 * k + dx, 20.0 - dy)
            for k in range(count // 2)
            for dx, dy in ((0, 0), (4, 0), (4, 9), (10, 9))
        ]
        return np.array([(0.0, 0.0), (top[-1][0], 0.0), *top[::-1]]) - [5.0 * (count // 2), 10.0]
    angle = np.arange(count) * 2 * math.pi / count
    reach = np.full(count, 25.0)
    if kind == 0:
        angle = angle + rng.uniform(-0.8, 0.8, count) * math.pi / count
        reach = rng.uniform(10.0, 40.0, count)
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])


def _errors(rng: np.random.Generator) -> np.ndarray:
    """Most of them as large as they may be."""
    share = np.where(rng.random((_FINGERS, 2)) < 0.7, 1.0, rng.random((_FINGERS, 2)))
    turn = rng.uniform(0, 2 * math.pi, (_FINGERS, 2))
    normal = np.where(
        rng.random(_FINGERS) < 0.7, rng.choice([-1.0, 1.0], _FINGERS), rng.uniform(-1, 1, _FINGERS)
    )
    return np.column_stack([turn[:, 0], share[:, 0], turn[:, 1], share[:, 1], normal])


def changed(scene: Scene, rng: np.random.Generator) -> Scene:
    """One thing of a scene moved, by anything between all of its range and rounding."""
    size = 10.0 ** (rng.uniform(-3, 0) if rng.random() < 0.7 else rng.uniform(-12, -3))
    what = int(rng.integers(6))
    if what == 0:
        row = int(rng.integers(len(scene.vertices)))
        vertices = scene.vertices.copy()
        vertices[row] += 20.0 * size * rng.normal(size=2)
        return replace(scene, vertices=vertices)
    if what == 1:
        return replace(scene, pose=scene.pose + size * np.array([20.0, 20.0, math.pi]) * rng.normal(size=3))
    if what == 2:
        approach = scene.approach.copy()
        approach[int(rng.integers(_FINGERS))] += size * np.array([math.pi, 0.8]) * rng.normal(size=2)
        return replace(scene, approach=approach)
    if what == 3:
        error = scene.error.copy()
        row = int(rng.integers(_FINGERS))
        error[row] += size * np.array([math.pi, 1, math.pi, 1, 1]) * rng.normal(size=5)
        error[row, [1, 3]] = np.clip(error[row, [1, 3]], 0.0, 1.0)
        error[row, 4] = np.clip(error[row, 4], -1.0, 1.0)
        return replace(scene, error=error)
    if what == 4:
        grown = math.exp(size * rng.normal())
        name = str(rng.choice(["bound_mm", "half_rad", "radius_mm"]))
        value = float(getattr(scene, name)) * grown
        return replace(
            scene, **{name: min(value, {"bound_mm": 2.0, "half_rad": 0.5, "radius_mm": 9.0}[name])}
        )
    off = scene.off + math.pi * size * rng.normal(size=len(scene.off))
    return replace(scene, off=off)


def felt(scene: Scene) -> tuple[Placed, list[Contact]] | None:
    """The object as it lies, and the contacts; None if the outline is none or a finger would begin inside."""
    shift = scene.tolerance_mm * np.column_stack([np.cos(scene.off), np.sin(scene.off)])
    true = scene.vertices + shift
    if not shapely.Polygon(true).is_valid or not shapely.Polygon(scene.vertices).is_valid:
        return None
    leg = np.roll(scene.vertices, -1, axis=0) - scene.vertices
    if np.hypot(*leg.T).min() < 0.5 or np.abs(scene.vertices).max() > 70.0:
        return None
    placed = Placed(flat("one", true), *map(float, scene.pose))
    shape = placed.shape
    rng = np.random.default_rng(1)
    contacts = []
    for number in range(scene.fingers):
        bearing, beside = scene.approach[number]
        heading = -unit(bearing)
        start = -_RING_MM * heading + beside * 40.0 * np.array([-heading[1], heading[0]])
        start = start + scene.pose[:2]
        reach = 1.6 * _RING_MM
        travel = first_contact(shape, start, heading, scene.radius_mm, reach)
        turn, share, other, rest, lean = scene.error[number]
        error = scene.bound_mm * share * unit(turn)
        begin = start + (scene.bound_mm + scene.further_mm) * rest * unit(other)
        touched = math.isfinite(travel)
        centre = start + (travel if touched else reach) * heading
        normal = None
        if touched:
            middle = true_normal(shape, centre, scene.radius_mm, rng) + lean * scene.half_rad
            normal = NormalRange(middle - scene.half_rad, middle + scene.half_rad)
        end = centre + error
        contacts.append(
            Contact(
                f"f{number}",
                Finger(scene.radius_mm, 10.0),
                touched,
                (float(begin[0]), float(begin[1])),
                (float(end[0]), float(end[1])),
                scene.bound_mm,
                normal,
                path_bound_mm=scene.bound_mm + scene.further_mm,
            )
        )
    return (placed, contacts) if sum(contact.touched for contact in contacts) >= 2 else None


def margin(answer: Recognition, scene: Scene, placed: Placed) -> float | None:
    """How far the truth is from being excluded, as a share of what is allowed; None if it is lost."""
    nominal = flat("one", scene.vertices)
    item = holding_truth(answer, replace(placed, model=nominal))
    if item is None or holding_cell(answer, nominal, replace(placed, model=nominal)) is None:
        return None
    step = 2 * math.pi / item.state.symmetry_order
    theta = item.bounds.theta_rad
    at = scene.pose[2] + step * round((sum(theta) / 2 - scene.pose[2]) / step)
    ends = [(at, theta)]
    if item.state.symmetry_order == 1:
        ends += [(scene.pose[0], item.bounds.x_mm), (scene.pose[1], item.bounds.y_mm)]
    shares = [min(value - lo, hi - value) / max(hi - lo, 1e-12) for value, (lo, hi) in ends]
    holding = np.count_nonzero((item.cells.lo <= at) & (at <= item.cells.hi))
    return float(sum(sorted(shares)[:2])) + 1e-3 * holding / max(len(item.cells), 1)


def tried(scene: Scene) -> tuple[float | None, float] | None:
    """The margin and the processor time of a scene; None if it is none or says too little."""
    found = felt(scene)
    if found is None:
        return None
    placed, contacts = found
    model = replace(flat("one", scene.vertices), tolerance_mm=scene.tolerance_mm)
    begin = time.process_time()
    try:
        answer = recognise(Catalogue([model]), contacts)
    except InputError:
        return None
    return margin(answer, scene, placed), time.process_time() - begin


def main() -> None:
    """Climb, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--first", type=int, default=0, help="number of the first climb")
    options = parser.parse_args()
    warnings.simplefilter("error")
    steps = lost = slow = accepted = 0
    edges: list[float] = []
    climb, begin = options.first, time.monotonic()
    while steps < options.steps and time.monotonic() - begin < options.seconds:
        rng = np.random.default_rng((83, climb))
        scene, best = begun(rng), math.inf
        for step in range(_STEPS_OF_A_CLIMB):
            candidate = begun(rng) if not math.isfinite(best) else changed(scene, rng)
            found = tried(candidate)
            if found is None:
                continue
            steps += 1
            slow += found[1] > _SLOW_S
            if found[0] is None:
                lost += 1
                print(f"LOST in climb {climb}, step {step}: {_text(candidate)}", flush=True)
                break
            if found[0] <= best:
                scene, best, accepted = candidate, found[0], accepted + 1
        edges.append(best)
        climb += 1
        if climb % 10 == 0:
            print(
                f"\r{steps} steps, {climb - options.first} climbs, {lost} lost ",
                end="",
                file=sys.stderr,
                flush=True,
            )
    print(f"\n{steps} steps in {len(edges)} climbs, {accepted} kept; {lost} lost; {slow} over {_SLOW_S:g} s")
    print(f"margins at the ends of climbs: median {np.median(edges):.1e}, 90 % {np.quantile(edges, 0.9):.1e}")
    sys.exit(bool(lost))


def _text(scene: Scene) -> str:
    return json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(scene).items()})


if __name__ == "__main__":
    main()
