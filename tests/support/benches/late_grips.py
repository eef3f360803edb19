"""Single grips of parts that slide, behind adapters as bought: what each claims, against what was hidden."""

import math
import tomllib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely
from scipy.ndimage import minimum_filter1d
from shapely import affinity

from palpate.base.errors import PalpateError
from palpate.base.geometry.plane import wrap_angle
from palpate.config import RigFile
from palpate.config.emulation import EmulatedPartConfig
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.wire import Device, Emission
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.bench import BenchRig, choose_placements, connect
from palpate.rig.emulated.devices import EmulatedRig, MockRig, emulate
from palpate.rig.emulated.hidden_truth import draw_parts
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.motion_bounds import MotionBounds
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from support.benches.rigs import firm_rig, small, small_objects
from support.benches.session import AlarmClock, shape_of
from support.commands.repository import ROOT

SLACK = 1e-6
_STEP_S = 1e-3
_LASTING = 11  # steps: what is over sooner may be between two frames
_HIDDEN_N = 0.03  # below that noise may hide it
RIGS = {"light": ROOT / "src" / "palpate" / "config" / "rigs" / "bench.toml", "fast": firm_rig()}
_TIMER = "{latency_ms = 16}"
_STALLS = "{stall_ms = [30, 80], stall_every_s = 0.3}"
_BOTH = "{latency_ms = 16, stall_ms = [30, 80], stall_every_s = 0.3}"


@dataclass(frozen=True)
class Row:
    """What is between host and devices; `late_s`: by how much frames are late, drawn for each of them.

    `touch_mm_s`: another speed than the rig's to measure contacts with.
    """

    name: str
    emulation: str
    late_s: tuple[float, float] = (0.0, 0.0)
    touch_mm_s: float | None = None


ROWS = (
    Row("nothing", ""),
    Row("latency timer of 16 ms", f"bus_adapter = {_TIMER}\narray_adapter = {_TIMER}"),
    Row("arrays' hub stalls", f"array_adapter = {_STALLS}"),
    Row("bus's hub stalls", f"bus_adapter = {_STALLS}"),
    Row("16 ms and stalls everywhere", f"bus_adapter = {_BOTH}\narray_adapter = {_BOTH}"),
    Row("frames late by 0 to 80 ms", "", late_s=(0.0, 0.08)),
    Row("frames late by 110 ms, touched at 15 mm/s", "", late_s=(0.11, 0.11), touch_mm_s=15.0),
    Row("frames late by 0 to 16 ms", "", late_s=(0.0, 0.016)),
)


