"""Strip trees against plain lists of pairs: run with `python benchmarks/bench_strips.py`.

Wavy outlines of more and more edges, point fingers, touches simulated by shapely with errors inside the
declared bounds. One row for each number of edges and width of the normal range: time of the first call, in
which tables or trees are made, and median time of further calls, with both searches; how much longer the
lists take; whether both gave the same hypotheses, and how often the truth was among them.
"""

import argparse
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact, NormalRange, Recognition, recognise
from support.oracles.shapely_touches import Placed, flat, grip, holding_truth, place

BOUND_MM = 0.1
BY_LISTS, BY_STRIPS = 10**9, 8


def wavy(edges: int) -> ObjectModel:
    a = 2 * np.pi * np.arange(edges) / edges
    radius = 60 + 6 * np.sin(3 * a + 1) + 3 * np.cos(7 * a) + np.sin(edges / 6 * a)
    return flat(f"wavy-{edges}", radius[:, None] * np.column_stack([np.cos(a), np.sin(a)]))


def measured(placed: Placed, contact: Contact, rng: np.random.Generator, half_range: float | None) -> Contact:
    """An exact contact with an error in its position, and the normal of the edge that it met, if wanted."""
    normal = None
    if half_range is not None:
        ring = np.asarray(placed.shape.exterior.coords)
        begin, along = ring[:-1], np.diff(ring, axis=0)
        rel = np.asarray(contact.end_mm) - begin
        part = np.clip(np.sum(rel * along, axis=1) / np.sum(along * along, axis=1), 0.0, 1.0)
        x, y = along[np.argmin(np.hypot(*(rel - part[:, None] * along).T))]
        outward = math.atan2(-x, y) if placed.shape.exterior.is_ccw else math.atan2(x, -y)
        middle = outward + rng.uniform(-half_range, half_range)
        normal = NormalRange(middle - half_range, middle + half_range)
    angle, size = rng.uniform(0, 2 * math.pi), BOUND_MM * math.sqrt(rng.uniform())
    x, y = size * math.cos(angle), size * math.sin(angle)
    return replace(
        contact,
        start_mm=(contact.start_mm[0] + x, contact.start_mm[1] + y),
        end_mm=(contact.end_mm[0] + x, contact.end_mm[1] + y),
        position_bound_mm=BOUND_MM,
        normal=normal,
    )


def scenes(
    model: ObjectModel, fingers: int, half_range: float | None, count: int
) -> list[tuple[Placed, list[Contact]]]:
    """Grips of point fingers on the object."""
    rng = np.random.default_rng(fingers)
    found: list[tuple[Placed, list[Contact]]] = []
    while len(found) < count:
        placed = place(model, rng)
        exact = grip(placed, rng, fingers=fingers, radius=0.0, bound=0.0, half_range=None)
        if all(contact.touched for contact in exact):
            found.append((placed, [measured(placed, contact, rng, half_range) for contact in exact]))
    return found


def timed(
    model: ObjectModel, flat_edges: int, chosen: list[tuple[Placed, list[Contact]]]
) -> tuple[float, float, list[Recognition]]:
    """Seconds of the first call, median seconds of calls for each grip, and the answers."""
    catalogue = Catalogue([model], flat_edges=flat_edges)
    begin = time.perf_counter()
    _ = recognise(catalogue, chosen[0][1]).hypotheses
    first = time.perf_counter() - begin
    seconds, answers = [], []
    for _, contacts in chosen:
        begin = time.perf_counter()
        answers.append(recognise(catalogue, contacts))
        _ = answers[-1].hypotheses
        seconds.append(time.perf_counter() - begin)
    return first, float(np.median(seconds)), answers


def same(one: Recognition, two: Recognition) -> bool:
    """Whether two answers hold the same hypotheses, in whatever order."""
    rows = []
    for found in (one.hypotheses, two.hypotheses):
        row = np.column_stack([found.state, found.verified, found.lo, found.hi])
        rows.append(row[np.lexsort(row.T[::-1].round(6))])
    return rows[0].shape == rows[1].shape and bool(np.allclose(rows[0], rows[1], rtol=0, atol=1e-9))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=5, help="grips per row")
    parser.add_argument(
        "--edges", type=int, nargs="+", default=[500, 1000, 2000], help="edges of the outlines"
    )
    options = parser.parse_args()
    count = options.grips
    print(f"position bound {BOUND_MM} mm, tip radius 0")
    print("                              lists              strips       lists/")
    print("edges  contacts  normals    first      then    first      then  strips  same  truth")
    for edges in options.edges:
        model = wavy(edges)
        for fingers, degrees in ((3, 15), (5, 15), (4, None)):
            chosen = scenes(model, fingers, None if degrees is None else math.radians(degrees), count)
            strips_first, strips, by_strips = timed(model, BY_STRIPS, chosen)
            lists_first, lists, by_lists = timed(model, BY_LISTS, chosen)
            equal = sum(same(one, two) for one, two in zip(by_lists, by_strips, strict=True))
            pairs = zip(by_strips, chosen, strict=True)
            kept = sum(holding_truth(found, placed) is not None for found, (placed, _) in pairs)
            normals = "unknown" if degrees is None else f"±{degrees}°"
            print(
                f"{edges:>5}  {fingers:>8}  {normals:<7}  {lists_first:>5.2f} s {1e3 * lists:>5.0f} ms  "
                f"{strips_first:>5.2f} s {1e3 * strips:>5.0f} ms  {lists / strips:>6.1f}  "
                f"{equal}/{count}   {kept}/{count}",
                flush=True,
            )


if __name__ == "__main__":
    main()
