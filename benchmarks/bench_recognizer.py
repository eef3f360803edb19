"""How long `recognise` takes, and how much it leaves: run with `python benchmarks/bench_recognizer.py`.

Touches are simulated by shapely with seeded noise inside the declared bounds. One row for each catalogue,
number of contacts and width of the normal range: median and 90th percentile of the time for one call, median
number of hypotheses, share of hypotheses with a verified configuration, and the share of time in each stage.
A second table says how time and memory grow with the catalogue: 250 to 1,000 outlines of 66 edges, point
fingers. A third one says what more contacts cost.
"""

import argparse
import cProfile
import math
import pstats
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact, NormalRange, recognise
from support.commands.repository import SHARED_OUTLINES
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
)

STAGES = {
    "tree": ("grow_branches",),
    "cells": ("sift_intervals", "sift_parts"),
    "regions": ("search_round",),
    "bounds": ("enclosures",),
}
NARROW = math.radians(15)


def scenes(
    path: Path, fingers: int, half_range: float | None, count: int
) -> list[tuple[object, list[Contact]]]:
    """Grips on random objects of a file, each touching with all of its fingers."""
    rng = np.random.default_rng(fingers)
    models = outlines(path)
    found: list[tuple[object, list[Contact]]] = []
    while len(found) < count:
        placed = place(models[int(rng.integers(len(models)))], rng)
        contacts = grip(placed, rng, fingers=fingers, half_range=half_range)
        if all(contact.touched for contact in contacts):
            found.append((placed, contacts))
    return found


def stage_shares(catalogue: Catalogue, grips: Sequence[list[Contact]]) -> str:
    """Share of the time of recognition, bounds included, that each stage takes."""
    profile = cProfile.Profile()
    profile.enable()
    for contacts in grips:
        _ = recognise(catalogue, contacts).hypotheses
    profile.disable()
    stats = pstats.Stats(profile)
    spent = {name: 0.0 for names in STAGES.values() for name in names}
    for (_, _, name), (_, _, _, cumulative, _) in stats.stats.items():
        if name in spent:
            spent[name] += cumulative
    whole = stats.total_tt or 1.0
    shares = {stage: sum(spent[name] for name in names) / whole for stage, names in STAGES.items()}
    shares["rest"] = max(0.0, 1.0 - sum(shares.values()))
    return " ".join(f"{stage} {share:3.0%}" for stage, share in shares.items())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grips", type=int, default=12, help="grips per row")
    count = parser.parse_args().grips
    print("position bound 0.3 mm, tip radius 5 mm")
    print("catalogue  contacts  normals    median     90 %  hypotheses  verified  truth  stages")
    for label, path in (("memo's 6", SHIPPED_OBJECTS), ("129 parts", SHARED_OUTLINES)):
        if not path.exists():
            print(f"{label}: skipped, its file is not beside the repository")
            continue
        catalogue = Catalogue(outlines(path))
        for fingers, degrees in ((2, 15), (3, 15), (3, None), (4, 15), (6, 15)):
            half_range = None if degrees is None else math.radians(degrees)
            seconds, left, verified, kept = [], [], [], 0
            chosen = scenes(path, fingers, half_range, count)
            _ = recognise(catalogue, chosen[0][1]).hypotheses  # outlines and boundaries are made on first use
            for placed, contacts in chosen:
                begin = time.perf_counter()
                found = recognise(catalogue, contacts)
                left.append(len(found.hypotheses))
                seconds.append(time.perf_counter() - begin)
                verified += [item.verified for item in found.hypotheses]
                kept += holding_truth(found, placed) is not None
            normals = "unknown" if degrees is None else f"±{degrees}°"
            stages = stage_shares(catalogue, [contacts for _, contacts in chosen[:4]])
            print(
                f"{label:<10} {fingers:>8}  {normals:<7} {1e3 * np.median(seconds):>7.1f} ms "
                f"{1e3 * np.percentile(seconds, 90):>5.0f} ms  {np.median(left):>10.0f}  "
                f"{np.mean(verified):>8.1%}  {kept}/{count}  {stages}",
                flush=True,
            )
    growth_with_the_catalogue(count)
    growth_with_the_contacts(count)


