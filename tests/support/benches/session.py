"""An emulated rig in this process, its touches, and what holds for each."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
from shapely import affinity

from palpate.config import ObjectsFile, RigFile, load_objects, shipped_objects
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.wire_faults import FaultyWire
from palpate.drivers.tactile.patches import PatchFlag
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.wire import Device, Emission
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.bench import BenchRig, connect
from palpate.rig.emulated.devices import EmulatedRig, MockRig, emulate
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, draw_placement
from palpate.rig.identification.identify import identify
from palpate.rig.identification.outcome import Identification
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from palpate.rig.session.log import SessionLog
from support.benches.rigs import quick_rig_of_shipped_size, small_objects, small_rig

# ----------------------------------------------------------------------------------------------------
# An emulated rig in this process, its hidden truth, and faults that come when the test says.

TORQUE_ENABLE = 64


class AlarmClock(VirtualClock):
    """A virtual clock that lets something happen at an instant, in the middle of whatever is going on."""

    def __init__(self) -> None:
        super().__init__()
        self._alarms: list[tuple[float, Callable[[], None]]] = []
        self.on_tick: Callable[[], None] = lambda: None

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        self._alarms.append((self.now() + seconds, action))

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        self._ring()

    def advance_to(self, instant: float) -> None:
        super().advance_to(instant)
        self._ring()

    def _ring(self) -> None:
        self.on_tick()
        due = [alarm for alarm in self._alarms if alarm[0] <= self.now()]
        self._alarms = [alarm for alarm in self._alarms if alarm not in due]
        for _, action in due:
            action()


class Cable:
    """What a device hangs on: once cut, nothing passes either way; `late_s` holds answers back.

    `wire` spoils what passes at rates that a test sets, or is unplugged; it is there once it is asked for.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self.cut = False
        self.late_s = 0.0

    @property
    def wire(self) -> FaultyWire:
        if not isinstance(self._device, FaultyWire):
            self._device = FaultyWire(self._device, 3)
        return self._device

    def feed(self, data: bytes, now: float) -> list[Emission]:
        answers = self._device.feed(b"" if self.cut else data, now)
        return [] if self.cut else [(instant + self.late_s, data) for instant, data in answers]

    def poll(self, now: float) -> list[Emission]:
        answers = self._device.poll(now)
        return [] if self.cut else answers

    def next_due(self) -> float | None:
        return None if self.cut else self._device.next_due()


def _ignore(stage: GripPhase) -> None:
    """Nobody wants to know."""


