"""What an emulated rig has on its table, as a calibrated hand sees it: after the run, to compare answers.

A calibration cannot know where the rig stands on its table. It speaks of the hand frame, in which the fingers
are nearest to where the rig file has them (`calibration.hand_frame`); the emulators speak of the table's.
"""

from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.emulated.answer_error import in_hand_frame
from palpate.rig.emulated.devices import EmulatedRig, emulate
from palpate.rig.emulated.scene import Placement

__all__ = ["placement_in_hand_frame"]


def placement_in_hand_frame(
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
