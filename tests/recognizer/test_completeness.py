"""The recogniser's promise: the truth is never lost while every error is within its bound.

Touches are simulated by shapely. Every seed is fixed, so a failure names a case that can be run again.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sampling import sample
from shapely_bench import (
    MOST_DRAWS,
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
    touch,
    until_touched,
)
from shared_files import SHARED_OUTLINES, needs_shared_outlines

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue, Recognition, recognise
from palpate.recognizer.contact import Contact

RADII = (0.0, 1.0, 5.0, 8.0)
BOUNDS = (0.0, 0.01, 0.3, 1.0)
NORMALS = (math.radians(1), math.radians(10), math.radians(45))


@cache
def shipped() -> Catalogue:
    return Catalogue(outlines(SHIPPED_OBJECTS))


def ring_polygon(*points: tuple[float, float]) -> Polygon:
    return Polygon(np.array(points, dtype=float))


def assert_kept(found: Recognition, placed: Placed, note: object) -> None:
    assert holding_truth(found, placed) is not None, (placed.model.name, placed.theta, note)


@pytest.mark.parametrize("seed", range(24))
def test_shipped_models(seed: int) -> None:
    rng = np.random.default_rng(seed)
    models = outlines(SHIPPED_OBJECTS)
    for trial in range(8):
        radius, bound = RADII[rng.integers(4)], BOUNDS[rng.integers(4)]
        half, fingers = NORMALS[rng.integers(3)], int(rng.integers(2, 7))
        placed = place(models[(seed + trial) % 6], rng)
        contacts = until_touched(
            grip,
            placed,
            rng,
            fingers=fingers,
            radius=radius,
            bound=bound,
            half_range=half,
            at_bound=bool(trial % 2),
        )
        assert_kept(recognise(shipped(), contacts), placed, (seed, trial, radius, bound, half))


@pytest.mark.parametrize("seed", range(6))
def test_unknown_normals(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    models = outlines(SHIPPED_OBJECTS)
    for trial in range(5):
        placed = place(models[(seed + trial) % 6], rng)
        contacts = until_touched(
            grip,
            placed,
            rng,
            fingers=3 + trial % 3,
            bound=BOUNDS[trial % 3],
            half_range=None,
            at_bound=bool(trial % 2),
        )
        assert_kept(recognise(shipped(), contacts), placed, (seed, trial))


@needs_shared_outlines
@pytest.mark.parametrize("trials", sample([12, 40], [12]))
def test_cut_parts(trials: int) -> None:
    models = outlines(SHARED_OUTLINES)
    catalogue = Catalogue(models)
    rng = np.random.default_rng(7)
    for trial in range(trials):
        placed = place(models[int(rng.integers(len(models)))], rng)
        contacts = until_touched(
            grip,
            placed,
            rng,
            fingers=3 + trial % 3,
            radius=RADII[trial % 4],
            bound=BOUNDS[rng.integers(4)] / 2,
            half_range=NORMALS[rng.integers(2)],
            at_bound=bool(trial % 2),
        )
        assert_kept(recognise(catalogue, contacts), placed, trial)


@pytest.mark.parametrize("theta", [math.pi, -math.pi, math.pi - 1e-4, -math.pi + 1e-4, 0.0, math.pi / 2])
def test_across_the_cut(theta: float) -> None:
    rng = np.random.default_rng(8)
    for model in outlines(SHIPPED_OBJECTS):
        placed = replace(place(model, rng), theta=theta)
        contacts = grip(placed, rng, fingers=4, at_bound=True)
        assert_kept(recognise(shipped(), contacts), placed, theta)


@pytest.mark.parametrize("seed", range(10))
def test_grip_after_grip(seed: int) -> None:
    """Extending keeps the truth and never knows less about it than the grips did before."""
    rng = np.random.default_rng(200 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    first = until_touched(grip, placed, rng, fingers=2 + seed % 2)
    further = [grip(placed, rng, fingers=2 + seed % 2, at_bound=bool(k % 2)) for k in (1, 2)]
    grips = [
        [replace(contact, name=f"{contact.name}.{k}") for contact in drawn]
        for k, drawn in enumerate([first, *further])
    ]
    found = recognise(shipped(), grips[0])
    assert_kept(found, placed, 0)
    for k in (1, 2):
        found = found.extend(grips[k])
        assert_kept(found, placed, k)
        assert found.contacts == tuple(contact for part in grips[: k + 1] for contact in part)
    at_once = recognise(shipped(), [contact for part in grips for contact in part])
    assert_kept(at_once, placed, "at once")
    stepwise = {(item.state_index) for item in found.hypotheses}
    for item in at_once.hypotheses:
        if item.verified:  # what satisfies all contacts exactly cannot have been lost on the way
            assert item.state_index in stepwise


@pytest.mark.parametrize("seed", range(8))
def test_misses_are_evidence(seed: int) -> None:
    rng = np.random.default_rng(300 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    contacts = until_touched(grip, placed, rng, fingers=3)
    misses: list[Contact] = []
    for _ in range(MOST_DRAWS):
        at = rng.uniform(0, 2 * math.pi)
        start = 140 * np.array([math.cos(at), math.sin(at)])
        aim = at + math.pi + rng.choice([-1, 1]) * rng.uniform(0.2, 0.5)
        tried = touch(
            placed.shape, rng, radius=5.0, bound=0.3, half_range=None, direction=aim, start=start, reach=280.0
        )
        if not tried.touched:
            misses.append(replace(tried, name=f"m{len(misses)}"))
        if len(misses) == 3:
            break
    assert len(misses) == 3
    without, found = recognise(shipped(), contacts), recognise(shipped(), [misses[0], *contacts, *misses[1:]])
    assert_kept(without, placed, seed)
    assert_kept(found, placed, seed)
    assert found.cells.volume.sum() <= without.cells.volume.sum() * (1 + 1e-9)


def star(
    placed: Placed,
    rng: np.random.Generator,
    *,
    radii: tuple[float, ...],
    heights: tuple[float, ...],
    bound: float,
    at_bound: bool,
) -> list[Contact]:
    """Fingers evenly round the table and straight to its middle, each of a radius at a height."""
    evenly = rng.uniform(0, 2 * math.pi) + 2 * math.pi * np.arange(len(radii)) / len(radii)
    return [
        touch(
            placed.shape_at(height),
            rng,
            radius=radius,
            bound=bound,
            half_range=math.radians(10),
            direction=at + math.pi,
            start=140 * np.array([math.cos(at), math.sin(at)]),
            reach=280.0,
            at_bound=at_bound,
            name=f"f{k}",
            height=height,
        )
        for k, (at, radius, height) in enumerate(zip(evenly, radii, heights, strict=True))
    ]


@pytest.mark.parametrize("seed", range(8))
def test_fingers_of_different_radii(seed: int) -> None:
    rng = np.random.default_rng(400 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    contacts = until_touched(star, placed, rng, radii=RADII, heights=(10.0,) * 4, bound=0.2, at_bound=True)
    assert_kept(recognise(shipped(), contacts), placed, seed)


def stepped() -> ObjectModel:
    base = ring_polygon((-30, -20), (34, -20), (34, 16), (10, 16), (10, 24), (-30, 24))
    hole = np.array([(-6, -6), (6, -6), (8, 6), (-6, 6)], dtype=float)
    top = Polygon(np.array([(-20, -12), (20, -14), (16, 12), (-18, 10)], dtype=float), (hole,))
    return ObjectModel("stepped", (State("on-base", (Section((0, 10), (base,)), Section((10, 25), (top,)))),))


@pytest.mark.parametrize("seed", range(12))
def test_sections_at_different_heights(seed: int) -> None:
    rng = np.random.default_rng(500 + seed)
    model = stepped()
    catalogue = Catalogue([model, flat("plate", [(-25, -15), (25, -15), (25, 15), (-25, 15)])])
    placed = place(model, rng)
    heights, at_bound = (5.0, 18.0, 10.0, 18.0), bool(seed % 2)
    contacts = until_touched(
        star, placed, rng, radii=(4.0,) * 4, heights=heights, bound=0.3, at_bound=at_bound
    )
    assert_kept(recognise(catalogue, contacts), placed, seed)


def test_a_finger_above_the_object_touches_nothing_of_it() -> None:
    rng = np.random.default_rng(9)
    low, high = (
        flat("low", [(-25, -15), (25, -15), (25, 15)], 12.0),
        flat("high", [(-25, -15), (25, -15), (25, 15)]),
    )
    placed = Placed(high, 0.0, 0.0, 0.4)
    contacts = [replace(c, finger=replace(c.finger, height_mm=15.0)) for c in grip(placed, rng)]
    found = recognise(Catalogue([low, high]), contacts)
    assert {item.state.object_name for item in found.hypotheses} == {"high"}


@pytest.mark.parametrize("seed", range(10))
def test_start_points_inside_the_convex_hull(seed: int) -> None:
    """A finger that comes down in the mouth of a U and moves outwards feels the mouth's own walls."""
    rng = np.random.default_rng(600 + seed)
    mouth = flat(
        "mouth", [(-40, -30), (40, -30), (40, 30), (24, 30), (24, -10), (-22, -14), (-22, 30), (-40, 30)]
    )
    placed = place(mouth, rng)
    catalogue = Catalogue([*outlines(SHIPPED_OBJECTS), mouth])

    def outwards() -> list[Contact]:
        return [
            touch(
                placed.shape,
                rng,
                radius=5.0,
                bound=0.3,
                half_range=math.radians(10),
                direction=float(direction),
                start=placed.on_table(np.array([1.0, 8.0])),
                reach=150.0,
                at_bound=bool(seed % 2),
                name=f"f{k}",
            )
            for k, direction in enumerate(rng.uniform(-math.pi, math.pi, 4))
        ]

    assert_kept(recognise(catalogue, until_touched(outwards)), placed, seed)


@pytest.mark.parametrize("seed", range(40))
def test_corners_of_a_notch_without_error(seed: int) -> None:
    """A disc that rests on both lips of a notch narrower than itself, or next to it, measured exactly."""
    rng = np.random.default_rng(700 + seed)
    notched = flat("notched", [(0, 0), (60, 0), (60, 30), (34, 30), (30, 12), (25, 30), (0, 30)])
    placed = place(notched, rng)
    into = np.array([29.5 + rng.uniform(-0.3, 0.3), 90.0])
    contacts = [
        touch(
            placed.shape,
            rng,
            radius=5.0,
            bound=0.0,
            half_range=math.radians(1),
            direction=placed.theta + angle,
            start=placed.on_table(point),
            reach=300.0,
            name=f"f{k}",
        )
        for k, (angle, point) in enumerate(
            [
                (-math.pi / 2, into),
                (0.0, np.array([-90.0, 15.0 + rng.uniform(-9, 9)])),
                (math.pi / 2, np.array([30 + rng.uniform(-20, 20), -90.0])),
            ]
        )
    ]
    assert_kept(recognise(Catalogue([notched]), contacts), placed, seed)
