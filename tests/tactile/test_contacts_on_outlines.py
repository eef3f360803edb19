"""The contact extractor against real outlines: the emulated skin pressed on the shipped models anywhere."""

import json
import math
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
import pytest
import shapely
from shapely.ops import nearest_points

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.tip import Outline, press
from palpate.drivers.tactile.array import TactileFrame
from palpate.drivers.tactile.contact import ContactExtractor, TipCalibration
from palpate.drivers.tactile.messages import Description, Frame, Message, Shape, Start
from palpate.drivers.tactile.protocol import Decoder, encode

RADIUS, ROWS, COLS = 5.0, 8, 20
PITCH = math.radians(270) / COLS
TIP = Description(
    unique_id=b"outlines".ljust(16, b"\0"),
    firmware="test",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=ROWS,
    cols=COLS,
    bit_depth=12,
    max_rate_hz=1000.0,
    full_scale_n=2.0475,
    counts_per_n=2000.0,
    tip_radius_mm=RADIUS,
    columns=tuple((k - (COLS - 1) / 2) * PITCH for k in range(COLS)),
    row_heights_mm=tuple(2.0 * k + 1.0 for k in range(ROWS)),
)


class Tip:
    """An emulated array and an extractor that only sees its frames."""

    def __init__(self, seed: int) -> None:
        self.array = EmulatedArray(
            TIP, seed=seed, noise_counts=2.0, gain_spread=0.2, offset_counts=20, crosstalk=0.06
        )
        self.decoder = Decoder()
        self.array.feed(encode(Message(0, 0, Start(1, 250_000))), 0.0)
        self.now = 0.0
        self.extractor = ContactExtractor(TIP, TipCalibration(gain=np.ones((ROWS, COLS)), gain_spread=0.2))
        self.extractor.tare(self.frames(np.zeros((ROWS, COLS)), 16))

    def frames(self, force_n: np.ndarray, count: int) -> list[TactileFrame]:
        taken = []
        for _ in range(count):
            self.now += 0.004
            self.array.sample(self.now, force_n)
            items = self.decoder.feed(b"".join(data for _, data in self.array.poll(self.now)))
            bodies = [item.body for item in items if isinstance(item, Message)]
            taken += [
                TactileFrame(0, 0.0, self.now, body.counts) for body in bodies if isinstance(body, Frame)
            ]
        return taken


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
        touch = press(Outline(ring, np.roll(ring, -1, axis=0), 20.0), centre, RADIUS, stiffness)
        if touch is None:
            continue
        direction = away + math.pi
        seen = (touch.angle - direction + math.pi) % (2 * math.pi) - math.pi
        slot = np.floor((seen - TIP.columns[0]) / PITCH + 0.5).astype(int)
        on = (slot >= 0) & (slot < COLS)
        columns = np.bincount(slot[on], touch.by_ray_n[on], minlength=COLS)
        near = nearest_points(part, shapely.Point(centre))[0]
        true = math.atan2(near.y - centre[1], near.x - centre[0])
        yield direction, np.tile(columns / ROWS, (ROWS, 1)), true


@pytest.mark.slow
def test_the_true_normal_is_in_the_range_wherever_a_finger_meets_a_part() -> None:
    """Parts have shallow corners, in and out, that a tip feels as one wide or lopsided patch."""
    rng = np.random.default_rng(705)
    tip = Tip(0)
    outside, halves = [], []
    for number, (direction, taxels, true) in enumerate(pressed(rng, outlines())):
        if number == 1500:
            break
        if number % 100 == 0:
            tip = Tip(number)
        patch = tip.extractor.extract(tip.frames(taxels, 8))
        if patch is None:
            continue  # pressed where the array has no taxels
        halves.append(patch.angle_half_range_rad)
        off = abs((true - direction - patch.angle_rad + math.pi) % (2 * math.pi) - math.pi)
        if off > patch.angle_half_range_rad:
            outside.append((number, math.degrees(off), math.degrees(patch.angle_half_range_rad), patch.flags))
    assert outside == []
    assert len(halves) > 1400
    assert np.median(halves) < math.radians(10.5)