def jagged(rng: np.random.Generator, name: str) -> ObjectModel:
    """An outline of 66 edges of about 4 mm, no two alike: a wavy round with a rough edge."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, 66))
    while np.min(np.diff(np.append(angle, angle[0] + 2 * np.pi))) < 0.01:
        angle = np.sort(rng.uniform(0, 2 * np.pi, 66))
    wave = sum(rng.normal(0, 0.12 / k) * np.cos(k * angle + rng.uniform(0, 6.28)) for k in range(1, 6))
    radius = 40 * (1 + wave) * (1 + rng.uniform(-0.06, 0.06, 66))
    return flat(name, np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))


def point_grip(placed: Placed, rng: np.random.Generator, fingers: int = 3) -> list[Contact]:
    """A grip of point fingers, with the normal of the edge nearest to each contact as its range's middle."""
    ring = np.asarray(shapely.geometry.polygon.orient(placed.shape).exterior.coords)
    leg = np.diff(ring, axis=0)
    felt = []
    for contact in grip(placed, rng, fingers=fingers, radius=0.0, bound=0.3, half_range=None):
        rel = np.asarray(contact.end_mm) - ring[:-1]
        part = np.clip(np.sum(rel * leg, axis=1) / np.sum(leg * leg, axis=1), 0, 1)
        x, y = leg[np.argmin(np.hypot(*(rel - part[:, None] * leg).T))]
        normal = math.atan2(-x, y) + rng.uniform(-NARROW, NARROW)
        felt.append(replace(contact, normal=NormalRange(normal - NARROW, normal + NARROW)))
    return felt


def growth_with_the_catalogue(count: int) -> None:
    """Outlines of 66 edges, r = 0, ε = 0.3 mm, ±15°, three contacts."""
    rng = np.random.default_rng(1)
    models = [jagged(rng, f"outline {k}") for k in range(1000)]
    print("\noutlines of 66 edges, point fingers, three contacts, ±15°")
    print("outlines    median     90 %   ratio  hypotheses  preparation  most memory so far")
    before = 0.0
    for size in (250, 500, 1000):
        begin = time.perf_counter()
        catalogue = Catalogue(models[:size])
        chosen = []
        while len(chosen) < count:
            felt = point_grip(place(models[int(rng.integers(size))], rng), rng)
            if all(contact.touched for contact in felt):
                chosen.append(felt)
        _ = recognise(catalogue, chosen[0]).hypotheses
        prepared = time.perf_counter() - begin
        seconds, left = [], []
        for felt in chosen:
            begin = time.perf_counter()
            found = recognise(catalogue, felt)
            left.append(len(found.hypotheses))
            seconds.append(time.perf_counter() - begin)
        median = float(np.median(seconds))
        ratio = f"{median / before:>5.2f}" if before else "     "
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{size:>8}  {1e3 * median:>5.0f} ms  {1e3 * np.percentile(seconds, 90):>4.0f} ms   {ratio}"
            f"  {np.median(left):>10.0f}  {prepared:>9.1f} s  {memory:>9.0f} MB",
            flush=True,
        )
        before = median


def growth_with_the_contacts(count: int) -> None:
    """Memo's six, r = 5, ±15°: what further contacts cost, all at once."""
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    print("\nmemo's 6, tip radius 5 mm, ±15°\ncontacts    median   ratio")
    before = 0.0
    for fingers in (3, 6, 12):
        chosen = scenes(SHIPPED_OBJECTS, fingers, NARROW, count)
        _ = recognise(catalogue, chosen[0][1]).hypotheses
        seconds = []
        for _, contacts in chosen:
            begin = time.perf_counter()
            _ = recognise(catalogue, contacts).hypotheses
            seconds.append(time.perf_counter() - begin)
        median = float(np.median(seconds))
        ratio = f"{median / before:>5.2f}" if before else ""
        print(f"{fingers:>8}  {1e3 * median:>5.1f} ms   {ratio}", flush=True)
        before = median


if __name__ == "__main__":
    main()
