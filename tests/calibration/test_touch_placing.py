"""A placing from its first touch to its last: the grip that is made again is the first that met something."""

from collections.abc import Sequence

from simulated_prober import SimulatedProber, SimulatedRig
from touched_references import DISC, FRESH

from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.finger_model import nominal_models
from palpate.calibration.finger_step import touch_placing
from palpate.calibration.measurements import Probe, TouchMeasurement
from palpate.config import RigFile

LOOKS = 3  # grips that look for the first reference


class MissingOnce(SimulatedProber):
    """The first grip after those that look for the reference meets nothing."""

    def __init__(self, world: SimulatedRig, rig: RigFile) -> None:
        super().__init__(world, rig)
        self.grips: list[list[Probe]] = []

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        self.grips.append(list(grip))
        found = super().touch(grip, placing)
        return [None] * len(found) if len(self.grips) == LOOKS + 1 else found


def test_the_grip_that_is_made_again_met_something_at_first() -> None:
    rig = FRESH.model_copy(update={"fingers": FRESH.fingers[:1]})
    prober = MissingOnce(SimulatedRig(rig, 3), rig)
    placings = [ReferencePlacement(DISC, (0.0, 0.0))]
    touched = touch_placing(
        prober, rig.fingers, nominal_models(rig.fingers), placings, [], tell=lambda _: None
    )
    assert prober.grips[-1] == prober.grips[LOOKS + 1]
    assert len(touched) == len(prober.grips) - 1
