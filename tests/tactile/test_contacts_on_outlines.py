"""The contact extractor against real outlines: the emulated skin pressed on the shipped models anywhere."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
import shapely
from shapely.ops import nearest_points
from tactile_tip import COLS, DESCRIPTION, PITCH, RADIUS, ROWS, TactileTip

from palpate.drivers.emulators.tip import PartSection, tip_load

# Half as sensitive: the forces are small beside the noise, as they are where fingers stop gently.
FAINT = replace(DESCRIPTION, full_scale_n=2.0475, counts_per_n=2000.0)


def outlines() -> list[np.ndarray]:
    text = files("palpate.config").joinpath("objects", "memo.json").read_text()
    return [np.array(item["outline"], dtype=float) for item in json.loads(text)["objects"]]


def pressed(rng: np.random.Generator, shapes: list[np.ndarray]) -> Iterator[tuple[float, np.ndarray, float]]:
    """Direction of travel, force on the taxels, and direction from the tip's axis to the nearest point."""
    while True:
        ring = shapes[rng.integers(len(shapes))]
        part = shapely.Polygon(ring)
        away = rng.uniform(0, 2 * math.pi)
        heading = -np.array([math.cos(away), math.sin(away)])
        begin = np.array(part.centroid.coords[0]) + rng.uniform(-20, 20, 2) - 200 * heading
        force, stiffness = math.exp(rng.uniform(math.log(0.33), math.log(0.8))), 3 * rng.uniform(0.8, 1.2)
        travel = 0.0
        while (
            travel < 300 and (gap := part.distance(shapely.Point(begin + travel * heading)) - RADIUS) > 1e-6
        ):
            travel += gap
        if travel >= 300:
            continue
        low, high = travel, travel + 3.0
        for _ in range(25):
            middle = (low + high) / 2
            dent = RADIUS - part.distance(shapely.Point(begin + middle * heading))
            low, high = (middle, high) if dent < force / stiffness else (low, middle)
        centre = begin + low * heading
        touch = tip_load(PartSection(ring, np.roll(ring, -1, axis=0), 20.0), centre, RADIUS, stiffness)
        if touch is None:
            continue
        direction = away + math.pi
        seen = (touch.angle - direction + math.pi) % (2 * math.pi) - math.pi
        slot = np.floor((seen - FAINT.columns[0]) / PITCH + 0.5).astype(int)
        on = (slot >= 0) & (slot < COLS)
        columns = np.bincount(slot[on], touch.by_ray_n[on], minlength=COLS)
        near = nearest_points(part, shapely.Point(centre))[0]
        true = math.atan2(near.y - centre[1], near.x - centre[0])
        yield direction, np.tile(columns / ROWS, (ROWS, 1)), true


@pytest.mark.slow
def test_the_true_normal_is_in_the_range_wherever_a_finger_meets_a_part() -> None:
    """Parts have shallow corners, in and out, that a tip feels as one wide or lopsided patch."""
    rng = np.random.default_rng(705)
    tip = TactileTip(0, description=FAINT, crosstalk=0.06)
    outside, halves = [], []
    for number, (direction, taxels, true) in enumerate(pressed(rng, outlines())):
        if number == 750:
            break
        if number % 100 == 0:
            tip = TactileTip(number, description=FAINT, crosstalk=0.06)
        patch = tip.touch(taxels, 8)
        if patch is None:
            continue  # pressed where the array has no taxels
        halves.append(patch.angle_half_range_rad)
        off = abs((true - direction - patch.angle_rad + math.pi) % (2 * math.pi) - math.pi)
        if off > patch.angle_half_range_rad:
            outside.append((number, math.degrees(off), math.degrees(patch.angle_half_range_rad), patch.flags))
    assert outside == []
    assert len(halves) > 700
    assert np.median(halves) < math.radians(10.5)
