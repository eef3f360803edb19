"""What an emulated rig has on its table, as a calibrated hand sees it: after the run, to compare answers.

A calibration cannot know where the rig stands on its table. It speaks of the hand frame, in which the fingers
are nearest to where the rig file has them (`calibration.hand_frame`); the emulators speak of the table's.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from palpate.calibration.hand_frame import Place, hand_frame
from palpate.config import RigFile
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.emulated import EmulatedRig, emulate
from palpate.rig.scene import Placement

__all__ = ["in_hand_frame", "placement_seen"]


def in_hand_frame(placement: Placement, rig: RigFile, truths: Sequence[FingerTruth | ArmTruth]) -> Placement:
    """A placement in the table's frame as it is in the hand frame of a rig as described.

    `truths`: where the rig's fingers really stand on the table, in its order.
    """
    described = [Place(finger.base_mm, math.radians(finger.heading_deg)) for finger in rig.fingers]
    found = [Place(truth.base_mm, truth.heading_rad) for truth in truths]
    motion = hand_frame(described, found)
    x, y = motion.point_mm((placement.x_mm, placement.y_mm))
    return replace(placement, x_mm=x, y_mm=y, theta_rad=placement.theta_rad + motion.angle_rad)


def placement_seen(
    on_bench: RigOnBench, placement: Placement | None, seed: int, emulated: EmulatedRig | None = None
) -> Placement | None:
    """The placement in the frame that the rig's answers are in: the hand frame once fingers' places were
    calibrated, else that of the rig file.

    `emulated`: the rig as described, as it was made for this placement and seed; made anew without it.
    """
    file = on_bench.calibration
    if placement is None or file is None or all(finger.place is None for finger in file.fingers):
        return placement
    devices = emulated or emulate(on_bench.described, placement, seed)
    return in_hand_frame(placement, on_bench.described, [item.truth for item in devices.bench.fingers])
