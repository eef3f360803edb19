"""A rig to calibrate, without servos and without time."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from palpate.base.geometry import Counts, Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.measurements import (
    LEG_FREE,
    LEG_IN,
    LEG_OUT,
    IdleMeasurement,
    PressMeasurement,
    Probe,
    Reference,
    RunRecord,
    ServoPath,
    StopMeasurement,
    TouchMeasurement,
)
from palpate.calibration.rig_models import nominal_models
from palpate.config import ArmFingerConfig, CalibrationDevice, RigFile, SlideFingerConfig
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import ArmTruth, EmulatedStage, FingerTruth, Play
from palpate.drivers.emulators.tip import PartSection, TipLoad, separation_mm, tip_load
from palpate.drivers.kinematics import TICK_RAD, Servos
from palpate.rig.commissioning.calibration_run import ConnectedRig
from palpate.rig.commissioning.hand_prober import approaches_of, joint_sides
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.hidden_truth import draw_tip_friction
from palpate.rig.emulated.scene import reference_outline
from support.benches.simulated_tips import (
    LoadedTip,
    Truth,
    Ways,
    bends_of_arm,
    direction_to,
    gives_way,
    link_directions_rad,
    pushed_tip,
    servos_stood,
    slide_distance_mm,
    travel_direction_rad,
    true_tip,
    whole_step_rad,
)

# ----------------------------------------------------------------------------------------------------
# A turning stage without servo, port and time, for the simulated rig: it stops near its goal, with play.


class SimulatedStage:
    """A stage with the emulated one's truth: its servo stops near its goal, its ring follows with play."""

    def __init__(self, truth: EmulatedStage, rig: RigFile, rng: np.random.Generator) -> None:
        assert rig.stage is not None
        self.centre_mm, self._joint = truth.centre_mm, truth.truth
        self._zero_rad = math.radians(rig.stage.zero_deg) - math.pi
        self._rng, self._goal_rad, self._shaft_rad = rng, math.nan, self._zero_rad
        self._play = Play(self._joint.play_rad, self._driven())
        self.turn_to(0.0)

    def turn_to(self, angle_rad: float) -> None:
        """Nothing if it is there."""
        if angle_rad != self._goal_rad:
            goal = self._zero_rad + self._joint.gear_ratio * angle_rad
            self._shaft_rad = goal + self._rng.normal(0, 0.5 * TICK_RAD)
            self._play.follow(self._driven())
        self._goal_rad = angle_rad

    @property
    def read_rad(self) -> float:
        """Angle by the servo."""
        return (round(self._shaft_rad / TICK_RAD) * TICK_RAD - self._zero_rad) / self._joint.gear_ratio

    def seen(self, outline: PartSection | None) -> PartSection | None:
        """An outline of W as the ring sees it."""
        if outline is None:
            return None
        c, s = math.cos(self._play.at), math.sin(self._play.at)
        back, centre = np.array([[c, -s], [s, c]]), np.array(self.centre_mm)
        start, end = ((corners - centre) @ back + centre for corners in (outline.start, outline.end))
        return PartSection(start, end, outline.top_mm)

    def _driven(self) -> float:
        return (self._shaft_rad - self._joint.zero_rad) / self._joint.gear_ratio


# ----------------------------------------------------------------------------------------------------
# A rig to calibrate, without servos, ports and time: the emulators' truth, geometry, tips and taxels.
#
# Thousands of times faster than the emulated bench, for tests of what calibration does with what it measures.

FORCE_N = 0.35
FRICTION_A, CURRENT_STEP_A, NM_PER_A = 0.028, 2.69e-3, 4.1 / 2.3
LATENCY_S = 0.02
RATE_HZ = 250.0
STEP_MM = 0.04
"""Travel of a press between two samples: 4 mm/s, 100 of them a second."""
ARM_N_PER_A, ARM_STEP_MM = 25.0, 0.07
_ROUNDS = 8  # to equilibrium: an arm gives way by a part of what its tip does


