"""How much wider are bounds than they need be? Run with `python benchmarks/bench_bounds.py`.

Seeded grips on shipped parts and shared outlines. From the truth on, a random search looks for the
configurations farthest to either side in x, y and θ which satisfy every contact and every free path exactly
(recognizer/verification.py, which tests/support/oracles/judge.py judges in turn: it is asked about each
of the six that are found). The bounds of the hypothesis that holds the truth are compared with their extent.
What the search does not find makes the ratios larger, not smaller.
"""

import argparse
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotate
from palpate.recognizer import Configuration, Hypothesis, Recognition
from palpate.recognizer.verification import Poses, verify
from support.commands.repository import SHARED_OUTLINES
from support.oracles.judge import Scene, asked, drawn, objections
from support.oracles.shapely_touches import equivalent_configurations, holding_truth

_WALKERS, _STEPS = 48, 150
_LEVER_MM = 40.0  # what a turn counts for against a shift
_MOVED = 0.7  # chance that a step goes along an axis at all
_LEAST_MM, _LEAST_RAD = 1e-3, 1e-5  # narrower sets are points, of which there is no ratio
_LEAST_TOUCHES = 3
_AXES = ("x", "y", "theta")


def feasible(answer: Recognition, state: int, at: Floats) -> np.ndarray:
    """Which configurations (n, 3), x and y in mm and θ in rad, satisfy everything, (n,)."""
    origin = answer.catalogue.states[state].origin_mm
    theta = at[:, 2]
    position = rotate(at[:, :2] - answer.anchor_mm, -theta) + origin
    poses = Poses(np.full(len(at), state), theta, position)
    held: np.ndarray = verify(answer.catalogue, poses, answer.contacts, answer.anchor_mm).holds
    return held


def farthest(answer: Recognition, state: int, starts: Floats, rng: np.random.Generator) -> Floats:
    """Feasible configurations (6, 3): the least and the largest found of x, y and θ, from `starts` (n, 3) on.

    Walkers in six herds, one a side; each accepts what is feasible and no less far, and now and then those
    that are behind go on from where the best are. Steps shrink where few are accepted.
    """
    sides = np.repeat(np.arange(6), _WALKERS)
    sign, axis = np.where(sides % 2, 1.0, -1.0), sides // 2
    at = starts[np.arange(len(sides)) % len(starts)]
    scale = np.full(len(sides), 0.3)
    for step in range(_STEPS):
        move = rng.normal(size=at.shape) * scale[:, None]
        move[:, 2] /= _LEVER_MM
        # Where normals are at the ends of their ranges, nearly every turn leads out.
        move *= rng.random(at.shape) < _MOVED
        # Every other step goes wherever it is feasible to go: the way to the farthest may not be straight.
        ahead = sign * move[np.arange(len(sides)), axis]
        wanted = (ahead > 0) | (rng.random(len(sides)) < 0.2)
        taken = np.zeros(len(sides), dtype=bool)
        rows = np.flatnonzero(wanted)
        taken[rows] = feasible(answer, state, (at + move)[rows])
        at[taken] += move[taken]
        scale[wanted] *= np.where(taken[wanted], 1.5, 0.85)
        scale = np.clip(scale, 1e-4, 2.0)
        if step % 10 == 9:
            value = (sign * at[np.arange(len(sides)), axis]).reshape(6, _WALKERS)
            order = np.argsort(value, axis=1) + np.arange(6)[:, None] * _WALKERS
            third = _WALKERS // 3
            at[order[:, :third]], scale[order[:, :third]] = at[order[:, -third:]], scale[order[:, -third:]]
    value = (sign * at[np.arange(len(sides)), axis]).reshape(6, _WALKERS)
    best: Floats = at.reshape(6, _WALKERS, 3)[np.arange(6), np.argmax(value, axis=1)]
    return best


def _row(item: Hypothesis) -> tuple[float, float, float]:
    at = item.configuration
    return at.x_mm, at.y_mm, at.theta_rad


def ratios(
    scene: Scene, answer: Recognition, item: Hypothesis, rng: np.random.Generator
) -> list[float] | None:
    """Widths of the bounds by those of the feasible set, for x, y and θ; None if it is all but flat."""
    state = item.state
    ends = (item.bounds.x_mm, item.bounds.y_mm, item.bounds.theta_rad)
    for x, y, theta in equivalent_configurations(scene.placed, state.symmetry_order, state.origin_mm):
        if all(lo <= value <= hi for value, (lo, hi) in zip((x, y, theta), ends, strict=True)):
            break
    # With all errors at their bounds the truth is in a corner, from which few ways lead on.
    starts = np.array([[x, y, theta], _row(item)])[: 1 + item.verified]
    assert feasible(answer, item.state_index, starts).all(), "the truth is not feasible"
    best = farthest(answer, item.state_index, starts, rng)
    for row in best:
        against = objections(state.state, scene.tolerance_mm, Configuration(*map(float, row)), scene.contacts)
        assert not against, against
    found = []
    for axis, (lo, hi) in enumerate(ends):
        least, most = best[2 * axis, axis], best[2 * axis + 1, axis]
        assert lo <= least <= most <= hi, f"outside of the bounds of {_AXES[axis]}"
        if most - least < (_LEAST_RAD if axis == 2 else _LEAST_MM):
            return None
        found.append((hi - lo) / (most - least))
    return found


def main() -> None:
    """Run the problems and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, metavar="INDEX", help="index of the first grip")
    parser.add_argument("--each", action="store_true", help="print every problem")
    options = parser.parse_args()
    families = ("memo", "parts") if SHARED_OUTLINES.exists() else ("memo",)
    table: dict[str, list[list[float]]] = defaultdict(list)
    spent, index = 0.0, options.first
    while len(table["all"]) < options.problems:
        scene = drawn(options.seed, index, families)
        index += 1
        if scene.touches < _LEAST_TOUCHES:
            continue
        begin = time.process_time()
        answer = asked(scene)
        spent += time.process_time() - begin
        item = holding_truth(answer, scene.placed)
        assert item is not None
        found = ratios(scene, answer, item, np.random.default_rng((options.seed, index)))
        if found is None:
            continue
        if options.each:
            print(
                index - 1,
                scene.touches,
                scene.radius_mm,
                scene.bound_mm,
                scene.normals_deg,
                len(answer.hypotheses),
                len(item.cells),
                np.round(found, 2),
                flush=True,
            )
        for key in (
            "all",
            f"{scene.touches} touches",
            f"tip {scene.radius_mm:g} mm",
            f"bound {scene.bound_mm:g} mm",
            "exact" if not scene.tolerance_mm else "tolerance",
        ):
            table[key].append(found)
    print(f"recognition: {spent / options.problems * 1e3:.1f} ms each")
    print(f"{'':<14} problems " + "".join(f"   {axis}: median   90 %" for axis in _AXES))
    for key in sorted(table):
        rows = np.array(table[key])
        print(
            f"{key:<14} {len(rows):>8} "
            + "".join(
                f"{np.median(rows[:, k]):>12.2f} {np.quantile(rows[:, k], 0.9):>8.2f}" for k in range(3)
            )
        )
    sys.exit(0)


if __name__ == "__main__":
    main()
