"""Parts learned by touch: `python benchmarks/bench_learning.py --learn N [--identify M]`.

`--learn N`: N outlines of others, drawn by seed, or with `--own` of our own, which have notches, slots and
holes that no tip can reach, are learned on the firm bench with a stage that turns by ±35°, with touches that
shapely works out, each as far off as its bounds allow (position 0.33 mm, path 0.58 mm, normals ±9.5°: those
of the emulated bench). Judged by shapely alone: the inner bound lies in what a tip of 5 mm can feel of the
true outline, the part in the outer one, and the felt outline within the model's tolerance of the model's.
Beside the tolerance stand the Hausdorff distances from the felt outline of the model, of a polygon through as
many true points, evenly spaced, and of the mean of a Gaussian process by the same touches (needs
scikit-learn); at the end, how the tolerance falls with touches.

`--identify M`: then M parts, drawn from those that were learned, are identified among all of them and the
shipped objects, in other places, with touches of the same kind. `--keep FOLDER` writes learned models there,
and takes those that are there in place of learning again; `--first-run K` begins with the identification of
that number.
"""

import argparse
import importlib.util
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import palpate
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.config import ObjectsFile, RigFile, load_objects, load_rig, shipped_objects
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.identification.identify import search
from palpate.rig.learning.learning_search import LearningSearch, learning_reach
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, reach_of
from support.commands.repository import EXAMPLES, SHARED_OUTLINES
from support.oracles.shapely_touches import outlines, place, touch

POSITION_MM, PATH_MM, NORMAL_RAD = 0.33, 0.58, math.radians(9.5)
TIP_MM, HEIGHT_MM, QUARTER = 5.0, 20.0, 64
SMALLEST_MM, LARGEST_MM = 35.0, 110.0
MOST_REGULAR = 4  # corners of own parts that are evenly spaced


def hands(
    shape: shapely.Geometry, rng: np.random.Generator
) -> Callable[[Sequence[FingerApproach], object], list[Touch]]:
    """Whatever carries out grips on a shape."""

    def execute(grip: Sequence[FingerApproach], _tell: object) -> list[Touch]:
        touches = []
        for number, item in enumerate(grip):
            met = touch(
                shape,
                rng,
                radius=item.finger.tip_radius_mm,
                bound=POSITION_MM,
                half_range=NORMAL_RAD,
                direction=item.direction_rad,
                start=np.array(item.start_mm),
                reach=item.travel_mm,
                at_bound=True,
                name=f"f{item.finger_index + 1}",
            )
            met = replace(met, finger=item.finger, path_bound_mm=PATH_MM)
            touches.append(Touch(number, met, None, (math.nan, math.nan)))
        return touches

    return execute


def felt_shape(shape: shapely.Geometry) -> shapely.Polygon:
    """What a tip can feel of a shape."""
    closing = shape.buffer(TIP_MM, QUARTER).buffer(-TIP_MM, QUARTER)
    return shapely.Polygon(max(shapely.get_parts(closing), key=shapely.area).exterior)


@dataclass(frozen=True)
class Learned:
    """A part that was learned, and how well."""

    truth: ObjectModel
    model: ObjectModel | None
    grips: int
    touches: int
    seconds: float
    computing_s: float
    is_between: bool
    hausdorff_mm: float = math.nan
    even_mm: float = math.nan
    gaussian_mm: float = math.nan
    falling: tuple[tuple[int, float], ...] = ()  # touches, tolerance with them


def learn(
    truth: ObjectModel, rig: RigFile, reach: Reach, seed: int, tolerance: float, most_s: float
) -> Learned:
    """Learn one part, and judge it."""
    rng = np.random.default_rng([1, seed])
    placed, begin = place(truth, rng, 10.0), time.process_time()
    search, execute = LearningSearch(rig, reach, HEIGHT_MM, tolerance), hands(placed.shape, rng)
    seconds, grips, touches, falling = 0.0, 0, 0, list[tuple[int, float]]()
    while seconds < most_s and not search.is_done and (grip := search.next()):
        contacts = [item.contact for item in execute(grip, None)]
        seconds += reach.grip_seconds(grip, [item.travel_mm for item in contacts])
        grips, touches = grips + 1, touches + sum(item.touched for item in contacts)
        search.take(contacts)
        falling.append((touches, search.tolerance_mm))
    (felt,), true = search.felt.values(), felt_shape(placed.shape)
    is_between = (
        felt.inner.difference(true.buffer(1e-3)).is_empty
        and placed.shape.difference(felt.outer.buffer(1e-3)).is_empty
        and search.holds_together
    )
    model = search.model(f"{truth.name} {seed}", "learned")
    spent = time.process_time() - begin
    result = Learned(truth, model, grips, touches, seconds, spent, is_between, falling=tuple(falling))
    if model is None:
        return result
    (nominal,) = search.outlines.values()
    shape = shapely.Polygon(nominal.points_mm)
    away = shapely.hausdorff_distance(shape.exterior, true.exterior, densify=0.002)
    is_within = true.exterior.difference(shape.exterior.buffer(nominal.tolerance_mm, QUARTER)).is_empty
    places = shapely.line_interpolate_point(true.exterior, np.arange(touches) / touches, normalized=True)
    even = shapely.Polygon(shapely.get_coordinates(places)).exterior
    apart = shapely.hausdorff_distance(even, true.exterior, densify=0.002)
    return replace(
        result,
        is_between=is_between and is_within,
        hausdorff_mm=float(away),
        even_mm=float(apart),
        gaussian_mm=_gaussian_mm(search, true),
    )