class LateFrames:
    """A device whose every emission reaches the host late by a drawn time, none before the one before it."""

    def __init__(self, device: Device, late_s: tuple[float, float], seed: int) -> None:
        self._device, self._late_s = device, late_s
        self._rng = np.random.default_rng(seed)
        self._queue: deque[Emission] = deque()

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Pass bytes on."""
        self._take(self._device.feed(data, now))
        return self._due(now)

    def poll(self, now: float) -> list[Emission]:
        """What has come by now."""
        self._take(self._device.poll(now))
        return self._due(now)

    def next_due(self) -> float | None:
        """When something happens."""
        times = [self._queue[0][0]] if self._queue else []
        own = self._device.next_due()
        return min(times + ([] if own is None else [own]), default=None)

    def _take(self, emissions: Sequence[Emission]) -> None:
        for start, data in emissions:
            due = start + self._rng.uniform(*self._late_s)
            self._queue.append((max(due, self._queue[-1][0] if self._queue else -math.inf), data))

    def _due(self, now: float) -> list[Emission]:
        found = []
        while self._queue and self._queue[0][0] <= now:
            found.append(self._queue.popleft())
        return found


@dataclass
class Hidden:
    """What really happened in each step of the bench: all (n,), or (n, fingers)."""

    bench: Bench
    time_s: list[float] = field(default_factory=list)
    force_n: list[list[float]] = field(default_factory=list)
    work_mj: list[list[float]] = field(default_factory=list)
    _at: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        step: Callable[[], None] = self.bench._step

        def watched() -> None:
            step()
            self.note()

        self.bench._step = watched  # type: ignore[method-assign]

    def note(self) -> None:
        """Note one step: forces on the part, and forwards what they have done."""
        fingers = self.bench.fingers
        at = [np.array(finger.stepped_mm) for finger in fingers]
        loads = [np.zeros(2) if f.press is None else np.asarray(f.press.force_n) for f in fingers]
        moved = [b - a for a, b in zip(self._at or at, at, strict=True)]
        self._at = at
        self.time_s.append(self.bench._steps * _STEP_S)
        self.force_n.append([_on_array_n(finger) for finger in fingers])
        # `press.force_n` is on the tip, so that on the part it is the other way round
        self.work_mj.append([max(0.0, -float(load @ way)) for load, way in zip(loads, moved, strict=True)])


def _on_array_n(finger: EmulatedFinger) -> float:
    """What presses where the array has columns (N)."""
    if finger.press is None:
        return 0.0
    columns = np.asarray(finger.array.description.columns)
    middle = finger._facing_rad + finger.truth.array_heading_rad
    seen = wrap_angle(finger.press.angle - middle)
    return float(finger.press.on_skin_n[(seen > columns[0]) & (seen < columns[-1])].sum())


def rig_of(kind: str, row: Row, part: EmulatedPartConfig) -> RigFile:
    """The small bench of a kind, with what the row puts between."""
    described = tomllib.loads(small(RIGS[kind]))
    described["emulation"] |= tomllib.loads(row.emulation)
    if row.touch_mm_s is not None:
        described["closing"]["touch_speed_mm_s"] = row.touch_mm_s
    rig = RigFile.model_validate(described)
    assert rig.emulation is not None
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"part": part})})


def bench_of(rig: RigFile, row: Row, placement: Placement, seed: int) -> BenchRig:
    """The emulated rig behind what the row says."""
    emulated = emulate(rig, [placement], seed)
    clock, devices = AlarmClock(), dict(emulated.devices)
    hub = MockHub(clock, f"age-{seed}")
    urls = {}
    for number, (port, (device, baudrate)) in enumerate(devices.items()):
        late = row.late_s[1] and port != rig.bus.port
        some: Device = LateFrames(device, row.late_s, seed * 10 + number) if late else device
        urls[port] = hub.attach(port.partition("://")[2], some, baudrate)
    mock = MockRig(EmulatedRig(emulated.bench, emulated.devices), hub, clock, urls)
    return BenchRig(rig, clock, urls.__getitem__, (placement,), mock)


def grip_of(rig: RigFile, shape: shapely.Polygon, rng: np.random.Generator) -> list[FingerApproach]:
    """An approach of each finger that meets the part, or nearly; fast as far as a plan may let it."""
    reach, grip = reach_of(rig), []
    for index, finger in enumerate(rig.fingers):
        own = reach.of_finger(index)
        item = reach.approaches[own[int(rng.integers(len(own) // 4, 3 * len(own) // 4))]]
        radius = finger.tip.radius_mm
        along = np.array([math.cos(item.direction_rad), math.sin(item.direction_rad)])
        way = shapely.LineString([item.start_mm, np.array(item.start_mm) + item.travel_mm * along])
        met = way.intersection(shape.buffer(radius + 2.0 + rng.exponential(3.0)))
        free = item.travel_mm if met.is_empty else shapely.Point(item.start_mm).distance(met)
        ends = way.intersection(shape.buffer(radius))
        travel = item.travel_mm
        if not ends.is_empty and rng.uniform() < 0.2:  # its way ends about where it touches
            travel = shapely.Point(item.start_mm).distance(ends) + rng.uniform(-0.3, 0.5)
        grip.append(replace(item, fast_mm=min(free, travel), travel_mm=travel))
    return grip


@dataclass
class Grip:
    """One grip, and what was hidden."""

    touches: list[Touch]
    hidden: Hidden
    at_measurement: Any
    final: Any


def carried_out(bench: BenchRig, shape: shapely.Polygon, rng: np.random.Generator) -> Grip:
    """Carry out one grip."""
    assert bench.emulated is not None
    emulated = bench.emulated.bench
    hidden, poses = Hidden(emulated), []

    def tell(phase: GripPhase) -> None:
        if phase is GripPhase.RETRACTING:
            poses.append(emulated.parts.displacements[0])

    with connect(bench) as hand:
        hand.prepare()
        touches = carry_out_grip(hand, grip_of(bench.rig, shape, rng), tell)
        for _ in range(20):
            bench.clock.sleep(0.01)
            emulated.advance(bench.clock.now())
    final = emulated.parts.displacements[0]
    measured = any(touch.contact.touched for touch in touches)
    return Grip(touches, hidden, poses[-1] if measured else final, final)  # misses are of the end


def moved(shape: shapely.Polygon, displacement: Any) -> shapely.Polygon:
    """A shape where a displacement has taken it."""
    turned = affinity.rotate(
        shape, displacement.turn_rad, origin=tuple(displacement.centre_mm), use_radians=True
    )
    return affinity.translate(turned, *displacement.shift_mm)


def judged(grip: Grip, rig: RigFile, catalogue: Catalogue, placement: Placement) -> dict[str, float]:
    """Each claim's worst share of its bound; above 1 it is broken."""
    shape = shape_of(placement)
    bounds = MotionBounds(rig, catalogue)
    row = [item.state.name for item in catalogue.states].index(placement.state.name)
    motion = bounds.of_grip(grip.touches)
    found: dict[str, float] = {}

    def claim(name: str, value: float, most: float) -> None:
        found[name] = max(
            found.get(name, 0.0), (value - SLACK) / most if most > 0 else float(value > SLACK) * 99
        )

    at = moved(shape, grip.at_measurement)
    c, s = math.cos(placement.theta_rad), math.sin(placement.theta_rad)
    x, y = catalogue.states[row].origin_mm
    middle = np.array([placement.x_mm + c * x - s * y, placement.y_mm + s * x + c * y])
    reach = float(np.hypot(*(shapely.get_coordinates(shape) - middle).T).max())
    before = float(motion.before.shift_mm[row] + reach * motion.before.turn_rad[row])
    for touch in grip.touches:
        contact = touch.contact
        radius = contact.finger.tip_radius_mm
        way = shapely.LineString([contact.start_mm, contact.end_mm])
        if math.isfinite(before):
            claim("way", max(radius - way.distance(at), 0.0), contact.path_bound_mm + before)
        if contact.touched:
            off = abs(at.boundary.distance(shapely.Point(contact.end_mm)) - radius)
            claim("contact", off, contact.position_bound_mm)
    poses = [grip.at_measurement, grip.final]
    places = [middle, *(pose.place(middle) for pose in poses)]
    turns = [0.0, *(pose.turn_rad for pose in poses)]
    for k, (name, most) in enumerate((("before", motion.before), ("after", motion.after))):
        if math.isfinite(most.shift_mm[row]):
            claim(f"{name}: shift", math.dist(places[k], places[k + 1]), float(most.shift_mm[row]))
            claim(f"{name}: turn", abs(turns[k + 1] - turns[k]), float(most.turn_rad[row]))
    _claim_loads(grip, bounds, rig, claim)
    return found


