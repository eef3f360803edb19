"""Presses on references, simulated and on the emulated rig."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints
from palpate.calibration.idle_statistics import PressAtBearing
from palpate.calibration.measurements import (
    LEG_FREE,
    LEG_IN,
    LEG_OUT,
    IdleMeasurement,
    PressMeasurement,
    Probe,
    ServoPath,
)
from palpate.config import RigFile
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.tip import PartSection, tip_load
from palpate.drivers.kinematics import TICK_RAD
from palpate.drivers.tactile.description import Description, Shape
from palpate.rig.bench import connect
from palpate.rig.commissioning.hand_prober import HandProber
from palpate.rig.emulated.scene import ReferencePlacer
from palpate.rig.motion.hand import Hand
from support.benches.session import EmulatedSession, emulated_session
from support.benches.touched_references import DISC, FRESH

# ----------------------------------------------------------------------------------------------------
# A press as a slide's servo reports it: angles in encoder steps and currents, as travel and push.

CURRENT_STEP_A = 2.69e-3


def slide_press(
    slide_rad: Floats,
    mm_per_rad: float,
    current_a: Floats,
    leg: Ints,
    counts: Floats | None = None,
    *,
    newton_per_a: float = 1.0,
    placing: int = 0,
) -> PressMeasurement:
    """Of finger f1; `current_a` (n,): positive if it pushes the tip out."""
    return PressMeasurement(
        "f1",
        placing,
        mm_per_rad * slide_rad,
        current_a * newton_per_a,
        leg,
        np.zeros((len(leg), 1, 1)) if counts is None else counts,
        abs(mm_per_rad) * TICK_RAD,
        CURRENT_STEP_A * newton_per_a,
        np.zeros(len(leg)),
        np.zeros(len(leg)),
        (0.0, newton_per_a),
    )


# ----------------------------------------------------------------------------------------------------
# Presses of a slide's tip against a disc and a flat face, as the emulated tip and taxels have them.
#
# Made from the emulators' physics, sample by sample, without servos: the current is what the slide pushes
# with and its friction, in the steps that Present Current has.

ROWS, COLS, PITCH = 8, 20, math.radians(13.5)
MM_PER_RAD = 100.0 / (2 * math.pi)
NEWTON_PER_A = 1.78 / (MM_PER_RAD * 1e-3)
SAMPLE_MM = 0.03
"""Travel from one sample to the next: 3 mm/s and 100 samples a second."""

DISC_MM = 25.0
BEARINGS_DEG = tuple(np.linspace(-50, 50, 9))
FACES_DEG = (-6.0, 9.0)

DESCRIPTION = Description(
    unique_id=b"test array no. 3",
    firmware="emulated 0.1",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=ROWS,
    cols=COLS,
    bit_depth=12,
    max_rate_hz=500.0,
    full_scale_n=2.0,
    counts_per_n=2000.0,
    tip_radius_mm=5.0,
    columns=tuple((j - 9.5) * PITCH for j in range(COLS)),
    row_heights_mm=tuple(1.0 + 2.0 * i for i in range(ROWS)),
)


def disc(radius_mm: float, sides: int = 360) -> PartSection:
    """A disc round (0, 0)."""
    angle = 2 * math.pi * np.arange(sides) / sides
    corners = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    return PartSection(corners, np.roll(corners, -1, axis=0), 60.0)


def face() -> PartSection:
    """A straight edge along y through (0, 0), touched from x < 0."""
    return PartSection(np.array([[0.0, -60.0]]), np.array([[0.0, 60.0]]), 60.0)


@dataclass(frozen=True)
class Truth:
    """What the fit does not know of a finger."""

    tip_radius_mm: float = 5.0
    stiffness_n_per_mm: float = 3.0
    phase_rad: float = 0.0
    friction_a: float = 0.05 / 1.78
    play_mm: float = 0.08


class PressingFinger:
    """A finger that presses; `taxels` are its array's, `rng` everything else that is left to chance."""

    def __init__(self, truth: Truth, taxels: Taxels, rng: np.random.Generator) -> None:
        self.truth = truth
        self.taxels = taxels
        self._rng = rng

    def idle(self) -> IdleMeasurement:
        """Five seconds of the untouched array."""
        time_s = np.arange(1000) / 200.0
        return IdleMeasurement("f1", self.taxels.counts(np.zeros((1000, ROWS, COLS)), time_s), time_s)

    def press(
        self, bearing_rad: float, disc_mm: float | None, force_n: float, bearing_sigma_rad: float
    ) -> PressAtBearing:
        """Press until the skin bears about `force_n`; `disc_mm` None for a flat face.

        `bearing_rad` at first contact; what is told of it is off by `bearing_sigma_rad`.
        """
        deepest = force_n / self.truth.stiffness_n_per_mm / math.cos(bearing_rad)
        way = np.arange(-3.0, deepest, SAMPLE_MM)
        place = np.concatenate([way, way[::-1]])
        leg = np.concatenate([np.where(way < 0, LEG_FREE, LEG_IN), np.full(len(way), LEG_OUT)])
        aim = float(self._rng.uniform(0, 2 * math.pi))
        felt, push = self._felt(way, bearing_rad, disc_mm, aim)
        felt, push = np.concatenate([felt, felt[::-1]]), np.concatenate([push, push[::-1]])
        raw = self.taxels.counts(felt).astype(float)
        zero = self.taxels.counts(np.zeros((100, ROWS, COLS))).mean(axis=0)
        outward = np.where(leg == LEG_OUT, -1.0, 1.0)
        current = push / NEWTON_PER_A + outward * self.truth.friction_a
        drive = (place + outward * self.truth.play_mm + self._rng.uniform(20, 60)) / MM_PER_RAD
        made = slide_press(
            np.rint(drive / TICK_RAD) * TICK_RAD,
            MM_PER_RAD,
            np.rint(current / CURRENT_STEP_A) * CURRENT_STEP_A,
            leg,
            raw - zero,
            newton_per_a=NEWTON_PER_A,
        )
        told = bearing_rad + bearing_sigma_rad * float(self._rng.standard_normal())
        return PressAtBearing(made, told, bearing_sigma_rad, 0.0 if disc_mm is None else 1 / disc_mm)

    def _felt(self, way: Floats, bearing: float, disc_mm: float | None, aim: float) -> tuple[Floats, Floats]:
        """Forces (n, rows, cols) N on taxels and (n,) N against the travel, which has direction `aim`.

        A face's outline has its own direction, so that there the aim is what the bearing makes it.
        """
        t = self.truth
        if disc_mm is None:
            outline, aim, start = face(), -bearing, np.array([-t.tip_radius_mm, 0.0])
        else:
            towards = aim + bearing
            outline = disc(disc_mm)
            start = -(disc_mm + t.tip_radius_mm) * np.array([math.cos(towards), math.sin(towards)])
        along = np.array([math.cos(aim), math.sin(aim)])
        felt, push = np.zeros((len(way), ROWS, COLS)), np.zeros(len(way))
        for i in np.flatnonzero(way >= 0):
            touch = tip_load(outline, start + way[i] * along, t.tip_radius_mm, t.stiffness_n_per_mm)
            if touch is not None:
                felt[i] = by_column(touch.angle, touch.by_ray_n, aim + t.phase_rad) / ROWS
                push[i] = -touch.force_n @ along
        return felt, push