def _gaussian_mm(search: LearningSearch, true: shapely.Polygon) -> float:
    """Hausdorff distance of what a Gaussian process makes of the same touches; nan without scikit-learn."""
    if importlib.util.find_spec("sklearn") is None:
        return math.nan
    from gaussian_outline import gaussian_outline  # noqa: PLC0415  (an environment of its own has it)

    (felt,) = search.felt.values()
    arcs = felt.touched
    across = (arcs.last_mm - arcs.first_mm) @ np.array([[0.0, -1.0], [1.0, 0.0]])
    normals = across / np.linalg.norm(across, axis=1, keepdims=True)
    found = gaussian_outline(arcs.middles_mm, -normals)
    if found is None:
        return math.nan
    return float(shapely.hausdorff_distance(found.exterior, true.exterior, densify=0.002))


def own_outline(seed: int) -> ObjectModel:
    """A part of 50 to 110 mm with up to three of: a slot, a notch with straight or slanting walls, a hole."""
    rng = np.random.default_rng([3, seed])
    size, corners = rng.uniform(28, 48), int(rng.integers(3, 8))
    if corners > MOST_REGULAR:
        turns = np.sort(rng.uniform(0, 2 * math.pi, corners))
    else:
        turns = 2 * math.pi * np.arange(corners) / corners
    ring = size * np.column_stack([np.cos(turns), rng.uniform(0.6, 1.0) * np.sin(turns)])
    hull = shapely.MultiPoint(ring).convex_hull.buffer(rng.uniform(4, 9), join_style="mitre")
    shape = hull
    for _ in range(int(rng.integers(1, 4))):
        kind, at = str(rng.choice(["slot", "notch", "wedge", "hole"])), rng.uniform()
        if kind != "hole":
            shape = shape.difference(_notch(hull, kind, at, rng.uniform(6, 0.6 * size), rng))
        elif not (room := hull.buffer(-14)).is_empty:
            shape = shape.difference(room.representative_point().buffer(rng.uniform(3, 12), 6))
    piece = max(shapely.get_parts(shape), key=shapely.area)
    outer, *holes = (shapely.get_coordinates(item)[:-1] for item in [piece.exterior, *piece.interiors])
    section = Section((0.0, HEIGHT_MM), (Polygon(outer, tuple(holes)),))
    return ObjectModel("own", (State("flat", (section,)),))


def _notch(
    hull: shapely.Polygon, kind: str, at: float, deep: float, rng: np.random.Generator
) -> shapely.Polygon:
    """Slot, notch or wedge from a place on the hull (`at`, 0 to 1) towards its middle."""
    place = shapely.line_interpolate_point(hull.exterior, at, normalized=True)
    mouth, middle = shapely.get_coordinates([place, hull.centroid])
    inward = (middle - mouth) / math.hypot(*(middle - mouth))
    across = np.array([-inward[1], inward[0]])
    wide = rng.uniform(4, 10) if kind == "slot" else rng.uniform(14, 30)
    narrow = 0.2 * wide if kind == "wedge" else wide
    begin, end = mouth - 30 * inward, mouth + deep * inward
    sides = (begin, -wide), (end, -narrow), (end, narrow), (begin, wide)
    return shapely.Polygon([point + across * width / 2 for point, width in sides])