class SimulatedRig:
    """The hidden truth of one emulated rig, and what lies on its table. `spoil` may change what is put there.

    `spoil(reference, number of puts so far)` gives the reference that is really put.
    """

    def __init__(
        self, rig: RigFile, seed: int, spoil: Callable[[Reference, int], Reference] = lambda item, _: item
    ) -> None:
        self.rig = rig
        emulated = emulate(rig, (), seed)
        self.fingers: tuple[EmulatedFinger, ...] = emulated.bench.fingers
        assert rig.emulation is not None
        self.friction = draw_tip_friction(rig.emulation.part, seed)
        self.rng = np.random.default_rng([seed, 7])
        self.spoil = spoil
        self.puts = 0
        self.outline: PartSection | None = None
        self.slid_mm = 0.0
        self.time_s = 0.0
        stage = emulated.bench.stage
        self.stage = None if stage is None else SimulatedStage(stage, rig, self.rng)

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

    def truth(self, finger: int) -> Truth:
        return self.fingers[finger].truth


class SimulatedProber:
    """Measures a simulated rig; `rig` says what is known of it by now, which decides the approaches."""

    def __init__(self, world: SimulatedRig, rig: RigFile, *, turned: bool = False) -> None:
        self._world, self._rig = world, rig
        self.approaches: Sequence[ServoPath] = _approaches(rig, turned=turned)
        self._aims: dict[int, float] = {}
        self._stage_rad = 0.0

    @property
    def turned(self) -> "SimulatedProber":
        return SimulatedProber(self._world, self._rig, turned=True)

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        world = self._world
        x, y = np.asarray(about_mm) + world.rng.uniform(-5.0, 5.0, 2)
        thing = world.spoil(reference, world.puts)
        world.outline = reference_outline(
            thing, float(x), float(y), float(world.rng.uniform(-math.pi, math.pi))
        )
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
            name = self._world.rig.fingers[self.approaches[probe.approach].finger].name
            late = LATENCY_S + self._world.rng.uniform(0, 1 / RATE_HZ)
            stood = probe.end_mm + speed_mm_s * late
            stops.append(StopMeasurement(name, speed_mm_s, stood, stood, probe.end_mm, 1 / RATE_HZ))
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
        assert isinstance(truth, FingerTruth)
        assert truth.stops_mm is not None
        flank = 1.0 if stop_mm == truth.stops_mm[1] else -1.0
        drive = (stop_mm + flank * truth.slide_play_mm - truth.zero_mm) / truth.mm_per_rad
        read = self._world.fingers[finger].servos[1].read_rad(drive)
        return whole_step_rad(read + self._world.rng.normal(0, 0.1 * TICK_RAD))

    def _touched(self, probe: Probe, placing: int) -> TouchMeasurement | None:
        item, rng = self.approaches[probe.approach], self._world.rng
        truth = self._world.truth(item.finger)
        self._turn_to(item.stage_rad)
        ways = self._ways(probe)
        found = self._contact(truth, item, ways, FORCE_N / truth.stiffness_n_per_mm)
        if found is None or found > probe.end_mm:
            return None
        servos = self._shafts(item, found)
        centre, facing = pushed_tip(truth, servos, ways, self._outline, FORCE_N)
        towards = direction_to(self._outline, centre)
        if isinstance(truth, FingerTruth) and self._loads(truth):
            touched = self._contact(truth, item, ways, 0.0)
            assert touched is not None
            found, towards, facing = self._pressed(truth, item, ways[0], touched)
        angle = towards - facing - truth.array_heading_rad + rng.normal(0, math.radians(0.5))
        near, far = servos_stood(truth, item, found)
        turned, known = 0.0, (int(ways[0]), 0)
        # Rigs measure on the move, over whole steps: hardly anything of their rounding is left.
        if isinstance(truth, FingerTruth):
            far += rng.normal(0, 0.004) / truth.mm_per_rad
        else:
            near, far = np.array([near, far]) + rng.normal(0, 0.1 * TICK_RAD, 2)
            turned = facing - travel_direction_rad(truth, item, ways, found)
            known = self._known_ways(item, found)
        return TouchMeasurement(
            self._world.rig.fingers[item.finger].name,
            placing,
            (float(near), float(far)),
            known[0],
            math.remainder(angle, 2 * math.pi),
            math.radians(3.0),
            FORCE_N,
            0.02,
            known[1],
            math.remainder(turned, 2 * math.pi),
            0.0 if self._world.stage is None else self._world.stage.read_rad,
        )

    @property
    def _outline(self) -> PartSection | None:
        """What lies on the table, as the fingers' ring sees it."""
        outline, stage = self._world.outline, self._world.stage
        return outline if stage is None else stage.seen(outline)

    def _turn_to(self, stage_rad: float) -> None:
        """Turn the stage; aims go home for it."""
        if self._world.stage is None or stage_rad == self._stage_rad:
            return
        self._world.stage.turn_to(stage_rad)
        self._stage_rad = stage_rad
        for k, spec in enumerate(self._rig.fingers):
            if isinstance(spec, SlideFingerConfig):
                self._aims[k] = math.radians(spec.aim.zero_deg) - math.pi

    def bearing_rad(self, number: int) -> float | None:
        """Where an approach really meets what is put, from the direction of travel; None if it does not."""
        item = self.approaches[number]
        truth = self._world.truth(item.finger)
        found = self._contact(truth, item, (0.0, 0.0), 0.0)
        if found is None:
            return None
        centre, _ = true_tip(truth, self._shafts(item, found), (0.0, 0.0))
        travel = travel_direction_rad(truth, item, (0.0, 0.0), found)
        return math.remainder(direction_to(self._outline, centre) - travel, 2 * math.pi)

    def _shafts(self, item: ServoPath, travel_mm: float) -> Servos:
        """True angles of both servos after a travel."""
        near, far = self._world.fingers[item.finger].servos
        read = servos_stood(self._world.truth(item.finger), item, travel_mm)
        return near.angle_rad(read[0]), far.angle_rad(read[1])

    def _loads(self, truth: FingerTruth) -> bool:
        return self._world.friction > 0 or truth.aim_yield is not None

    def _loaded(self, truth: FingerTruth, item: ServoPath, way: float) -> LoadedTip:
        outline = self._outline
        assert outline is not None
        _, travel = true_tip(truth, self._shafts(item, 0.0), (0.0, 0.0))
        return LoadedTip(truth, outline, self._world.friction, travel, int(way))

    def _pressed(
        self, truth: FingerTruth, item: ServoPath, way: float, touched: float
    ) -> tuple[float, float, float]:
        """Travel where the tip is pressed as in a touch; directions to where that is felt, and of the way."""
        tip, travel, pressed = self._loaded(truth, item, way), touched, 0.0
        found = travel
        while pressed < FORCE_N:
            before = (travel, pressed)
            travel += 0.01
            load, _ = tip.put(slide_distance_mm(truth, self._shafts(item, travel)[1]))
            if load is None:
                continue
            pressed = float(load.by_ray_n.sum())
            share = min(max((FORCE_N - before[1]) / max(pressed - before[1], 1e-9), 0.0), 1.0)
            found = before[0] + share * (travel - before[0])
        assert load is not None
        felt = np.angle((load.by_ray_n * np.exp(1j * load.angle)).sum())
        return found, float(felt), tip.travel_rad

    def _contact(self, truth: Truth, item: ServoPath, ways: Ways, dent_mm: float) -> float | None:
        """Travel at which the tip is dented by so much; None if it meets nothing."""
        outline = self._outline
        if outline is None:
            return None

        def gap(travel: float) -> float:
            force_n = dent_mm * truth.stiffness_n_per_mm
            centre, _ = pushed_tip(truth, self._shafts(item, travel), ways, outline, force_n)
            return separation_mm(outline, centre) - truth.tip_radius_mm + dent_mm

        travels = np.linspace(0.0, item.length_mm, 80)
        first = next((k for k, travel in enumerate(travels) if gap(travel) < 0), 0)
        if first == 0:
            return None
        lo, hi = travels[first - 1], travels[first]
        for _ in range(30):
            middle = (lo + hi) / 2
            lo, hi = (middle, hi) if gap(middle) > 0 else (lo, middle)
        return float(lo)

    def _press(self, probe: Probe, placing: int) -> PressMeasurement:
        item, world = self.approaches[probe.approach], self._world
        truth, ways = world.truth(item.finger), self._ways(probe)
        start = self._contact(truth, item, ways, 0.0)
        assert start is not None
        depth = np.arange(-2.0, 3.0 / truth.stiffness_n_per_mm, STEP_MM)
        # Frames are averaged since the last look, so they are half a sample older than the servo's state.
        places = start + np.concatenate([depth - STEP_MM / 2, depth[::-1] + STEP_MM / 2])
        forces, push = self._felt(truth, item, ways, places)
        world.time_s += 2.0
        now = np.full(len(depth), world.time_s)
        zero = self._counts(item.finger, np.zeros((16, 8, 20)), now[:16]).mean(axis=0)
        counts = np.concatenate(
            [self._counts(item.finger, part, now).astype(float) - zero for part in np.split(forces, 2)]
        )
        out = np.concatenate([np.ones(len(depth)), -np.ones(len(depth))])
        leg = np.concatenate([np.where(depth < 0, LEG_FREE, LEG_IN), np.full(len(depth), LEG_OUT)])
        drive = start + np.concatenate([depth, depth[::-1]])
        if isinstance(truth, FingerTruth):
            # The contact was computed with the play taken up; going back, the drive is on the other flank.
            per_mm = float(np.diff(item.servos_rad[:, 1])[0]) / item.length_mm
            drive += (out - 1) * truth.slide_play_mm / (abs(truth.mm_per_rad) * abs(per_mm))
            servo = np.rint((item.servos_rad[0, 1] + drive * per_mm) / TICK_RAD) * TICK_RAD
            travel, step_mm = (servo - item.servos_rad[0, 1]) / per_mm, TICK_RAD / abs(per_mm)
            worth = (0.0, NM_PER_A * abs(per_mm) * 1000)
        else:
            travel, step_mm = drive + world.rng.normal(0, 0.01, len(drive)), ARM_STEP_MM
            worth = (ARM_N_PER_A, ARM_N_PER_A)
        newton_per_a = sum(worth)
        current = push / newton_per_a + out * FRICTION_A
        return PressMeasurement(
            world.rig.fingers[item.finger].name,
            placing,
            travel,
            np.rint(current / CURRENT_STEP_A) * CURRENT_STEP_A * newton_per_a,
            leg,
            counts,
            step_mm,
            CURRENT_STEP_A * newton_per_a,
            np.zeros(len(travel)),
            self._described_facing(item, travel),
            worth,
            (FRICTION_A, FRICTION_A),
        )

    def _described_facing(self, item: ServoPath, travel_mm: Floats) -> Floats:
        """Where the finger faces, from its direction of travel, as rig file and servos have it; (n,)."""
        model = nominal_models(self._world.rig.fingers)[item.finger]

        def values(servos: Floats) -> Floats:
            return np.tile(model.prior, (len(servos), 1))

        servos, ends = item.servos_at(travel_mm), item.servos_rad[[0, -1]]
        first, last = model.centres(values(ends), ends, np.zeros((2, 2)))
        facing = model.facing_rad(values(servos), servos, np.zeros((len(servos), 2)))
        return wrap_angle(facing - math.atan2(last[1] - first[1], last[0] - first[0]))

    def _felt(self, truth: Truth, item: ServoPath, ways: Ways, places: Floats) -> tuple[Floats, Floats]:
        """Forces on taxels (n, 8, 20), and along the way (n,), after travels (n,)."""
        forces, push = np.zeros((len(places), 8, 20)), np.zeros(len(places))
        tip = self._loaded(truth, item, ways[0]) if isinstance(truth, FingerTruth) else None
        columns = np.asarray(self._world.fingers[item.finger].array.description.columns)
        for k, place in enumerate(places):
            servos = self._shafts(item, place)
            if tip is None:
                felt, force, facing = self._unloaded(truth, servos, ways)
                travel = travel_direction_rad(truth, item, ways, place)
            else:
                assert isinstance(truth, FingerTruth)
                felt, force = tip.put(slide_distance_mm(truth, servos[1]))
                facing = travel = tip.travel_rad
            if felt is None:
                continue
            seen = (felt.angle - facing - truth.array_heading_rad + math.pi) % (2 * math.pi) - math.pi
            slot = np.floor((seen - columns[0]) / (columns[1] - columns[0]) + 0.5).astype(int)
            on = (slot >= 0) & (slot < 20)
            forces[k] = np.bincount(slot[on], felt.by_ray_n[on], minlength=20)[None, :] / 8
            push[k] = -float(force @ [math.cos(travel), math.sin(travel)])
        return forces, push

    def _unloaded(self, truth: Truth, servos: Servos, ways: Ways) -> tuple[TipLoad | None, Floats, float]:
        """What a tip without friction feels, the force on it, and where it faces."""
        outline = self._outline
        assert outline is not None
        force, bends = np.zeros(2), (0.0, 0.0)
        for _ in range(_ROUNDS if gives_way(truth) else 1):
            centre, facing = true_tip(truth, servos, ways, bends)
            load = tip_load(outline, centre, truth.tip_radius_mm, truth.stiffness_n_per_mm)
            force = np.zeros(2) if load is None else load.force_n
            if isinstance(truth, ArmTruth):
                bends = bends_of_arm(truth, link_directions_rad(truth, servos, ways), force)
        return load, force, facing

    def _counts(self, finger: int, force_n: Floats, time_s: Floats) -> Counts:
        return self._world.fingers[finger].array.taxels.counts(force_n, time_s)

    def _ways(self, probe: Probe) -> Ways:
        """On which flanks of their plays joints really are."""
        item = self.approaches[probe.approach]
        spec = self._world.rig.fingers[item.finger]
        if isinstance(spec, ArmFingerConfig):
            turned = np.diff(item.servos_at(np.array([probe.end_mm - 2.0, probe.end_mm])), axis=0)[0]
            near, far = np.sign(turned / [spec.shoulder.gear_ratio, spec.elbow.gear_ratio]).tolist()
            return near, far
        aim = float(item.servos_rad[0, 0])
        before = self._aims.get(item.finger)
        self._aims[item.finger] = aim
        if probe.side and isinstance(spec, SlideFingerConfig) and spec.aim.backlash_holds_n is not None:
            return float(probe.side), 0.0
        return 0.0 if before is None or before == aim else math.copysign(1, aim - before), 0.0

    def _known_ways(self, item: ServoPath, travel: float) -> tuple[int, int]:
        """Those of an arm that are sure."""
        spec = self._world.rig.fingers[item.finger]
        assert isinstance(spec, ArmFingerConfig)
        return joint_sides(spec, item.servos_at(np.array([travel - 2.0, travel])))


_known: dict[str, Sequence[ServoPath]] = {}


def _approaches(rig: RigFile, *, turned: bool) -> Sequence[ServoPath]:
    """Those of arms are kept: they take seconds, and hang on nothing that is found before fingers' places."""
    if turned or not all(isinstance(finger, ArmFingerConfig) for finger in rig.fingers):
        return approaches_of(rig, turned=turned)
    key = rig.model_dump_json(exclude={"fingers": {"__all__": {"tip", "array"}}})
    if key not in _known:
        _known[key] = approaches_of(rig)
    return _known[key]


@dataclass
class Kept:
    """A keeper that remembers everything that was ever kept; `resume` is what it begins with."""

    resume: RunRecord | None = None
    saved: list[str] = field(default_factory=list)

    def load(self) -> RunRecord | None:
        return self.resume

    def save(self, record: RunRecord) -> None:
        self.saved.append(record.model_dump_json())