def _claim_loads(
    grip: Grip, bounds: MotionBounds, rig: RigFile, claim: Callable[[str, float, float], None]
) -> None:
    loads = bounds.loads(grip.touches)
    traces = [touch.trace for touch in grip.touches if touch.trace is not None]
    if not loads or len(traces) < len(grip.touches):
        return
    begin, period = min(float(t.time_s[0]) for t in traces), 1 / rig.closing.sample_rate_hz
    time_s = np.array(grip.hidden.time_s)
    index = np.floor((time_s - begin) / period).astype(int)
    force, work = np.array(grip.hidden.force_n), np.array(grip.hidden.work_mj)
    most = (loads[-1].at_contact_n + loads[-1].anywhere_n).T
    known = (index >= 0) & (index < len(most))
    for k, touch in enumerate(grip.touches):
        own = touch.finger_index
        lasting = minimum_filter1d(force[:, own], _LASTING, mode="nearest")[known]
        over = lasting > _HIDDEN_N
        if over.any():
            claim("force", float((lasting[over] / most[index[known], k][over]).max()), 1.0)
        claim("work", float(work[known, own].sum()), float(loads[-1].work_mj[k].sum()))


def run_grip(kind: str, row: Row, seed: int) -> dict[str, float] | str:
    """One grip; what it claimed, or why there was none."""
    rng = np.random.default_rng([seed, 31])
    part = EmulatedPartConfig(
        engine="quasi-static",
        mass_kg=0.05 * 20 ** rng.uniform(),
        friction=rng.uniform(0.15, 0.5),
        tip_friction=rng.uniform(0.0, 0.6),
    )
    rig, objects = rig_of(kind, row, part), small_objects()
    (placement,) = choose_placements(rig, objects, None, seed)
    (truth,) = draw_parts(part, [placement], seed)
    rig = rig.model_copy(update={"search": rig.search.model_copy(update={"part_holds_n": truth.slip_n})})
    bench = bench_of(rig, row, placement, seed)
    try:
        grip = carried_out(bench, shape_of(placement), rng)
    except PalpateError as error:
        return str(error)
    return judged(grip, rig, Catalogue([placement.model]), placement)