def by_column(angle: Floats, by_ray: Floats, middle: float) -> Floats:
    """Sort rays into columns as the emulated bench does; `middle`: where the array's middle looks."""
    seen = (angle - middle + math.pi) % (2 * math.pi) - math.pi
    slot = np.floor((seen - DESCRIPTION.columns[0]) / PITCH + 0.5).astype(np.int64)
    on_array = (slot >= 0) & (slot < COLS)
    return np.bincount(slot[on_array], by_ray[on_array], minlength=COLS)


def presses_of(finger: PressingFinger, bearings_deg: Sequence[float] = BEARINGS_DEG) -> list[PressAtBearing]:
    """Presses against a disc at some bearings and two against a face."""
    wanted = [(b, DISC_MM) for b in bearings_deg] + [(b, None) for b in FACES_DEG]
    return [finger.press(math.radians(b), size, 3.5, math.radians(0.3)) for b, size in wanted]


# ----------------------------------------------------------------------------------------------------
# The emulated fresh rig with a disc on its table; where its fingers really meet it is told with shapely.

GOAL_CURRENT = 102
HARD_N = 8.0  # max_force_n of the rig file
# 0.05 Nm of friction of a motor with 4.1 Nm at 2.3 A (e-Manual).
FRICTION_A = 0.05 * 2.3 / 4.1


