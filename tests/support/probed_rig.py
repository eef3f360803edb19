"""The emulated fresh rig with a disc on its table; where its fingers really meet it is told with shapely."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import shapely
from emulated_session import EmulatedSession, emulated_session
from touched_references import DISC, FRESH

from palpate.calibration.measurements import Probe, ServoPath
from palpate.config import RigFile
from palpate.drivers.emulators.bench import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.bench import connect
from palpate.rig.commissioning.hand_prober import HandProber
from palpate.rig.emulated.scene import ReferencePlacer
from palpate.rig.motion.hand import Hand

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
        outline = self.session.bench.fingers[0].outline
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