@dataclass
class EmulatedSession:
    """A rig that can be connected, and everything that the host is not told."""

    rig: RigFile
    bench_rig: BenchRig
    clock: AlarmClock
    bench: Bench
    cables: Mapping[str, Cable]
    placement: Placement | None
    hub: MockHub
    stages: list[GripPhase] = field(default_factory=list)

    @property
    def servos(self) -> dict[int, EmulatedServo]:
        found = {s.dxl_id: s for finger in self.bench.fingers for s in finger.servos}
        if self.bench.stage is not None:
            found[self.bench.stage.servo.dxl_id] = self.bench.stage.servo
        return found

    def torque(self) -> dict[int, bool]:
        """Torque Enable of every servo, from its own control table."""
        found = {}
        for dxl_id, servo in self.servos.items():
            answer = servo.answer_block(TORQUE_ENABLE, 1)
            assert answer is not None
            found[dxl_id] = bool(answer.params[0])
        return found

    def rest(self, seconds: float) -> float:
        """Let the mechanics go on by themselves; returns how far any tip still moved (mm)."""
        before = [finger.centre_mm for finger in self.bench.fingers]
        self.clock.sleep(seconds)
        self.bench.advance(self.clock.now())
        after = [finger.centre_mm for finger in self.bench.fingers]
        return max(float(np.hypot(*(b - a))) for a, b in zip(before, after, strict=True))

    def run_grip(
        self, folder: Path, grip: Sequence[FingerApproach], on_stage: Callable[[GripPhase], None] = _ignore
    ) -> list[Touch]:
        """Connect, prepare, carry out one grip, disconnect; everything logged as in a real session."""

        def tell(stage: GripPhase) -> None:
            self.stages.append(stage)
            on_stage(stage)

        with SessionLog(folder, self.clock, {}) as log, connect(self.bench_rig, log) as hand:
            return self.grip(hand, grip, tell)

    def grip(
        self, hand: Hand, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] = _ignore
    ) -> list[Touch]:
        hand.prepare()
        return carry_out_grip(hand, grip, tell)

    def middle(self) -> list[FingerApproach]:
        """Every finger straight towards the table's middle, as far as it goes."""
        reach = reach_of(self.rig)
        grip = []
        for index in range(len(self.rig.fingers)):
            own = reach.of_finger(index)
            grip.append(reach.approaches[own[len(own) // 2]])
        return grip


def emulated_session(
    *,
    seed: int = 7,
    rig: RigFile | None = None,
    objects: ObjectsFile | None = None,
    placement: Placement | None = None,
    others: Sequence[Placement] = (),
    empty: bool = False,
) -> EmulatedSession:
    """The shipped bench with an object drawn by the seed, unless given or `empty`, and `others` beside it."""
    rig = rig or quick_rig_of_shipped_size()
    assert rig.emulation is not None
    if placement is None and not empty:
        objects = objects or load_objects(shipped_objects())
        rng = np.random.default_rng([seed, 0])
        placement = draw_placement(objects, rig.emulation.placement_radius_mm, rng)
    placements = () if placement is None else (placement, *others)
    emulated = emulate(rig, placements, seed)
    clock = AlarmClock()
    hub = MockHub(clock, "session")
    cables = {port: Cable(device) for port, (device, _) in emulated.devices.items()}
    urls = {
        port: hub.attach(port.partition("://")[2], cable, emulated.devices[port][1])
        for port, cable in cables.items()
    }
    mock = MockRig(EmulatedRig(emulated.bench, emulated.devices), hub, clock, urls)
    bench_rig = BenchRig(rig, clock, urls.__getitem__, placements, mock)
    return EmulatedSession(rig, bench_rig, clock, emulated.bench, cables, placement, hub)


def small_session(*, seed: int = 7, empty: bool = False) -> EmulatedSession:
    """The shipped bench but for its size, with a small part: its ways take half the time."""
    return emulated_session(seed=seed, rig=small_rig(), objects=small_objects(), empty=empty)


def identify_checked(session: EmulatedSession, catalogue: Catalogue) -> Identification:
    """A whole run: the answer holds the truth, torque ends off, and no finger pressed harder than it may."""
    with connect(session.bench_rig) as hand:
        hand.prepare()
        result = identify(hand, catalogue)
    assert not any(session.torque().values())
    assert all(f.hardest_n <= session.rig.closing.max_force_n for f in session.bench.fingers)
    assert result.recognition is not None
    assert session.placement is not None
    truth = compare_answer(session.placement, result.recognition.hypotheses)
    assert truth.named, truth
    assert truth.inside_bounds, truth
    return result


def shape_of(placement: Placement) -> shapely.Polygon:
    """The object's lowest section where it really lies, in W."""
    parts = [shapely.Polygon(p.outer, p.holes) for p in placement.state.sections[0].polygons]
    turned = affinity.rotate(shapely.union_all(parts), placement.theta_rad, origin=(0, 0), use_radians=True)
    placed = affinity.translate(turned, placement.x_mm, placement.y_mm)
    assert isinstance(placed, shapely.Polygon)
    return placed


def angle_in(angle: float, lo: float, hi: float) -> bool:
    """Whether a direction is in a range that runs counter-clockwise from lo to hi."""
    return (angle - lo) % (2 * math.pi) <= hi - lo


# ----------------------------------------------------------------------------------------------------
# Is what a touch claims true of the bench? For tests that know where the part and the tip really are.

SEVERAL = frozenset({PatchFlag.WIDE, PatchFlag.SEVERAL_PATCHES})


def check_touch(shape: shapely.Geometry, touch: Touch, centre: np.ndarray, radius: float) -> None:
    """Compare one touch with the true section and the true centre of the tip while it was measured."""
    contact = touch.contact
    way = shapely.LineString([contact.start_mm, contact.end_mm])
    assert way.distance(shape) >= radius - contact.path_bound_mm
    if not contact.touched:
        return
    assert touch.patch is not None
    tip = shapely.Point(centre)
    nearest = shapely.get_point(shapely.shortest_line(shape.boundary, tip), 0)
    outward = np.array([tip.x - nearest.x, tip.y - nearest.y])
    if shape.contains(tip):
        outward = -outward
    just_touching = np.array([nearest.x, nearest.y]) + radius * outward / np.hypot(*outward)
    # A tip in a notch touches twice; then the nearer edge need not be the one that was measured.
    alone = shapely.Point(just_touching).distance(shape) > radius - 1e-6 and not touch.patch.flags & SEVERAL
    if alone:
        assert math.dist(contact.end_mm, just_touching) <= contact.position_bound_mm
        if contact.normal is not None:
            angle = math.atan2(outward[1], outward[0])
            assert angle_in(angle, contact.normal.lo_rad, contact.normal.hi_rad)
        return
    where = shapely.Point(contact.end_mm).buffer(contact.position_bound_mm)
    near = shape.buffer(radius, quad_segs=128).boundary.intersection(where)
    assert not near.is_empty
    if contact.normal is not None:
        found = []
        for point in shapely.get_coordinates(shapely.segmentize(near, 0.02)):
            foot = shapely.get_point(shapely.shortest_line(shape.boundary, shapely.Point(point)), 0)
            found.append(math.atan2(point[1] - foot.y, point[0] - foot.x))
        assert any(angle_in(angle, contact.normal.lo_rad, contact.normal.hi_rad) for angle in found)


# ----------------------------------------------------------------------------------------------------
# Random grips of an emulated session, each touch checked against the bench's truth.


def random_grip(session: EmulatedSession, rng: np.random.Generator) -> list[FingerApproach]:
    """One approach of each finger, most of them towards where things lie."""
    reach = reach_of(session.rig)
    grip = []
    for index in range(len(session.rig.fingers)):
        own = reach.of_finger(index)
        k = int(np.clip(rng.normal(len(own) / 2, len(own) / 8), 0, len(own) - 1))
        grip.append(reach.approaches[own[k]])
    return grip


def run_checked(session: EmulatedSession, grips: int, seed: int) -> list[Touch]:
    """Several random grips in one connection, each touch checked against the bench's truth."""
    shape = shapely.union_all([shape_of(placement) for placement in session.bench_rig.placements])
    rng = np.random.default_rng([seed, 77])
    centres: list[np.ndarray] = []

    def remember(stage: GripPhase) -> None:
        if stage is GripPhase.RETRACTING:
            centres[:] = [finger.centre_mm for finger in session.bench.fingers]

    every = []
    with connect(session.bench_rig) as hand:
        for _ in range(grips):
            touches = session.grip(hand, random_grip(session, rng), remember)
            for touch in touches:
                radius = session.rig.fingers[touch.finger_index].tip.radius_mm
                check_touch(shape, touch, centres[touch.finger_index], radius)
            every += touches
    limit = session.rig.closing.max_force_n
    assert all(finger.hardest_n <= limit for finger in session.bench.fingers)
    assert not any(session.torque().values())
    return every