@dataclass(frozen=True, eq=False)
class ProbedRig:
    """A rig that is connected and prepared."""

    session: EmulatedSession
    hand: Hand
    prober: HandProber

    def truth(self, finger: int) -> FingerTruth:
        truth = self.session.bench.fingers[finger].truth
        assert isinstance(truth, FingerTruth)
        return truth

    def put_disc(self) -> None:
        """Put it near the middle."""
        self.prober.put(DISC, (0.0, 0.0))

    def head_on(self) -> list[Probe]:
        """For each finger its approach that passes nearest to the disc's middle, up to its true contact."""
        found = []
        for index in range(len(self.session.bench.fingers)):
            own = [k for k, item in enumerate(self.prober.approaches) if item.finger == index]
            best = min(own, key=lambda k: abs(self._aside_mm(self.prober.approaches[k])))
            found.append(Probe(best, self.contact_mm(self.prober.approaches[best])))
        return found

    def contact_mm(self, approach: ServoPath) -> float:
        """Travel of the host's at which a tip begins to touch."""
        return travel_mm(approach, self.contact_rad(approach))

    def contact_rad(self, approach: ServoPath) -> float:
        """Angle of the slide's servo at which a tip begins to touch: its drive is a half play ahead of it."""
        truth = self.truth(approach.finger)
        shape, direction = self._shape(), self._direction_rad(approach)

        def gap(distance: float) -> float:
            x = truth.base_mm[0] + distance * math.cos(direction)
            y = truth.base_mm[1] + distance * math.sin(direction)
            return shape.distance(shapely.Point(x, y)) - truth.tip_radius_mm

        near, far = 50.0, math.dist(truth.base_mm, shape.centroid.coords[0])
        assert gap(near) > 0 > gap(far)
        for _ in range(40):
            middle = (near + far) / 2
            near, far = (middle, far) if gap(middle) > 0 else (near, middle)
        return (near + truth.slide_play_mm - truth.zero_mm) / truth.mm_per_rad

    def goal_current(self, dxl_id: int) -> int:
        """Goal Current of a servo, in its unit, from its control table."""
        answer = self.session.servos[dxl_id].answer_block(GOAL_CURRENT, 2)
        assert answer is not None
        return int.from_bytes(answer.params[:2], "little")

    def forget_forces(self) -> None:
        for finger in self.session.bench.fingers:
            finger.hardest_n = 0.0

    def hardest_n(self) -> float:
        """The largest force on any tip."""
        return max(finger.hardest_n for finger in self.session.bench.fingers)

    def waits(self) -> bool:
        """Whether all tips are outside of the workspace."""
        fingers: Sequence[EmulatedFinger] = self.session.bench.fingers
        return all(np.hypot(*finger.centre_mm) > FRESH.workspace.radius_mm for finger in fingers)

    def _shape(self) -> shapely.Polygon:
        (outline,) = self.session.bench.fingers[0].outlines
        assert outline is not None
        return shapely.Polygon(outline.start)

    def _direction_rad(self, approach: ServoPath) -> float:
        truth = self.truth(approach.finger)
        return truth.heading_rad + (float(approach.servos_rad[0, 0]) - truth.aim_zero_rad) / truth.gear_ratio

    def _aside_mm(self, approach: ServoPath) -> float:
        direction, middle = self._direction_rad(approach), self._shape().centroid
        x, y = self.truth(approach.finger).base_mm
        return math.cos(direction) * (middle.y - y) - math.sin(direction) * (middle.x - x)


def travel_mm(approach: ServoPath, slide_rad: float) -> float:
    """Travel of a slide along an approach whose servo stands at an angle."""
    start, end = approach.servos_rad[:, 1].tolist()
    return (slide_rad - start) / (end - start) * approach.length_mm


@contextmanager
def probed_rig(fingers: int, seed: int = 3, rig: RigFile = FRESH) -> Iterator[ProbedRig]:
    """The first fingers of the fresh rig: fewer are emulated faster."""
    rig = rig.model_copy(update={"fingers": rig.fingers[:fingers]})
    session = emulated_session(seed=seed, rig=rig, empty=True)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        yield ProbedRig(session, hand, HandProber(hand, ReferencePlacer(session.bench, seed)))
