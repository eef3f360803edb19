"""A rig to calibrate, without servos, ports and time: the emulators' truth, geometry, tips and taxels.

Thousands of times faster than the emulated bench, for tests of what calibration does with what it measures.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from simulated_load import LoadedTip

from palpate.calibration.measurements import (
    FREE,
    IN,
    OUT,
    IdleMeasurement,
    PressMeasurement,
    StopMeasurement,
    TouchMeasurement,
)
from palpate.calibration.prober import Probe, SlideApproach
from palpate.calibration.reference import Reference
from palpate.config import CalibrationDevice, RigFile, SlideFingerConfig
from palpate.drivers.emulators.bench import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.drivers.emulators.tip import PartSection, separation_mm
from palpate.drivers.finger import TICK_RAD
from palpate.geometry import Counts, Floats
from palpate.rig.commissioning.calibration import ConnectedRig
from palpate.rig.commissioning.rig_prober import approaches_of
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.reference_table import outline_of

FORCE_N = 0.35
FRICTION_A, CURRENT_STEP_A, NM_PER_A = 0.028, 2.69e-3, 4.1 / 2.3
LATENCY_S = 0.02
RATE_HZ = 250.0
STEP_MM = 0.04
"""Travel of a press between two samples: 4 mm/s, 100 of them a second."""


class SimulatedRig:
    """The hidden truth of one emulated rig, and what lies on its table. `spoil` may change what is put there.

    `spoil(reference, number of puts so far)` gives the reference that is really put.
    """

    def __init__(
        self, rig: RigFile, seed: int, spoil: Callable[[Reference, int], Reference] = lambda item, _: item
    ) -> None:
        self.rig = rig
        emulated = emulate(rig, None, seed)
        self.fingers: tuple[EmulatedFinger, ...] = emulated.bench.fingers
        self.friction = 0.0 if emulated.part is None else emulated.part.tip_friction
        self.rng = np.random.default_rng([seed, 7])
        self.spoil = spoil
        self.puts = 0
        self.outline: PartSection | None = None
        self.slid_mm = 0.0
        self.time_s = 0.0

    @contextmanager
    def connect(self, rig: RigFile, *, moving: bool) -> Iterator[ConnectedRig]:
        del moving
        arrays = [finger.array.description for finger in self.fingers]
        devices = [
            CalibrationDevice(
                port=spec.array.port, kind="array", id=told.unique_id.hex(), model="8 x 20", firmware="1"
            )
            for spec, told in zip(rig.fingers, arrays, strict=True)
        ]
        yield ConnectedRig(SimulatedProber(self, rig), arrays, devices, emulated=True)

    def truth(self, finger: int) -> FingerTruth:
        found = self.fingers[finger].truth
        assert isinstance(found, FingerTruth)
        return found


class SimulatedProber:
    """Measures a simulated rig; `rig` says what is known of it by now, which decides the approaches."""

    def __init__(self, world: SimulatedRig, rig: RigFile) -> None:
        self._world = world
        self.approaches: Sequence[SlideApproach] = approaches_of(rig)
        self._aims: dict[int, float] = {}

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        world = self._world
        x, y = np.asarray(about_mm) + world.rng.uniform(-5.0, 5.0, 2)
        thing = world.spoil(reference, world.puts)
        world.outline = outline_of(thing, float(x), float(y), float(world.rng.uniform(-math.pi, math.pi)))
        world.puts += 1

    def clear(self) -> None:
        self._world.outline = None

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        return [self._touched(probe, placing) for probe in grip]

    def press(self, contacts: Sequence[Probe], placing: int) -> list[PressMeasurement]:
        return [self._press(probe, placing) for probe in contacts]

    def stop(self, contacts: Sequence[Probe], speed_mm_s: float) -> list[StopMeasurement]:
        stops = []
        for probe in contacts:
            item, truth = (
                self.approaches[probe.approach],
                self._world.truth(self.approaches[probe.approach].finger),
            )
            late = LATENCY_S + self._world.rng.uniform(0, 1 / RATE_HZ)
            stood = self._step(probe.end_rad + speed_mm_s * late / truth.mm_per_rad)
            name = self._world.rig.fingers[item.finger].name
            stops.append(StopMeasurement(name, speed_mm_s, stood, stood, probe.end_rad, 1 / RATE_HZ))
        return stops

    def swing(self) -> list[float]:
        return [0.0175 for _ in self._world.fingers]

    def idle(self, seconds: float) -> list[IdleMeasurement]:
        world, count = self._world, round(seconds * RATE_HZ)
        time_s = world.time_s + np.arange(count) / RATE_HZ
        world.time_s += seconds + 60.0
        return [
            IdleMeasurement(spec.name, self._counts(k, np.zeros((count, 8, 20)), time_s), time_s)
            for k, spec in enumerate(world.rig.fingers)
        ]

    def home(self, finger: int, stop_mm: float) -> float:
        truth = self._world.truth(finger)
        assert truth.stops_mm is not None
        flank = 1.0 if stop_mm == truth.stops_mm[1] else -1.0
        drive = (stop_mm + flank * truth.slide_play_mm - truth.zero_mm) / truth.mm_per_rad
        return self._step(drive + self._world.rng.normal(0, 0.1 * TICK_RAD))

    def _touched(self, probe: Probe, placing: int) -> TouchMeasurement | None:
        item = self.approaches[probe.approach]
        truth = self._world.truth(item.finger)
        way = self._way(probe)
        dent = FORCE_N / truth.stiffness_n_per_mm
        found = self._contact(truth, item, way, dent)
        if found is None or found > probe.end_rad:
            return None
        centre, travel = _centre(truth, item, way, found)
        towards = _towards(self._world.outline, centre)
        if self._loads(truth):
            touched = self._contact(truth, item, way, 0.0)
            assert touched is not None
            found, towards, travel = self._pressed(truth, item, way, touched)
        angle = towards - travel - truth.array_heading_rad + self._world.rng.normal(0, math.radians(0.5))
        # Rigs measure on the move, over whole steps: hardly anything of their rounding is left.
        found += self._world.rng.normal(0, 0.004) / truth.mm_per_rad
        return TouchMeasurement(
            self._world.rig.fingers[item.finger].name,
            placing,
            (self._step(item.aim_rad), found),
            way,
            math.remainder(angle, 2 * math.pi),
            math.radians(3.0),
            FORCE_N,
            0.02,
        )

    def bearing_rad(self, number: int) -> float | None:
        """Where an approach really meets what is put, from the direction of travel; None if it does not."""
        item = self.approaches[number]
        truth = self._world.truth(item.finger)
        found = self._contact(truth, item, 0, 0.0)
        if found is None:
            return None
        centre, travel = _centre(truth, item, 0, found)
        return math.remainder(_towards(self._world.outline, centre) - travel, 2 * math.pi)

    def _loads(self, truth: FingerTruth) -> bool:
        return self._world.friction > 0 or truth.aim_yield is not None

    def _tip(self, truth: FingerTruth, item: SlideApproach, way: int) -> LoadedTip:
        assert self._world.outline is not None
        _, travel = _centre(truth, item, 0, item.start_rad)
        return LoadedTip(truth, self._world.outline, self._world.friction, travel, way)

    def _pressed(
        self, truth: FingerTruth, item: SlideApproach, way: int, touched: float
    ) -> tuple[float, float, float]:
        """Slide where the tip is pressed as in a touch; directions to where that is felt, and of the way."""
        tip, slide, pressed = self._tip(truth, item, way), touched, 0.0
        found = slide
        while pressed < FORCE_N:
            before = (slide, pressed)
            slide += 0.01 / truth.mm_per_rad
            load, _ = tip.put(_distance(truth, slide))
            if load is None:
                continue
            pressed = float(load.by_ray_n.sum())
            share = min(max((FORCE_N - before[1]) / max(pressed - before[1], 1e-9), 0.0), 1.0)
            found = before[0] + share * (slide - before[0])
        assert load is not None
        felt = np.angle((load.by_ray_n * np.exp(1j * load.angle)).sum())
        return found, float(felt), tip.travel_rad

    def _contact(self, truth: FingerTruth, item: SlideApproach, way: int, dent_mm: float) -> float | None:
        """Servo angle of the slide at which the tip is dented by so much; None if it meets nothing."""
        outline = self._world.outline
        if outline is None:
            return None

        def gap(slide: float) -> float:
            centre, _ = _centre(truth, item, way, slide)
            return separation_mm(outline, centre) - truth.tip_radius_mm + dent_mm

        slides = np.linspace(item.start_rad, item.end_rad, 80)
        first = next((k for k, slide in enumerate(slides) if gap(slide) < 0), 0)
        if first == 0:
            return None
        lo, hi = slides[first - 1], slides[first]
        for _ in range(30):
            middle = (lo + hi) / 2
            lo, hi = (middle, hi) if gap(middle) > 0 else (lo, middle)
        return float(lo)

    def _press(self, probe: Probe, placing: int) -> PressMeasurement:
        item, world = self.approaches[probe.approach], self._world
        truth, way = world.truth(item.finger), self._way(probe)
        start = self._contact(truth, item, way, 0.0)
        assert start is not None
        assert world.outline is not None
        deepest = 3.0 / truth.stiffness_n_per_mm
        depth = np.arange(-2.0, deepest, STEP_MM)
        leg = np.where(depth < 0, FREE, IN)
        forces, push = np.zeros((2 * len(depth), 8, 20)), np.zeros(2 * len(depth))
        tip = self._tip(truth, item, way)
        for k, deep in enumerate(np.concatenate([depth - STEP_MM / 2, depth[::-1] + STEP_MM / 2])):
            # Frames are averaged since the last look, so they are half a sample older than the servo's state.
            felt, force = tip.put(_distance(truth, start + deep / truth.mm_per_rad))
            if felt is not None:
                finger, travel = world.fingers[item.finger], tip.travel_rad
                columns = np.asarray(finger.array.description.columns)
                pitch = columns[1] - columns[0]
                seen = (felt.angle - travel - truth.array_heading_rad + math.pi) % (2 * math.pi) - math.pi
                slot = np.floor((seen - columns[0]) / pitch + 0.5).astype(int)
                on = (slot >= 0) & (slot < 20)
                forces[k] = np.bincount(slot[on], felt.by_ray_n[on], minlength=20)[None, :] / 8
                push[k] = -float(force @ [math.cos(travel), math.sin(travel)])
        world.time_s += 2.0
        now = np.full(len(depth), world.time_s)
        zero = self._counts(item.finger, np.zeros((16, 8, 20)), now[:16]).mean(axis=0)
        counts = np.concatenate(
            [self._counts(item.finger, part, now).astype(float) - zero for part in np.split(forces, 2)]
        )
        back = np.full(len(depth), OUT)
        out = np.concatenate([np.ones(len(depth)), -np.ones(len(depth))])
        newton_per_a = NM_PER_A / (truth.mm_per_rad / 1000)
        current = push / newton_per_a + out * FRICTION_A
        # The contact was computed with the play taken up; going back, the drive is on the other flank.
        drive = start + np.concatenate([depth, depth[::-1]]) / truth.mm_per_rad
        drive += (out - 1) * truth.slide_play_mm / truth.mm_per_rad
        return PressMeasurement(
            world.rig.fingers[item.finger].name,
            placing,
            self._step(item.aim_rad),
            np.rint(drive / TICK_RAD) * TICK_RAD,
            np.rint(current / CURRENT_STEP_A) * CURRENT_STEP_A,
            np.concatenate([leg, back]),
            counts,
        )

    def _counts(self, finger: int, force_n: Floats, time_s: Floats) -> Counts:
        return self._world.fingers[finger].array.taxels.counts(force_n, time_s)

    def _way(self, probe: Probe) -> int:
        item = self.approaches[probe.approach]
        spec = self._world.rig.fingers[item.finger]
        if probe.side and isinstance(spec, SlideFingerConfig) and spec.aim.backlash_holds_n is not None:
            self._aims[item.finger] = item.aim_rad
            return probe.side
        before = self._aims.get(item.finger)
        self._aims[item.finger] = item.aim_rad
        return 0 if before is None or before == item.aim_rad else int(math.copysign(1, item.aim_rad - before))

    def _step(self, angle_rad: float) -> float:
        return round(angle_rad / TICK_RAD) * TICK_RAD


def _distance(truth: FingerTruth, slide_rad: float) -> float:
    """From the base to the tip's centre, with the play taken up as in a touch."""
    return truth.zero_mm + truth.mm_per_rad * slide_rad - truth.slide_play_mm


def _centre(truth: FingerTruth, item: SlideApproach, way: int, slide_rad: float) -> tuple[Floats, float]:
    """True centre (2,) with the play taken up as in a touch, and the direction of travel."""
    aim = round(item.aim_rad / TICK_RAD) * TICK_RAD
    travel = truth.heading_rad + (aim - truth.aim_zero_rad) / truth.gear_ratio - way * truth.aim_play_rad
    distance = truth.zero_mm + truth.mm_per_rad * slide_rad - truth.slide_play_mm
    x, y = truth.base_mm
    return np.array([x + distance * math.cos(travel), y + distance * math.sin(travel)]), travel


def _towards(outline: PartSection | None, centre: Floats) -> float:
    """Direction from a point to the nearest point of an outline."""
    assert outline is not None
    rel = centre - outline.start
    share = np.clip(np.einsum("ij,ij->i", rel, outline.along) / outline.square, 0.0, 1.0)
    away = rel - share[:, None] * outline.along
    nearest = away[np.einsum("ij,ij->i", away, away).argmin()]
    return math.atan2(-nearest[1], -nearest[0])
