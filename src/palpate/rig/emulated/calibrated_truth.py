"""Truth on an emulated table in the frame in which a calibrated rig answers.

A calibration cannot measure where the rig stands on its table. Its answers are in the hand frame, in which
the fingers are nearest to where the rig file has them; the emulators' truth is in the table's frame.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from palpate.calibration.gauge_freedom import BasePose, align_to_nominal
from palpate.config import ArmFingerConfig, FingerConfig, RigFile
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.emulated.devices import EmulatedRig, emulate
from palpate.rig.emulated.scene import Placement, moved

__all__ = ["built_pose", "in_hand_frame", "placement_in_hand_frame"]


def placement_in_hand_frame(
    on_bench: RigOnBench, placement: Placement | None, seed: int, emulated: EmulatedRig | None = None
) -> Placement | None:
    """The placement in the frame that the rig's answers are in: the hand frame once fingers' places were
    calibrated, else that of the rig file.

    `emulated`: the rig as described, as it was made for this seed; made anew without it.
    With it, the part is where fingers have pushed it by now.
    """
    if placement is not None and emulated is not None:
        placement = moved(placement, emulated.bench.part.displacement)
    file = on_bench.calibration
    if placement is None or file is None or all(finger.place is None for finger in file.fingers):
        return placement
    devices = emulated or emulate(on_bench.described, None, seed)
    return in_hand_frame(placement, on_bench.described, [item.truth for item in devices.bench.fingers])


def in_hand_frame(placement: Placement, rig: RigFile, truths: Sequence[FingerTruth | ArmTruth]) -> Placement:
    """The placement as a calibrated rig speaks of it: fingers stand nearest to the drawing there.

    `rig` is the drawing, the rig file before it was calibrated; `truths` are its fingers', in their order.
    """
    drawn = [BasePose(finger.base_mm, math.radians(finger.heading_deg)) for finger in rig.fingers]
    built = [built_pose(spec, truth) for spec, truth in zip(rig.fingers, truths, strict=True)]
    moved = align_to_nominal(drawn, built)
    x, y = moved.point_mm((placement.x_mm, placement.y_mm))
    return replace(placement, x_mm=x, y_mm=y, theta_rad=placement.theta_rad + moved.angle_rad)


def built_pose(spec: FingerConfig, truth: FingerTruth | ArmTruth) -> BasePose:
    """Where a finger really stands; an arm's heading as a calibration has it, with the shoulder's zero."""
    heading = truth.heading_rad
    if isinstance(spec, ArmFingerConfig) and isinstance(truth, ArmTruth):
        described_rad = math.radians(spec.shoulder.zero_deg) - math.pi
        heading += (described_rad - truth.shoulder.zero_rad) / spec.shoulder.gear_ratio
    return BasePose(truth.base_mm, heading)