def main() -> None:
    """Print a line for each part, and sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--learn", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--own", action="store_true")
    parser.add_argument("--identify", type=int, default=0)
    parser.add_argument("--first-run", type=int, default=0)
    parser.add_argument("--tolerance", type=float, default=1.5)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--keep", type=Path, default=None)
    given = parser.parse_args()
    rig = load_rig(EXAMPLES / "turning-rig.toml")
    reach = learning_reach(rig)
    found = []
    for seed in range(given.first, given.first + given.learn):
        truth = own_outline(seed) if given.own else _outline_of_others(seed)
        kept = None if given.keep is None else given.keep / f"{truth.name}-{seed}.json"
        if kept is not None and kept.exists():
            found.append(Learned(truth, load_objects(kept).objects[0], 0, 0, 0.0, 0.0, is_between=True))
            continue
        item = learn(truth, rig, reach, seed, given.tolerance, given.seconds)
        if kept is not None and item.model is not None:
            palpate.save(ObjectsFile((item.model,)), kept)
        _tell(seed, item)
        found.append(item)
    _falling(found)
    runs = range(given.first_run, given.first_run + given.identify)
    _identify(rig, reach_of(rig), [item for item in found if item.model is not None], runs)


def _outline_of_others(seed: int) -> ObjectModel:
    truths = [
        item
        for item in outlines(SHARED_OUTLINES)
        if SMALLEST_MM < np.ptp(item.states[0].sections[0].polygons[0].outer, axis=0).max() < LARGEST_MM
    ]
    drawn = np.random.default_rng(0).permutation(len(truths))
    return truths[drawn[seed % len(truths)]]


def _tell(seed: int, item: Learned) -> None:
    tolerance = math.nan if item.model is None else item.model.tolerance_mm
    print(
        f"{seed:>3} {item.truth.name:<14} grips {item.grips:>3} touches {item.touches:>3} "
        f"{item.seconds:>5.0f} s  tolerance {tolerance:>5.2f} mm  between {item.is_between!s:<5} "
        f"Hausdorff {item.hausdorff_mm:>5.2f} mm, evenly {item.even_mm:>5.2f} mm, "
        f"Gaussian {item.gaussian_mm:>5.2f} mm  "
        f"computing {item.computing_s:.0f} s",
        flush=True,
    )


def _falling(found: Sequence[Learned]) -> None:
    for count in (30, 45, 60, 90, 120):
        with_so_many = [
            min((tolerance for touches, tolerance in item.falling if touches <= count), default=math.inf)
            for item in found
            if item.touches >= count or item.model is not None
        ]
        closed = sum(map(math.isfinite, with_so_many))
        print(
            f"up to {count:>3} touches: closed {closed} of {len(with_so_many)}, "
            f"tolerance {np.median(with_so_many):.2f} mm (median)"
        )


def _identify(rig: RigFile, reach: Reach, known: Sequence[Learned], runs: Sequence[int]) -> None:
    if not known or not runs:
        return
    shipped = load_objects(shipped_objects()).objects
    catalogue = Catalogue([*(item.model for item in known if item.model is not None), *shipped])
    limits = {"max_grips": 40, "goal_position_mm": 5.0, "goal_orientation_deg": 8.0}
    eased = rig.model_copy(update={"search": rig.search.model_copy(update=limits)})
    verdicts: Counter[str] = Counter()
    for seed in runs:
        rng = np.random.default_rng([2, seed])
        item = known[int(rng.integers(len(known)))]
        placed = place(item.truth, rng, 15.0)
        begin = time.process_time()
        result = search(eased, reach, hands(placed.shape, rng), catalogue)
        hypotheses = () if result.recognition is None else result.recognition.hypotheses
        names = {one.state.object_name for one in hypotheses}
        assert item.model is not None, "chosen by"
        is_wrong = result.outcome.is_answer and item.model.name not in names
        is_lost = item.model.name not in names
        verdict = f"{result.outcome.value}{' WRONG' * is_wrong}{' LOST' * is_lost}"
        verdicts[verdict] += 1
        wide = max((one.bounds.position_half_mm for one in hypotheses), default=math.nan)
        turned = max((one.bounds.orientation_half_rad for one in hypotheses), default=math.nan)
        touches = sum(one.contact.touched for grip in result.grips for one in grip)
        print(
            f"{seed:>3} {item.model.name:<16} {verdict:<17} left {len(hypotheses)} of "
            f"{len(names)} objects, ±{wide:.1f} mm ±{math.degrees(turned):.1f}°  grips "
            f"{len(result.grips)} touches {touches}  computing {time.process_time() - begin:.0f} s",
            flush=True,
        )
    print(", ".join(f"{name} {number}" for name, number in verdicts.items()))


if __name__ == "__main__":
    main()
